"""Bodies of two parts, ``multipart/form-data``, and how many requests may hold memory and compute at once."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import shutil
from collections import Counter
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_DOCUMENT_DEPTH, MAX_DOCUMENT_KEYS, MAX_DOCUMENT_PARTS, MAX_NUMBER
from kilter_service.ground.naming import ANY, LINE, LINES
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.policy import Kind, Rule

FORM = "multipart/form-data"


def is_form(request: Request) -> bool:
    """Whether the body says that it has parts."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower() == FORM


async def spool_form(
    request: Request, path: Path, names: tuple[str, str], limits_mb: tuple[int, int]
) -> tuple[bytes, str, str]:
    """Write the file to ``path``; return the document, the media type of the file, and the SHA-256 of the whole body.

    ``names`` are those of the document and of the file, ``limits_mb`` how large the document and the whole may be.

    Raises:
        ServiceError: the body is larger than the limit, packed, broken off, or has not these two parts.

    """
    digest = hashlib.sha256()

    async def iter_hashed_chunks() -> AsyncGenerator[bytes, None]:
        async for piece in iter_body_chunks(request, limits_mb[1], UPLOAD):
            digest.update(piece)
            yield piece

    parser = MultiPartParser(
        request.headers,
        iter_hashed_chunks(),
        max_files=1,
        max_fields=1,
        max_part_size=limits_mb[0] << 20,
    )
    try:
        form = await parser.parse()
    except (MultiPartException, KeyError, UnicodeError) as error:
        raise ServiceError(
            f"The body is not a form of the parts {names[0]} and {names[1]}: {error}.", code="payload_invalid"
        ) from error
    try:
        document, file = (form.get(name) for name in names)
        if not isinstance(document, str) or not isinstance(file, UploadFile):
            raise ServiceError(
                f"The form must have {names[0]}, JSON without a filename, and {names[1]}, a file with its Content-Type.",
                code="payload_invalid",
            )
        await run_in_threadpool(_copy_upload, file, path)
        return document.encode(), file.content_type or "", digest.hexdigest()
    finally:
        await form.close()


def _copy_upload(file: UploadFile, path: Path) -> None:
    with path.open("wb") as to:
        shutil.copyfileobj(file.file, to)


UPLOAD, DOCUMENT = "KILTER_MAX_UPLOAD_MB", "KILTER_MAX_DOCUMENT_MB"
MESH = "a mesh"
REMEDY = {
    MESH: "simplify the mesh, it is only drawn",
    UPLOAD: "split it (`kilter upload` sends long recordings in parts), or raise KILTER_MAX_UPLOAD_MB",
    DOCUMENT: "leave out what is not needed, or raise KILTER_MAX_DOCUMENT_MB",
}
SILENT_S = 60.0  # a sender that is silent for so long has gone
JSON_TYPES = ("/json", "+json")
PIECE_BYTES = 1 << 20


async def spool_upload(request: Request, path: Path, limit_mb: int, setting: str = UPLOAD) -> str:
    """Write the body to ``path`` and return its SHA-256.

    Raises:
        ServiceError: the body is larger than the limit, packed, or it broke off.

    """
    digest, waiting = hashlib.sha256(), bytearray()
    with path.open("wb") as file:

        def keep(piece: bytes) -> None:
            digest.update(piece)
            file.write(piece)

        async for part in iter_body_chunks(request, limit_mb, setting):
            waiting += part
            if len(waiting) >= PIECE_BYTES:
                await run_in_threadpool(keep, bytes(waiting))
                waiting.clear()
        await run_in_threadpool(keep, bytes(waiting))
    return digest.hexdigest()


async def iter_body_chunks(request: Request, limit_mb: int, setting: str) -> AsyncIterator[bytes]:
    """Yield the body piece by piece, as far as it may go, whatever its length is said to be.

    Raises:
        ServiceError: as for `spool_upload`.

    """
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding != "identity":
        raise ServiceError(
            f"Content-Encoding {encoding[:40]} is not read: send the body as it is (Parquet is packed already).",
            code="media_type_unsupported",
        )
    limit, size = limit_mb << 20, 0
    _check_size(int(request.headers.get("content-length") or 0), limit, setting)
    stream = request.stream()
    try:
        while True:
            async with asyncio.timeout(SILENT_S):
                part = await anext(stream, None)
            if part is None:
                return
            size += len(part)
            _check_size(size, limit, setting)
            yield part
    except (ClientDisconnect, TimeoutError) as error:
        raise ServiceError("The upload broke off; nothing was stored.", code="upload_incomplete") from error


def _check_size(size: int, limit: int, setting: str) -> None:
    if size > limit:
        raise ServiceError(
            f"The body is larger than {limit >> 20} MB: {REMEDY[setting]}.",
            code="upload_too_large",
            limit_mb=limit >> 20,
        )


async def read_document(request: Request, limit_mb: int) -> bytes:
    """Return the whole body of a request that holds a document.

    Raises:
        ServiceError: as for `spool_upload`.

    """
    return b"".join([part async for part in iter_body_chunks(request, limit_mb, DOCUMENT)])


def is_json(request: Request) -> bool:
    """Whether the body says that it is JSON."""
    plain = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return plain.startswith("application/") and plain.endswith(JSON_TYPES)


async def parse_json(body: bytes) -> Any:
    """Parse a JSON document in a thread, not on the event loop.

    Raises:
        ServiceError: it is not JSON, or has a shape that no document of Kilter has.

    """
    return await run_in_threadpool(_parse_json, body)


def _parse_json(body: bytes) -> Any:
    # No other thread runs while the parser does, so a document with too many parts is counted and refused, not parsed.
    if max(body.count(b":"), body.count(b"{") + body.count(b"[")) > MAX_DOCUMENT_PARTS:
        raise ServiceError(
            f"The body has more than {MAX_DOCUMENT_PARTS} fields, lists and objects: leave out what is not needed.",
            code="payload_invalid",
        )
    try:
        document = json.loads(body, object_pairs_hook=_few, parse_constant=_no_constant)
    except RecursionError as error:
        raise ServiceError(TOO_DEEP, code="payload_invalid") from error
    except ValueError as error:
        raise ServiceError(f"The body is not JSON: {error}.", code="payload_invalid") from error
    check_document(document)
    return document


def _few(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > MAX_DOCUMENT_KEYS:
        raise ServiceError(
            f"An object of the body has {len(pairs)} fields, at most {MAX_DOCUMENT_KEYS} are allowed.",
            code="payload_invalid",
        )
    document = dict(pairs)
    if len(document) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in document if names.count(name) > 1)
        raise ServiceError(
            f"An object of the body has the field {twice[:MOST_PLACE]!r} twice: keep one of them.",
            code="payload_invalid",
        )
    return document


def _no_constant(name: str) -> float:
    raise ServiceError(f"The body holds {name}, which is not JSON: give a number or null.", code="payload_invalid")


TOO_DEEP = f"The body is nested deeper than {MAX_DOCUMENT_DEPTH} levels: no document of Kilter is."
MOST_PLACE = 200  # characters of a place in a refusal
# Fields with several lines, and files that are sent within a document; every other text is a name or one line.
FIELDS = {"notes": LINES, "remarks": LINES, "reason": LINES, "source": LINES, "urdf": ANY}


def check_address(request: Request) -> None:
    """Look at the texts in a request's address.

    Raises:
        ServiceError: one has NUL.

    """
    for name, value in request.path_params.items():
        refuse(str(value), f"path.{name}", ANY)
    for name, value in request.query_params.multi_items():
        refuse(value, f"query.{name}", LINE if name == "name" else ANY)


def check_names(request: Request, known: frozenset[str]) -> None:
    """Look at the names of the parameters in a request's address: one that is misspelt would have no effect.

    Raises:
        ServiceError: one is not in ``known``.

    """
    for name in request.query_params:
        if name not in known:
            near = get_close_matches(name, known, 1)
            meant = f"; did you mean {near[0]}?" if near else f"; it takes {', '.join(sorted(known)) or 'none'}."
            raise invalid(f"query.{name}", f"is not a parameter of this address{meant}".rstrip("."))


def check_document(document: Any) -> None:
    """Look at all values of a JSON document.

    Raises:
        ServiceError: a text with a character that nobody sees, a number beyond all measurements, or too deep a nesting.

    """
    waiting: list[tuple[tuple[str, ...], Any]] = [(("body",), document)]
    while waiting:
        place, value = waiting.pop()
        if len(place) > MAX_DOCUMENT_DEPTH:
            raise ServiceError(TOO_DEEP, code="payload_invalid")
        if isinstance(value, dict):
            for name, part in value.items():
                refuse(name, ".".join(place), LINE)
                waiting.append(((*place, name), part))
        elif isinstance(value, list):
            waiting += [((*place, str(number)), part) for number, part in enumerate(value)]
        elif isinstance(value, str):
            refuse(value, ".".join(place), FIELDS.get(place[-1], LINE))
        elif isinstance(value, int | float) and not -MAX_NUMBER <= value <= MAX_NUMBER:
            raise invalid(".".join(place), f"is beyond {MAX_NUMBER:.0e}: give a number of the size of a measurement")


def refuse(text: str, place: str, marks: re.Pattern[str]) -> None:
    """Refuse a text that has one of ``marks``.

    Raises:
        ServiceError: it has one.

    """
    if found := marks.search(text):
        raise invalid(
            place, f"has the invisible character U+{ord(found[0]):04X} at {found.start() + 1}: leave that character out"
        )


def invalid(place: str, message: str) -> ServiceError:
    """Return the refusal of a value at a place of the request."""
    place = place[:MOST_PLACE]
    errors = [{"place": place, "message": message, "type": "value_error"}]
    return ServiceError(f"{place} {message}.", code="payload_invalid", errors=errors)


P = ParamSpec("P")
T = TypeVar("T")


class Room:
    """Requests of one kind: ``places`` are open at once, ``slots`` of them compute, the others wait for ``wait_s`` (None: on).

    ``places_each`` and ``slots_each`` are those that one person may take; None: all.
    """

    def __init__(
        self,
        slots: int,
        places: int,
        slots_each: int | None = None,
        places_each: int | None = None,
        wait_s: float | None = None,
    ) -> None:
        self.slots, self.places, self.wait_s = slots, places, wait_s
        self.slots_each, self.places_each = slots_each or slots, places_each or places
        self.open, self.computing = Counter[str](), Counter[str]()  # requests by person
        self._freed = asyncio.Condition()

    @property
    def is_full(self) -> bool:
        """Whether all slots are taken."""
        return self.computing.total() >= self.slots

    @contextmanager
    def entered(self, person: str) -> Iterator[None]:
        """Take a place.

        Raises:
            ServiceError: all are taken, or all that this person may take.

        """
        if self.open[person] >= self.places_each < self.places:
            raise ServiceError(
                f"{self.open[person]} such requests of yours are open, more are not taken: send it again when one has ended.",
                code="too_many_open",
                retry_after_s=1,
            )
        if self.open.total() >= self.places:
            raise ServiceError(
                f"{self.places} such requests are being answered already: send it again in a second.", code="busy"
            )
        self.open[person] += 1
        try:
            yield
        finally:
            self.open -= Counter([person])

    async def take_slot(self, person: str, wait_s: float | None) -> None:
        """Wait for a slot.

        Raises:
            ServiceError: none became free in time.

        """
        try:
            async with asyncio.timeout(wait_s), self._freed:
                await self._freed.wait_for(lambda: not self.is_full and self.computing[person] < self.slots_each)
                self.computing[person] += 1
        except TimeoutError:
            raise ServiceError(
                f"For {wait_s:g} s other requests of this kind have been computing: send it again in a while.",
                code="busy",
            ) from None

    async def release_slot(self, person: str) -> None:
        """Give a slot back."""
        self.computing -= Counter([person])
        async with self._freed:
            self._freed.notify_all()


def rooms_by_kind(settings: Settings) -> Mapping[Kind, Room]:
    """Return the room of each kind of work."""
    slots, places = settings.max_computing, settings.max_requests
    shared = max(1, slots // 2), max(1, places // 2)  # half of it stays free for the others' arms
    return {
        "corrections": Room(slots, places, *shared),
        "stops": Room(2 * slots, places, slots, shared[1]),  # who activates may roll back meanwhile
        "drops": Room(slots, places, slots_each=1, places_each=4, wait_s=10.0),
        "files": Room(slots, places),  # those that wait are on disk
        "checks": Room(slots, places),  # documents that only compute
        "documents": Room(slots, places),
        "reads": Room(slots, places),  # open to everybody on loopback
    }


def room_of(request: Request, kind: Kind) -> Room:
    """Return the room that a request of this kind computes in, and keep it for `in_turn`."""
    request.state.room = request.app.state.rooms[kind]
    request.state.has_slot = False
    return request.state.room  # type: ignore[no-any-return]


async def compute(request: Request, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Work on what was received in a thread, once a slot is free."""
    return await in_turn(request, partial(run_in_threadpool, work, *args, **kwargs))


async def in_turn(request: Request, work: Callable[[], Awaitable[T]]) -> T:
    """Do something once the request has a slot of its room; where the time of the route is limited, for so long.

    A thread cannot be stopped: work that is not waited for any more keeps its slot until it ends, so there are never more
    such threads than slots.

    Raises:
        ServiceError: it took too long, or others did.

    """
    if request.state.has_slot:
        return await work()
    rule: Rule = request.state.rule
    room: Room = request.state.room
    person: str = request.state.caller.sender
    limit_s: float | None = request.app.state.settings.compute_limit_s if rule.instead else None
    await room.take_slot(person, limit_s or room.wait_s)
    request.state.has_slot = True
    if limit_s is None:
        return await _run_and_release(room, person, work)
    task = asyncio.create_task(_run_and_release(room, person, work))
    done, _ = await asyncio.wait({task}, timeout=limit_s)
    if not done:
        task.add_done_callback(_forget)
        raise ServiceError(
            f"It computes for longer than the {limit_s:g} s that an answer may take here (KILTER_COMPUTE_LIMIT_S on the "
            f"server). {rule.instead}",
            code="compute_limit",
            limit_s=limit_s,
        )
    return task.result()


async def _run_and_release(room: Room, person: str, work: Callable[[], Awaitable[T]]) -> T:
    try:
        return await work()
    finally:
        await room.release_slot(person)


def _forget(task: asyncio.Task[Any]) -> None:
    """Take the error of work whose answer nobody waits for, so that the event loop does not report it."""
    if not task.cancelled():
        task.exception()
