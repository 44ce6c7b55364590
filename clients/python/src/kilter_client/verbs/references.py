"""Robots, campaigns, versions and jobs as a script names them: a result, an id, its beginning, a name, ``latest``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

from kilter_client.errors import UsageError
from kilter_client.results.record import Record

ResourceReference: TypeAlias = str | Record
What = Literal["robot", "campaign", "version", "job"]

# Where an answer names the thing, the nearest first.
FIELDS: dict[str, tuple[str, ...]] = {
    "robot": ("name",),
    "campaign": ("campaign_id", "id"),
    "version": ("version_id", "id"),
    "job": ("job_id", "id"),
}
BEGINNINGS: dict[str, What] = {"cmp_": "campaign", "ver_": "version", "job_": "job"}


def reference(what: What, thing: ResourceReference) -> str:
    """Return the words that name a thing.

    Raises:
        UsageError: it is something else.

    """
    if isinstance(thing, str):
        return thing
    if isinstance(thing, Record):
        named = [str(thing[field]) for field in FIELDS[what] if thing.get(field)]
        fitting = [name for name in named if what == "robot" or BEGINNINGS.get(name[:4]) == what]
        if fitting and (what != "robot" or "convention" in thing):
            return fitting[0]
    raise UsageError(f"{thing!r} is not a {what}: give its name or id, or the result that made it.")


def references(what: What, things: ResourceReference | Sequence[ResourceReference]) -> list[str]:
    """Return the words that name one thing or several."""
    several = [things] if isinstance(things, str | Record) else things
    return [reference(what, thing) for thing in several]


def infer_kind(thing: ResourceReference, kind: What | None) -> What:
    """Return what a thing is, by its id or by the answer that it is.

    Raises:
        UsageError: a name alone does not say it.

    """
    if kind is not None:
        return kind
    words = (
        thing if isinstance(thing, str) else str(thing.get("version_id") or thing.get("campaign_id") or thing.get("id"))
    )
    if words[:4] in BEGINNINGS:
        return BEGINNINGS[words[:4]]
    if isinstance(thing, Record) and "convention" in thing:
        return "robot"
    raise UsageError(f"{thing!r} may name several things: say which with kind='robot', 'campaign' or 'version'.")
