"""Calls sent to a server over connections that stay open: with threads, or under asyncio.

Verbs as methods: of a client that waits for the answer, and of one whose answers are awaited.

A server for a while: `kilterd serve` as a child process with its own data folder and free ports on loopback.
"""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar
from urllib.parse import urlsplit

from kilter_client.errors import KilterError, ServerUnreachableError, UsageError
from kilter_client.requests.steps import Answer, Follow, Pause, Relocate, Request, Step, Steps, refuse
from kilter_files.ground.later import later

with later(__name__):
    import httpx  # 0.2 s: not when the package is imported


P = ParamSpec("P")
M = TypeVar("M")


def waiting(verb: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], T]:
    """Return the method of a verb that returns when it is done."""

    def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = self.run(verb(*args, **kwargs))
        return found

    return _copy_verb_signature(method, verb)


def make_document_method(call: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], T]:
    """Return the method of a call that returns what the server answered, as it is."""

    def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = self._run(call(*args, **kwargs))
        return found

    return _copy_verb_signature(method, call)


def make_async_method(verb: Callable[P, Steps[T]]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Return the method of a verb that is awaited."""

    async def method(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        found: T = await self.run(verb(*args, **kwargs))
        return found

    return _copy_verb_signature(method, verb)


def _copy_verb_signature(like: M, verb: Callable[..., Any]) -> M:
    """Give a method the name, the words and the signature of its verb; it returns what the steps end with."""
    method: Any = like
    method.__name__, method.__doc__, method.__module__ = verb.__name__, verb.__doc__, verb.__module__
    method.__qualname__ = f"Kilter.{verb.__name__}"
    signature = inspect.signature(verb)
    returns = str(signature.return_annotation).removeprefix("Steps[").removesuffix("]")
    own = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    method.__signature__ = inspect.Signature([own, *signature.parameters.values()], return_annotation=returns)
    method.__annotations__ = {**verb.__annotations__, "return": returns}
    return like


T = TypeVar("T")
Reword = Callable[[KilterError], None]

EVENTS_TIMEOUT_S = 90.0  # the server sends something at least every 15 s


class Connection:
    """One server, kept connected."""

    def __init__(
        self, place: Place, transport: httpx.BaseTransport | None = None, reword: Reword | None = None
    ) -> None:
        self.url, self._place, self._reword = place.url, place, reword
        self._answered = False  # until then an address where nobody listens is a wrong one
        self._client = httpx.Client(transport=transport, **_settings(place))

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def run(self, call: Steps[T]) -> T:
        """Do what a call asks for, step by step, and return what it returns.

        Raises:
            ApiError: the server refuses; a subclass by the problem's code.
            ServerUnreachableError: no answer.

        """
        answer: Answer | KilterError | None = None
        with _in_words(self._reword):
            while True:
                try:
                    step = call.throw(answer) if isinstance(answer, KilterError) else call.send(answer)
                except StopIteration as end:
                    found: T = end.value
                    return found
                try:
                    answer = self._perform_step(step)
                except KilterError as error:
                    answer = error
                except BaseException:  # Ctrl-C, or what the caller's progress raised: the call lets go of what it holds
                    call.close()
                    raise

    def _perform_step(self, step: Step) -> Answer | None:
        if isinstance(step, Pause):
            time.sleep(step.seconds)
            return None
        if isinstance(step, Relocate):
            self.url, self._place = _relocate_client(self._client, self._place)
            return None
        with reaching(self.url, self._answered):
            if isinstance(step, Follow):
                self._follow_events(step)
                self._answered = True
                return None
            content = None if step.content is None else step.pieces()
            response = self._client.request(content=content, **_arguments(step))
            self._answered = True
            return Answer(response.status_code, response.headers, response.content, str(response.url))

    def _follow_events(self, step: Follow) -> None:
        step.events.discard_partial_event()
        with self._client.stream("GET", step.path, headers=step.headers(), timeout=EVENTS_TIMEOUT_S) as response:
            if response.status_code >= 400:
                refuse(response.status_code, response.read())
            for line in response.iter_lines():
                if any(step.on_event(data) for data in step.events.parse_event_line(line) if isinstance(data, dict)):
                    return


class AsyncConnection:
    """One server, kept connected, under asyncio."""

    def __init__(
        self, place: Place, transport: httpx.AsyncBaseTransport | None = None, reword: Reword | None = None
    ) -> None:
        self.url, self._place, self._reword = place.url, place, reword
        self._answered = False  # until then an address where nobody listens is a wrong one
        self._client = httpx.AsyncClient(transport=transport, **_settings(place))

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def run(self, call: Steps[T]) -> T:
        """Do what a call asks for, step by step, and return what it returns; errors are those of ``Connection``."""
        answer: Answer | KilterError | None = None
        with _in_words(self._reword):
            while True:
                try:
                    step = call.throw(answer) if isinstance(answer, KilterError) else call.send(answer)
                except StopIteration as end:
                    found: T = end.value
                    return found
                try:
                    answer = await self._perform_step(step)
                except KilterError as error:
                    answer = error
                except BaseException:  # a task that is cancelled waits here: what the call holds is let go at once
                    call.close()
                    raise

    async def _perform_step(self, step: Step) -> Answer | None:
        if isinstance(step, Pause):
            import asyncio  # brings ssl along: not when the package is imported

            await asyncio.sleep(step.seconds)
            return None
        if isinstance(step, Relocate):
            self.url, self._place = _relocate_client(self._client, self._place)
            return None
        with reaching(self.url, self._answered):
            if isinstance(step, Follow):
                await self._follow_events(step)
                self._answered = True
                return None
            content = None if step.content is None else _stream_pieces(step)
            response = await self._client.request(content=content, **_arguments(step))
            self._answered = True
            return Answer(response.status_code, response.headers, response.content, str(response.url))

    async def _follow_events(self, step: Follow) -> None:
        step.events.discard_partial_event()
        async with self._client.stream("GET", step.path, headers=step.headers(), timeout=EVENTS_TIMEOUT_S) as response:
            if response.status_code >= 400:
                refuse(response.status_code, await response.aread())
            async for line in response.aiter_lines():
                if any(step.on_event(data) for data in step.events.parse_event_line(line) if isinstance(data, dict)):
                    return


def _settings(place: Place) -> dict[str, Any]:
    headers = {"Authorization": f"Bearer {place.token}"} if place.token else {}
    # Certificates are read, 0.03 s, where they are needed.
    verify = _trusted_authorities() if place.url.lower().startswith("https:") else False
    return {"base_url": place.url, "headers": headers, "verify": verify}


def _trusted_authorities() -> Any:
    """Return whom to trust: the authority of KILTER_CA, else those that this machine trusts."""
    file = os.environ.get("KILTER_CA")
    if not file:
        return True
    import ssl

    try:
        return ssl.create_default_context(cafile=file)
    except OSError as error:
        raise UsageError(
            f"KILTER_CA: {file} cannot be read as certificates ({error}): give the PEM file of the authority that signed "
            "the server's certificate."
        ) from error


def _relocate_client(client: httpx.Client | httpx.AsyncClient, place: Place) -> tuple[str, Place]:
    """Let a client go on with the server that runs on this machine now, if it was found by its file there."""
    if not place.by_file:
        return place.url, place
    try:
        place = locate()
    except ServerUnreachableError:  # it has not said yet where it is
        return place.url, place
    client.base_url = place.url
    client.headers.update(_settings(place)["headers"])
    return place.url, place


def _arguments(step: Request) -> dict[str, Any]:
    """What ``httpx`` is given of a request besides its content."""
    length = {} if step.content is None else {"Content-Length": str(len(step.content))}
    given: dict[str, Any] = {"json": step.body} if step.body is not None else {}
    return given | {
        "method": step.method,
        "url": step.path,
        "params": step.params,
        "headers": {**step.headers, **length},
        "timeout": step.timeout_s,
    }


async def _stream_pieces(step: Request) -> AsyncIterator[bytes]:
    for piece in step.pieces():
        yield piece


@contextmanager
def _in_words(reword: Reword | None) -> Iterator[None]:
    """Put errors that leave a call in the words of whoever called."""
    try:
        yield
    except KilterError as error:
        if reword is not None:
            reword(error)
        raise


@contextmanager
def reaching(url: str, answered: bool) -> Iterator[None]:
    """Raise errors of the connection to a server as the client's own; ``answered`` says that it was there before."""
    try:
        yield
    except httpx.TimeoutException as error:
        raise ServerUnreachableError(f"{url} did not answer in time ({error}).", url=url) from error
    except (httpx.TransportError, httpx.InvalidURL) as error:
        if "CERTIFICATE_VERIFY_FAILED" in str(error):
            raise ServerUnreachableError(
                f"{url} has a certificate that this machine does not trust ({error}): set KILTER_CA to the PEM file of the "
                "authority that signed it, and use a name that is in it.",
                url=url,
            ) from error
        found = ServerUnreachableError(
            f"{url} does not answer ({error}). Is the server running (`kilterd serve`), and KILTER_URL right?",
            url=url,
        )
        found.unsent = isinstance(error, httpx.ConnectError)
        found.lost = answered if found.unsent else isinstance(error, httpx.NetworkError | httpx.RemoteProtocolError)
        raise found from error


SERVER_FILE = "server.json"
TOKEN_FILE = "token"  # noqa: S105 (the name of a file)


@dataclass(frozen=True)
class Place:
    """A server's address, and the token to send with every request (None: send none).

    ``by_file`` says that a server on this machine told its address in its data folder; started again it may have another.
    """

    url: str
    token: str | None
    by_file: bool = field(default=False, compare=False)


def data_folder() -> Path:
    """Return the data folder of a server on this machine: KILTER_DATA, else ``~/.kilter``."""
    return Path(os.environ.get("KILTER_DATA") or Path.home() / ".kilter")


def locate(url: str | None = None, token: str | None = None) -> Place:
    """Find the server: the arguments, else KILTER_URL and KILTER_TOKEN, else the running server's own files.

    Raises:
        ServerUnreachableError: nothing says where the server is.

    """
    told = url or os.environ.get("KILTER_URL")
    found = (told or _running_server()).rstrip("/")
    secret = token or os.environ.get("KILTER_TOKEN")
    # The token file belongs to a server on this machine: it must not travel to another one.
    if secret is None and _is_this_machine(found):
        with suppress(OSError, UnicodeDecodeError):
            secret = (data_folder() / TOKEN_FILE).read_text(encoding="ascii").strip() or None
    return Place(found, secret, by_file=not told)


def _running_server() -> str:
    file = data_folder() / SERVER_FILE
    try:
        url = json.loads(file.read_text(encoding="utf-8"))["url"]
    except FileNotFoundError as error:
        raise ServerUnreachableError(
            f"No server is known: {file} does not exist. Start one with `kilterd serve`, or set KILTER_URL.",
            file=str(file),
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ServerUnreachableError(
            f"{file} cannot be read as a server's address ({error}). Restart `kilterd serve`, or set KILTER_URL.",
            file=str(file),
        ) from error
    return str(url)


def _is_this_machine(url: str) -> bool:
    host = urlsplit(url).hostname or ""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


START_DEADLINE_S = 150.0  # the first start after a change compiles the kernels
STOP_DEADLINE_S = 20.0
POLL_S = 0.05

Start = Callable[..., subprocess.Popen[bytes]]


@dataclass(frozen=True)
class LocalServer:
    """Where a started server is: its URL, its zenoh endpoint and its data folder."""

    url: str
    zenoh: str
    data: Path

    def environment(self) -> dict[str, str]:
        """Return this process's environment with what a client needs to find the server and this program's commands."""
        commands = str(Path(sys.executable).parent)
        return os.environ | {
            "KILTER_DATA": str(self.data),
            "KILTER_URL": self.url,
            "PATH": commands + os.pathsep + os.environ.get("PATH", ""),
        }


@contextmanager
def local_server(data: Path, start: Start = subprocess.Popen) -> Iterator[LocalServer]:
    """Start a server on free loopback ports and stop it by its handle afterwards; its log is ``data/server.log``."""
    command = [sys.executable, "-m", "kilter_service", "serve", "--port", "0"]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment = plain | {"KILTER_DATA": str(data), "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    data.mkdir(parents=True, exist_ok=True)
    with (data / "server.log").open("wb") as log:
        process = start(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield _wait_until_ready(process, data)
        finally:
            _stop(process)


def _wait_until_ready(process: subprocess.Popen[bytes], data: Path) -> LocalServer:
    deadline = time.monotonic() + START_DEADLINE_S
    file = data / "server.json"
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise RuntimeError(f"kilterd ended with {process.returncode}; its log:\n{_log(data)}")
        if file.exists():
            document = json.loads(file.read_text())
            return LocalServer(document["url"], document["zenoh"], data)
        time.sleep(POLL_S)
    raise RuntimeError(f"kilterd was not ready after {START_DEADLINE_S:.0f} s; its log:\n{_log(data)}")


def _log(data: Path) -> str:
    return (data / "server.log").read_text(errors="replace")[-4000:]


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_DEADLINE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
