"""Requests to the server; every refusal comes back as the exception of its code."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from kilter_client.errors import ApiError, ServerUnreachableError, from_problem
from kilter_client.locate import Place, locate

if TYPE_CHECKING:
    import httpx

Document = dict[str, Any]
Content = bytes | Iterator[bytes] | Callable[[], Iterator[bytes]] | None

TIMEOUT_S = 60.0
BUSY, BUSY_TRIES, LONGEST_WAIT_S = 503, 6, 10.0  # a busy server says after how many seconds to come again
EVENTS_TIMEOUT_S = 90.0  # the server sends something at least every 15 s


def address(*parts: str) -> str:
    """Return the path of a resource; names are quoted, whatever they hold."""
    return "/v1/" + "/".join(quote(part, safe="") for part in parts)


class Connection:
    """One server, kept connected."""

    def __init__(self, place: Place, transport: httpx.BaseTransport | None = None) -> None:
        import httpx  # 0.2 s: not when the package is imported

        self.url = place.url
        self._place = place
        secret = place.url.lower().startswith("https:")  # certificates are read, 0.03 s, where they are needed
        headers = {"Authorization": f"Bearer {place.token}"} if place.token else {}
        self._client = httpx.Client(
            base_url=place.url, headers=headers, transport=transport, timeout=TIMEOUT_S, verify=secret
        )

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def look_again(self) -> None:
        """Go on with the server that runs on this machine now, if this one was found by its file there."""
        if not self._place.by_file:
            return
        try:
            self.url = locate().url  # its token is that of its data folder, as before
        except ServerUnreachableError:  # it has not said yet where it is
            return
        self._client.base_url = self.url

    def request(self, method: str, path: str, content: Content = None, **arguments: Any) -> httpx.Response:
        """Send a request and return its answer; one that the server is too busy for is sent again after a while.

        ``content`` is a body, or a function that makes it anew for every try.

        Raises:
            ApiError: the server refuses; a subclass by the problem's code.
            ServerUnreachableError: no answer.

        """
        for left in reversed(range(BUSY_TRIES)):
            body = content() if callable(content) else content
            with self._reaching():
                response = self._client.request(method, path, content=body, **arguments)
            wait_s = response.headers.get("Retry-After", "")
            if response.status_code != BUSY or not wait_s.isdecimal() or not left:
                break
            time.sleep(min(float(wait_s), LONGEST_WAIT_S))
        _refuse(response.status_code, response.content)
        return response

    def get(self, path: str, **parameters: Any) -> Document:
        """Return the JSON document at ``path``."""
        return self.document(self.request("GET", path, params=parameters))

    def post(self, path: str, body: Mapping[str, Any] | None = None) -> Document:
        """Send a JSON document and return the answer's."""
        return self.document(self.request("POST", path, json=body))

    def patch(self, path: str, body: Mapping[str, Any]) -> Document:
        """Send what shall change as a JSON document and return the answer's."""
        return self.document(self.request("PATCH", path, json=body))

    def document(self, response: httpx.Response) -> Document:
        """Return the JSON object an answer holds.

        Raises:
            ApiError: it holds something else, so this is no Kilter server.

        """
        try:
            found = response.json()
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise ApiError(
                f"{response.url} answered something that is no JSON object: is KILTER_URL a Kilter server?",
                status=response.status_code,
            )
        return found

    @contextmanager
    def lines(self, path: str) -> Iterator[Iterator[str]]:
        """Open a stream of text lines (server-sent events)."""
        headers = {"Accept": "text/event-stream"}
        with self._reaching(), self._client.stream("GET", path, headers=headers, timeout=EVENTS_TIMEOUT_S) as response:
            if response.status_code >= 400:
                _refuse(response.status_code, response.read())
            yield response.iter_lines()

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        import httpx

        try:
            yield
        except httpx.TimeoutException as error:
            raise ServerUnreachableError(f"{self.url} did not answer in time ({error}).", url=self.url) from error
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise ServerUnreachableError(
                f"{self.url} does not answer ({error}). Is the server running (`kilterd serve`), and KILTER_URL right?",
                url=self.url,
            ) from error


def _refuse(status: int, content: bytes) -> None:
    if status < 400:
        return
    try:
        problem = json.loads(content)
    except ValueError:
        problem = {}
    raise from_problem(problem if isinstance(problem, dict) else {}, status)
