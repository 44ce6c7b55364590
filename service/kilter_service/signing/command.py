"""`kilterd stream-keys`: shows and rotates the master secret of the stream."""

from __future__ import annotations

import argparse
import time

from kilter_service.settings import Settings
from kilter_service.signing.masters import OVERLAP_S, masters_in, write

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


def run(settings: Settings, given: argparse.Namespace) -> None:
    """Show or rotate the secret from which the keys of the stream are derived."""
    file = settings.stream_keys_file
    masters = masters_in(file)
    if given.rotate:
        masters = masters.rotated(max(0.0, given.overlap_h) * 3600.0)
        write(file, masters)
    print(f"Secrets in {file}:")
    for master in masters.all:
        left_h = None if master.until is None else max(0.0, (master.until - time.time()) / 3600.0)
        print(f"  {master.number:08x}  {'in use' if left_h is None else f'valid for {left_h:.1f} h'}")
