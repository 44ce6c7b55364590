"""Is anything left that noise does not explain (E2): chi-square, lack of fit on repeats, errors on held-out poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, f

from kilter_core.errors import FindingDocument
from kilter_core.gap.noise.from_repeats import WITHIN
from kilter_core.gap.search.events import fitted_away
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.scan import residual_given
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

ADEQUATE = 0.01
TOO_SMALL = 0.001  # chance of a residual so far below the noise, from which the noise is none
CLOSED_LEVERAGE = 1.0 - 1e-6


@dataclass(frozen=True)
class Adequacy:
    """Chi-square of the residual with its freedom, lack of fit F and its p; p is None where noise is relative.

    ``p_value_low`` is the chance of a residual as small or smaller: one far below the noise says that the noise is none
    (repeats that drifted, a sigma stated too large), and nothing can be confirmed by it.
    ``least`` says that the noise is that within visits: the least it can be. A residual no larger proves the model
    adequate and the approach exact; a larger one may be either the model's or the approach's, and proves nothing.
    ``most`` says that it may hold drift: a larger residual proves the model wrong, a smaller one proves nothing.
    """

    chi2: float
    nu: float
    lack_of_fit: float
    p_value: float | None
    least: bool = False
    p_value_low: float | None = None
    most: bool = False

    @property
    def too_large(self) -> bool:
        """Whether the residual refutes the noise: it is smaller than noise of that size could leave."""
        return self.p_value_low is not None and self.p_value_low <= TOO_SMALL

    @property
    def adequate(self) -> bool | None:
        """Whether noise explains what is left; None when the noise came from the fit, or is refuted or a bound only."""
        if self.p_value is None or (self.least and self.p_value <= ADEQUATE):
            return None
        if self.too_large or (self.most and self.p_value > ADEQUATE):
            return None
        return self.p_value > ADEQUATE

    @property
    def relative(self) -> bool:
        """Whether no noise is known apart from the fit: no repeats, no revisits, and nothing that the instrument states."""
        return self.adequate is None and not self.has_doubtful_noise

    @property
    def has_doubtful_noise(self) -> bool:
        """Whether the noise is that of repeats, and how large it is is in doubt: it may hold drift, or the rows refute it."""
        return self.adequate is None and self.p_value is not None and not self.least

    def sentence(self, left: str) -> str:
        """The model as a whole in words; ``left`` says how much remains, and where."""
        if self.has_doubtful_noise:
            return "Whether something else remains is not known: the repeats do not tell how large the noise is."
        if self.adequate is None:
            return "Whether something else remains is not known: the noise is not known apart from the fit."
        return f"Something else remains{left}." if not self.adequate else "The model as a whole agrees with the rows."

    def warnings(self) -> tuple[FindingDocument, ...]:
        """What to know before trusting the noise."""
        if not self.too_large:
            return ()
        ratio = float(np.sqrt(max(self.lack_of_fit, 0.0)))
        return (
            FindingDocument.make(
                "noise_too_large",
                f"What is left is {ratio:.2f} times the noise, less than noise of that size leaves: the repeats "
                "drifted or were disturbed, or a stated sigma is too large. No claim rests on the size of this noise. "
                "Repeat ten poses with one other pose in between, or state the sigma of the instrument.",
                ratio=ratio,
            ),
        )

    def to_document(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "chi2": self.chi2,
            "freedom": self.nu,
            "chi2_per_freedom": self.chi2 / max(self.nu, 1.0),
            "lack_of_fit_f": self.lack_of_fit,
            "p_value": self.p_value,
            "p_value_low": self.p_value_low,
        }


def adequacy(problem: LinearizedProblem, condition: Ints, chosen: Sequence[int]) -> Adequacy:
    """Judge what is left after geometry and the chosen columns; ``condition (V,)`` numbers visits that should agree."""
    left = problem.gram.condition_on_columns(chosen)
    pure, freedom = _pure_error(problem, condition, chosen)
    lof_freedom = max(left.nu - freedom, 1.0)
    lof = max(left.yy - pure, 0.0) / lof_freedom
    noise = problem.settings.noise
    if not noise.absolute and noise.source != WITHIN:
        return Adequacy(left.yy, left.nu, lof, None)
    lof *= noise.over_readings  # only a residual as small as the readings' own scatter says anything
    law = chi2(lof_freedom, scale=1.0 / lof_freedom) if np.isinf(noise.freedom) else f(lof_freedom, noise.freedom)
    high, low = float(law.sf(lof)), float(law.cdf(lof))
    return Adequacy(left.yy, left.nu, lof, high, not noise.absolute, low, noise.most)


def left_out_errors(problem: LinearizedProblem, chosen: Sequence[int]) -> Floats:
    """Whitened errors (V, m) of each visit predicted by the fit without its whole pose (leave one pose out)."""
    basis = problem.basis(chosen)
    size = problem.settings.whitener.shape[-1]
    r = residual_given(problem, chosen).reshape(-1, size)
    blocks = basis.reshape(len(basis) // size, size, basis.shape[1])
    out = np.zeros_like(r)
    for index in _poses(problem):
        B = blocks[index].reshape(size * len(index), basis.shape[1])
        w, V = np.linalg.eigh(B @ B.T)
        shrink = 1.0 / (1.0 - np.minimum(w, CLOSED_LEVERAGE))
        out[index] = ((V * shrink) @ (V.T @ r[index].reshape(-1))).reshape(-1, size)
    return out


def left_out_floor(problem: LinearizedProblem, chosen: Sequence[int]) -> float:
    """Variance of those errors, in units of noise, when the model is perfect: what its estimation costs."""
    basis = problem.basis(chosen)
    size = problem.settings.whitener.shape[-1]
    blocks = basis.reshape(len(basis) // size, size, basis.shape[1])
    total: float = 0.0
    for index in _poses(problem):
        B = blocks[index].reshape(size * len(index), basis.shape[1])
        total += float(np.sum(1.0 / (1.0 - np.minimum(np.linalg.eigvalsh(B @ B.T), CLOSED_LEVERAGE))))
    unused = size * float(np.sum(~problem.settings.used))
    return float((total - unused) / max(blocks.shape[0] * size - unused, 1.0))


def gain(before: Floats, after: Floats, group: Ints) -> tuple[float, float]:
    """Mean drop of the squared error per pose and its standard error, from errors (V, m) before and after."""
    drop = np.bincount(group, np.sum(before**2, axis=1) - np.sum(after**2, axis=1))
    drop = drop[np.bincount(group) > 0]
    return float(np.mean(drop)), float(np.std(drop, ddof=1) / np.sqrt(len(drop))) if len(drop) > 1 else np.inf


def _poses(problem: LinearizedProblem) -> list[Ints]:
    """Visits of each pose."""
    order = np.argsort(problem.settings.group, kind="stable")
    starts = np.flatnonzero(np.diff(problem.settings.group[order], prepend=-1))
    return list(np.split(order, starts[1:]))


def _pure_error(problem: LinearizedProblem, condition: Ints, chosen: Sequence[int]) -> tuple[float, float]:
    """Chi-square of repeats about their mean, and its freedom: less what was fitted to them with time or temperature."""
    size = problem.settings.whitener.shape[-1]
    used = problem.settings.used
    r = residual_given(problem, chosen).reshape(-1, size)[used]
    group = np.unique(condition[used], return_inverse=True)[1]
    beside = problem.settings.source.sensor_reading_mask[used]
    told = float((size - beside.shape[1]) * (len(group) - len(np.unique(group)))) + _repeated_reading_count(
        beside, group
    )
    return float(np.sum(subtract_group_means(r, group) ** 2)), told - fitted_away(problem, chosen, condition)


def _repeated_reading_count(seen: Bools, group: Ints) -> float:
    """How many numbers of sensors, ``seen (V, k)``, repeat another of their group: a cell without a reading repeats none."""
    count = np.zeros((int(group.max(initial=-1)) + 1, seen.shape[1]))
    np.add.at(count, group, seen)
    return float(np.sum(np.maximum(count - 1.0, 0.0)))
