"""Whether a model or a calibration predicts poses it never saw worse than another: compared pose by pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import CoreError, FindingDocument, NotConvergedError, TooFewPosesError
from kilter_core.identify.estimate import refit_frames, registration_only
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.plausibility import refuse_foreign
from kilter_core.identify.registry import METHODS
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import LEAST_ROWS, group_contacts
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import evenly
from kilter_core.parameters import DEG, MM, mm
from kilter_core.types import Bools, Floats

BY_CHANCE = 1.0  # standard errors of the mean difference of poses
MUCH = 1.01  # times the rms error: worse however few poses made it so
ERRORS_OF_DOUBT = 2.0  # standard errors of the mean difference: chance alone goes beyond in one of forty comparisons
SHARE_OF_DOUBT = 0.01  # of the other's error: with thousands of poses any difference is certain, a small one no harm
WORSE_THAN_REGISTRATION = "heldout_worse_than_registration"
WORSE_THAN_GEOMETRY = "worse_than_geometry"

ELSEWHERE = "set_up_elsewhere"
RIGID = 0.2  # of the error is left in new frames: no wear or drift of an arm is a rigid motion so nearly
BY_POSE = (
    "With {words} fitted to these rows {here:.3g} mm are left (mean by pose), {there:.3g} mm as the version has {them}"
)
EVALUATE = "Evaluate with refit {refit}."
CONFIRM = "Name them as the confirmation, where base and tool are fitted, or hold out poses of the same set-up."

FEWEST_POSES = 8  # base and tool have 9 to 12 unknowns: fewer poses are explained by them whatever the arm is like
NOTHING = 0.5  # share of the scatter of the points that rows of no arm leave: chance explains little of it
DOUBTED = 0.03  # share from which mix-ups are looked for
ROWS_OF_A_POSE = 4  # repeats beyond tell nothing about the calibration


@dataclass(frozen=True)
class Grown:
    """An error (m or rad) that grew, ``before`` and ``after``: the ``quantity`` compared is the one to be told."""

    quantity: str
    before: float
    after: float


MEAN, RMS = "mean by pose", "rms by pose"


def grown(before: Floats, after: Floats) -> Grown | None:
    """What of the errors (G,) of poses grew: the mean by more than its standard error, or the rms by 1 %; None if neither."""
    step = after - before
    error = float(np.std(step, ddof=1) / np.sqrt(len(step))) if len(step) > 1 else 0.0
    if step.mean() > BY_CHANCE * error > 0.0:
        return Grown(MEAN, float(before.mean()), float(after.mean()))
    rms = [float(np.sqrt(np.mean(e**2))) for e in (before, after)]
    return Grown(RMS, *rms) if rms[1] > MUCH * rms[0] else None


@dataclass(frozen=True)
class Difference:
    """How much larger (m) the error of one calibration is than another's, mean over the poses, and how much is chance."""

    mean: float
    margin: float

    @property
    def worse(self) -> bool:
        """Whether the first predicts worse beyond doubt."""
        return bool(self.mean > self.margin)

    @staticmethod
    def from_paired_errors(errors: Floats, others: Floats) -> Difference:
        """Compare the errors (P,) m of two calibrations at the same poses, pose by pose."""
        paired = errors - others
        doubt = ERRORS_OF_DOUBT * float(np.std(paired, ddof=1)) / np.sqrt(len(paired))
        return Difference(float(np.mean(paired)), max(doubt, SHARE_OF_DOUBT * float(np.mean(others))))


@dataclass(frozen=True)
class PoseErrors:
    """Rms error (G,) m of each held-out pose, by stage: "registration_only", "identified", perhaps "geometry_fitted".

    ``remarks`` are warnings of them beside the comparison.
    """

    stages: Mapping[str, Floats]
    remarks: tuple[FindingDocument, ...] = ()

    @staticmethod
    def from_calibrations(stages: Mapping[str, Calibration | None], unseen: Measurement) -> PoseErrors:
        """Errors of calibrations on rows they did not see; stages that are None are left out."""
        unseen = unseen.of_tool()
        return PoseErrors({name: _by_pose(one, unseen) for name, one in stages.items() if one is not None})

    @staticmethod
    def concatenate(parts: Sequence[PoseErrors]) -> PoseErrors:
        """Pool folds; a stage that some fold lacks is left out."""
        names = [name for name in parts[0].stages if all(name in p.stages for p in parts)]
        remarks = tuple(one for part in parts for one in part.remarks)
        return PoseErrors({name: np.concatenate([p.stages[name] for p in parts]) for name in names}, remarks)

    def warnings(self) -> Iterator[FindingDocument]:
        """Say what predicts worse than something simpler."""
        yield from self.remarks
        after = self.stages["identified"]
        simpler = (
            ("registration_only", "base and tool alone", WORSE_THAN_REGISTRATION),
            ("geometry_fitted", "the geometry alone", WORSE_THAN_GEOMETRY),
        )
        for stage, words, code in simpler:
            before = self.stages.get(stage)
            told = None if before is None else grown(before, after)
            if before is not None and told is not None:
                yield worse_warning(code, words, told, Difference.from_paired_errors(after, before).worse)


def mean_mm(errors: Floats) -> float:
    """Mean of errors (P,) m, in mm for a report."""
    return mm(float(np.mean(errors)))


def worse_warning(code: str, words: str, told: Grown, beyond_chance: bool, unit: str = "mm") -> FindingDocument:
    """Warn that held-out poses are predicted worse than by something simpler; beyond chance, activation is refused."""
    advice = (
        "do not activate this version. Measure more poses, spread over the joints, or free fewer parameters and effects."
        if beyond_chance
        else "by no more than chance explains. Measure more poses, spread over the joints, before you rely on the difference."
    )
    scale = MM if unit == "mm" else DEG
    before, after = told.before * scale, told.after * scale
    less, more = _format_distinguishably(before, after)
    said = f"Held-out poses are predicted worse ({more} {unit}, {told.quantity}) than with {words} ({less} {unit}): {advice}"
    sizes = {f"simpler_{unit}": before, f"identified_{unit}": after}
    return FindingDocument.make(code, said, **sizes, quantity=told.quantity, beyond_chance=beyond_chance)


def _format_distinguishably(*values: float) -> tuple[str, ...]:
    """Numbers with as many digits as it takes to see that they differ."""
    said = [tuple(f"{value:.{digits}g}" for value in values) for digits in range(3, 9)]
    return next((words for words in said if len(set(words)) == len(words)), said[-1])


def geometry_alone(
    begin: Calibration, measurement: Measurement, options: IdentifyOptions, frames: Sequence[str] = ()
) -> Calibration | None:
    """The same rows fitted without effects, to compare with; None where there are none, or no such fit.

    Effects with these ids stay: ``frames`` say where a tool was mounted in each session, and nothing of the arm.
    """
    plain = begin.with_effects([e for e in begin.model.effects if e.instrument is not None or e.id in frames])
    if len(plain.model.effects) == len(begin.model.effects):
        return None
    free, fix = (tuple(p for p in patterns if _matches_any(p, plain.names)) for patterns in (options.free, options.fix))
    if options.free and not free:
        fix = (*fix, *plain.names[6 : plain.model.n_geometric - 6])
    method = "least_squares" if METHODS[options.method].continues else options.method
    level = None if options.level == 3 else options.level
    chosen = replace(options, effects=(), free=free, fix=fix, level=level, method=method, tilt_first=False)
    try:
        fit = fit_by_method(plain, measurement, chosen)
    except CoreError:
        return None
    return fit.calibration()


def _matches_any(pattern: str, names: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names)


def _by_pose(calibration: Calibration, unseen: Measurement) -> Floats:
    residual = unseen.residual(calibration.predict(unseen.observations)).points
    square = np.sum(np.nan_to_num(residual) ** 2, axis=(1, 2)) / np.maximum(
        np.sum(~np.isnan(residual[..., 0]), axis=1), 1
    )
    pose = unseen.observations.pose_groups()
    # Distances and contacts are between rows: each counts for itself.
    group = pose if len(pose) == len(square) else np.arange(len(square))
    return np.asarray(np.sqrt(np.bincount(group, square) / np.bincount(group)))


def elsewhere(
    calibration: Calibration, measurement: Measurement, remedy: str = EVALUATE, refit: Sequence[str] = ()
) -> Iterator[FindingDocument]:
    """Warn where rows agree with a calibration in other frames only; say nothing of rows that are too few to tell.

    ``refit`` are the frames fitted to the rows already; ``remedy`` may name those to fit as ``{refit}``.
    """
    if not measurement.observes_places:
        return
    for anew in (("base",), ("base", "tool")):
        if set(anew) <= set(refit):
            continue
        try:
            stages = {
                "there": refit_frames(calibration, measurement, tuple(refit)),
                "here": refit_frames(calibration, measurement, anew),
            }
        except TooFewPosesError:
            return
        errors = PoseErrors.from_calibrations(stages, measurement).stages
        there, here = errors["there"], errors["here"]
        if np.mean(here) < RIGID * np.mean(there) and Difference.from_paired_errors(there, here).worse:
            yield _warning(anew, mean_mm(there), mean_mm(here), remedy)
            return


def _warning(anew: Sequence[str], there_mm: float, here_mm: float, remedy: str) -> FindingDocument:
    words, one = " and ".join(anew), len(anew) == 1
    numbers = BY_POSE.format(words=words, here=here_mm, there=there_mm, them="it" if one else "them")
    who = "the instrument, or the arm, stood elsewhere" if one else "instrument and tool were set up anew"
    refit = "[" + ", ".join(f'"{name}"' for name in anew) + "]"
    return FindingDocument.make(
        ELSEWHERE,
        f"{numbers}: {who}. {remedy.format(refit=refit)}",
        refit=list(anew),
        version_mm=there_mm,
        refitted_mm=here_mm,
    )


# Whether a calibration predicts unseen poses worse than another, base and tool refitted to them.
# The frames are fitted because they do not belong to the arm: a tracker that was set up again, or a tool that was
# mounted again, must not count against a calibration. A pose counts once, however often it was measured.


def errors_by_pose(calibration: Calibration, observations: Observations) -> Floats:
    """Mean distance (P,) m between measured and predicted points of each pose, in frames fitted to these rows.

    Raises:
        TooFewPosesError: too few poses for the frames. NotConvergedError: they have no best place.

    """
    observations = observations.select(_seen_row_mask(observations))
    measurement = Measurement.from_observations(observations)
    try:
        fitted = registration_only(calibration, measurement, "huber")  # a few wrong rows must not move all the others
    except NotConvergedError:
        fitted = registration_only(calibration, measurement)
    points = measurement.residual(fitted.predict(observations)).points
    rows = np.nanmean(np.linalg.norm(points, axis=-1), axis=1)
    groups = observations.pose_groups()
    return np.asarray(np.bincount(groups, weights=rows) / np.bincount(groups))


def _seen_row_mask(observations: Observations) -> Bools:
    if observations.markers is None:
        return np.ones(len(observations), dtype=bool)
    return np.asarray(np.isfinite(observations.markers[:, :, 0]).any(axis=1))


def lacking(calibration: Calibration, observations: Observations) -> list[str]:
    """Columns that the effects of a calibration need and the rows do not have."""
    observations = observations.with_tilt_as_condition()
    present = {f.name for f in fields(observations) if getattr(observations, f.name) is not None}
    available = frozenset({"moments"} | present)
    return sorted({name for effect in calibration.model.effects for name in effect.missing(available)})


def said_of_misfit(robot: Robot, observations: Observations, best: float) -> str | None:
    """Why rows of which the ``best`` of all models leaves so much, m mean, say nothing about any; None: they may.

    Rows that base and tool in any place leave scattered over the workspace follow no arm; where less is left, what is
    mixed up in them must be known.
    """
    points = observations.position if observations.markers is None else np.nanmean(observations.markers, axis=1)
    if points is None:
        return None
    size = float(np.sqrt(np.nanmean(np.sum((points - np.nanmean(points, axis=0)) ** 2, axis=1))))
    if best <= DOUBTED * size:
        return None
    try:
        refuse_foreign(Calibration.nominal(robot), Measurement.from_observations(observations))
    except CoreError as error:
        return error.message
    if best <= NOTHING * size:
        return None
    return f"Its points are {mm(size):.4g} mm apart (rms): joints and positions do not belong together."


def setups(observations: Observations) -> list[Observations]:
    """The rows by session: between sessions instrument and tool may have been set up anew."""
    if observations.session is None:
        return [observations]
    return [observations.select(observations.session == code) for code in np.unique(observations.session)]


def thin_poses(observations: Observations, poses: int) -> Observations:
    """At most so many poses, evenly chosen in their order, and a few rows of each.

    Of every socket, plane and bar at least so many rows stay as its own place takes, where it has them.
    """
    groups = observations.pose_groups()
    first = np.unique(groups, return_index=True)[1]
    in_order = groups[np.sort(first)]
    chosen = in_order[evenly(len(in_order), poses)]
    by_pose = np.argsort(groups, kind="stable")
    starts = np.searchsorted(groups[by_pose], np.arange(len(in_order)))
    repeat = np.empty(len(groups), dtype=np.int64)
    repeat[by_pose] = np.arange(len(groups)) - starts[groups[by_pose]]
    kept = np.isin(groups, chosen) & (repeat < ROWS_OF_A_POSE)
    for contact in group_contacts(observations):
        if int(kept[contact.rows].sum()) < LEAST_ROWS[contact.kind]:
            kept[contact.rows[evenly(len(contact.rows), LEAST_ROWS[contact.kind])]] = True
    return observations.select(np.flatnonzero(kept))


def count_poses(observations: Observations) -> int:
    """Number of distinct poses."""
    return int(observations.pose_groups().max()) + 1 if len(observations) else 0


def pool_setup_errors(errors: Sequence[Floats]) -> Floats:
    """Errors of several set-ups as one."""
    return np.concatenate(errors) if errors else np.zeros(0)
