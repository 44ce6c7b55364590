"""How large (E9): each amplitude as the version stores it, and the profile of its fit, all else re-optimised at every value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from kilter_core.gap.evidence.fits.final_fit import final_effect_amounts, inflation
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import estimate_linear_parameters, fit_nonlinear_values, loss
from kilter_core.gap.search.linear.settings import tail
from kilter_core.identify.uncertainty.stated_noise import profile_end

LEVEL = 0.95
MOST_ROWS = 3000  # scalars above which the likelihood is so narrow that its own curvature cannot matter
MOST_PROFILES = 16
HELD = 1.0  # standard deviations from what the rows ask for, from which a physical range holds an amplitude


@dataclass(frozen=True)
class Amplitude:
    """A parameter of a named effect (SI): value, standard deviation, 95 % interval; conditional on the library.

    ``value`` is what the version stores, ``wanted`` what the rows ask for where a physical range holds it.
    """

    column: int
    value: float
    sigma: float
    low: float
    high: float
    wanted: float

    @property
    def is_significant(self) -> bool:
        """Whether the data show it: its own interval does not hold zero."""
        return not self.low <= 0.0 <= self.high


def amplitudes(
    search: SearchResult, progress: Callable[[float], None], over: Callable[[], bool] = lambda: False
) -> dict[int, Amplitude]:
    """Amplitude of every chosen column, inflated by what noise leaves unexplained: max(1, chi²/nu).

    Where time is ``over`` the ends of intervals are those of the linearised problem.
    """
    problem, columns = search.problem, search.columns
    if not columns:
        return {}
    fit, width = final_effect_amounts(search), interval_width(search)
    grown, least = inflation(search), loss(problem.settings, problem.values, columns)
    out = {}
    for n, k in enumerate(columns):
        progress(n / len(columns))
        value, wanted, sigma = float(fit.values[n]), float(fit.wanted[n]), float(np.sqrt(fit.covariance[n, n]))
        ends = [wanted + side * width * sigma for side in (-1.0, 1.0)]
        held = abs(wanted - value) > HELD * sigma
        if problem.rows <= MOST_ROWS and n < MOST_PROFILES and sigma > 0.0 and not held and not over():
            ends = [_profile_interval_end(search, k, value, end, least, width * grown) for end in ends]
        out[k] = Amplitude(k, value, sigma, min(ends[0], value), max(ends[1], value), wanted)
    return out


def interval_width(search: SearchResult) -> float:
    """Standard deviations from the middle of a 95 % interval to its ends."""
    return float(t.isf((1 - LEVEL) / 2, max(scale_freedom(search), 1.0)))


def scale_freedom(search: SearchResult) -> float:
    """Numbers that the scale of the noise rests on: those of the repeats, or what is left where there are none."""
    noise = search.problem.settings.noise
    if not search.problem.settings.trusted:
        return search.problem.gram.condition_on_columns(search.columns).nu
    return noise.freedom if noise.absolute else np.inf


def _profile_interval_end(search: SearchResult, k: int, best: float, end: float, least: float, target: float) -> float:
    """End of the profile interval: where twice the loss has risen by ``target``², one secant step from the linear end."""
    columns, settings = search.columns, search.problem.settings
    others = [c for c in columns if c != k]

    def root(move: float) -> float:
        values = fit_nonlinear_values(settings, search.problem.values, others, (k, best + move))
        return float(np.sqrt(max(2.0 * (loss(settings, values, columns) - least), 0.0)))

    move = profile_end(root, end - best, target, 1, close=0.0)
    return end if move is None else best + move


def seen_joints(search: SearchResult, place: int) -> tuple[tuple[int, ...] | None, bool]:
    """Joints at which the data show a chosen candidate (None: it acts at none), and whether they show any of it.

    The parameters of a joint are judged together: sine and cosine of a short range are each uncertain, and the curve is not.
    """
    candidate, columns = search.selector.scorer.candidates[place], search.columns
    source = search.problem.settings.source
    if candidate.joints is None:
        return None, amplitude_significance(search, columns, candidate.columns)[1]
    joints, start = set[int](), 0
    for effect in candidate.effects:
        own = candidate.columns[start : start + len(effect.parameters(source.model.robot))]
        start += len(own)
        joints |= set(effect.joints or ()) if amplitude_significance(search, columns, own)[1] else set()
    return tuple(j for j in candidate.joints if j in joints), bool(joints)


def amplitude_significance(search: SearchResult, columns: Sequence[int], own: Sequence[int]) -> tuple[float, bool]:
    """Chance of the amplitudes of ``own`` among the library ``columns`` of a fit, and whether the data show them."""
    values, covariance = estimate_linear_parameters(search.problem, columns)
    index = [list(columns).index(k) for k in own]
    wide = covariance[np.ix_(index, index)] * inflation(search) ** 2
    size = values[index] @ np.linalg.pinv(wide, hermitian=True) @ values[index]
    p = float(tail(size, len(index), scale_freedom(search)))
    return p, p < 1.0 - LEVEL


def are_all_significant(chances: Sequence[float], tested: int) -> bool:
    """Whether all of some members of a family are shown, by Holm's steps: 5 % over all that were ``tested``.

    Members that were let go count among these, or the last of many would be the best of many tried at 5 %.
    """
    return all(p < (1.0 - LEVEL) / (tested - n) for n, p in enumerate(sorted(chances)))
