"""What a metrologist should know of a fit before trusting it: the checks after a fit, in the order they are told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.chain import Element
from kilter_core.effects.masses import LoadError
from kilter_core.errors import FindingDocument
from kilter_core.identify.carried_masses import beside_drawn_masses, considered_masses
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet_report import prior_warnings
from kilter_core.identify.identifiability import far_from_stated, identifiable, load_rows
from kilter_core.identify.measured_rows import Repeats
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.believable import another_arm
from kilter_core.identify.plausibility.belonging import unless_astray
from kilter_core.identify.report import fit_warnings
from kilter_core.identify.scale_gauge import free_scale
from kilter_core.identify.setup_frames import marginal, of_the_arm
from kilter_core.identify.steps.start import Fitted, Study
from kilter_core.identify.steps.validation import HeldOut
from kilter_core.identify.uncertainty.by_view import predictive_of_views, tool_sigma_from_views
from kilter_core.identify.uncertainty.predictive import Predictive, predictive
from kilter_core.identify.uncertainty.stated_noise import BeyondNoise, Intervals, bootstrap, profile
from kilter_core.identify.uncertainty.structure import Structure
from kilter_core.identify.view_report import (
    tell_less,
    too_large_to_deploy,
    views_document,
    with_own_scatter,
    wrong_views,
)
from kilter_core.identify.views import unknown_rig
from kilter_core.measurement.camera.view_motion import Delay, board_shapes, timing
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations.rig import format_part_name
from kilter_core.parameters import mm
from kilter_core.types import QUANTILE, Each, Floats, Progress


@dataclass(frozen=True)
class Uncertainty:
    """How far the fit of a study is known.

    ``fit`` has the covariance to report, ``arm_fit`` is the same without the frames of set-ups, cameras and boards.
    ``beyond`` is what rows leave beyond the stated noise, ``masses`` are errors of masses that the covariance holds and no
    parameter, ``views`` says where cameras and boards are and how far off the tool is in what they see.
    """

    fit: Fit
    arm_fit: Fit
    repeats: Repeats
    beyond: BeyondNoise | None
    masses: LoadError | None
    intervals: Intervals | None
    predictive: Predictive
    views: dict[str, Any]


def estimate_uncertainty(study: Study, fitted: Fitted, held: HeldOut, each: Each, progress: Progress) -> Uncertainty:
    """Widen the covariance of a fit to what its rows scatter, then find intervals and what a prediction may be off by."""
    options, plain, arm = study.options, fitted.fit, fitted.arm
    repeats = Repeats.from_observations(study.train, plain.residual)
    clustered, scatter = with_own_scatter(plain)
    beyond = BeyondNoise.from_fit(clustered, repeats, options.noise_m)
    masses = considered_masses(arm.model.effects, arm.robot, study.train, options)
    predicted = clustered if beyond is None else beyond.widen(clustered)
    fit = predicted if masses is None else beside_drawn_masses(plain, predicted, masses)
    wider = (1.0 if beyond is None else beyond.widening) * fit.sigma / predicted.sigma
    if scatter is None:
        lack = Structure.from_fit(plain), tool_sigma_from_views(plain)
        prediction = predictive(marginal(predicted), repeats, options.noise_m, *lack)
    else:
        prediction = predictive_of_views(fit, scatter)
    return Uncertainty(
        fit=fit,
        arm_fit=marginal(fit),
        repeats=repeats,
        beyond=beyond,
        masses=masses,
        intervals=_intervals(options, plain, fit, wider, each, progress),
        predictive=prediction,
        views=views_document(arm, clustered, scatter, fitted.begin, held.views),
    )


def _intervals(
    options: IdentifyOptions, plain: Fit, fit: Fit, wider: Floats, each: Each, progress: Progress
) -> Intervals | None:
    """Intervals of a fit; a profile, whose likelihood takes rows as independent, is widened to what the poses show."""
    if options.intervals is None:
        return None
    if options.intervals == "profile":
        found = profile(plain, progress, each).widen_by_factor(fit.sigma / plain.sigma)
    else:
        found = bootstrap(plain, options.seed, progress).widen_by_factor(wider)
    arm = of_the_arm(fit)
    return replace(found, lower=found.lower[arm], upper=found.upper[arm], stands_in=found.stands_in[arm])


CHANCE = 1e-3  # of saying it of a flat board, all boards together, or of pictures in time
LITTLE_M = 2e-5  # from the highest to the lowest corner: no printed sheet is flatter
LITTLE_PX = 0.05  # rms of a corner, below which a delay is not worth a word
TRACKER = "a few points that a tracker or a measuring arm takes in the robot's own base"
SETTLES = {
    "base_yaw": "set the first joint's zero by its mark or a reference in the base, or measure " + TRACKER,
    "tool_roll": "set the last joint's zero by its mark, or measure two points of the tool whose place on it is known",
    "axis_place": "measure " + TRACKER,
    "tool_place": "measure a point of the tool whose place on the flange is known",
    "board_scale": "measure one long distance: between two corners with a caliper or a metre stick (state the board's scale "
    "as exact then), or between two places of the tool",
    "focal_length": "tilt the board by 30 degrees and more, take views at two distances, or calibrate the lens by itself and "
    "state `sigmas_px`",
}


@dataclass(frozen=True)
class Outcome:
    """A study with what each step found."""

    study: Study
    fitted: Fitted
    held: HeldOut
    known: Uncertainty

    @property
    def load_rows(self) -> list[dict[str, Any]]:
        """Masses and centres as stated and as found."""
        fit = self.known.arm_fit
        return load_rows(self.fitted.arm, fit.names, fit.sigma, fit.problem.prior_sigma)


CHECKS_AFTER: tuple[Callable[[Outcome], Iterable[FindingDocument]], ...] = (
    lambda one: fit_warnings(one.known.arm_fit, one.study.train, one.known.repeats),
    lambda one: () if one.fitted.learned is None else (one.fitted.learned.warning(),),
    lambda one: another_arm(one.fitted.arm),
    lambda one: gauges(one.known.fit),
    lambda one: bent_boards(one.known.fit),
    lambda one: bad_timing(one.known.fit),
    lambda one: far_from_stated(one.load_rows),
    lambda one: () if one.known.beyond is None else (one.known.beyond.warning(one.study.inside),),
    lambda one: wrong_views(one.fitted.fit, one.fitted.begin, one.study.options, one.study.inside),
    lambda one: one.study.remarks,
    lambda one: () if one.held.poses is None else one.held.poses.warnings(),
    lambda one: () if one.study.fleet is None else prior_warnings(one.study.fleet, one.fitted.fit),
    lambda one: too_large_to_deploy(one.known.views, one.held.rms_mm("registration_only")),
    lambda one: tell_less(one.known.views, one.held.rms_mm("identified")),
)


def list_findings(outcome: Outcome) -> tuple[FindingDocument, ...]:
    """Warnings of all checks, without those that another one explains."""
    return tuple(unless_astray(finding for check in CHECKS_AFTER for finding in check(outcome)))


# What to know of cameras and boards before trusting a fit: what they cannot tell apart, bent boards, late pictures.
# A camera's place takes what the first joint's zero or height does, a board's what the last joint's does, a board's
# scale what all lengths do together. Which of the two a fit gives it to is a choice, and no pixel contradicts it.


def gauges(fit: Fit) -> Iterator[FindingDocument]:
    """Warnings ``camera_gauge``: what is given to one of two that act alike; nothing where a tracker measured too."""
    rig, names = unknown_rig(fit.problem.model), list(fit.names)
    if rig is None:
        return
    seen = np.asarray(identifiable(fit.sigma, fit.problem.prior_sigma))
    unknown = {n for n, told, arm in zip(names, seen, of_the_arm(fit), strict=True) if arm and not told}
    if fit.problem.measurement.tool.places_itself:
        yield from _of_ends(fit, rig, unknown)
    if free_scale(fit):
        boards = [f"board_{b.name}_scale" for b in rig.rig.boards]
        yield _gauge_warning(
            "board_scale", boards, "The scale of the board", "all link lengths and the distance to the camera"
        )
    for camera in rig.rig.cameras:
        focal = [f"camera_{camera.name}_{k}" for k in ("fx", "fy")]
        known = dict(zip(names, seen, strict=True))
        if any(not known.get(name, True) for name in focal):
            yield _gauge_warning(
                "focal_length",
                focal,
                f"The focal length of {format_part_name('camera', camera.name)}",
                "its distance to the board",
            )


def _of_ends(fit: Fit, rig: PlacedRig, unknown: set[str]) -> Iterator[FindingDocument]:
    robot = fit.problem.model.robot
    elements = robot.chain.elements
    joints = [k for k, e in enumerate(elements) if e.joint is not None]
    room, tool = _fixed_and_flange_parts(rig)
    for code, turns, found, what, other in (
        ("base_yaw", True, elements[: joints[0] + 1], "The zero of the first joint", f"how {room} is rotated"),
        ("axis_place", False, elements[: joints[1]], "The place of the first axis", f"where {room} stands"),
        ("tool_roll", True, elements[joints[-1] :], "The zero of the last joint", f"how {tool} is rotated"),
        ("tool_place", False, elements[joints[-1] :], "The length behind the last joint", f"where {tool} is mounted"),
    ):
        names = [str(e.name) for e in found if e.name in unknown and _is(e, turns)]
        if names:
            yield _gauge_warning(code, names, what, other)


def _is(element: Element, turns: bool) -> bool:
    return element.axis.rotates == turns


def _fixed_and_flange_parts(rig: PlacedRig) -> tuple[str, str]:
    """What stands in the room and what is on the flange, in words."""
    parts = [("camera", c.name, c.mount) for c in rig.rig.cameras] + [
        ("board", b.name, b.mount) for b in rig.rig.boards
    ]
    fixed = next(format_part_name(what, name) for what, name, mount in parts if mount == "fixed")
    return fixed, next(format_part_name(what, name) for what, name, mount in parts if mount == "flange")


def _gauge_warning(gauge: str, names: list[str], what: str, other: str) -> FindingDocument:
    return FindingDocument.make(
        "camera_gauge",
        f"{what} ({', '.join(names)}) cannot be told from {other} by these pixels: it keeps what it was given. To "
        f"settle it, {SETTLES[gauge]}.",
        gauge=gauge,
        parameters=names,
    )


def bent_boards(fit: Fit) -> Iterator[FindingDocument]:
    """Warnings ``board_not_flat``; nothing where no camera measured, or too little."""
    views = fit.problem.measurement.pixels
    if views is None:
        return
    prediction = fit.calibration().predict(views.observations)
    found = list(board_shapes(views, prediction, views.resolve_rig(prediction)))
    for one in found:
        if one.chance * len(found) > CHANCE or one.size - QUANTILE * one.sigma < LITTLE_M:
            continue
        (x, y), twist = (mm(v) for v in one.bows), mm(one.twist)
        size, half = mm(one.size), mm(QUANTILE * one.sigma)
        yield FindingDocument.make(
            "board_not_flat",
            f"Board {one.board} is not flat: from its highest to its lowest corner {size:.2g} mm (95 %: within "
            f"{half:.1g} mm), a bow of {x:.2g} mm along x and {y:.2g} mm along y and a twist of {twist:.2g} mm in z of its "
            f"frame. It moves corners by {one.rms_px:.2g} px (rms). Glue it to a stiff plate and measure anew, or add this to "
            "the heights in its `corners_mm`; if another board says the same, the lens needs another model.",
            board=one.board,
            size_mm=size,
            u95_mm=half,
            bow_x_mm=x,
            bow_y_mm=y,
            twist_mm=twist,
            rms_px=one.rms_px,
            p_value=one.chance,
        )


def bad_timing(fit: Fit) -> Iterator[FindingDocument]:
    """Warnings ``pictures_late`` and ``rolling_shutter``; nothing of views of an arm at rest."""
    views = fit.problem.measurement.pixels
    found = None if views is None else timing(views, fit.calibration())
    if found is None:
        return
    if _clear(found.pictures):
        late = found.pictures
        side = "after" if late.s > 0.0 else "before"
        yield _timing_warning(
            "pictures_late",
            late,
            found.views,
            f"Pictures were taken {_format_delay(late)} {side} their joints were read: corners are off along the motion by "
            f"{late.rms_px:.2g} px (rms). Let the arm rest at every pose, or move the times of the pictures by that much.",
        )
    if _clear(found.lines):
        lines = found.lines
        yield _timing_warning(
            "rolling_shutter",
            lines,
            found.views,
            f"The camera reads its picture line by line, over {_format_delay(lines)}, while the arm moves: corners are off by "
            f"{lines.rms_px:.2g} px (rms). Let the arm rest at every pose, or take a camera with a global shutter.",
        )


def _clear(one: Delay) -> bool:
    return one.chance < CHANCE and one.rms_px > LITTLE_PX


def _format_delay(one: Delay) -> str:
    return f"{abs(one.s):.3g} s (95 %: within {QUANTILE * one.sigma:.1g} s)"


def _timing_warning(code: str, one: Delay, views: int, message: str) -> FindingDocument:
    return FindingDocument.make(
        code, message, time_s=one.s, u95_s=QUANTILE * one.sigma, rms_px=one.rms_px, views=views, p_value=one.chance
    )
