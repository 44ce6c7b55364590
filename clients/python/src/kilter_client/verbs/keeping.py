"""Verbs that name, note, retire, restore and purge."""

from __future__ import annotations

from typing import Any, cast

from kilter_client import typed
from kilter_client.errors import UsageError
from kilter_client.requests.calls import references
from kilter_client.requests.calls import robots as robot_calls
from kilter_client.requests.calls.references import Kind
from kilter_client.requests.steps import Document, Steps
from kilter_client.results.record import Record
from kilter_client.verbs.inputs import ResourceReference, What, infer_kind, reference


def change(
    thing: ResourceReference,
    *,
    name: str | None = None,
    notes: str | None = None,
    kind: What | None = None,
    robot: str | None = None,
) -> Steps[Record]:
    """Name a campaign or version, or add a note to it or to a robot; what is left out stays.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.
        ConflictError: the name is taken.

    """
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    if what != "robot":
        return _read(what, (yield from references.change(_require_keepable(what), called, name, notes, robot)))
    if name is not None:
        raise UsageError("A robot keeps the name it was added with: give notes= only.")
    return _read(what, (yield from robot_calls.note(called, notes or "")))


def retire(thing: ResourceReference, *, kind: What | None = None, robot: str | None = None) -> Steps[Record]:
    """Take a campaign, a version or a robot out of use; what cites it does not change.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.
        ConflictError: it is active.

    """
    return (yield from _do("retire", thing, kind, robot))


def restore(thing: ResourceReference, *, kind: What | None = None, robot: str | None = None) -> Steps[Record]:
    """Bring a campaign, a version or a robot back into use.

    Raises:
        UsageError: a name alone does not say what it is: give ``kind``.

    """
    return (yield from _do("restore", thing, kind, robot))


def purge(thing: ResourceReference, *, kind: What | None = None) -> Steps[typed.comparisons.Tombstone]:
    """Delete a retired campaign, version or robot for good, by its full id; returns its tombstone: its hash, who, when.

    Raises:
        ConflictError: something cites it, or it is in use.

    """
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    found = (
        yield from robot_calls.do(called, "purge")
        if what == "robot"
        else references.purge(_require_keepable(what), called)
    )
    return typed.comparisons.Tombstone.read(found)


def _do(doing: str, thing: ResourceReference, kind: What | None, robot: str | None) -> Steps[Record]:
    what = infer_kind(thing, kind)
    called = reference(what, thing)
    if what == "robot":
        return _read(what, (yield from robot_calls.do(called, doing)))
    return _read(what, (yield from references.do(_require_keepable(what), called, doing, robot)))


def _require_keepable(what: What) -> Kind:
    if what == "job":
        raise UsageError("Jobs are kept as they are: name, note, retire or purge the version that the job made.")
    return cast(Kind, what)


def _read(what: What, document: Document) -> Record:
    kinds: dict[str, Any] = {
        "campaign": typed.campaigns.Campaign,
        "version": typed.versions.Version,
        "robot": typed.robots.RobotReport,
    }
    found: Record = kinds[what].read(document)
    return found
