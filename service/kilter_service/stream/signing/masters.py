"""The master secret from which the keys of all sessions are derived, in a file only its owner can read.

Nothing else is stored: a corrector that has the secret derives the key of any session from the session's id, so keys survive
its restart and an outage of the API. After a rotation the secret before it is valid for a stated time.

`kilterd stream-keys`: shows and rotates the master secret of the stream.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import secrets
import stat
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hmac import compare_digest
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.sealed import Session

SECRET_BYTES = 32
LONGEST_S = 7 * 86_400
OVERLAP_S = 86_400


@dataclass(frozen=True)
class Master:
    """One secret; ``until`` is when it ends (s since 1970), None for the one in use."""

    secret: bytes
    until: float | None = None

    @property
    def number(self) -> int:
        """By which session ids name it."""
        return sealed.secret_number(self.secret)

    def valid(self, now_s: float) -> bool:
        """Whether sessions made under it are still taken."""
        return self.until is None or now_s < self.until


@dataclass(frozen=True)
class Masters:
    """The secret in use, which is the last one, those before it that are still valid, and sessions that were revoked."""

    all: tuple[Master, ...]
    revoked: frozenset[bytes] = frozenset()

    def find(self, number: int) -> Master | None:
        """The valid secret of this number."""
        now = time.time()
        return next((master for master in self.all if master.valid(now) and master.number == number), None)

    def new_session(self, lifetime_s: float) -> bytes:
        """Id of a new session under the secret in use."""
        expires = int(time.time() + lifetime_s)
        return Session(self.all[-1].number, expires, secrets.randbits(64)).encode()

    def session_key(self, session: bytes, site: str, robot: str, stream: str) -> bytes | None:
        """Key of a session; None when it was revoked, or its secret is not known here, or no longer valid."""
        if session in self.revoked:
            return None
        master = self.find(Session(*sealed.ID.unpack(session)).master)
        return sealed.session_key(master.secret, session, site, robot, stream) if master else None

    def sign_announcement(self, address: str, site: str, robot: str, body: bytes) -> bytes:
        """A document of the corrector about a robot, signed under each valid secret."""
        now = time.time()
        tags = [
            f"{master.number:08x}:{sealed.said_tag(sealed.robot_key(master.secret, site, robot), address, body).hex()}"
            for master in self.all
            if master.valid(now)
        ]
        return sealed.signed_document(body, " ".join(tags))

    def heard(self, address: str, site: str, robot: str, data: bytes) -> bytes | None:
        """Document of an announcement that :meth:`sign_announcement` signed under a valid secret, else None."""
        opened = sealed.opened_document(data)
        if opened is None:
            return None
        body, tags = opened
        for number, given in tags.items():
            master = self.find(number)
            if master is not None:
                key = sealed.robot_key(master.secret, site, robot)
                return body if compare_digest(sealed.said_tag(key, address, body), given) else None
        return None

    def with_rotated_secret(self, overlap_s: float) -> Masters:
        """With a new secret in use; the one before ends after ``overlap_s``."""
        now = time.time()
        kept = [master for master in self.all if master.valid(now)]
        kept[-1] = Master(kept[-1].secret, now + overlap_s)
        return Masters((*kept, new_master()), self.revoked)

    def with_sessions_revoked(self, sessions: Iterable[bytes]) -> Masters:
        """With these sessions revoked too; those that have ended by themselves are forgotten."""
        now = time.time()
        named = {*self.revoked, *sessions}
        return Masters(self.all, frozenset(one for one in named if Session(*sealed.ID.unpack(one)).expires_s > now))


def new_master() -> Master:
    """A new random secret."""
    return Master(secrets.token_bytes(SECRET_BYTES))


def load_masters(file: Path, make: bool = True) -> Masters:
    """The secrets of a file, which is made when it does not exist.

    Raises:
        ServiceError: others can read the file, or it is damaged.

    """
    if make and not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file, Masters((new_master(),)), replace=False)
    if stat.S_IMODE(file.stat().st_mode) & 0o077:
        raise ServiceError(
            f"{file} can be read by others: run `chmod 600 {file}`, then `kilterd stream-keys --rotate --overlap-h 0`.",
            code="token_file_open",
            path=str(file),
        )
    try:
        document = json.loads(file.read_text(encoding="ascii"))
        revoked = frozenset(bytes.fromhex(one) for one in document.get("revoked", ()))
        if any(len(one) != sealed.SESSION_BYTES for one in revoked):
            raise ValueError("a revoked session without 16 bytes")
        masters = Masters(tuple(Master(bytes.fromhex(r["secret"]), r["until"]) for r in document["keys"]), revoked)
        if not masters.all or any(len(master.secret) != SECRET_BYTES for master in masters.all):
            raise ValueError("no secret of 32 bytes")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ServiceError(
            f"{file} is damaged ({error}): restore it from a backup, or delete it: a new one is made at the next "
            "start, and then every controller needs a new session.",
            code="stream_keys_damaged",
            path=str(file),
        ) from error
    return masters


def update_masters_file(file: Path, change: Callable[[Masters], Masters]) -> Masters:
    """Change the secrets of a file, one process after the other, and return what is there now."""
    with os.fdopen(os.open(file.with_name(f"{file.name}.lock"), os.O_WRONLY | os.O_CREAT, 0o600), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        masters = change(load_masters(file))
        write(file, masters)
    return masters


def write(file: Path, masters: Masters, replace: bool = True) -> None:
    """Write the secrets (mode 0600). Without ``replace`` a file that is there stays: two processes may start at once."""
    draft = file.with_name(f"{file.name}.{os.getpid()}.{secrets.token_hex(4)}")
    rows = [{"secret": master.secret.hex(), "until": master.until} for master in masters.all]
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as out:
        out.write(json.dumps({"keys": rows, "revoked": sorted(one.hex() for one in masters.revoked)}) + "\n")
        out.flush()
        os.fsync(out.fileno())
    if replace:
        draft.replace(file)
        return
    try:
        os.link(draft, file)
    except FileExistsError:
        return
    finally:
        draft.unlink()


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


def show_or_rotate(settings: Settings, given: argparse.Namespace) -> None:
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
