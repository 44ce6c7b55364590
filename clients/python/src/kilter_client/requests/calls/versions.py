"""Calls about versions, and corrections by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from kilter_client.requests.calls.references import place, resolve_id
from kilter_client.requests.steps import Answer, Document, Request, Steps, address, get, post, send_with_retries

if TYPE_CHECKING:
    from kilter_files import Prepared

LONG_TIMEOUT_S = 600.0
NOMINAL = "nominal"  # in a comparison: the nominal robot


def list_versions(robot: str, retired: bool = False) -> Steps[list[Document]]:
    """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
    found = yield from get(address("robots", robot, "versions"), retired=retired or None)
    return list(found["versions"])


def fetch_document(version: str, robot: str | None = None) -> Steps[Document]:
    """Return a version: parent, job, campaigns, effects, parameters, covariance."""
    path = yield from place("version", version, robot)
    return (yield from get(path))


def preview(version: str, robot: str | None = None) -> Steps[Document]:
    """Return how a version would correct."""
    path = yield from place("version", version, robot, "preview")
    return (yield from get(path))


def activate(
    version: str, *, force: bool = False, reason: str = "", robot: str | None = None, if_match: str | None = None
) -> Steps[Document]:
    """Make a version the one that corrects, unless it predicts worse than the active one.

    ``force`` activates it nevertheless; the log records this and the ``reason``. ``if_match``: only from the state of
    that ETag.
    """
    path = yield from place("version", version, robot, "activate")
    headers = {"If-Match": if_match} if if_match else {}
    return (yield from post(path, {"force": force, "reason": reason}, headers))


def rollback(robot: str) -> Steps[Document]:
    """Return to the version before the one that is active now: sent twice, or beside another's, it goes back once."""
    active = yield from send_with_retries(Request("GET", address("robots", robot, "activations"), params={"limit": 1}))
    state = active.headers.get("etag")
    return (yield from post(address("robots", robot, "rollback"), headers={"If-Match": state} if state else {}))


def activations(robot: str) -> Steps[list[Document]]:
    """Return who activated which version of a robot, when and why, newest first."""
    found = yield from get(address("robots", robot, "activations"))
    return list(found["activations"])


def diff(first: str, second: str, robot: str | None = None) -> Steps[Document]:
    """Compare two versions; ``nominal`` stands for the nominal robot, a job for the version that it made."""
    one = first if first == NOMINAL else (yield from resolve_id(_kind(first), first, robot))
    other = second if second == NOMINAL else (yield from resolve_id(_kind(second), second, robot))
    return (yield from get(address("versions", one, "diff", other)))


def residuals(version: str, campaigns: Sequence[str] = (), form: str = "csv", robot: str | None = None) -> Steps[bytes]:
    """Return what a version leaves of every row as a file, csv or parquet: of these campaigns, or of all its own."""
    path = yield from place("version", version, robot, "residuals")
    used = []
    for campaign in campaigns:
        found = yield from resolve_id("campaign", campaign, robot)
        used.append(found)
    asked = {"format": form, "campaign": used}
    answer = yield from send_with_retries(Request("GET", path, params=asked, timeout_s=LONG_TIMEOUT_S))
    return answer.content


def export(
    version: str, form: str = "json", robot: str | None = None, ranges_percent: float | None = None
) -> Steps[Exported]:
    """Return a version as a file: json, urdf, dh-csv, ...; its ``notes`` say what it leaves out.

    Form ``ranges`` is how far the arm may be from it; the ranges cover ``ranges_percent``, by default 95.
    """
    path = yield from place("version", version, robot, "export")
    wanted = {"format": form} | ({} if ranges_percent is None else {"ranges": str(ranges_percent)})
    answer = yield from send_with_retries(Request("GET", path, params=wanted))
    exported = Exported(answer.content)
    exported.notes = server_notes(answer)
    return exported


def server_notes(answer: Answer) -> tuple[str, ...]:
    """What the server says of a file beside it."""
    return tuple(filter(None, answer.headers.get("kilter-notes", "").split(" | ")))


def correct(
    robot: str,
    trajectory: Prepared,
    version: str | None,
    form: str | None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
    *,
    task: str | None = None,
    strict: bool = False,
    at_limit: str | None = None,
    hold: Sequence[int] | None = None,
) -> Steps[Answer]:
    """Correct a trajectory; ``strict`` refuses it unless every row is corrected to within what is stated."""
    chosen = None if not version else (yield from resolve_id("version", version, robot))
    wanted = {
        "version": chosen,
        "format": form or None,
        "task": task or None,
        "strict": strict or None,
        "at_limit": at_limit or None,
        "hold": list(hold) if hold else None,
    }
    return (yield from _send_path(robot, "correct", trajectory, wanted, payload_kg, payload_com_mm, bool(form)))


def torques(
    robot: str,
    path: Prepared,
    search: str | None,
    version: str | None,
    payload_kg: float | None = None,
    payload_com_mm: Sequence[float] | None = None,
) -> Steps[Answer]:
    """Add the torques that a path needs, by a search in torques or a version."""
    wanted = {
        "search": None if not search else (yield from resolve_id("job", search, robot)),
        "version": None if not version else (yield from resolve_id("version", version, robot)),
    }
    return (yield from _send_path(robot, "torques", path, wanted, payload_kg, payload_com_mm))


def _send_path(
    robot: str,
    what: str,
    path: Prepared,
    wanted: Document,
    payload_kg: float | None,
    payload_com_mm: Sequence[float] | None,
    other_form: bool = False,
) -> Steps[Answer]:
    carried = None if payload_com_mm is None else ",".join(f"{float(value)!r}" for value in payload_com_mm)
    wanted = {**wanted, "payload_kg": payload_kg, "payload_com_mm": carried}
    request = Request(
        "POST",
        address("robots", robot, what),
        content=path.content,
        headers={"Content-Type": path.content_type, "Accept": "*/*" if other_form else path.content_type},
        params={name: value for name, value in wanted.items() if value is not None},
        timeout_s=LONG_TIMEOUT_S,
        again=True,
    )
    return (yield from send_with_retries(request))


def _kind(reference: str) -> Literal["job", "version"]:
    return "job" if reference.startswith("job_") else "version"


class Exported(bytes):
    """A version as bytes of a file; ``notes`` are what the file leaves out, and what else the server says of it."""

    notes: tuple[str, ...] = ()
