"""Learned effects stay out unless they predict poses they never saw: the gate before the fit."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from kilter_core.identify.holdout import fold_splits
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import FRAME_NAMES, IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Floats

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

    def warning(self) -> dict[str, Any]:
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
        return {"code": "learned_kept" if self.kept else "learned_left_out", "message": text}


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
