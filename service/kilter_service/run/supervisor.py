"""`kilterd serve`: API, worker, corrector and, where topics are set, the ROS 2 adaptor; each is restarted when it dies."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import signal
import ssl
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from kilter_files.ground.later import later
from kilter_service.ground.backup_folder import migration_lock
from kilter_service.ground.child_process import Child, ChildOutput, stop_event
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import ServerFile, private_folder
from kilter_service.ground.settings import LOCK_FILE, Settings
from kilter_service.run.serving import listener, listening_url
from kilter_service.stream.corrector.endpoints import check_free, check_listening
from kilter_service.stream.corrector.session import goes_on_alone
from kilter_service.web.auth.token import admin_token, check_binding

with later(__name__):
    from kilter_service.run.backup import upgrade

log = logging.getLogger("kilter.serve")

Missing = dict[str, str]  # parts that are not ready, by name, and what is wrong with each
SUPERVISED = "KILTER_SUPERVISED"
BESIDE, BEGAN = "KILTER_BESIDE", "KILTER_BEGAN"  # as health.service reads them, which imports SQLAlchemy
STARTING = "is starting"  # as health.service says it
CHECK_S = 0.1
NEEDED = ("api", "corrector")  # without which no setpoint is corrected, or nobody can say by what
SETTLED_S = 3.0  # what is missing for so long, and not because it starts, is not waited for
READY_S = 300.0  # the first start on a machine compiles the kernels, on a busy one for minutes
STOP_S = 8.0
REFUSED = 2  # what a process ends with when its settings cannot be: the same again would end the same
KILLED = (-signal.SIGKILL, -signal.SIGTERM)
REMEDY = "Mend what it says, `kilterd doctor` checks the rest"
MOST_ENDS = 3  # before the server ever stood; a process that ended so often ends the same the next time


class Program(Child):
    """A process of Kilter with a command of its own; it ends by itself when this one does: its standard input closes."""

    def __init__(self, name: str, settings: Settings, *arguments: str, keep: tuple[int, ...] = ()) -> None:
        super().__init__(name)
        self._command = [sys.executable, "-m", "kilter_service", name, *arguments]
        stated = {SUPERVISED: "1", BESIDE: _companion_processes(settings), BEGAN: str(time.monotonic())}
        self._environment = {**os.environ, **settings.environment(), **stated}
        self._keep = keep
        self._process: subprocess.Popen[bytes] | None = None
        self._output = ChildOutput(name)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    def _launch(self) -> None:
        self._process = subprocess.Popen(
            self._command,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=self._keep,
            start_new_session=True,  # Ctrl-C is for the supervisor, which ends its children in order
        )
        self.pid = self._process.pid
        self._output.follow(self._process.stdout)

    def refuse_if_refused(self) -> None:
        """End this process as the other ended, when it cannot run with these settings; it has said why.

        Raises:
            SystemExit: with the other's exit code.

        """
        if self._process is not None and self._process.poll() == REFUSED:
            raise SystemExit(REFUSED)

    def hopeless(self) -> str | None:
        """How it ended, when it ended again and again at the start of the server, with what it said last; None else."""
        return f"{self.ending}, {self.ends} times in a row" if self.ends >= MOST_ENDS else None

    def refuse_if_hopeless(self) -> None:
        """Give up a process that ends again and again before the server was ever ready.

        Raises:
            ServiceError: it did, with what it said last.

        """
        ending = self.hopeless()
        if ending is not None:
            raise ServiceError(
                f"The {self.name} process {ending}: the server is not started. {REMEDY}, and start again.",
                code="process_ends",
                process=self.name,
            )

    def _how_it_ended(self) -> tuple[str, bool]:
        code = 0 if self._process is None else self._process.returncode
        if code in KILLED:  # from outside: it had nothing to say about it
            return f"was killed ({signal.Signals(-code).name})", True
        return f"ended with {code} ({self._output.last_line()})", False

    def ask_to_stop(self) -> None:
        """Send SIGTERM."""
        if self._process is not None:
            self._process.terminate()

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _wait_until_ended(self, seconds: float) -> bool:
        try:
            if self._process is not None:
                self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _close(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
        self._output.close()


def _companion_processes(settings: Settings) -> str:
    """Which processes run beside the API; health misses one that is silent."""
    return "worker,corrector,ros2" if settings.ros2 else "worker,corrector"


def serve(settings: Settings) -> None:
    """Run everything until SIGTERM or SIGINT; prints one JSON line when all is ready.

    Raises:
        ServiceError: an address may not be listened on or is taken, or a server runs in this data folder already.
        SystemExit: a process cannot run with these settings, and has said why.

    """
    check_binding(settings)
    check_listening(settings)
    admin_token(settings)
    stop = stop_event()
    with _alone(settings.data), listener(settings) as opened, ServerFile(settings.server_file) as file:
        went_on = goes_on_alone(settings.corrector_file)
        if not went_on:
            check_free(settings.zenoh_listen)
        children = [
            Program("api", settings, "--fd", str(opened.fileno()), keep=(opened.fileno(),)),
            Program("worker", settings),
            Program("corrector", settings),
        ]
        if settings.ros2:
            children.append(Program("ros2", settings))
        try:
            _start(settings, children, stop)
            missing = _wait_until_standing(settings, children, listening_url(opened, settings), stop, went_on)
            if missing is not None:
                document = _document(settings, listening_url(opened, settings), missing)
                file.write(document)
                print(json.dumps(document), flush=True)
            while not stop.wait(CHECK_S):
                for child in children:
                    child.watch()
        finally:
            _stop(children)


def _document(settings: Settings, url: str, missing: Missing) -> dict[str, Any]:
    found = {"url": url, "pid": os.getpid(), "zenoh": _zenoh(settings), "data": str(settings.data)}
    return found | ({"missing": missing} if missing else {})


def _start(settings: Settings, children: list[Program], stop: threading.Event) -> None:
    # They import for a second or two, so they start first, the corrector with its two processes before the others; all
    # wait for the migration themselves.
    with migration_lock(settings.data):
        for child in reversed(children):
            if stop.is_set():
                return
            child.start()
        _migrate(settings)


def _migrate(settings: Settings) -> None:
    upgrade.upgrade(settings, replay=False)  # loaded after the children were started: it takes a moment


def _stop(children: list[Program]) -> None:
    for child in children:
        child.ask_to_stop()
    deadline = time.monotonic() + STOP_S
    for child in children:
        child.wait(deadline)


def _wait_until_standing(
    settings: Settings, children: list[Program], url: str, stop: threading.Event, went_on: bool
) -> Missing | None:
    """Wait until all is ready, or until only parts are missing that the arm's correction does without.

    Returns what is missing, in words; None when it was stopped meanwhile. A disk that is nearly full or a worker that ends
    at every start must not end a corrector that corrects: others ask for readiness, this one whether the processes stand.
    Where a stream process `went_on` alone from the server before, an arm follows it: then not even an API that ends at
    every start ends it.
    """
    deadline = time.monotonic() + READY_S
    since, before = time.monotonic(), None
    while not stop.wait(CHECK_S / 2):
        for child in children:
            child.refuse_if_refused()  # later a port may be taken for a moment, and everything else goes on
            child.watch()
        corrects = _zenoh(settings) is not None
        for child in children:
            if child.name in NEEDED and not (went_on and (corrects or child.name == "api")):
                child.refuse_if_hopeless()  # of a stream that went on the API may end before the corrector stands
        missing = _missing(url) if corrects else None
        if missing is None and corrects:  # the API does not answer
            missing = _hopeless({"api": STARTING}, children) or None
        if missing == {}:
            return missing
        missing = None if missing is None else missing | _hopeless(missing, children)
        lasting = missing is not None and not any(said.startswith(STARTING) for said in missing.values())
        if not lasting or before is None or missing is None or missing.keys() != before.keys():
            since = time.monotonic()
        elif time.monotonic() - since > SETTLED_S:
            for name, said in missing.items():
                log.error("%s: %s. Setpoints are corrected meanwhile.", name, said.rstrip("."))
            return missing
        before = missing
        if time.monotonic() > deadline:
            raise ServiceError(f"Not all processes were ready within {READY_S:.0f} s; their messages are above.")
    return None


def _hopeless(missing: Missing, children: list[Program]) -> Missing:
    """Say of the missing processes that end again and again why they do: health knows only that they are starting."""
    endings = {child.name: child.hopeless() for child in children if child.name in missing}
    return {name: f"{said}. {REMEDY}" for name, said in endings.items() if said is not None}


def _missing(url: str) -> Missing | None:
    """What health finds wrong, by part; None when the API does not answer."""
    # Asked is this machine's own socket, and no token is sent: the certificate may be for other names only. A default
    # context would read all certificates that the machine trusts, which kept a core busy while the others started.
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        # The URL of our own listener.
        with urllib.request.urlopen(f"{url}/v1/health", timeout=2, context=context) as answer:  # noqa: S310
            checks: dict[str, dict[str, Any]] = json.load(answer)["checks"]
    except (urllib.error.URLError, OSError, ValueError, KeyError):
        return None
    return {name: str(check["detail"]) for name, check in checks.items() if not check["ok"]}


def _zenoh(settings: Settings) -> str | None:
    """Return the endpoint of the corrector that runs now; None until one has said that it listens."""
    try:
        document: dict[str, Any] = json.loads(settings.corrector_file.read_text(encoding="utf-8"))
        os.kill(document["pid"], 0)
    except (OSError, ValueError, KeyError):
        return None
    return str(document["endpoints"].get("stream"))


@contextmanager
def _alone(data: Path) -> Iterator[IO[str]]:
    """Hold the data folder's lock, so that no two servers share it."""
    private_folder(data)
    with (data / LOCK_FILE).open("w", encoding="ascii") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ServiceError(
                f"A server runs in {data} already: stop it, or give another folder with --data.", code="data_in_use"
            ) from error
        yield file
