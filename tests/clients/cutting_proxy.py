"""A proxy in front of a real server that cuts connections where a test says so: the answer is lost, not the request."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

PIECE = 1 << 16


class CuttingProxy:
    """Forwards bytes; ``cuts`` is asked for each piece of an answer, with the head of its request.

    It says "drop" to cut the connection before the piece and "after" to cut it behind.
    """

    def __init__(self, port: int) -> None:
        self.heads: list[str] = []
        self.cuts: Callable[[str, bytes], str] = lambda head, piece: ""
        self._upstream = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._accept, daemon=True)

    def cut_next(self, start: str, times: int = 1) -> None:
        """Lose so many answers to requests whose first line begins so."""
        left = [None] * times

        def cuts(head: str, piece: bytes) -> str:
            return "drop" if head.startswith(start) and left and left.pop() is None else ""

        self.cuts = cuts

    def sent(self, start: str) -> list[dict[str, str]]:
        """Return the headers of all requests whose first line begins so; names in lower case."""
        lines = [head.split("\r\n") for head in self.heads if head.startswith(start)]
        return [{n.lower(): v for n, v in (line.split(": ", 1) for line in one[1:] if line)} for one in lines]

    @contextmanager
    def running(self) -> Iterator[CuttingProxy]:
        """Accept connections until the block ends."""
        self._thread.start()
        try:
            yield self
        finally:
            with suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
            self._thread.join(10)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._upstream))
            last: list[str] = [""]
            threading.Thread(target=self._there, args=(client, server, last), daemon=True).start()
            threading.Thread(target=self._back, args=(client, server, last), daemon=True).start()

    def _there(self, client: socket.socket, server: socket.socket, last: list[str]) -> None:
        with suppress(OSError):
            while piece := client.recv(PIECE):
                head = piece.split(b"\r\n\r\n")[0].decode("latin-1")
                if " HTTP/1.1\r\n" in head:
                    last[0] = head
                    self.heads.append(head)
                server.sendall(piece)
        _close(client, server)

    def _back(self, client: socket.socket, server: socket.socket, last: list[str]) -> None:
        with suppress(OSError):
            while piece := server.recv(PIECE):
                cut = self.cuts(last[0], piece)
                if cut != "drop":
                    client.sendall(piece)
                if cut:
                    break
        _close(client, server)


def _close(*ends: socket.socket) -> None:
    for end in ends:
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()
