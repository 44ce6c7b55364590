"""Values in requests that no database, terminal or computation holds are refused with their place, before any use."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any

from fastapi import Request

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_DOCUMENT_DEPTH, MAX_NUMBER
from kilter_service.ground.texts import ANY, LINE, LINES

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
