"""A body that is sent too slowly: nobody holds a request open by sending a byte now and then."""

from __future__ import annotations

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kilter_service.ground.errors import ServiceError

GRACE_S = 30.0  # of waiting, for any body
LEAST_BYTES_S = 10_000.0  # what a sender must reach on average after that


class Unhurried:
    """Count the time that is spent waiting for a body; that in which the server reads or computes does not count."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        await self.app(scope, _Body(receive).receive_message if scope["type"] == "http" else receive, send)


class _Body:
    def __init__(self, receive: Receive) -> None:
        self._receive, self._whole = receive, False
        self._waited, self._bytes = 0.0, 0

    async def receive_message(self) -> Message:
        """Return what comes next of a request.

        Raises:
            ServiceError: it did not come in time.

        """
        if self._whole:  # what follows is that the sender goes away, whenever it likes
            return await self._receive()
        clock = asyncio.get_running_loop().time
        since, allowed = clock(), GRACE_S + self._bytes / LEAST_BYTES_S
        try:
            async with asyncio.timeout(max(0.0, allowed - self._waited)):
                message = await self._receive()
        except TimeoutError as error:
            raise ServiceError(
                f"The request was not whole after {allowed:.0f} s of waiting; nothing was stored. Send it again over a faster "
                f"connection (at least {LEAST_BYTES_S / 1000:.0f} kB/s), a long recording in parts.",
                code="request_too_slow",
                retry_after_s=1,
            ) from error
        self._waited += clock() - since
        self._bytes += len(message.get("body", b""))
        self._whole = not message.get("more_body", False)
        return message
