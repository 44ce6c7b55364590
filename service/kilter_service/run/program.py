"""`kilterd`: the commands that run Kilter's processes."""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from pydantic import ValidationError

from kilter_files.ground.later import later
from kilter_service.ground.private_files import UMASK, protect
from kilter_service.ground.settings import DATABASE_FILE, JOBS_FILE, Settings, code_version
from kilter_service.run import zenoh_folders
from kilter_service.stream.signing import masters
from kilter_service.web import logs

# A command loads what it runs, and nothing else.
with later(__name__):
    from kilter_service.ground import db, private_files
    from kilter_service.ground.db import failures, revision
    from kilter_service.jobs.work import worker as jobs
    from kilter_service.run import compiling, serving, supervisor
    from kilter_service.run.backup import commands
    from kilter_service.run.backup import upgrade as upgrading
    from kilter_service.run.doctor import commands as doctor_commands
    from kilter_service.stream import ros2_process
    from kilter_service.stream.corrector import process as corrector_process
    from kilter_service.web import audit as audits
    from kilter_service.web.auth import token

ASIDE = frozenset({"compile", "doctor"})  # which change nothing in the data folder
TRACED = frozenset({"api", "worker"})
USAGE_CODES = frozenset(
    {
        "binding_refused",
        "token_file_open",
        "token_weak",
        "stream_keys_damaged",
        "jobs_taken",
        "seal_key_other",
        "seal_key_unusable",
        "webhook_secret_unusable",
    }
)
Command = Callable[[Settings, argparse.Namespace], None]


def serve(settings: Settings, _: argparse.Namespace) -> None:
    """Run API, worker and corrector together, and the ROS 2 adaptor where topics are set."""
    supervisor.serve(settings)


def api(settings: Settings, arguments: argparse.Namespace) -> None:
    """Run the HTTP API alone."""
    if arguments.fd is not None:
        serving.serve(settings, socket.socket(fileno=arguments.fd))
        return
    token.check_binding(settings)
    token.admin_token(settings)
    with serving.listener(settings) as opened, private_files.ServerFile(settings.server_file) as file:
        serving.check_database(settings)
        document = {
            "url": serving.listening_url(opened, settings),
            "pid": os.getpid(),
            "zenoh": None,
            "data": str(settings.data),
        }
        file.write(document)
        print(json.dumps(document), flush=True)
        serving.serve(settings, opened)


def worker(settings: Settings, arguments: argparse.Namespace) -> None:
    """Run a process that executes jobs."""
    if not arguments.supervised:  # nobody migrates the database meanwhile
        serving.check_database(settings)
    with serving.lasting():
        run = jobs.run  # imports the worker's libraries
    run(settings)


def corrector(settings: Settings, arguments: argparse.Namespace) -> None:
    """Run the process that corrects setpoints over zenoh."""
    corrector_process.run(settings, arguments.deserted.is_set)


def ros2(settings: Settings, _: argparse.Namespace) -> None:
    """Run the process that corrects messages of ROS 2."""
    ros2_process.run(settings)


def migrate(settings: Settings, _: argparse.Namespace) -> None:
    """Bring the database to the revision of this Kilter."""
    done = upgrading.upgrade(settings)
    print(f"The database {'was brought to' if done.steps else 'is at'} revision {revision.HEAD}.")
    if done.copy is not None:
        print(f"As it was it is kept as {done.copy}.")


def upgrade(settings: Settings, arguments: argparse.Namespace) -> None:
    """Bring the database to the revision of this Kilter, or say what that would do (--check)."""
    commands.upgrade(settings, arguments)


def audit(settings: Settings, arguments: argparse.Namespace) -> None:
    """Check that the audit in a database is whole; no server need run."""
    head = audits.parse_head(arguments.head)
    noted = [] if head is None else [head]
    if arguments.journal:
        told = audits.parse_journal_heads(Path(arguments.journal))
        print(f"The journal names {len(set(told))} entries.")
        noted += told
    database = db.Database(settings.database)
    try:
        revision.check(database)
        last = audits.verify(database, *noted)
    finally:
        database.close()
    print(f"The audit is whole: {last.number} entries, the last is {last.number}:{last.sha256}.")


def doctor(settings: Settings, arguments: argparse.Namespace) -> None:
    """Check what the server needs on this machine, one line each, with the remedy."""
    doctor_commands.doctor(settings, arguments)


def backup(settings: Settings, arguments: argparse.Namespace) -> None:
    """Write all that is stored to a file, while the server runs."""
    commands.backup(settings, arguments)


def restore(settings: Settings, arguments: argparse.Namespace) -> None:
    """Bring a backup into an empty data folder or database."""
    commands.restore(settings, arguments)


def verify(settings: Settings, arguments: argparse.Namespace) -> None:
    """Check every hash of the database, or of a backup, while the server runs."""
    commands.verify(settings, arguments)


def seal(settings: Settings, arguments: argparse.Namespace) -> None:
    """Seal all rows anew: with a new key, or after a change by hand."""
    commands.seal(settings, arguments)


def purge_jobs(settings: Settings, arguments: argparse.Namespace) -> None:
    """Delete jobs that ended long ago and that nothing needs, while the server runs."""
    age = jobs.parse_age(arguments.older_than)
    database = db.Database(settings.database)
    try:
        revision.check(database)
        if arguments.dry_run:
            print(f"{jobs.count(database, age)} jobs would be purged.")
            return
        print(f"{jobs.purge(database, age, 'kilterd purge-jobs')} jobs were purged; the audit names them.")
    finally:
        database.close()


def compile_kernels(_: Settings, __: argparse.Namespace) -> None:
    """Compile the numeric kernels once, for every process of this installation; nothing else is touched."""
    compiling.compile_kernels()


def stream_keys(settings: Settings, arguments: argparse.Namespace) -> None:
    """Show or rotate the secret from which the keys of the stream are derived."""
    masters.show_or_rotate(settings, arguments)


def zenoh_config(settings: Settings, arguments: argparse.Namespace) -> None:
    """Write zenoh configurations with TLS and access control, one folder per role, or rotate their certificates."""
    zenoh_folders.write_role_folders(settings, arguments)


COMMANDS: dict[str, tuple[Command, str]] = {
    "serve": (serve, "kilterd serve --data ~/kilter --port 8730"),
    "api": (api, "kilterd api --port 0"),
    "worker": (worker, "KILTER_WORKER_NAME=second kilterd worker"),
    "corrector": (corrector, "KILTER_ZENOH_LISTEN=tcp/127.0.0.1:7447 kilterd corrector"),
    "ros2": (ros2, "KILTER_ROS2='{...}' kilterd ros2"),
    "audit": (audit, "kilterd audit --data /backup/kilter"),
    "zenoh-config": (zenoh_config, zenoh_folders.EXAMPLE),
    "stream-keys": (stream_keys, masters.EXAMPLE),
    "migrate": (migrate, "KILTER_DATABASE_URL=postgresql://kilter@db/kilter kilterd migrate"),
    "upgrade": (upgrade, "kilterd upgrade --check"),
    "backup": (backup, "kilterd backup /backups --keep 14"),
    "restore": (restore, "kilterd restore /backups/kilter-20261122T181500Z.kilter-backup --data ~/restored"),
    "verify": (verify, "kilterd verify"),
    "seal": (seal, "KILTER_SEAL_KEY=/etc/kilter/seal-key kilterd seal"),
    "purge-jobs": (purge_jobs, "kilterd purge-jobs --older-than 30d"),
    "doctor": (doctor, "kilterd doctor --json"),
    "compile": (compile_kernels, "sudo /opt/kilter/bin/kilterd compile"),
}
PATHS = {
    "backup": ("PATH", "?", "file to write, or a folder, where it is named after the time (default: KILTER_BACKUPS)"),
    "restore": ("FILE", None, "file that `kilterd backup` wrote"),
    "verify": ("FILE", "?", "a backup to check (default: the database of the server)"),
}
ACCEPTS = {
    "seal": "take the rows as they are, whatever their seals say",
    "restore": "restore although its seals cannot be compared: they have another key, or none",
}
NAMES = ", ".join(f"KILTER_{name.upper()}" for name in Settings.model_fields)
ENVIRONMENT = f"Every setting is also an environment variable: {NAMES}."


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    root = argparse.ArgumentParser(
        prog="kilterd", description="The server of Kilter.", epilog=f"Example: kilterd serve. {ENVIRONMENT}"
    )
    root.add_argument("--version", action="version", version=f"kilterd {code_version()}")
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (run, example) in COMMANDS.items():
        text = (run.__doc__ or "").strip()
        added = commands.add_parser(name, help=text, description=text, epilog=f"Example: {example}. {ENVIRONMENT}")
        added.add_argument("--data", help="folder of database, token and server file (default ~/.kilter)")
        added.add_argument("--database-url", help="SQLAlchemy URL (default: SQLite in the data folder)")
        if name in ("serve", "api"):
            added.add_argument("--host", help="address to listen on (default 127.0.0.1)")
            added.add_argument("--port", help="port to listen on, 0 for a free one (default 8730)")
        if name == "audit":
            added.add_argument("--head", help="NUMBER:SHA256 of an entry noted earlier, which must still be there")
            added.add_argument("--journal", help="log of the server: every entry that it names must still be there")
        if name in PATHS:
            shown, count, help_text = PATHS[name]
            added.add_argument("path", metavar=shown, nargs=count, help=help_text)
        if name == "backup":
            added.add_argument("--keep", metavar="N", type=_number, help="remove all but the newest N of the folder")
        if name == "purge-jobs":
            added.add_argument("--older-than", metavar="AGE", required=True, help="12h, 30d or 8w since a job ended")
            added.add_argument("--dry-run", action="store_true", help="only say how many it would be")
        if name in ACCEPTS:
            added.add_argument("--accept", action="store_true", help=ACCEPTS[name])
        if name == "upgrade":
            added.add_argument("--check", action="store_true", help="say what would change, and change nothing")
        if name == "doctor":
            added.add_argument("--json", action="store_true", help="print one JSON document")
        if name == "api":
            added.add_argument("--fd", type=int, help=argparse.SUPPRESS)
        if name == "stream-keys":
            masters.add_options(added)
        if name == "zenoh-config":
            zenoh_folders.add_options(added)
    return root


def _number(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} would keep none: give 1 or more")
    return number


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; exits 0 when it is done, 1 when it failed, 2 when it was called wrongly."""
    given = parser().parse_args(arguments)
    os.umask(UMASK)  # whatever a library writes, the database too, is its owner's
    # The fits are small: threads of the linear algebra library only wait for each other there, ten times slower on a
    # busy machine with two cores (docs/explanation/surprises.md). It is read when numpy is imported, by a command.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    overrides = {name: getattr(given, name, None) for name in ("data", "database_url", "host", "port")}
    try:
        settings = Settings(**{name: value for name, value in overrides.items() if value is not None})
        if given.command not in ASIDE:
            protect(settings.data, DATABASE_FILE, JOBS_FILE)
        logs.configure(settings, given.command)
        if given.command in TRACED:
            logs.configure_tracing(given.command)
        given.deserted = threading.Event()
        given.supervised = _end_with_parent(given.deserted)
        COMMANDS[given.command][0](settings, given)
    except ValidationError as error:
        for item in error.errors():
            name, *inside = map(str, item["loc"])
            by_option = overrides.get(name) is not None
            said = f"--{name.replace('_', '-')}" if by_option else f"KILTER_{name.upper()}"
            print(f"kilterd: {'.'.join([said, *inside])}: {item['msg']}", file=sys.stderr)
        sys.exit(2)
    except Exception as error:
        _exit_with_error(error)


def _exit_with_error(error: Exception) -> NoReturn:
    """Say in one sentence why the command ends; what Kilter does not know is raised again, with its traceback."""
    known = failures.in_words(error)
    if known is None and not isinstance(error, OSError):
        raise error
    logs.log_exit_reason(str(error) if known is None else known.message)
    sys.exit(2 if known is not None and known.code in USAGE_CODES else 1)


def _end_with_parent(deserted: threading.Event) -> bool:
    """Make a child of `kilterd serve` stop when the supervisor is gone, however it went; returns whether it is one.

    ``deserted`` is set then: a supervisor that stops in order says so before it is gone.
    """
    if os.environ.pop("KILTER_SUPERVISED", None) is None:
        return False

    def watch() -> None:
        while os.read(0, 1024):
            continue
        deserted.set()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True, name="parent-watch").start()
    return True
