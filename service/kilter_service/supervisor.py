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

from kilter_service.auth.listen_rules import check_binding
from kilter_service.auth.token import admin_token
from kilter_service.corrector.endpoints import check_free, check_listening
from kilter_service.corrector.orphan import goes_on_alone
from kilter_service.errors import ServiceError
from kilter_service.health.pulse import stopped
from kilter_service.last_words import LastWords
from kilter_service.private_files import private_folder
from kilter_service.server_file import ServerFile
from kilter_service.serving import listener, url_of
from kilter_service.settings import LOCK_FILE, Settings

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
FIRST_PAUSE_S, LONGEST_PAUSE_S, STEADY_S = 0.2, 10.0, 30.0
KILLED = (-signal.SIGKILL, -signal.SIGTERM)
REMEDY = "Mend what it says, `kilterd doctor` checks the rest"
MOST_ENDS = 3  # before the server ever stood; a process that ended so often ends the same the next time


class Child:
    """A process of Kilter; `watch` restarts it when it has ended."""

    def __init__(self, name: str, settings: Settings, *arguments: str, keep: tuple[int, ...] = ()) -> None:
        self.name = name
        self._command = [sys.executable, "-m", "kilter_service", name, *arguments]
        said = {SUPERVISED: "1", BESIDE: _beside(settings), BEGAN: str(time.monotonic())}
        self._environment = {**os.environ, **settings.environment(), **said}
        self._keep = keep
        self._process: subprocess.Popen[bytes] | None = None
        self._started = 0.0
        self._pause = FIRST_PAUSE_S
        self._again_at: float | None = None
        self._said = LastWords(name)
        self._frozen = False
        self._ending = ""
        self._ends = 0

    def start(self) -> None:
        """Start the process; it ends by itself when this one does, because its standard input closes."""
        self._started, self._again_at, self._frozen = time.monotonic(), None, False
        self._process = subprocess.Popen(
            self._command,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=self._keep,
            start_new_session=True,  # Ctrl-C is for the supervisor, which ends its children in order
        )
        self._said.follow(self._process.stdout)

    @property
    def pid(self) -> int | None:
        """Process id of the running process."""
        return None if self._process is None else self._process.pid

    def watch(self) -> None:
        """Restart the process when it has ended: at once, and more slowly when it keeps ending."""
        if self._process is None:
            return
        if self._process.poll() is None:
            self._say_if_frozen(self._process.pid)
            return
        time_s = time.monotonic()
        if self._again_at is None:
            if time_s - self._started > STEADY_S:
                self._pause = FIRST_PAUSE_S
            self._ends += 1
            self._ending = self._how_it_ended()
            log.error("%s %s: it starts again", self.name, self._ending)
            if self._process.returncode in KILLED:  # by somebody, not by its own failure: it need not be slowed down
                self._pause = FIRST_PAUSE_S
            self._again_at = time_s + self._pause
            self._pause = min(2 * self._pause, LONGEST_PAUSE_S)
        if time_s >= self._again_at:
            self._close()
            self.start()

    def _say_if_frozen(self, pid: int) -> None:
        """Say that somebody stopped the process (SIGSTOP, a debugger); whoever did it may want to go on."""
        frozen = stopped(pid)
        if frozen == self._frozen:
            return
        self._frozen = frozen
        if frozen:
            remedy = f"`kill -CONT {pid}` lets it go on, after `kill -KILL {pid}` it starts again"
            log.error("%s is frozen (SIGSTOP or a debugger): %s", self.name, remedy)
        else:
            log.warning("%s goes on", self.name)

    def refuse_if_refused(self) -> None:
        """End this process as the other ended, when it cannot run with these settings; it has said why.

        Raises:
            SystemExit: with the other's exit code.

        """
        if self._process is not None and self._process.poll() == REFUSED:
            raise SystemExit(REFUSED)

    def hopeless(self) -> str | None:
        """How it ended, when it ended again and again at the start of the server, with what it said last; None else."""
        if self._ends < MOST_ENDS:
            return None
        return f"{self._ending}, {self._ends} times in a row"

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

    def _how_it_ended(self) -> str:
        assert self._process is not None
        code = self._process.returncode
        if code in KILLED:  # from outside: it had nothing to say about it
            return f"was killed ({signal.Signals(-code).name})"
        return f"ended with {code} ({self._said.last()})"

    def ask_to_stop(self) -> None:
        """Send SIGTERM."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def wait(self, deadline: float) -> None:
        """Wait for the end; kill the process when the deadline passes."""
        if self._process is None:
            return
        try:
            self._process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            log.warning("%s did not stop: it is killed", self.name)
            self._process.kill()
            self._process.wait()
        self._close()

    def _close(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
        self._said.close()


def _beside(settings: Settings) -> str:
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
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with _alone(settings.data), listener(settings) as opened, ServerFile(settings.server_file) as file:
        went_on = goes_on_alone(settings.corrector_file)
        if not went_on:
            check_free(settings.zenoh_listen)
        children = [
            Child("api", settings, "--fd", str(opened.fileno()), keep=(opened.fileno(),)),
            Child("worker", settings),
            Child("corrector", settings),
        ]
        if settings.ros2:
            children.append(Child("ros2", settings))
        try:
            _start(settings, children, stop)
            missing = _wait_until_standing(settings, children, url_of(opened, settings), stop, went_on)
            if missing is not None:
                document = _document(settings, url_of(opened, settings), missing)
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


def _start(settings: Settings, children: list[Child], stop: threading.Event) -> None:
    # They import for a second or two, so they start first, the corrector with its two processes before the others; all
    # wait for the migration themselves.
    for child in reversed(children):
        if stop.is_set():
            return
        child.start()
    _migrate(settings)


def _migrate(settings: Settings) -> None:
    from kilter_service.backup.upgrade import upgrade  # after the children were started: importing takes a moment

    upgrade(settings)


def _stop(children: list[Child]) -> None:
    for child in children:
        child.ask_to_stop()
    deadline = time.monotonic() + STOP_S
    for child in children:
        child.wait(deadline)


def _wait_until_standing(
    settings: Settings, children: list[Child], url: str, stop: threading.Event, went_on: bool
) -> Missing | None:
    """Wait until all is ready, or until only parts are missing that the arm's correction does without.

    Returns what is missing, in words; None when it was stopped meanwhile. A disk that is nearly full or a worker that ends
    at every start must not end a corrector that corrects: others ask for readiness, this one whether the processes stand.
    Where a stream process `went_on` alone from the server before, an arm follows it: then not even an API that ends at
    every start ends it.

    Raises:
        ServiceError: no setpoint can be corrected: the API or the corrector ends at every start, or did not start in time.

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


def _hopeless(missing: Missing, children: list[Child]) -> Missing:
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
