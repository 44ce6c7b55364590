"""Versions in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.contract.versions import ActivationWish
from kilter_service.ground.correction_outcome import REACHED_M
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.wire import joint_scale, to_mm
from kilter_service.page.figures.plot import BLUE, GREY, ORANGE, RED, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.route import PageRoute
from kilter_service.page.shared import contributions
from kilter_service.page.shared.in_names import in_names
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import get_root_path, redirect, render
from kilter_service.page.versions import by_factor, comparison, looking_ahead, service
from kilter_service.page.versions.looking_ahead import REFUSED
from kilter_service.page.words import bare, largest, percent, unit
from kilter_service.versions import activation
from kilter_service.versions.addressed import AddressedVersion, FirstVersion, SecondVersion
from kilter_service.versions.if_match import Expected
from kilter_service.versions.predictions.places import workspace
from kilter_service.web.auth.access import Admin
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

if TYPE_CHECKING:
    from kilter_core.types import Floats

WHAT = {
    "OK": "corrected to within what is stated",
    "DAMPED": "damped: a singularity is near, or the place is out of reach",
    "LIMITED": "held at a limit of the correction",
    "UNSURE": "corrected, but the version is unsure there",
}
LABELS = {"OK": "corrected", "DAMPED": "damped", "LIMITED": "held at a limit", "UNSURE": "unsure"}
# Drawn in this order, so that the rare ones lie above.
LOOKS = {"OK": (0, GREY), "UNSURE": (0, GREY), "LIMITED": (1, ORANGE), "DAMPED": (0, BLUE)}
REFUSED_LOOK = (2, RED)


@dataclass(frozen=True)
class Shown:
    """Rows of the table (what, share, how many, most that is left), and the map."""

    poses: int
    unit: str
    rows: Sequence[tuple[str, str, int, str]]
    map: Plot


def reach_shown(database: Database, version_id: str, temperature_c: float | None) -> Shown:
    """Look at what a version does all over the joint limits.

    Raises:
        ServiceError: no such version.

    """
    seen = workspace(database, version_id, temperature_c)
    found, words = seen.found, np.array(seen.found.words)
    order = sorted(found.counts, key=_order)
    left = [_most(found.left[words == word]) for word in order]
    most = largest([*left, to_mm(REACHED_M)])
    rows = [
        (
            _state_words(word),
            percent(float((words == word).mean())),
            int((words == word).sum()),
            _format_left_error(one, most),
        )
        for word, one in zip(order, left, strict=True)
    ]
    out = to_mm(np.hypot(seen.points[:, 0], seen.points[:, 1]))
    up = to_mm(seen.points[:, 2])
    plot = Plot(
        "Where the version corrects",
        around("distance from the axis of the base, mm", out.tolist(), zero=True),
        around("height above the base, mm", up.tolist()),
        width=560.0,
        height=380.0,
        description="Each point is a pose drawn within the joint limits, at the place of its tool.",
        table=(
            ["What", "Share", "Poses", f"Most that is left, {unit(most)}"],
            [[a, b, str(c), d] for a, b, c, d in rows],
        ),
    )
    scale = np.array(joint_scale(seen.robot))
    for word in sorted(found.counts, key=_drawn):
        mine = np.flatnonzero(words == word)
        number, colour = LOOKS.get(word, REFUSED_LOOK)
        names = [f"{_label(word)}: {', '.join(f'{v:.0f}' for v in found.q[k] * scale)}" for k in mine]
        plot.points(out[mine].tolist(), up[mine].tolist(), _label(word), number, colour, names)
    return Shown(len(words), unit(most), rows, plot)


def _most(left: Floats) -> float | None:
    """The most that is left, mm; None where it is not known."""
    return None if np.isnan(left).all() else to_mm(float(np.nanmax(left)))


def _format_left_error(left: float | None, most: float | None) -> str:
    """Write it in the unit of the most; to less than a micrometre nothing is computed."""
    least = to_mm(REACHED_M)
    return bare(left, most) if left is None or left >= least else f"below {bare(least, most)}"


def _order(word: str) -> tuple[int, str]:
    return (list(WHAT).index(word) if word in WHAT else len(WHAT), word)


def _drawn(word: str) -> tuple[int, str]:
    return (list(LOOKS).index(word) if word in LOOKS else len(LOOKS), word)


def _state_words(word: str) -> str:
    return WHAT.get(word) or f"refused: {REFUSED.get(word, word.lower().replace('_', ' '))}"


def _label(word: str) -> str:
    return LABELS.get(word) or f"refused ({word.lower().replace('_', ' ')})"


router = APIRouter(include_in_schema=False, route_class=PageRoute)
LONGEST_TAG, LONGEST_REASON = 100, 500
Tag = Annotated[str, Form(max_length=LONGEST_TAG)]


@router.get("/robots/{robot}/versions")
def history(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the versions of a robot and who activated them."""
    asked, log = Asked.from_request(request, ("state",)), Asked.from_request(request, page=service.LOG)
    return render(request, "versions/history.html", shown=service.history(database, robot, asked, log))


@router.get("/robots/{robot}/versions/compare")
def chosen(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    version: Annotated[list[str] | None, Query(max_length=comparison.MOST_VERSIONS)] = None,
    rows: bool = False,
) -> Response:
    """Compare versions that were ticked: two of them in full, of more each with the first, many rows once asked for."""
    wanted = list(dict.fromkeys(version or []))
    if len(wanted) == 2:
        return redirect(request, f"{get_root_path(request)}/versions/{wanted[0]}/compare/{wanted[1]}")
    return render(
        request, "versions/several.html", robot=robot, several=comparison.several(database, robot, wanted, rows)
    )


@router.get("/versions/{version}")
def version(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show a version."""
    return render(request, "versions/version.html", shown=service.version(database, version))


@router.get("/versions/{version}/exports")
def exports(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the files that a version can be downloaded as, and what each leaves out."""
    files = looking_ahead.exports(database, version)
    return render(request, "versions/exports.html", version=version, files=files)


@router.get("/versions/{version}/contributions")
def effects(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show how far each effect of a version moves the tool."""
    return render(request, "versions/contributions.html", moved=contributions.moved_by_each(database, version))


@router.get("/versions/{version}/workspace")
def show_workspace(
    version: AddressedVersion, request: Request, database: DatabaseOfApp, settings: SettingsOfApp
) -> HTMLResponse:
    """Show where a version corrects, damps and refuses."""
    shown = reach_shown(database, version, settings.temperature_c)
    return render(request, "versions/workspace.html", shown=shown)


@router.get("/versions/{version}/by-factor")
def factors(
    version: AddressedVersion,
    request: Request,
    database: DatabaseOfApp,
    campaign: Annotated[list[str] | None, Query()] = None,
) -> HTMLResponse:
    """Show what a version leaves of rows by joint, direction, load and time."""
    return render(request, "versions/by_factor.html", figures=by_factor.figures(database, version, campaign or []))


@router.get("/versions/{version}/activation")
def look_ahead(
    version: AddressedVersion, request: Request, database: DatabaseOfApp, settings: SettingsOfApp
) -> HTMLResponse:
    """Show what would change by activating a version; the first half of activating it."""
    ahead = looking_ahead.correction_ahead(database, version, settings.temperature_c)
    return render(request, "versions/activation.html", ahead=ahead)


@router.post("/versions/{version}/activate")
def activate(
    version: AddressedVersion,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    actor: Admin,
    etag: Tag,
    force: Annotated[bool, Form()] = False,
    reason: Annotated[str, Form(max_length=LONGEST_REASON)] = "",
) -> Response:
    """Activate a version from the state that the dialog showed; a refusal is shown with what can be done."""
    wish = ActivationWish(force=force, reason=reason.strip())
    if wish.force and not wish.reason:
        raise ServiceError("Say why you force it: the log keeps the reason.", code="option_invalid", option="reason")
    try:
        done = activation.activate(database, version, actor, wish, settings.temperature_c, Expected((etag,)))
    except ServiceError as error:
        if error.code != "activation_refused":
            raise
        said = [in_names(database, str(one["message"])) for one in error.context["objections"]]
        return render(request, "versions/refused.html", 409, version=version, etag=etag, said=said)
    return redirect(request, f"{get_root_path(request)}/robots/{done.robot}")


@router.get("/robots/{robot}/rollback")
def look_back(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show what would change by going back to the version before."""
    ahead = looking_ahead.back(database, robot, settings.temperature_c)
    return render(request, "versions/rollback.html", robot=robot, ahead=ahead)


@router.post("/robots/{robot}/rollback")
def roll_back(
    robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin, etag: Tag
) -> Response:
    """Go back to the version before."""
    done = activation.rollback(database, robot, actor, settings.temperature_c, Expected((etag,)))
    return redirect(request, f"{get_root_path(request)}/robots/{done.robot}")


@router.get("/versions/{a}/compare/{b}")
def compare(
    a: FirstVersion,
    b: SecondVersion,
    request: Request,
    database: DatabaseOfApp,
    campaign: Annotated[list[str] | None, Query(max_length=comparison.MOST_CAMPAIGNS)] = None,
    rows: bool = False,
) -> HTMLResponse:
    """Show how two versions differ, and what each leaves of the campaigns chosen; of many rows once they are asked for."""
    shown = comparison.compared_versions(database, a, b, campaign, rows)
    return render(request, "versions/compare.html", shown=shown)
