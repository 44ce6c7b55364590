"""`kilterd`: the commands that run Kilter's processes."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence

from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_service.settings import Settings
from kilter_service.version import code_version

USAGE_CODES = frozenset({"binding_refused", "token_file_open", "jobs_taken"})
Command = Callable[[Settings, argparse.Namespace], None]


def serve(settings: Settings, _: argparse.Namespace) -> None:
    """Run API, worker and corrector together, and the ROS 2 adaptor where topics are set."""
    from kilter_service.supervisor import serve

    serve(settings)


def api(settings: Settings, arguments: argparse.Namespace) -> None:
    """Run the HTTP API alone."""
    from kilter_service import serving

    if arguments.fd is not None:
        serving.serve(settings, socket.socket(fileno=arguments.fd))
        return
    from kilter_service.auth.token import admin_token, check_binding
    from kilter_service.server_file import ServerFile

    check_binding(settings)
    admin_token(settings)
    with serving.listener(settings) as opened, ServerFile(settings.server_file) as file:
        serving.check_database(settings)
        document = {"url": serving.url_of(opened), "pid": os.getpid(), "zenoh": None, "data": str(settings.data)}
        file.write(document)
        print(json.dumps(document), flush=True)
        serving.serve(settings, opened)


def worker(settings: Settings, _: argparse.Namespace) -> None:
    """Run a process that executes jobs."""
    from kilter_service.jobs.worker import run

    run(settings)


def corrector(settings: Settings, _: argparse.Namespace) -> None:
    """Run the process that corrects setpoints over zenoh."""
    from kilter_service.corrector.process import run

    run(settings)


def ros2(settings: Settings, _: argparse.Namespace) -> None:
    """Run the process that corrects messages of ROS 2."""
    from kilter_service.ros2.process import run

    run(settings)


def migrate(settings: Settings, _: argparse.Namespace) -> None:
    """Bring the database to the revision of this Kilter."""
    from kilter_service.db import Database, revision

    database = Database(settings.database)
    try:
        done = revision.migrate(database)
    finally:
        database.close()
    print(f"The database {'was brought to' if done else 'is at'} revision {revision.HEAD}.")


COMMANDS: dict[str, tuple[Command, str]] = {
    "serve": (serve, "kilterd serve --data ~/kilter --port 8730"),
    "api": (api, "kilterd api --port 0"),
    "worker": (worker, "KILTER_WORKER_NAME=second kilterd worker"),
    "corrector": (corrector, "KILTER_ZENOH_LISTEN=tcp/127.0.0.1:7447 kilterd corrector"),
    "ros2": (ros2, "KILTER_ROS2='{...}' kilterd ros2"),
    "migrate": (migrate, "KILTER_DATABASE_URL=postgresql://kilter@db/kilter kilterd migrate"),
}
ENVIRONMENT = (
    "Every setting is also an environment variable: KILTER_DATA, KILTER_DATABASE_URL, KILTER_HOST, KILTER_PORT, "
    "KILTER_TOKEN, KILTER_ZENOH_CONFIG, KILTER_ZENOH_LISTEN, KILTER_SITE, KILTER_TEMPERATURE_C, KILTER_ROS2, "
    "KILTER_ROS2_DOMAIN, KILTER_ROS2_CONNECT, KILTER_ROS2_DIALECT, KILTER_MAX_UPLOAD_MB, "
    "KILTER_MAX_DOCUMENT_MB, KILTER_MAX_REQUESTS, KILTER_MAX_COMPUTING, KILTER_WORKER_NAME, "
    "KILTER_WORKER_PROCESSES, KILTER_WORKER_QUEUES."
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    root = argparse.ArgumentParser(
        prog="kilterd", description="The server of Kilter.", epilog=f"Example: kilterd serve. {ENVIRONMENT}"
    )
    root.add_argument("--version", action="version", version=f"kilterd {code_version()}")
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (run, example) in COMMANDS.items():
        text = (run.__doc__ or "").strip()
        command = commands.add_parser(name, help=text, description=text, epilog=f"Example: {example}. {ENVIRONMENT}")
        command.add_argument("--data", help="folder of database, token and server file (default ~/.kilter)")
        command.add_argument("--database-url", help="SQLAlchemy URL (default: SQLite in the data folder)")
        if name in ("serve", "api"):
            command.add_argument("--host", help="address to listen on (default 127.0.0.1)")
            command.add_argument("--port", help="port to listen on, 0 for a free one (default 8730)")
        if name == "api":
            command.add_argument("--fd", type=int, help=argparse.SUPPRESS)
    return root


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; exits 0 when it is done, 1 when it failed, 2 when it was called wrongly."""
    given = parser().parse_args(arguments)
    # The fits are small: threads of the linear algebra library only wait for each other there, ten times slower on a
    # busy machine with two cores (docs/explanation/surprises.md). It is read when numpy is imported, by a command.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # INFO of libraries is theirs; what Kilter logs at INFO is for whoever runs it.
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    logging.getLogger("kilter").setLevel(logging.INFO)
    overrides = {name: getattr(given, name, None) for name in ("data", "database_url", "host", "port")}
    try:
        settings = Settings(**{name: value for name, value in overrides.items() if value is not None})
        _end_with_parent()
        COMMANDS[given.command][0](settings, given)
    except ValidationError as error:
        for item in error.errors():
            print(f"kilterd: {'.'.join(str(p) for p in item['loc'])}: {item['msg']}", file=sys.stderr)
        sys.exit(2)
    except CoreError as error:
        print(f"kilterd: {error.message}", file=sys.stderr)
        sys.exit(2 if error.code in USAGE_CODES else 1)
    except OSError as error:
        print(f"kilterd: {error}", file=sys.stderr)
        sys.exit(1)


def _end_with_parent() -> None:
    """Make a child of `kilterd serve` stop when the supervisor is gone, however it went."""
    if os.environ.pop("KILTER_SUPERVISED", None) is None:
        return

    def watch() -> None:
        while os.read(0, 1024):
            continue
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True, name="parent-watch").start()


if __name__ == "__main__":
    main()
