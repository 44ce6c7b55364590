"""Robots, campaigns, versions and jobs of a server, as the documents it sends."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from kilter_client.requests.calls import campaigns, jobs, references, robots, versions
from kilter_client.requests.calls.jobs import Progress, require_success
from kilter_client.requests.calls.references import Found, Kind, is_full
from kilter_client.requests.connection import Connection, make_document_method
from kilter_client.requests.steps import Document, Sent, event_data
from kilter_files import prepare

if TYPE_CHECKING:
    from kilter_files import Prepared


__all__ = [
    "Found",
    "Jobs",
    "Kept",
    "Kind",
    "Progress",
    "Resource",
    "Validation",
    "event_data",
    "is_full",
    "require_success",
]


class Resource:
    """What can be asked about one kind of thing, over a connection."""

    def __init__(self, connection: Connection) -> None:
        self._run = connection.run


class Kept(Resource):
    """What campaigns and versions have in common. An id may be its beginning, a name, or ``latest`` of a robot."""

    kind: ClassVar[Kind]

    def resolve_id(self, reference: str, robot: str | None = None) -> str:
        """Return the id that a reference stands for."""
        return self._run(references.resolve_id(self.kind, reference, robot))

    def change(
        self, reference: str, *, name: str | None = None, notes: str | None = None, robot: str | None = None
    ) -> Document:
        """Name it, or note something on it; what is left out stays."""
        return self._run(references.change(self.kind, reference, name, notes, robot))

    def retire(self, reference: str, robot: str | None = None) -> Document:
        """Take it out of use; what cites it does not change."""
        return self._run(references.do(self.kind, reference, "retire", robot))

    def restore(self, reference: str, robot: str | None = None) -> Document:
        """Bring it back into use."""
        return self._run(references.do(self.kind, reference, "restore", robot))

    def purge(self, full_id: str) -> Document:
        """Delete it for good, by its full id, if nothing cites it; returns what is left: its hash, who and when."""
        return self._run(references.purge(self.kind, full_id))


def is_same_campaign(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Whether a campaign is the wanted one: its name, perhaps with a number behind it, and all that is stated of its rows.

    The same rows at another temperature, with another payload or by another instrument are another campaign: what is
    stated of them is never dropped because they were sent before with less.
    """
    numbered = r"( \(\d+\))?" if wanted.get("numbered") else ""  # the server put it behind a name that was taken
    called = re.fullmatch(re.escape(wanted["name"]) + numbered, known["name"]) is not None
    alike = all((known.get(key) or "") == (wanted.get(key) or "") for key in ("device", "role", "notes", "instrument"))
    there, asked = (one.get("conditions") or {} for one in (known, wanted))
    named = [{name for name, value in one.items() if value is not None} for one in (there, asked)]
    holds = named[0] == named[1] and _agree(there, asked)
    return called and alike and holds and _day(known.get("measured_at")) == _day(wanted.get("measured_at"))


def _agree(there: Any, asked: Any) -> bool:
    """Whether what is asked stands there; the server adds what a document leaves to its defaults."""
    if isinstance(asked, Mapping) and isinstance(there, Mapping):
        return all(_agree(there.get(name), value) for name, value in asked.items() if value is not None)
    if isinstance(asked, list | tuple) and isinstance(there, list | tuple):
        return len(there) == len(asked) and all(_agree(a, b) for a, b in zip(there, asked, strict=True))
    return bool(there == asked)


def _day(moment: str | None) -> object:
    """The day of a time: one that is given as today ends now, at each sending a little later."""
    return None if moment is None else datetime.fromisoformat(moment).astimezone().date()


class Robots(Resource):
    """The robots."""

    add = make_document_method(robots.add)
    check = make_document_method(robots.check)
    convert = make_document_method(robots.convert)
    from_circles = make_document_method(robots.from_circles)
    frame = make_document_method(robots.frame)
    list = make_document_method(robots.list_robots)
    get = make_document_method(robots.fetch_document)
    compensation = make_document_method(robots.compensate)
    tolerance = make_document_method(robots.set_tolerance)
    today = make_document_method(robots.today)
    bridges = make_document_method(robots.bridges)
    announce_bridge = make_document_method(robots.announce_bridge)
    drift = make_document_method(robots.drift)
    drifts = make_document_method(robots.drifts)
    remove = make_document_method(robots.remove)
    note = make_document_method(robots.note)
    stream_session = make_document_method(robots.stream_session)

    def retire(self, name: str) -> Document:
        """Take a robot out of use; the active version keeps correcting."""
        return self._run(robots.do(name, "retire"))

    def restore(self, name: str) -> Document:
        """Bring a robot back into use."""
        return self._run(robots.do(name, "restore"))

    def purge(self, name: str) -> Document:
        """Delete a robot without campaigns and versions; returns what is left: its hash, who and when."""
        return self._run(robots.do(name, "purge"))


class Campaigns(Kept):
    """The measurement campaigns. An id may be its beginning, a name, or ``latest`` with its robot."""

    kind = "campaign"

    def add(
        self,
        robot: str,
        name: str,
        *,
        device: str = "",
        role: str = "train",
        conditions: Mapping[str, Any] | None = None,
        notes: str = "",
        staged: bool = False,
        numbered: bool = False,
        measured_at: str | None = None,
        instrument: str | None = None,
    ) -> Document:
        """Add a campaign to a robot; a ``staged`` one is seen and used by nobody before ``commit``.

        A name that another campaign of the robot has is refused; ``numbered`` puts a number behind it instead.
        """
        wanted = {
            "name": name,
            "device": device,
            "role": role,
            "conditions": dict(conditions or {}),
            "notes": notes,
            "staged": staged,
            "numbered": numbered,
            "measured_at": measured_at,
            "instrument": instrument,
        }
        return self._run(campaigns.add(robot, wanted))

    check = make_document_method(campaigns.check)
    list = make_document_method(campaigns.list_campaigns)
    commit = make_document_method(campaigns.commit)
    discard = make_document_method(campaigns.discard)
    get = make_document_method(campaigns.fetch_document)
    rows = make_document_method(campaigns.rows)
    suspicious = make_document_method(campaigns.suspicious)

    def upload(
        self, campaign: str, data: Prepared | Path | str, sent: Sent | None = None, robot: str | None = None
    ) -> Document:
        """Send observations: a prepared file, or the path of one with contract columns. The same bytes change nothing.

        ``sent`` is told the bytes sent and their total.
        """
        file = prepare(data) if isinstance(data, str | Path) else data
        return self._run(campaigns.upload(campaign, file, sent, robot))


class Versions(Kept):
    """The parameter versions. An id may be its beginning, a name, or ``latest`` with its robot."""

    kind = "version"

    list = make_document_method(versions.list_versions)
    get = make_document_method(versions.fetch_document)
    activate = make_document_method(versions.activate)
    activations = make_document_method(versions.activations)
    rollback = make_document_method(versions.rollback)
    diff = make_document_method(versions.diff)
    residuals = make_document_method(versions.residuals)
    export = make_document_method(versions.export)


Validation = Sequence[str] | float | Mapping[str, int] | None


class Jobs(Resource):
    """The jobs of a server."""

    def submit(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Ask for a job (identify, gap, evaluate, plan, joint_parameters) and return its document, still queued.

        ``confirmation`` are campaigns of another day or set-up in which a gap search must see again what it found.
        Campaigns and versions may be named by the beginning of an id, a name, or ``latest``. ``name`` is that of the job
        and of the version it makes.
        """
        body = jobs.request_body(kind, robot, campaigns, validation, options, confirmation, name)
        return self._run(jobs.submit(robot, body))

    def check(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Say what such a job would do, at once: nothing is stored, nothing queued.

        The document has ``would_run`` and ``problems``, what is used and held out, ``missing``, ``duration_s``; of
        ``identify`` also ``identifiability``, of ``gap`` ``testability``.
        """
        body = jobs.request_body(kind, robot, campaigns, validation, options, confirmation, name)
        return self._run(jobs.check(robot, body))

    list = make_document_method(jobs.list_jobs)
    get = make_document_method(jobs.fetch_document)
    cancel = make_document_method(jobs.cancel)
    wait = make_document_method(jobs.wait)

    def run(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
        timeout_s: float | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Submit a job and wait for it."""
        job = self.submit(kind, robot, campaigns, validation, options, confirmation, name)
        return self.wait(job["id"], progress, timeout_s)
