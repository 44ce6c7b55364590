"""The versions of a robot, one of them, and who activated what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from fastapi import Form, Query, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.campaigns import suspicious
from kilter_service.contract.versions import ActivationWish, VersionSummary
from kilter_service.ground.correction_outcome import REACHED_M
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.ground.wire import joint_scale, to_mm
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.figures.plot import BLUE, GREY, ORANGE, RED, Plot, around, category_axis, lengths
from kilter_service.page.shared import errors_drawn
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.naming import in_names, objections_in_names, of_a_mass, parameter_rows
from kilter_service.page.shared.standing import Accuracy, accuracy_from_metrics
from kilter_service.page.versions import comparison
from kilter_service.page.versions import comparison as looking_ahead
from kilter_service.page.versions.comparison import REFUSED
from kilter_service.page.words import bare, in_columns, largest, percent, unit
from kilter_service.robots import service as robots
from kilter_service.versions import activation, service
from kilter_service.versions.if_match import AddressedVersion, Expected, FirstVersion, SecondVersion
from kilter_service.versions.predictions import places
from kilter_service.versions.predictions.places import workspace
from kilter_service.versions.today import service as today
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp

if TYPE_CHECKING:
    from kilter_core.types import Floats


MOST_SHOWN = 200  # versions to compare one with
MOST_BARS = 24
LOG = "log"  # the page of the activations, in the address


Listed = tuple[VersionSummary, Accuracy | None]  # a version in the list, with its error


def history(database: Database, robot: str, asked: Asked, log: Asked) -> dict[str, Any]:
    """Return the versions of a robot that the address asks for, those that are retired too: the lineage has them.

    ``active`` is the version that the robot is corrected with, ``last`` the newest activation, ``names`` those of versions,
    ``standing`` how good the robot is today in words.
    """
    made = service.list_versions(database, robot, Page(), with_retired=True).versions
    found = [(one, accuracy_from_metrics(one.metrics)) for one in made]
    entries = service.activations(database, robot, Page()).activations
    shown = select_page(entries, log, lambda _: "", {}, named=LOG)
    named = [
        one.model_copy(update={"objections": objections_in_names(database, one.objections)}) for one in shown.shown
    ]
    return {
        "robot": robots.get(database, robot),
        "versions": _select_versions_page(found, asked),
        "activations": replace(shown, shown=named),
        "figure": errors_by_version(found),
        "active": next((one for one in made if one.active), None),
        "last": entries[0] if entries else None,
        "names": {one.id: display_name(one) for one in made},
        "standing": today.of_robot(database, robot).sentences[0],
    }


def _select_versions_page(found: Sequence[Listed], asked: Asked) -> Part[Listed]:
    return select_page(
        found,
        asked,
        lambda one: f"{one[0].name} {one[0].id} {one[0].notes} {' '.join(one[0].effects)}",
        {
            "name": lambda one: display_name(one[0]),
            "made": lambda one: one[0].created_at,
            "error": lambda one: one[1].mean if one[1] else None,
        },
        {"state": lambda one: "active" if one[0].active else "retired" if one[0].retired_at else "other"},
        "-made",
    )


def load_version(database: Database, version_id: str) -> dict[str, Any]:
    """Return a version with all that its view says of it; ``parent`` is the name of the version it was started from."""
    found = service.get(database, version_id)
    known = [
        one for one in found.parameters if one.value is not None and (one.identifiable is not False or one.from_prior)
    ]
    others = service.list_versions(database, found.robot, Page(limit=MOST_SHOWN)).versions
    return {
        "version": found,
        "accuracy": accuracy_from_metrics(found.metrics),
        "rows": parameter_rows(known, places.prior_sigmas(database, version_id)),
        "unseen": [one for one in found.parameters if one not in known and not of_a_mass(one.name)],
        "others": sorted((one for one in others if one.id != version_id), key=lambda one: not one.active),
        "suspicious": suspicious.of_campaigns(database, (used.id for used in found.campaigns)),
        "today": today.of_robot(database, found.robot) if found.active else None,
        "parent": "" if found.parent_id is None else display_name(service.get(database, found.parent_id)),
    }


def errors_by_version(found: Sequence[Listed]) -> Plot | None:
    """Draw the held-out error of each version, oldest first; None with fewer than two."""
    known = [(version, error) for version, error in reversed(found) if error and error.held_out]
    if len(known) < 2:
        return None
    known = known[-MOST_BARS:]
    names = [version.name or f"{version.created_at:%m-%d %H:%M:%S}" for version, _ in known]
    means = [accuracy.mean for _, accuracy in known]
    ends = [(a.mean if a.low is None else a.low, a.mean if a.high is None else a.high) for _, a in known]
    unit, sizes = in_columns([[mean, *both] for mean, both in zip(means, ends, strict=True)])
    table = [[name, mean, f"{low} to {high}"] for name, (mean, low, high) in zip(names, sizes, strict=True)]
    drawn = Plot(
        "Held-out error of each version",
        category_axis("version, oldest first", names),
        lengths("mean error", [0.0, *means, *(high for _, high in ends)], zero=True),
        height=260.0,
        description="A bar for each version, with the 95 % interval of its mean error on the poses held out of its own fit.",
        table=(["version", f"mean error, {unit}", f"95 % interval, {unit}"], table),
    )
    active = [version.active for version, _ in known]
    for which, label, number, colour in ((True, "active", 0, ""), (False, "not active", 1, GREY)):
        some = [k for k, one in enumerate(active) if one is which]
        if some:
            places, values = [k + 0.5 for k in some], [means[k] for k in some]
            drawn.bars(places, values, 0.5, label, number, colour, errors=[ends[k] for k in some])
    return drawn


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


def reach_shown(database: Database, version_id: str, temperature_c: float | None) -> dict[str, Any]:
    """Look at what a version does all over the joint limits: lines of the table, and the map.

    Raises:
        ServiceError: no such version.

    """
    seen = workspace(database, version_id, temperature_c)
    found, words = seen.found, np.array(seen.found.words)
    order = sorted(found.counts, key=lambda word: _place_among(word, WHAT))
    left = [_most(found.left[words == word]) for word in order]
    most = largest([*left, to_mm(REACHED_M)])
    rows = [
        [_state_words(word), percent((words == word).mean()), f"{(words == word).sum()}", _format_left_error(one, most)]
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
        table=(["What", "Share", "Poses", f"Most that is left, {unit(most)}"], rows),
    )
    scale = np.array(joint_scale(seen.robot))
    for word in sorted(found.counts, key=lambda word: _place_among(word, LOOKS)):
        mine = np.flatnonzero(words == word)
        number, colour = LOOKS.get(word, REFUSED_LOOK)
        names = [f"{_label(word)}: {', '.join(f'{v:.0f}' for v in found.q[k] * scale)}" for k in mine]
        plot.points(out[mine].tolist(), up[mine].tolist(), _label(word), number, colour, names)
    return {"poses": len(words), "unit": unit(most), "rows": rows, "map": plot}


def _most(left: Floats) -> float | None:
    """The most that is left, mm; None where it is not known."""
    return None if np.isnan(left).all() else to_mm(float(np.nanmax(left)))


def _format_left_error(left: float | None, most: float | None) -> str:
    """Write it in the unit of the most; to less than a micrometre nothing is computed."""
    least = to_mm(REACHED_M)
    return bare(left, most) if left is None or left >= least else f"below {bare(least, most)}"


def _place_among(word: str, known: Mapping[str, object]) -> tuple[int, str]:
    return (list(known).index(word) if word in known else len(known), word)


def _state_words(word: str) -> str:
    return WHAT.get(word) or f"refused: {REFUSED.get(word, word.lower().replace('_', ' '))}"


def _label(word: str) -> str:
    return LABELS.get(word) or f"refused ({word.lower().replace('_', ' ')})"


LONGEST_TAG, LONGEST_REASON = 100, 500
Tag = Annotated[str, Form(max_length=LONGEST_TAG)]


@router.get("/robots/{robot}/versions")
def show_history(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the versions of a robot and who activated them."""
    asked, log = Asked.from_request(request, ("state",)), Asked.from_request(request, page=LOG)
    return render(request, "versions/history.html", shown=history(database, robot, asked, log))


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
        return redirect(request, f"/versions/{wanted[0]}/compare/{wanted[1]}")
    return render(
        request, "versions/several.html", robot=robot, several=comparison.several(database, robot, wanted, rows)
    )


@router.get("/versions/{version}")
def show_version(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show a version."""
    return render(request, "versions/version.html", shown=load_version(database, version))


@router.get("/versions/{version}/exports")
def exports(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the files that a version can be downloaded as, and what each leaves out."""
    files = looking_ahead.exports(database, version)
    return render(request, "versions/exports.html", version=version, files=files)


@router.get("/versions/{version}/contributions")
def effects(version: AddressedVersion, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show how far each effect of a version moves the tool."""
    return render(request, "versions/contributions.html", moved=errors_drawn.moved_by_each(database, version))


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
    return render(request, "versions/by_factor.html", figures=comparison.figures(database, version, campaign or []))


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
        return render(request, "versions/refused.html", 409, version=version, said=said)
    return redirect(request, f"/robots/{done.robot}")


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
    return redirect(request, f"/robots/{done.robot}")


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
