"""Is what is left, or what was named, large enough to matter: enough poses make any difference significant.

On 20 000 poses a misfit of a tenth of the noise is certain, and worth nothing: it is below what the instrument promises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, f

from kilter_core.gap.evidence.fits.final_fit import final_effect_amounts
from kilter_core.gap.evidence.held_out.adequacy import Adequacy
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import displacement_by_columns, displacement_derivatives, noise_rms
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import QUANTILE

SURE = 0.05  # chance that the misfit is larger than its upper bound
LONG_MM = 0.1  # from which a size is written in mm
BESIDE = 0.1  # share of an effect's own movement that a misfit may have if it shall not put the name in doubt


@dataclass(frozen=True)
class Misfit:
    """What the model leaves beyond the noise, rms mm in space: best estimate, upper bound, and the size that matters.

    ``floor_mm`` is None for joint data, where a size at the tool is not known: everything matters there.
    """

    rms_mm: float | None
    upper_mm: float | None
    floor_mm: float | None
    adequate: bool | None = None

    @property
    def too_small(self) -> bool:
        """Whether the noise does not explain what is left, and it is still too small to matter."""
        if self.adequate is not False or self.floor_mm is None or self.upper_mm is None or self.rms_mm is None:
            return False
        # A misfit of nothing at all comes from a noise that was said too large, which is another fault.
        return self.rms_mm > 0.0 and self.upper_mm < self.floor_mm

    def is_negligible_for_effect(self, moves_mm: float) -> bool:
        """Whether it is too small to matter and small beside what an effect does."""
        return self.too_small and self.upper_mm is not None and self.upper_mm < BESIDE * moves_mm

    def matters(self, moves_mm: float) -> bool:
        """Whether a movement of the tool is large enough to matter."""
        return self.floor_mm is None or moves_mm >= self.floor_mm

    @property
    def size_text(self) -> str:
        """Its size in words."""
        if self.rms_mm is None:
            return "unknown"
        return f"{1e3 * self.rms_mm:.1f} um" if self.rms_mm < LONG_MM else f"{self.rms_mm:.2g} mm"

    def to_document(self) -> dict[str, Any]:
        """Plain numbers and whether it is too small to matter."""
        return {
            "misfit_mm": self.rms_mm,
            "misfit_upper_mm": self.upper_mm,
            "matters_mm": self.floor_mm,
            "too_small_to_matter": self.too_small,
        }


def misfit(found: SearchResult, fit: Adequacy, rows: Observations, options: GapOptions) -> Misfit:
    """Size of the misfit at the end of a search, from lack of fit: the variance of visits beyond that of the noise."""
    settings = found.problem.settings
    if not settings.source.observes_tool:
        return Misfit(None, None, None, fit.adequate)
    floor = floor_mm(rows, options)
    if not settings.noise.absolute:
        return Misfit(None, None, floor, fit.adequate)
    noise, freedom = mm(noise_rms(settings)), settings.noise.freedom
    nu = max(fit.nu, 1.0)
    least = chi2.ppf(SURE, nu) / nu if np.isinf(freedom) else f.ppf(SURE, nu, max(freedom, 1.0))
    sizes = [noise * float(np.sqrt(max(ratio - 1.0, 0.0))) for ratio in (fit.lack_of_fit, fit.lack_of_fit / least)]
    return Misfit(sizes[0], sizes[1], floor, fit.adequate)


def floor_mm(rows: Observations, options: GapOptions) -> float:
    """Size that matters: the option, or what the instrument promises of a coordinate where that is more."""
    promised = 0.0 if options.noise_mm is None else options.noise_mm
    if rows.sigma is not None:
        promised = max(promised, mm(float(np.sqrt(np.nanmean(rows.sigma**2)))))
    return max(options.matters_um * 1e-3, promised)


def moves_mm(found: SearchResult) -> dict[int, float]:
    """Rms displacement of the tool by each chosen candidate, mm; infinite for joint data."""
    source = found.problem.settings.source
    if not source.observes_tool:
        return dict.fromkeys(found.chosen, float("inf"))
    used = found.problem.settings.used
    own = {k: found.selector.scorer.candidates[k].columns for k in found.chosen}
    moved = {k: displacement_by_columns(found.problem, columns)[used] for k, columns in own.items()}
    return {k: mm(source.rms(m)) for k, m in moved.items()}


def outweighing(found: SearchResult, k: int, joints: tuple[int, ...] | None, left: Misfit) -> tuple[int, ...] | None:
    """Of some ``joints`` of a chosen candidate those that move the tool by more than is left beside it; all where none does.

    A joint of a family that moves it by less may be no more than a part of what is left.
    """
    candidate, source = found.selector.scorer.candidates[k], found.problem.settings.source
    if joints is None or len(joints) < 2 or left.rms_mm is None or not source.observes_tool:
        return joints
    used, start, moved = found.problem.settings.used, 0, dict[int, float]()
    for effect in candidate.effects:
        own = candidate.columns[start : start + len(effect.parameters(source.model.robot))]
        start += len(own)
        moved |= dict.fromkeys(effect.joints or (), mm(source.rms(displacement_by_columns(found.problem, own)[used])))
    return tuple(j for j in joints if moved.get(j, 0.0) > left.rms_mm) or joints


def moves_u95_mm(found: SearchResult, k: int) -> float:
    """Half of the 95 % interval of the rms displacement by a chosen candidate, by what is known of its amounts together."""
    problem, own = found.problem, list(found.selector.scorer.candidates[k].columns)
    source = problem.settings.source
    if not source.observes_tool:
        return float("inf")
    each = displacement_derivatives(problem, own)[problem.settings.used]
    amount, places = source.library(problem.values)[own], [found.columns.index(column) for column in own]
    covariance = final_effect_amounts(found).covariance[np.ix_(places, places)]
    # What a length follows: that of the sum of its squares, for lengths add up as the root of one quadratic form.
    size = source.rms(each @ amount)
    slope = [
        (source.rms(each @ (amount + step)) ** 2 - source.rms(each @ (amount - step)) ** 2) / (4.0 * step.max() * size)
        for step in np.diag(np.sqrt(np.diag(covariance)))
    ]
    return QUANTILE * mm(float(np.sqrt(slope @ covariance @ np.array(slope))))
