"""`kilterd doctor` as a command."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import stat
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta

from kilter_service.ground import backup_folder
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import UMASK
from kilter_service.ground.settings import DATABASE_FILE, JOBS_FILE, TOKEN_FILE, Settings
from kilter_service.run.backup import store
from kilter_service.run.backup.service import verify_stored
from kilter_service.stream.corrector.fast_path import is_fast_path_compiled

LEAST_FREE_MB = 1024
SLOW_S = 1.0
AHEAD = timedelta(minutes=5)  # of this machine's clock: what was stored cannot be later than now
OLD_S = 48 * 3600.0  # a backup is made every night
TIMER = "`systemctl list-timers kilter-backup`, `journalctl -u kilter-backup`"
BUILT = datetime(2026, 11, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Check:
    """The outcome of a check."""

    name: str
    ok: bool
    detail: str


def _ok(detail: str) -> tuple[bool, str]:
    return True, detail


def _wrong(detail: str) -> tuple[bool, str]:
    return False, detail


def permissions(settings: Settings) -> tuple[bool, str]:
    """The data folder can be written to, and belongs to its owner alone."""
    data = settings.data
    if not data.exists():
        return _ok(f"{data} does not exist yet: the first start makes it")
    if not os.access(data, os.W_OK | os.X_OK):
        return _wrong(f"{data} cannot be written to: give it to this account (`chown`), or set KILTER_DATA to another")
    files = [path for name in (DATABASE_FILE, JOBS_FILE, TOKEN_FILE) for path in data.glob(f"{name}*")]
    if stat.S_IMODE(data.stat().st_mode) & UMASK:
        return _wrong(
            f"{data} is open to other accounts: run `chmod go= {data}`, unless others need the folder; no start changes it"
        )
    for path in files:
        if stat.S_IMODE(path.stat().st_mode) & UMASK:
            return _wrong(f"{path} is open to other accounts: run `chmod go= {path}` (the next start does it too)")
    return _ok(f"{data} belongs to its owner alone")


def disk(settings: Settings) -> tuple[bool, str]:
    """There is room for what comes."""
    folder = next(path for path in (settings.data.absolute(), *settings.data.absolute().parents) if path.exists())
    free = shutil.disk_usage(folder).free >> 20
    needed = max(LEAST_FREE_MB, 4 * settings.max_upload_mb)
    if free < needed:
        return _wrong(
            f"{free} MB are free under {folder}, {needed} MB should be: delete something, or move the data folder"
        )
    return _ok(f"{free} MB are free")


def database(settings: Settings) -> tuple[bool, str]:
    """The database answers, soon."""
    if settings.database_url is None and not (settings.data / DATABASE_FILE).exists():
        return _ok("SQLite, not there yet: the first start makes it")
    with _open_database(settings) as opened:
        start = time.monotonic()
        revision.current(opened)
        took = time.monotonic() - start
    kind = "SQLite" if settings.database_url is None else "PostgreSQL"
    if took > SLOW_S:
        return _wrong(f"{kind} took {took:.1f} s to answer: see what keeps it or its disk busy")
    return _ok(f"{kind} answers in {took * 1e3:.0f} ms")


def schema(settings: Settings) -> tuple[bool, str]:
    """The database is of this Kilter."""
    if settings.database_url is None and not (settings.data / DATABASE_FILE).exists():
        return _ok(f"the first start makes revision {revision.HEAD}")
    with _open_database(settings) as opened:
        revision.check(opened)
    return _ok(f"revision {revision.HEAD}")


def hashes(settings: Settings) -> tuple[bool, str]:
    """The newest measurements and all versions have their hashes."""
    if settings.database_url is None and not (settings.data / DATABASE_FILE).exists():
        return _ok("nothing is stored yet")
    found = verify_stored(settings, quick=True)
    if found.other_key:
        return _wrong(found.other_key)
    if found.damaged:
        return _wrong(f"{found.damaged[0]} Run `kilterd verify` for all, then `kilterd restore` a backup that is whole")
    return _ok(f"{found.describe_coverage()} looked at, `kilterd verify` looks at all")


def backup(settings: Settings) -> tuple[bool, str]:
    """A backup was made lately, and is whole."""
    folder = settings.backups
    if folder is None:
        return _ok("not looked for: set KILTER_BACKUPS to the folder that `kilterd backup` writes into")
    backup_folder.check_folder(folder)
    found = backup_folder.backups(folder)
    if not found:
        return _wrong(f"none in {folder}: run `kilterd backup`, and see that its timer is on ({TIMER})")
    newest, age_s = found[0], found[0].age_s()
    if age_s < -AHEAD.total_seconds():
        return _wrong(f"the newest, {newest.path.name}, is of a later time than now: set the clock, or move it away")
    if not backup_folder.has_hash(newest.path):
        return _wrong(f"the newest, {newest.path.name}, does not have its hash: move it away and run `kilterd backup`")
    told = f"the newest of {len(found)}, {newest.path.name}, is {age_s / 3600:.0f} h old"
    return (
        _wrong(f"{told}: run `kilterd backup`, and see why its timer did not ({TIMER})") if age_s > OLD_S else _ok(told)
    )


def clock(settings: Settings) -> tuple[bool, str]:
    """The clock is not behind what it was."""
    now = datetime.now(UTC)
    remedy = "set the clock (`timedatectl set-ntp true`): tokens, order and ages follow it"
    if now < BUILT:
        return _wrong(f"it is {now:%Y-%m-%d} by the clock of this machine: {remedy}")
    if settings.database_url is not None or (settings.data / DATABASE_FILE).exists():
        with _open_database(settings) as opened:
            last = store.latest_stored_time(opened) if revision.current(opened) == revision.HEAD else None
        if last is not None and last > now + AHEAD:
            return _wrong(
                f"it is {now:%Y-%m-%d %H:%M} UTC, and something was stored at {last:%Y-%m-%d %H:%M}: {remedy}"
            )
    return _ok(f"{now:%Y-%m-%d %H:%M} UTC")


def http_port(settings: Settings) -> tuple[bool, str]:
    """The port of the API is free, or the server has it."""
    return _port(settings.host, settings.port, "KILTER_PORT", _is_kilter(settings.host, settings.port))


def zenoh_port(settings: Settings) -> tuple[bool, str]:
    """The port of the corrector is free, or the corrector has it."""
    protocol, _, address = settings.zenoh_listen.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        return _ok(f"{settings.zenoh_listen} is not looked at")
    running = settings.corrector_file.exists() and settings.zenoh_listen in settings.corrector_file.read_text("utf-8")
    return _port(host.strip("[]"), int(port), "KILTER_ZENOH_LISTEN", running)


def zenoh_config(settings: Settings) -> tuple[bool, str]:
    """The configuration of zenoh can be read."""
    if settings.zenoh_config is None:
        return _ok("none: the stream stays on this machine")
    if not settings.zenoh_config.is_file():
        return _wrong(f"{settings.zenoh_config} does not exist: correct KILTER_ZENOH_CONFIG")
    import zenoh

    try:
        zenoh.Config.from_file(str(settings.zenoh_config))
    except Exception as error:  # zenoh raises its own without a name
        return _wrong(f"{settings.zenoh_config} is not a zenoh configuration ({str(error)[:200]}): correct it (JSON5)")
    return _ok(str(settings.zenoh_config))


def kernels(_: Settings) -> tuple[bool, str]:
    """The kernels of this release are compiled."""
    if not is_fast_path_compiled():
        return _wrong("not compiled yet: the first start takes a minute or two. `kilterd compile` compiles them before")
    return _ok("compiled")


CHECKS: dict[str, Callable[[Settings], tuple[bool, str]]] = {
    "permissions": permissions,
    "disk": disk,
    "database": database,
    "schema": schema,
    "hashes": hashes,
    "backup": backup,
    "clock": clock,
    "port": http_port,
    "zenoh port": zenoh_port,
    "zenoh config": zenoh_config,
    "kernels": kernels,
}


def run(settings: Settings) -> list[Check]:
    """Do every check; one that cannot be done says why."""
    return [_run_check(name, check, settings) for name, check in CHECKS.items()]


def _run_check(name: str, check: Callable[[Settings], tuple[bool, str]], settings: Settings) -> Check:
    try:
        return Check(name, *check(settings))
    except Exception as error:
        known = in_words(error)
        if known is None and not isinstance(error, OSError):
            raise
        return Check(name, False, str(error) if known is None else known.message)


@contextmanager
def _open_database(settings: Settings) -> Iterator[Database]:
    opened = Database(settings.database)
    try:
        yield opened
    finally:
        opened.close()


def _is_kilter(host: str, port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://{host}:{port}/v1/health/live", timeout=2) as answer:
            return b'"live"' in answer.read(1000)
    except (urllib.error.URLError, OSError, ValueError):
        return False


def _port(host: str, port: int, setting: str, ours: bool) -> tuple[bool, str]:
    if port == 0:
        return _ok("a free one is taken")
    if ours:
        return _ok(f"{port}: Kilter runs there")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise ServiceError(
            f"{host} port {port} cannot be listened on ({os.strerror(error.errno or 0)}): set {setting} to another",
            code="binding_refused",
        ) from error
    return _ok(f"{port} is free")


def doctor(settings: Settings, arguments: argparse.Namespace) -> None:
    """Print the checks; ends with 1 when one of them failed."""
    found = run(settings)
    wrong = [check for check in found if not check.ok]
    if arguments.json:
        print(json.dumps({"ok": not wrong, "checks": [asdict(check) for check in found]}, indent=1))
    else:
        for check in found:
            print(f"{'ok   ' if check.ok else 'WRONG'} {check.name}: {check.detail.rstrip('.')}.")
    if wrong:
        sys.exit(1)
