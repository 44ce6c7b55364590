"""Whether a named effect makes the prediction of the confirmation better: the guard of an activation, before anything is said.

An amplitude may be seen again in a linearised problem, everything else moving within its covariance, and the version may
still predict that very campaign worse. So the version with its effect, and the same search's fit without it, predict the
confirmation as they are: amplitudes held, base and tool fitted to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.errors import CoreError, FindingDocument
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import fit_nonlinear_values
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.comparison import Difference, errors_by_pose, lacking
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import segments
from kilter_core.parameters import mm
from kilter_core.types import Floats

CODE = "confirmation_worse"
PIECES = 20  # that the motions of a confirmation are cut into: each is much longer than its errors correlate


@dataclass(frozen=True)
class Guarded:
    """Mean errors of poses with and without something, and whether it is worse, or better, beyond chance.

    ``length`` says that they are m, not rad of encoders.
    """

    with_it: float
    without: float
    worse: bool
    better: bool
    length: bool = True

    @staticmethod
    def from_errors(with_it: Floats, without: Floats, length: bool = True) -> Guarded:
        """Compare the errors (P,) of two calibrations at the same poses."""
        return Guarded(
            float(with_it.mean()),
            float(without.mean()),
            Difference.from_paired_errors(with_it, without).worse,
            Difference.from_paired_errors(without, with_it).worse,
            length,
        )

    def sentence(self, without: str) -> str:
        """Both numbers in words."""
        return f"{mm(self.with_it):.3g} mm with it, {mm(self.without):.3g} mm {without}"


@dataclass(frozen=True)
class Guard:
    """The confirmation as the version of a search predicts it; ``errors (P,)`` m None where it cannot."""

    found: SearchResult
    begin: Calibration
    version: Calibration
    rows: Observations
    errors: Floats | None

    @staticmethod
    def from_confirmation(found: SearchResult, begin: Calibration, version: Calibration, rows: Observations) -> Guard:
        """Predict the confirmation, base and tool or the zeros of its encoders fitted to it."""
        source = found.problem.settings.source
        told = _errors(version, rows) if source.observes_tool else _encoder_errors(source, found.problem.values, rows)
        return Guard(found, begin, version, rows, told)

    def effect(self, place: int) -> Guarded | None:
        """The version beside the same search's fit without one of its effects."""
        return self._compare_with_refit(self.found.selector.columns([k for k in self.found.chosen if k != place]))

    def geometry(self) -> Guarded | None:
        """The version beside the geometry fitted alone; None where it has no effects, or cannot be compared."""
        return self._compare_with_refit([]) if self.found.chosen else None

    def warnings(self, registered: Calibration | None) -> Iterator[FindingDocument]:
        """Say that the whole version predicts the confirmation worse than base and tool alone."""
        if registered is None or self.errors is None or not self.found.problem.settings.source.observes_tool:
            return
        plain = _errors(registered, self.rows)
        told = None if plain is None else Guarded.from_errors(self.errors, plain)
        if told is not None and told.worse:
            yield FindingDocument.make(
                CODE,
                f"The confirmation is predicted worse ({mm(told.with_it):.3g} mm) than with base and tool alone "
                f"({mm(told.without):.3g} mm), both fitted to it: do not activate this version. What was found is not what "
                "the arm does there; measure more poses in both campaigns and search again.",
                simpler_mm=mm(told.without),
                identified_mm=mm(told.with_it),
                beyond_chance=True,
            )

    def _compare_with_refit(self, columns: list[int]) -> Guarded | None:
        if self.errors is None:
            return None
        problem, source = self.found.problem, self.found.problem.settings.source
        try:
            values = fit_nonlinear_values(problem.settings, problem.values, columns)
            if source.observes_tool:
                plain = _errors(source.to_calibration(values, self.version.model, self.begin), self.rows)
            else:
                plain = _encoder_errors(source, values, self.rows)
        except (CoreError, np.linalg.LinAlgError):
            return None
        return None if plain is None else Guarded.from_errors(self.errors, plain, source.observes_tool)


def _errors(calibration: Calibration, rows: Observations) -> Floats | None:
    """Errors (P,) m by pose; None where the tool was not measured, or a column or poses are missing."""
    if (rows.position is None and rows.markers is None) or lacking(calibration, rows):
        return None
    try:
        found = errors_by_pose(calibration.for_another_campaign(rows), rows)
    except CoreError:
        return None
    return found if np.isfinite(found).all() else None


def _encoder_errors(source: Source, values: Floats, rows: Observations) -> Floats:
    """Rms errors (P,) rad of link encoders in pieces of a motion, zeros fitted: samples in a row repeat each other."""
    other = source.on_rows(rows)
    left, motion = other.residual(values), segments(rows)
    for k in range(int(motion.max(initial=-1)) + 1):
        left[motion == k] -= left[motion == k].mean(axis=0)
    return np.array([other.rms(piece) for piece in np.array_split(left, PIECES)])
