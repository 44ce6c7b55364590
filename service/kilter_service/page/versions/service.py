"""What the views of versions show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.campaigns import SuspiciousRows
from kilter_service.contract.fits import Parameter
from kilter_service.contract.robot_reports import RobotReport
from kilter_service.contract.today import Today
from kilter_service.contract.versions import Activation, Version, VersionSummary
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.page.figures.plot import GREY, Plot
from kilter_service.page.figures.scale import category_axis, lengths
from kilter_service.page.shared.accuracy import Accuracy, accuracy_from_metrics
from kilter_service.page.shared.in_names import objections_in_names
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.masses import of_a_mass
from kilter_service.page.shared.parameter_rows import ParameterRow, parameter_rows
from kilter_service.page.words import in_columns
from kilter_service.robots import service as robots
from kilter_service.versions import service
from kilter_service.versions.if_match import tag_of_robot
from kilter_service.versions.predictions import places
from kilter_service.versions.today import service as today

MOST_SHOWN = 200  # versions to compare one with
MOST_BARS = 24
LOG = "log"  # the page of the activations, in the address


@dataclass(frozen=True)
class Listed:
    """A version in the list, with its error."""

    version: VersionSummary
    accuracy: Accuracy | None


@dataclass(frozen=True)
class History:
    """The versions of a robot, newest first, who activated what, and the state that a roll-back starts from.

    ``active`` is the version that the robot is corrected with, ``last`` the newest activation, ``names`` those of versions,
    ``standing`` how good the robot is today in words.
    """

    robot: RobotReport
    versions: Part[Listed]
    activations: Part[Activation]
    etag: str
    figure: Plot | None
    active: VersionSummary | None
    last: Activation | None
    names: Mapping[str, str]
    standing: str


@dataclass(frozen=True)
class Shown:
    """A version with all that its view says of it."""

    version: Version
    accuracy: Accuracy | None
    etag: str
    parameters: Sequence[Parameter]
    rows: Sequence[ParameterRow]
    unseen: Sequence[Parameter]
    others: Sequence[VersionSummary]
    suspicious: Sequence[SuspiciousRows]
    today: Today | None
    parent: str  # name of the version it was started from


def history(database: Database, robot: str, asked: Asked, log: Asked) -> History:
    """Return the versions of a robot that the address asks for, those that are retired too: the lineage has them."""
    found = [
        Listed(one, accuracy_from_metrics(one.metrics))
        for one in service.list_versions(database, robot, Page(), with_retired=True).versions
    ]
    entries = service.activations(database, robot, Page()).activations
    shown = select_page(entries, log, lambda _: "", {}, named=LOG)
    named = [
        one.model_copy(update={"objections": objections_in_names(database, one.objections)}) for one in shown.shown
    ]
    return History(
        robots.get(database, robot),
        _select_versions_page(found, asked),
        replace(shown, shown=named),
        tag_of_robot(database, robot),
        errors_by_version(found),
        next((one.version for one in found if one.version.active), None),
        entries[0] if entries else None,
        {one.version.id: display_name(one.version) for one in found},
        today.of_robot(database, robot).sentences[0],
    )


def _select_versions_page(found: Sequence[Listed], asked: Asked) -> Part[Listed]:
    def state(one: Listed) -> str:
        return "active" if one.version.active else "retired" if one.version.retired_at else "other"

    return select_page(
        found,
        asked,
        lambda one: f"{one.version.name} {one.version.id} {one.version.notes} {' '.join(one.version.effects)}",
        {
            "name": lambda one: display_name(one.version),
            "made": lambda one: one.version.created_at,
            "error": lambda one: one.accuracy.mean if one.accuracy else None,
        },
        {"state": state},
        "-made",
    )


def version(database: Database, version_id: str) -> Shown:
    """Return a version."""
    found = service.get(database, version_id)
    known = [
        one for one in found.parameters if one.value is not None and (one.identifiable is not False or one.from_prior)
    ]
    unknown = [one for one in found.parameters if one not in known]
    unseen = [one for one in unknown if not of_a_mass(one.name)]
    others = service.list_versions(database, found.robot, Page(limit=MOST_SHOWN)).versions
    rest = sorted((one for one in others if one.id != version_id), key=lambda one: not one.active)
    now = today.of_robot(database, found.robot) if found.active else None
    odd = suspicious.of_campaigns(database, (used.id for used in found.campaigns))
    parent = "" if found.parent_id is None else display_name(service.get(database, found.parent_id))
    return Shown(
        found,
        accuracy_from_metrics(found.metrics),
        tag_of_robot(database, found.robot),
        known,
        parameter_rows(known, places.prior_sigmas(database, version_id)),
        unseen,
        rest,
        odd,
        now,
        parent,
    )


def errors_by_version(found: Sequence[Listed]) -> Plot | None:
    """Draw the held-out error of each version, oldest first; None with fewer than two."""
    known = [(one.version, one.accuracy) for one in reversed(found) if one.accuracy and one.accuracy.held_out]
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
