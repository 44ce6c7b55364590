"""Rows set aside as whole poses, and learned effects that stay out unless they predict such rows.

Of rows held by sockets, planes and bars whole placements are set aside: where a placement stands is fitted to its rows, so
rows of one placement on both sides would judge themselves. Of several motions whole ones are, of a single one its end:
neighbouring samples are the same measurement twice. Beside views contacts are all fitted: they are few, and settle the
scale; views are set aside.

What is drawn depends on the joint readings and the seed only, never on the order of the rows, on ids or on the kind of job:
the same campaign and the same share are the same poses for whoever holds them out, and versions can be compared there. A
share is where folds begin: half of the poses are the first of two folds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from hashlib import blake2b
from typing import Any

import numpy as np

from kilter_core.errors import FindingDocument, OptionError, TooFewPosesError
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import FRAME_NAMES, IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts, placements
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import is_trajectory, segments
from kilter_core.parameters import mm
from kilter_core.types import Floats, Ints

FEWEST_PLACEMENTS = 2  # one to fit, one to hold out
REMEDY = "Measure in another socket, plane or bar mount too, name a campaign of other placements to validate"
STEP = 1e-6  # rad or m: readings are the same to this, through whatever unit they came
EDGE = 0.381966  # of a step, where steps begin: at no decimal that a file would write


@dataclass(frozen=True)
class Folds:
    """Cross-validation in ``folds`` parts."""

    folds: int


@dataclass(frozen=True)
class _Units:
    """What is set aside whole: ``order (N,)`` is the place of each row's unit in the draw, of ``count``.

    ``names`` are those of placements. Of a ``few`` units one is held out however small the share.
    """

    order: Ints
    count: int
    names: tuple[str, ...] = ()
    few: bool = False

    @staticmethod
    def from_observations(observations: Observations, seed: int, parts: int | None = None) -> _Units:
        """Placements, motions, or poses; a single motion is cut into ``parts``, its samples when None."""
        placed = placements(observations) if observations.camera is None else None
        if placed is not None:
            return _Units(_drawn(placed[0], observations, seed), len(placed[1]), placed[1], few=True)
        if not is_trajectory(observations):
            groups = observations.pose_groups()
            return _Units(_drawn(groups, observations, seed), int(groups.max(initial=-1)) + 1)
        motion = segments(observations)
        count = int(motion.max()) + 1
        if count >= (parts or FEWEST_PLACEMENTS):
            return _Units(_drawn(motion, observations, seed), count, few=True)
        late = np.arange(len(motion))[::-1]  # the end comes first: a share is what comes after the rest
        return _Units(late, len(motion))


def split(observations: Observations, fraction: float, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out), with ``fraction`` of the poses held out: of contacts of the placements, of motions of
    these, or the end of one.

    Raises:
        OptionError: a fraction outside (0, 1). TooFewPosesError: a side without poses or placements.

    """
    if not 0.0 < fraction < 1.0:
        raise OptionError(f"validation is {fraction}: give a fraction between 0 and 1.", option="validation")
    views, contacts = _views_beside_contacts(observations)
    if len(contacts):
        shown, unseen = split(observations.select(views), fraction, seed)
        return _merge_rows(views[shown], contacts), views[unseen]
    units = _Units.from_observations(observations, seed)
    if units.names and len(units.names) < FEWEST_PLACEMENTS:
        raise TooFewPosesError(
            f"All rows are held by {units.names[0]}, and held out are whole placements. {REMEDY}, or leave the fraction "
            "out.",
            placements=len(units.names),
        )
    count = round(fraction * units.count)
    if units.few:  # a tenth of three sockets is one of them
        count = min(max(count, 1), units.count - 1)
    if count == 0 or count == units.count:
        raise TooFewPosesError(
            f"{units.count} poses cannot be split {1 - fraction:.0%} to {fraction:.0%}: measure more."
        )
    inside = units.order < count
    return np.flatnonzero(~inside), np.flatnonzero(inside)


def fold_splits(observations: Observations, folds: int, seed: int) -> Iterator[tuple[Ints, Ints]]:
    """Row indices (train, held out) of each fold; every pose (of contacts every placement) is held out once.

    Raises:
        OptionError: fewer than two folds. TooFewPosesError: fewer poses or placements than folds.

    """
    if folds < 2:
        raise OptionError(f"folds is {folds}: give two or more.", option="validation")
    views, contacts = _views_beside_contacts(observations)
    if len(contacts):
        for shown, unseen in fold_splits(observations.select(views), folds, seed):
            yield _merge_rows(views[shown], contacts), views[unseen]
        return
    units = _Units.from_observations(observations, seed, folds)
    if units.names and units.count < folds:
        fewer = f"give {units.count} folds or fewer, or m" if units.count >= FEWEST_PLACEMENTS else "m"
        raise TooFewPosesError(
            f"{units.count} placements ({', '.join(units.names)}) cannot make {folds} folds, for held out are whole "
            f"placements: {fewer}{REMEDY[1:]}.",
            placements=units.count,
        )
    if units.count < folds:
        raise TooFewPosesError(f"{units.count} poses cannot make {folds} folds: give fewer folds.")
    for part in np.array_split(np.arange(units.count), folds):
        inside = np.isin(units.order, part)
        yield np.flatnonzero(~inside), np.flatnonzero(inside)


def _views_beside_contacts(observations: Observations) -> tuple[Ints, Ints]:
    """Rows of views and instruments, and rows beside them that contacts held; none of these where there are no views."""
    if observations.camera is None or not has_contacts(observations):
        return np.arange(len(observations)), np.zeros(0, dtype=np.int64)
    seen = observations.camera >= 0
    if observations.position is not None or observations.markers is not None:  # rows of an instrument are held out too
        seen |= observations.tool_seen
    return np.flatnonzero(seen), np.flatnonzero(~seen)


def _merge_rows(views: Ints, contacts: Ints) -> Ints:
    return np.sort(np.concatenate([views, contacts]))


def _drawn(groups: Ints, observations: Observations, seed: int) -> Ints:
    """Place (N,) of each row's group in an order drawn from its joint readings.

    Groups of one row and of several come in proportion from the beginning on: repeats show the noise, on either side.
    """
    count = int(groups.max(initial=-1)) + 1
    by_group = np.argsort(groups, kind="stable")
    start = np.searchsorted(groups[by_group], np.arange(count))
    keys = [np.minimum.reduceat(key[by_group], start) for key in _keys(observations, seed)]
    again = np.bincount(groups, minlength=count) > 1
    place = np.zeros(count)
    for kind in (again, ~again):
        own = np.flatnonzero(kind)
        place[own[np.lexsort([key[own] for key in reversed(keys)])]] = (np.arange(len(own)) + 0.5) / max(len(own), 1)
    order = np.empty(count, dtype=np.int64)
    order[np.lexsort([keys[0], place])] = np.arange(count)
    return order[groups]


def _keys(observations: Observations, seed: int) -> list[Floats]:
    """What a draw goes by (N,) each: the joints; for groups at the same joints what they carried, and when they were."""
    o = observations
    loads = (o.payload_kg, o.payload_com, o.link_mass, o.link_wrench)
    beside = (o.stated_direction, *loads, o.temperature_c, o.t, o.position, o.base_tilt_x, o.base_tilt_y)
    columns = [c.reshape(len(o), -1) for c in beside if c is not None]
    return [_hash_rows(o.q, seed), _hash_rows(np.hstack([o.q, *columns]), seed)]


def _hash_rows(values: Floats, seed: int) -> Floats:
    """A number in [0, 1) for each row (N, c), the same on every machine."""
    steps = np.floor(np.nan_to_num(values) / STEP + EDGE).astype("<i8")
    key = int(seed).to_bytes(8, "little")
    found = [int.from_bytes(blake2b(row.tobytes(), digest_size=7, key=key).digest(), "little") for row in steps]
    return np.array(found, dtype=np.float64) / 2.0**56


FRAMES = tuple(f"{frame}_{k}" for frame in ("base", "tool") for k in FRAME_NAMES)
FOLDS = 5
FEWEST_POSES = 30
ALPHA = 0.01
LEAST_GAIN = 0.02  # share of the held-out error


@dataclass(frozen=True)
class Learned:
    """What the gate decided about the learned effects ``ids``; mean held-out errors m without and with them."""

    ids: tuple[str, ...]
    kept: bool
    poses: int
    without: float | None = None
    beside: float | None = None
    p_value: float | None = None

    def to_document(self) -> dict[str, Any]:
        """The verdict with its numbers, in mm."""
        without, beside = (None if v is None else mm(v) for v in (self.without, self.beside))
        return {
            "effects": list(self.ids),
            "kept": self.kept,
            "poses": self.poses,
            "held_out_without_mm": without,
            "held_out_with_mm": beside,
            "p_value": self.p_value,
        }

    def warning(self) -> FindingDocument:
        """Say in words what was kept, or why nothing was."""
        names = ", ".join(self.ids)
        if self.kept:
            text = (
                f"{names} is learned, not physics: it has no cause, and holds only near the poses it was learned from. "
                "Look for the cause with a gap job."
            )
        elif self.p_value is None:
            text = (
                f"{names} was left out: {self.poses} poses are too few to test it on poses held out, "
                f"{FEWEST_POSES} are needed."
            )
        else:
            text = (
                f"{names} was left out: it does not predict poses held out better (p = {self.p_value:.2g}). "
                "Nothing is left that the joint angles explain; measure more poses, or do without it."
            )
        return FindingDocument.make("learned_kept" if self.kept else "learned_left_out", text)


def select_learned_effects(
    begin: Calibration, train: Observations, options: IdentifyOptions, prior: Prior | None = None
) -> tuple[Calibration, Learned | None]:
    """The model to fit, without its learned effects unless they lower the error of held-out poses; and the verdict.

    Every pose is predicted once by a fit without and once by a fit with them that did not see it. They stay when the mean
    error falls by ``LEAST_GAIN`` and Wilcoxon's signed ranks of the poses say so at ``ALPHA``.
    """
    ids = tuple(e.id for e in begin.model.effects if e.learned)
    if not ids:
        return begin, None
    plain = begin.with_effects([e for e in begin.model.effects if not e.learned])
    poses = int(train.pose_groups().max()) + 1
    if poses < FEWEST_POSES:
        return plain, Learned(ids, False, poses)
    without, beside = (_held_out(model, train, options, prior) for model in (plain, begin))
    from scipy.stats import wilcoxon  # 20 MB, which the API does without

    better = without - beside
    p = float(wilcoxon(better, alternative="greater").pvalue) if np.any(better) else 1.0
    kept = p < ALPHA and float(beside.mean()) < (1.0 - LEAST_GAIN) * float(without.mean())
    return begin if kept else plain, Learned(ids, kept, poses, float(without.mean()), float(beside.mean()), p)


def _held_out(begin: Calibration, train: Observations, options: IdentifyOptions, prior: Prior | None) -> Floats:
    """Mean error (G,) m of every pose, predicted by a fit that did not see it."""
    shape = Measurement.from_observations(train, begin.marker_points).marker_points
    error = np.empty(len(train))
    for inside, outside in fold_splits(train, FOLDS, options.seed):
        unseen, found = Measurement.from_observations(train.select(outside), shape), begin
        if not _nothing_else(begin, options):
            fit = fit_by_method(begin, Measurement.from_observations(train.select(inside), shape), options, None, prior)
            found = Calibration(fit.problem.model, fit.values, shape)
        points = unseen.residual(found.predict(unseen.observations)).points
        error[outside] = np.nanmean(np.linalg.norm(points, axis=2), axis=1)
    groups = train.pose_groups()
    return np.asarray(np.bincount(groups, error) / np.bincount(groups))


def _nothing_else(begin: Calibration, options: IdentifyOptions) -> bool:
    """Whether the options hold base, tool, chain and effects alike, so that nothing but the learned is left to fit."""
    held = options.base == options.tool == "fixed" and not begin.model.effects
    return held and set(begin.names) <= set(FRAMES) | {n for n in begin.names if _matches(n, options.fix)}


def _matches(name: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)
