"""`Idempotency-Key`: the same request sent again, also at the same time, does nothing more and has the first answer.

The answer is stored in the transaction of what it answers, and transactions that write follow one another: whichever
repeat comes second finds it. Keys are the person's: those of another token, by a header or by a login, are other keys, and so
are those for another address.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Header, Request
from pydantic import BaseModel, TypeAdapter

from kilter_service.ground.db import Session
from kilter_service.ground.errors import ServiceError
from kilter_service.web import store
from kilter_service.web.auth.access import get_caller

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
