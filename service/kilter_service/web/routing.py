"""Routes that ask for a token, answers that a client may keep, requests that are carried out once, and what routes share.

The answer is stored in the transaction of what it answers, and transactions that write follow one another: whichever
repeat comes second finds it. Keys are the person's: those of another token, by a header or by a login, are other keys, and so
are those for another address.
"""

from __future__ import annotations

import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Header, Request, Response
from fastapi import Query as FromQuery
from fastapi.concurrency import run_in_threadpool
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Query
from fastapi.routing import APIRoute
from pydantic import BaseModel, TypeAdapter

from kilter_service.contract.server import REFUSALS
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, decode_cursor
from kilter_service.ground.private_files import Scratch
from kilter_service.ground.settings import Settings
from kilter_service.web import store
from kilter_service.web.auth.access import admit, get_caller
from kilter_service.web.auth.policy import Kind, Rule
from kilter_service.web.bodies import check_address, check_names, in_turn, is_json, parse_json, read_document, room_of

Handler = Callable[[Request], Awaitable[Response]]


class GuardedRoute(APIRoute):
    """A route of Kilter.

    Who sends the request, and whether that is enough, is settled before the body is read. A JSON document is read up to the
    size limit, parsed and validated in a thread, and answered when a slot is free. Endpoints receive files themselves.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **more: Any) -> None:
        if more.get("include_in_schema", True):
            more["responses"] = {**REFUSALS, **(more.get("responses") or {})}
        super().__init__(path, endpoint, **more)

    def get_route_handler(self) -> Callable[[Request], Any]:
        """Return what answers a request."""
        answer: Handler = super().get_route_handler()
        takes_file = "requestBody" in (self.openapi_extra or {})
        # Views of the page are opened with whatever other sites append to a link; they pass over what they do not know.
        strict = self.path.startswith(("/v1/", "/metrics"))
        known = frozenset(
            field.alias for field in get_flat_params(self.dependant) if isinstance(field.field_info, Query)
        )

        async def handle(request: Request) -> Response:
            check_address(request)  # before the database sees what is in it
            request.state.rule = await admit(request, self.path)
            if strict:
                check_names(request, known)
            kind = self._kind_of_work(request.state.rule, takes_file)
            if kind is None:
                return await answer(request)
            with room_of(request, kind).entered(request.state.caller.sender):
                if takes_file:  # it takes its slot once the file is on disk
                    return await answer(request)
                if self.body_field is not None:
                    return await self._answer_document(request, answer)
                return await in_turn(request, lambda: answer(request))

        return handle

    def _kind_of_work(self, rule: Rule, takes_file: bool) -> Kind | None:
        if rule.room is not None:
            return rule.room
        if takes_file:
            return "files"
        if self.body_field is not None:
            return "checks" if rule.instead else "documents"
        return "reads" if rule.instead else None

    async def _answer_document(self, request: Request, answer: Handler) -> Response:
        body = await read_document(request, request.app.state.settings.max_document_mb)

        async def answer_parsed_request() -> Response:
            return await answer(await self._parse_request_body(request, body))

        return await in_turn(request, answer_parsed_request)

    async def _parse_request_body(self, request: Request, body: bytes) -> Request:
        """Return the request with its document parsed; FastAPI finds both where it would have put them."""
        found = Request(request.scope, request.receive)
        found._body = body
        if body and is_json(request):
            found._json = await parse_json(body)
            assert self.body_field is not None
            # FastAPI checks on the event loop. What is wrong, and may be so in many places, is found here.
            _, errors = await run_in_threadpool(self.body_field.validate, found._json, loc=("body",))
            if errors:
                raise RequestValidationError(errors, body=found._json)
        return found


# Only its own reader may keep an answer, and asks each time whether it still holds: people rename and retire things.
ASK_AGAIN = "private, no-cache"
FOR_GOOD = "private, max-age=31536000, immutable"  # of what nothing changes any more
NOT_CHANGED = {304: {"description": "`If-None-Match` names what would be sent: it is not sent again"}}


class ConditionalRoute(GuardedRoute):
    """A route whose plain reads have an ETag, made from what they say, and honour `If-None-Match`."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **more: Any) -> None:
        if more.get("methods") == ["GET"]:
            more["responses"] = {**NOT_CHANGED, **(more.get("responses") or {})}
        super().__init__(path, endpoint, **more)

    def get_route_handler(self) -> Callable[[Request], Any]:
        """Return what answers a request."""
        answer = super().get_route_handler()

        async def handle(request: Request) -> Response:
            response: Response = await answer(request)
            if request.method == "GET" and response.status_code == 200 and hasattr(response, "body"):
                return _conditional(request, response)
            return response

        return handle


def _conditional(request: Request, response: Response) -> Response:
    # An endpoint that knows the state behind its answer has named it already: `If-Match` names that state.
    tag = response.headers.get("etag") or f'"{hashlib.blake2s(bytes(response.body), digest_size=16).hexdigest()}"'
    response.headers["ETag"] = tag
    response.headers.setdefault("Cache-Control", ASK_AGAIN)
    if not _has_matching_etag(request.headers.get("if-none-match", ""), tag):
        return response
    kept = {name: response.headers[name] for name in ("ETag", "Cache-Control")}
    return Response(status_code=304, headers=kept)


def _has_matching_etag(header: str, tag: str) -> bool:
    """Whether a list of ETags has this one; a weak one counts, as RFC 9110 wants of a read."""
    named = [one.strip().removeprefix("W/") for one in header.split(",")]
    return tag in named or named == ["*"]


A = TypeVar("A")
M = TypeVar("M", bound=BaseModel)
LONGEST = 200


@dataclass(frozen=True)
class Once:
    """The key of a request; without one (``id`` None) nothing is looked up and nothing kept."""

    id: str | None = None

    def first_answer(self, session: Session, body_sha256: str, answer: TypeAdapter[A]) -> A | None:
        """Return the first answer under this key, None when this is the first request.

        Raises:
            ServiceError: the first one had another body.

        """
        found = None if self.id is None else store.answer(session, self.id)
        if found is None:
            return None
        if found[0] != body_sha256:
            raise ServiceError(
                "This Idempotency-Key was sent before with another body: send the same body again, or a new key for a new "
                "request. Nothing was stored.",
                code="idempotency_mismatch",
            )
        return answer.validate_python(found[1])

    def keep(self, session: Session, body_sha256: str, answer: M) -> M:
        """Keep the answer for repeats; returns it."""
        if self.id is not None:
            store.keep(session, self.id, body_sha256, answer.model_dump(mode="json"))
        return answer


NOT_REPEATED = Once()


def hash_document(body: BaseModel) -> str:
    """Return the hash of a document as it was understood: another order of its fields is the same."""
    return hashlib.sha256(body.model_dump_json().encode()).hexdigest()


async def once_from_header(
    request: Request,
    idempotency_key: Annotated[
        str | None,
        Header(
            min_length=1,
            max_length=LONGEST,
            pattern=r"^[\x21-\x7e]+$",
            description="The same key with the same body, within seven days: nothing more is done, the first answer comes",
        ),
    ] = None,
) -> Once:
    """Return the key that a request brings; a dependency of its route."""
    if idempotency_key is None:
        return Once()
    caller = get_caller(request)
    whole = (request.method, request.url.path, caller.token_id, caller.actor, idempotency_key)
    return Once(hashlib.sha256("\0".join(whole).encode()).hexdigest())


OnceOnly = Annotated[Once, Depends(once_from_header)]


async def get_database(request: Request) -> Database:
    """Return the database of the application that serves this request."""
    database: Database = request.app.state.database
    return database


async def get_settings(request: Request) -> Settings:
    """Return the settings of the application that serves this request."""
    settings: Settings = request.app.state.settings
    return settings


def get_scratch(request: Request) -> Scratch:
    """Return where the application that serves this request keeps temporary files."""
    scratch: Scratch = request.app.state.scratch
    return scratch


DatabaseOfApp = Annotated[Database, Depends(get_database)]
SettingsOfApp = Annotated[Settings, Depends(get_settings)]


MOST = 1000
JOBS = 100  # newest jobs that are listed by default

Limit = Annotated[int | None, FromQuery(ge=1, le=MOST, description="Entries of a page, 1 to 1000; left out: all.")]
JobsLimit = Annotated[int, FromQuery(ge=1, le=MOST, description="Jobs of a page, 1 to 1000.")]
After = Annotated[
    str | None, FromQuery(max_length=400, description="`next` of the page before; left out: the first page.")
]


async def page(limit: Limit = None, after: After = None) -> Page:
    """Read which page of a list is asked for."""
    return Page(limit, None if after is None else decode_cursor(after))


async def page_of_jobs(limit: JobsLimit = JOBS, after: After = None) -> Page:
    """Read which page of the jobs is asked for."""
    return Page(limit, None if after is None else decode_cursor(after))


PageOfList = Annotated[Page, Depends(page)]
PageOfJobs = Annotated[Page, Depends(page_of_jobs)]
