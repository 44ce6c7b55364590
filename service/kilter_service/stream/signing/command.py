"""`kilterd stream-keys`: shows and rotates the master secret of the stream."""

from __future__ import annotations

import argparse
import time

from kilter_service.ground.settings import Settings
from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.masters import OVERLAP_S, load_masters, update_masters_file

EXAMPLE = "kilterd stream-keys --rotate --overlap-h 24"


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    command.add_argument(
        "--rotate", action="store_true", help="make a new secret; the one in use ends after the overlap"
    )
    command.add_argument(
        "--overlap-h",
        type=float,
        default=OVERLAP_S / 3600.0,
        help="how long the one before is valid, hours (default 24)",
    )
    command.add_argument(
        "--revoke",
        action="append",
        type=_session,
        metavar="SESSION",
        help="end a session at once, by its id of 32 hexadecimal digits; repeat for more",
    )


def _session(text: str) -> bytes:
    try:
        found = bytes.fromhex(text)
    except ValueError:
        found = b""
    if len(found) != sealed.SESSION_BYTES:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not the id of a session: give its 32 hexadecimal digits (`kilter server audit` has them)"
        )
    return found


def run(settings: Settings, given: argparse.Namespace) -> None:
    """Show or rotate the secret from which the keys of the stream are derived."""
    file = settings.stream_keys_file
    masters = load_masters(file)
    if given.rotate:
        masters = update_masters_file(file, lambda now: now.with_rotated_secret(max(0.0, given.overlap_h) * 3600.0))
    if given.revoke:
        masters = update_masters_file(file, lambda now: now.with_sessions_revoked(given.revoke))
    print(f"Secrets in {file}:")
    for master in masters.all:
        left_h = None if master.until is None else max(0.0, (master.until - time.time()) / 3600.0)
        print(f"  {master.number:08x}  {'in use' if left_h is None else f'valid for {left_h:.1f} h'}")
    for session in sorted(masters.revoked):
        print(f"  session {session.hex()} was revoked")
