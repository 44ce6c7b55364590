"""What a result says of its views: their cameras and boards, how noisy corners are, and how far off the tool is.

A camera tells where a board is across its line of sight, and ten times worse along it. If the whole cell, arm and distances,
is a thousandth larger than fitted, no corner moves across: only the board is seen a thousandth larger. So errors that are seen
through views, held out or not, have next to nothing of an error of size. The covariance of the fit has all of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc, gammaincinv

from kilter_core.errors import CoreError, FindingDocument
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.measured_rows import measurement_for
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.options import FRAME_NAMES, IdentifyOptions
from kilter_core.identify.plausibility.orientation_mix_ups import NUMBERS, Part, ViewResiduals, astray, astray_views
from kilter_core.identify.plausibility.unrelated_views import shuffled_control
from kilter_core.identify.scale_gauge import contradicted_scale
from kilter_core.identify.uncertainty.by_view import (
    beside_tool_error,
    by_tool_error,
    predictive_of_views,
    rig_sigmas,
    view_scatter,
)
from kilter_core.identify.uncertainty.clustered import with_clustered_covariance
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.identify.views import rig_from_calibration, rig_from_values, with_cameras
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.views import ToolErrors, ViewScatter
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import Place
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.observations.groups import evenly
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import inverse, rotation_log, xyz_rpy_from_pose
from kilter_core.types import QUANTILE, Bools, Floats, Ints

# Whether a camera or a board was bumped half-way: its places before and after, which a fit takes for one, averaged.
#
# What a step of its place takes off the squares of what views leave, with all parameters following, is scored at
# every place between two views, by sums along the order of measurement.

CHANCE = 1e-3  # of saying it of a rig that stood still, all parts and places together
SHARE = 0.3  # of what is left that the step must explain: an arm measured in order can look like a little of one
PER_SIDE = 4  # views on either side: fewer are wrong rows
SURE = 0.95  # of the interval of rows in which it happened
ALIKE = 1.3  # times what the best explanation leaves: parts that leave no more are named with it
RIDGE = 1e-9


@dataclass(frozen=True)
class Moved:
    """How far something moved: ``size`` m at the tool (rms) and ``turn`` rad, each with its standard deviation."""

    size: tuple[float, float]
    turn: tuple[float, float]

    @property
    def clear(self) -> bool:
        """Whether it is more than chance with the part in two places."""
        return any(value > QUANTILE * sigma for value, sigma in (self.size, self.turn))


@dataclass(frozen=True)
class Step:
    """A part that moved before view ``at`` of those in order; ``first`` and ``last`` view that may be the first after it.

    It explains a ``share`` of the squares that views leave, by ``chance``, and leaves ``left``.
    """

    part: Part
    at: int
    first: int
    last: int
    chance: float
    share: float
    left: float


def steps(seen: ViewResiduals, order: Ints) -> list[Step]:
    """The best step of each part, the best part first; ``order`` are the views in the order of measurement."""
    seen = seen.only(order)
    found = [one for part in seen.parts if (one := _step(seen, part)) is not None]
    return sorted(found, key=lambda one: one.left)


def _step(seen: ViewResiduals, part: Part) -> Step | None:
    own = np.any(part.columns != 0.0, axis=(1, 2))
    before = np.cumsum(own) - own
    able = (before >= PER_SIDE) & (own.sum() - before >= PER_SIDE) & own
    if not able.any() or seen.freedom <= 2 * NUMBERS:
        return None
    B = part.columns
    H = _tail_sums(B.transpose(0, 2, 1) @ B)
    Z = _tail_sums(seen.A.transpose(0, 2, 1) @ B)
    c = _tail_sums(np.einsum("kij,ki->kj", B, seen.refitted_residuals))
    S = H - Z.transpose(0, 2, 1) @ (seen.parameter_covariance @ Z)
    size = np.sqrt(np.diagonal(H, axis1=1, axis2=2))
    size = np.where(able[:, None] & (size > 0.0), size, 1.0)
    S = S / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(NUMBERS)
    inverse = np.linalg.inv(S) / (size[:, :, None] * size[:, None, :])
    gain = np.where(able, np.einsum("ki,kij,kj->k", c, inverse, c), 0.0)
    whole = float(np.sum(seen.refitted_residuals**2))
    k = int(np.argmax(gain))
    free = seen.freedom - NUMBERS
    variance = max(whole - float(gain[k]), 1e-9 * whole, 1e-30) / free
    chance = float(fdtrc(NUMBERS, free, float(gain[k]) / NUMBERS / variance)) * int(able.sum()) * len(seen.parts)
    likely = np.exp(np.maximum(0.5 * (gain - gain[k]) / variance, -700.0)) * able
    sure = np.argsort(-likely, kind="stable")
    sure = sure[: int(np.searchsorted(np.cumsum(likely[sure]), SURE * likely.sum())) + 1]
    return Step(
        part,
        k,
        int(sure.min()),
        int(sure.max()),
        min(chance, 1.0),
        float(gain[k]) / max(whole, 1e-300),
        whole - float(gain[k]),
    )


def _tail_sums(each: Floats) -> Floats:
    """Sums over all from each place on."""
    return np.asarray(np.cumsum(each[::-1], axis=0)[::-1])


@dataclass(frozen=True)
class Found:
    """The best step of those that views show, and others that leave hardly more, of views in ``order``."""

    best: Step
    others: tuple[Step, ...]
    order: Ints

    @staticmethod
    def from_fit(fit: Fit, seen: ViewResiduals) -> Found | None:
        """What moved, beyond chance; None where nothing did."""
        rows = fit.problem.measurement.observations
        given = read_clock(rows).order if rows.row is None else np.argsort(rows.row, kind="stable")
        rank = np.empty(len(rows), dtype=np.int64)
        rank[given] = np.arange(len(rows))
        order = np.argsort(rank[seen.rows], kind="stable")
        found = steps(seen, order)
        if not found or found[0].chance > CHANCE or found[0].share < SHARE:
            return None
        best = found[0]
        others = tuple(one for one in found[1:] if one.left < ALIKE * best.left)
        return Found(best, others, seen.rows[order])

    def later(self, rows: int) -> Bools:
        """Which of so many fitted rows were measured after it."""
        out = np.zeros(rows, dtype=bool)
        out[self.order[self.best.at :]] = True
        return out


def camera_moved(found: Found, moved: Moved | None, numbers: Ints) -> FindingDocument:
    """The warning ``camera_moved``; ``numbers (N,)`` are those of the fitted rows among the ones given, from 0."""
    best, part = found.best, found.best.part
    last, row, first, latest = (
        int(numbers[found.order[k]]) + 1 for k in (max(best.at - 1, 0), best.at, best.first, best.last)
    )
    sure = "" if first == latest else f" (95 %: the first row after it is {first} to {latest})"
    far = ""
    sizes: dict[str, float | None] = dict.fromkeys(("moved_mm", "u95_mm", "rotated_deg", "u95_deg"))
    if moved is not None:
        size, half = mm(moved.size[0]), mm(QUANTILE * moved.size[1])
        turn, half_turn = float(degrees(moved.turn[0])), float(degrees(QUANTILE * moved.turn[1]))
        sizes = {"moved_mm": size, "u95_mm": half, "rotated_deg": turn, "u95_deg": half_turn}
        far = (
            f", by {size:.3g} mm at the tool (95 %: within {half:.1g} mm) and {turn:.2g} deg (within "
            f"{half_turn:.1g} deg)"
        )
    other = [f"{one.part.words[0].lower()}{one.part.words[1:]} did" for one in found.others]
    either = ", or ".join([*other, "the base of the robot did" if part.fixed else "the tool did"])
    what = "camera" if part.camera else "board"
    return FindingDocument.make(
        "camera_moved",
        f"{part.words} moved between rows {last} and {row}{sure}{far}, or {either}: this fit averages the places "
        f"before and after. Give the {what} another name from row {row} on (column `{what}`, and a second entry in "
        f"`{what}s`), and identify again: each place is then fitted by itself.",
        part=what,
        name=part.name,
        row=row,
        rows_95=[first, latest],
        **sizes,
        p_value=best.chance,
    )


def cameras_document(calibration: Calibration, known: Mapping[str, float]) -> dict[str, Any]:
    """``cameras`` and ``boards`` of a result, fixed ones in the robot's base frame, others in that of its flange."""
    rig, model = rig_from_calibration(calibration), calibration.model.absorb_frame_increments(calibration.values)[0]
    if rig is None:
        return {}
    rig = rig.transform_frames(base=inverse(model.T_base), tool=model.T_tool)
    cameras = [
        {
            "name": one.name,
            "mount": one.mount,
            "frame": _frame(one.mount),
            **_pose(place.pose),
            **_sigmas("camera", one.name, known),
            "width_px": one.size[0],
            "height_px": one.size[1],
            **dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), map(float, place.values[:4]), strict=True)),
            "distortion_model": one.model,
            "distortion": place.values[4:].tolist(),
            "intrinsics_sigmas": [known.get(f"camera_{one.name}_{n}", 0.0) for n in one.names] if known else None,
        }
        for one, place in zip(rig.rig.cameras, rig.cameras, strict=True)
    ]
    boards = [
        {
            "name": one.name,
            "mount": one.mount,
            "frame": _frame(one.mount),
            **_pose(place.pose),
            **_sigmas("board", one.name, known),
            **_scale(place, known.get(f"board_{one.name}_scale")),
        }
        for one, place in zip(rig.rig.boards, rig.boards, strict=True)
    ]
    return {"cameras": cameras, "boards": boards}


def tool_document(found: ViewScatter) -> dict[str, float]:
    """How far off the tool is, with its 95 % interval."""
    root = math.sqrt(3.0)  # of the three coordinates of a point
    return {
        "rms_mm": mm(found.rms_m),
        "low_mm": mm(root * found.place_low),
        "high_mm": mm(root * found.place_high),
        "orientation_deg": degrees(root * found.turn),
    }


def _frame(mount: str) -> str:
    return "base" if mount == "fixed" else "flange"


def _pose(T: Floats) -> dict[str, float]:
    xyz, rpy = xyz_rpy_from_pose(T)
    out = {f"{k}_mm": mm(float(v)) for k, v in zip("xyz", xyz, strict=True)}
    return out | {f"r{k}_deg": degrees(float(v)) for k, v in zip("xyz", rpy, strict=True)}


def _sigmas(what: str, name: str, known: Mapping[str, float]) -> dict[str, Any]:
    if not known:
        return {"sigma_mm": None, "sigma_deg": None}
    place = [mm(known.get(f"{what}_{name}_{k}", 0.0)) for k in "xyz"]
    turn = [degrees(known.get(f"{what}_{name}_r{k}", 0.0)) for k in "xyz"]
    return {"sigma_mm": place, "sigma_deg": turn}


def _scale(place: Place, sigma: float | None) -> dict[str, float | None]:
    return {
        "scale_percent": 1e2 * float(place.values[0]),
        "scale_sigma_percent": None if sigma is None else 1e2 * sigma,
    }


STEP = 1e-6  # m, rad: of a difference


@dataclass(frozen=True)
class Apart:
    """Rows in which one of the parts has two names, and the fit to them."""

    fit: Fit
    step: Step
    place: int
    other: int
    later: Bools

    @staticmethod
    def fit_moved_part(
        begin: Calibration, train: Observations, options: IdentifyOptions, step: Step, later: Bools
    ) -> Apart | None:
        """Fit the rows anew, of which those ``later (N,)`` saw the part elsewhere; None where nothing comes of it."""
        assert train.rig is not None
        column, parts = ("camera", train.rig.cameras) if step.part.camera else ("board", train.rig.boards)
        codes = train.camera if step.part.camera else train.board
        assert codes is not None
        place = [one.name for one in parts].index(step.part.name)
        again = replace(parts[place], name=f"{step.part.name} after")
        rig = replace(train.rig, **{f"{column}s": (*parts, again)})
        moved: dict[str, Any] = {column: np.where(later & (codes == place), len(parts), codes)}
        rows = replace(train, rig=rig, **moved)
        try:
            measurement = measurement_for(rows, options, begin.marker_points)
            fit = beside_tool_error(fit_by_method(with_cameras(begin, rows, measurement), measurement, options))
            return Apart(by_tool_error(fit, view_scatter(fit)), step, place, len(parts), later)
        except CoreError:
            return None

    def estimate_motion(self) -> Moved:
        """How far the part moved at the tool (m, rms over the later rows) and rotated (rad), with standard deviations."""
        names = [self.fit.problem.model.names[k] for k in self.fit.problem.free]
        mine = [k for k, name in enumerate(names) if name.startswith((self._prefix, f"{self._prefix[:-1]} after_"))]
        slopes = np.zeros((2, len(self.fit.names)))
        for k in mine:  # to both sides: a length near zero bends, and what both places share must cancel
            there = STEP * (np.arange(len(self.fit.values)) == self.fit.problem.free[k])
            slopes[:, k] = (self._sizes(self.fit.values + there) - self._sizes(self.fit.values - there)) / (2.0 * STEP)
        size, turn = self._sizes(self.fit.values)
        left = np.sqrt(np.diag(slopes @ self.fit.covariance @ slopes.T))
        return Moved((float(size), float(left[0])), (float(turn), float(left[1])))

    @property
    def _prefix(self) -> str:
        return f"{'camera' if self.step.part.camera else 'board'}_{self.step.part.name}_"

    def _sizes(self, values: Floats) -> Floats:
        model = self.fit.problem.model
        rig = rig_from_values(model, values)
        assert rig is not None
        parts = rig.cameras if self.step.part.camera else rig.boards
        before, after = parts[self.place].pose, parts[self.other].pose
        change = after @ inverse(before)
        turn = np.linalg.norm(rotation_log(change[None, :3, :3])[0])
        at = np.zeros((1, 3))  # the tool point, in whose frame what is on the flange stands
        if self.step.part.fixed:
            at = self.fit.calibration().predict(self.fit.problem.measurement.observations).position[self.later]
        off = at @ (change[:3, :3] - np.eye(3)).T + change[:3, 3]
        return np.array([np.sqrt(np.mean(np.sum(off**2, axis=1))), turn])


def with_own_scatter(fit: Fit) -> tuple[Fit, ViewScatter | None]:
    """The fit with the covariance that its poses support, or its views where nothing else was measured of the tool."""
    if not fit.problem.measurement.tool.places_itself:
        return with_clustered_covariance(fit), None
    found = view_scatter(fit)
    return by_tool_error(fit, found), found


def views_document(
    calibration: Calibration, fit: Fit, found: ViewScatter | None, begin: Calibration, held: ToolErrors | None
) -> dict[str, Any]:
    """Cameras and boards of a result; empty where no camera measured.

    From views alone also ``pixels``: how noisy corners are, how far off the tool is in views that were fitted and ``held``
    out, the noise of the views taken off, how far off it may be by what the fit leaves open, and what shuffled joints leave.
    """
    measurement = fit.problem.measurement
    if measurement.pixels is None:
        return {}
    said = cameras_document(calibration, rig_sigmas(fit))
    if found is None:
        return said
    open_ = left_open(calibration, predictive_of_views(fit, found), measurement.observations)
    pixels = {
        "noise_px": found.sigma_px,
        "between_views": found.beyond,
        "train": tool_document(found),
        "validation": None if held is None else tool_document(held.scatter()),
        "left_open": {"rms_mm": mm(open_.rms), "high_mm": mm(open_.high)},
        **shuffled_control(begin, measurement.observations),
    }
    return {**said, "pixels": pixels}


WRONG_VIEWS = ("views_astray", "camera_moved", "board_scale_differs")  # codes of warnings of :func:`wrong_views`
TOO_LARGE_MM = 1.0  # an arm that is off by more picks and places, and assembles nothing
LITTLE = 0.5  # share of the registered nominal robot's error, beyond which a version is hardly worth it
BEYOND_SHOWN = 1.25  # as much more left open than held-out views show is worth a warning
LACKING = 1.5  # variance between views over that of their corners, beyond which the model lacks something


def too_large_to_deploy(said: dict[str, Any], registered_mm: float | None) -> Iterator[FindingDocument]:
    """Warn of a fit that ended well and whose tool, on views held out, is too far off to be corrected with."""
    held = (said.get("pixels") or {}).get("validation")
    if held is None:
        return
    little = registered_mm is not None and held["high_mm"] > LITTLE * registered_mm
    if held["high_mm"] <= TOO_LARGE_MM and not little:
        return
    between = said["pixels"]["between_views"]
    state = (
        "The calibration is complete"
        if between <= LACKING
        else (f"Views scatter {between:.2g} times as much as their corners explain, so the model lacks something")
    )
    reason = "" if registered_mm is None or not little else f", and cameras placed alone leave {registered_mm:.3g} mm"
    yield FindingDocument.make(
        "too_large_to_deploy",
        f"{state}, but the error is too large to deploy: on views held out the tool is off by "
        f"{held['rms_mm']:.3g} mm (95 %: up to {held['high_mm']:.3g} mm){reason}. Take more and sharper views that fill the "
        "picture, add points of a tracker, or look for what is missing with `kilter gap`.",
        rms_mm=held["rms_mm"],
        high_mm=held["high_mm"],
    )


def tell_less(
    said: Mapping[str, Any], held_mm: float | None, seen: str = "By views held out"
) -> Iterator[FindingDocument]:
    """Warn where a fit to views leaves more open than views show, ``held_mm`` rms, which were ``seen`` apart from it."""
    left = (said.get("pixels") or {}).get("left_open")
    if left is None or held_mm is None or left["rms_mm"] <= BEYOND_SHOWN * held_mm:
        return
    yield FindingDocument.make(
        "views_tell_less",
        f"{seen} the tool is off by {held_mm:.3g} mm rms, but the views that were fitted leave more open: "
        f"{left['rms_mm']:.3g} mm rms, up to {left['high_mm']:.3g} mm (95 %), most of it along the lines of sight and in how "
        "large everything is. Take views from nearer, or of a larger board, or measure a length: two points of known distance, "
        "sockets, a few points of a tracker.",
        rms_mm=left["rms_mm"],
        high_mm=left["high_mm"],
    )


def held_views(identified: Calibration, held: Observations, train: Measurement) -> ToolErrors | None:
    """Motions of the tool that explain views that were not fitted; None without views."""
    views = Measurement.from_observations(held, held=True, anchor=train).pixels
    return None if views is None else views.tool_errors(identified)


def wrong_views(
    fit: Fit, begin: Calibration, options: IdentifyOptions, inside: Ints | None
) -> Iterator[FindingDocument]:
    """Warnings of a fit to views alone: rows that are not of their joints, what moved half-way, a board of another size.

    ``inside (N,)`` are the numbers of the fitted rows among the ones given; all when None.
    """
    seen, train = ViewResiduals.from_fit(fit), fit.problem.measurement.observations
    if seen is None:
        return
    numbers = np.arange(len(train)) if inside is None else inside
    far = astray(seen)
    yield from astray_views(seen, far, numbers)
    found = Found.from_fit(fit, seen.only(np.flatnonzero(~far)))
    if found is not None:
        apart = Apart.fit_moved_part(begin, train, options, found.best, found.later(len(train)))
        moved = None if apart is None else apart.estimate_motion()
        if moved is None or moved.clear:
            yield camera_moved(found, moved, numbers)
    yield from contradicted_scale(fit)


FRAMES = (*(f"base_{k}" for k in FRAME_NAMES), *(f"tool_{k}" for k in FRAME_NAMES[:3]))  # rotated, no point moves
MOST = 500  # rows at which it is looked
SEEN = 1e-9  # share of the largest singular value of what frames move below which they move nothing
UPPER = 0.975


@dataclass(frozen=True)
class LeftOpen:
    """Root mean square distance ``rms`` m of the tool that is expected, and the upper end ``high`` m of its 95 % interval."""

    rms: float
    high: float


def left_open(calibration: Calibration, known: Predictive, rows: Observations) -> LeftOpen:
    """By the covariance of the parameters, at the poses of ``rows``, with base and tool where they fit best there."""
    rows = rows.select(evenly(len(rows), MOST))
    names = list(calibration.names)
    own = [k for k, name in enumerate(names) if name in known.names and name not in FRAMES]
    free = np.array(sorted({*own, *(names.index(name) for name in FRAMES)}), dtype=np.int64)
    J = calibration.model.jacobian(rows, calibration.values, free, False)[1][:, :3].reshape(3 * len(rows), -1)
    frame = np.array([names[k] in FRAMES for k in free])
    u, s, _ = np.linalg.svd(J[:, frame], full_matrices=False)
    u = u[:, s > SEEN * s[0]]
    arm = J[:, ~frame] - u @ (u.T @ J[:, ~frame])
    place = [known.names.index(names[k]) for k in free[~frame]]
    # Few directions are open, often one: the sum of their squares scatters as that of so many numbers (Satterthwaite 1946).
    square = arm.T @ arm @ known.covariance[np.ix_(place, place)]
    whole = float(np.trace(square))
    if whole <= 0.0:
        return LeftOpen(0.0, 0.0)
    directions = whole**2 / float(np.sum(square * square.T))
    rms = float(np.sqrt(whole / len(rows)))
    return LeftOpen(rms, rms * float(np.sqrt(2.0 * gammaincinv(directions / 2.0, UPPER) / directions)))
