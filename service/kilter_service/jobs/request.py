"""The route of jobs: what is wrong with a kind or an option is said as a refusal of the job, not of the payload's shape."""

from __future__ import annotations

from fastapi import Request
from fastapi.exceptions import RequestValidationError

from kilter_service.jobs.refusals import refusal, without_kind
from kilter_service.web.conditional import ConditionalRoute


class JobRoute(ConditionalRoute):
    """A route that takes jobs."""

    async def _parse_request_body(self, request: Request, body: bytes) -> Request:
        try:
            return await super()._parse_request_body(request, body)
        except RequestValidationError as error:
            found, document = error.errors(), error.body
            refused = refusal(found, document)
            if refused is not None:
                raise refused from error
            raise RequestValidationError(without_kind(found, document)) from error
