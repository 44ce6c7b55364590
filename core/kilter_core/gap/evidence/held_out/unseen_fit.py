"""Does the whole model agree with rows that no choice saw: chi-square of their errors, by the noise and by what was fitted.

A search chooses by what the rows it sees leave, so how little is left there says too little of the model: runs that closed
left 33 of 18 µm, 46 of 16 µm on other poses of the same campaign. The errors of held-out rows follow the noise and, all
together, the covariance of what was fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, f

from kilter_core.gap.evidence.fits.final_fit import Posterior
from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator, on_rows
from kilter_core.gap.noise.visits import average_visits
from kilter_core.gap.search.linear.linearized import cholesky_root
from kilter_core.gap.search.sources.source import Source, number_readings
from kilter_core.observations import Observations
from kilter_core.parameters import metres, mm
from kilter_core.types import Bools, Floats, Ints

REFUTED = 0.01  # chance below which noise does not explain what held-out rows leave


@dataclass(frozen=True)
class UnseenFit:
    """Chi-square of held-out rows with its freedom, and its p; ``left``, ``noise`` and ``matters`` are rms lengths, m.

    ``left`` is what they leave in space, ``noise`` what noise and the covariance of the fit leave of it. ``all_rows`` are
    chi-square and freedom with the rows that were set aside; None where none were.
    """

    chi2: float
    freedom: int
    p_value: float
    poses: int
    left: float
    noise: float
    matters: float
    all_rows: tuple[float, int] | None = None

    @property
    def refutes_model(self) -> bool:
        """Whether more is left than noise explains, and more of it than is too small to matter."""
        return self.p_value <= REFUTED and self.beyond > self.matters

    @property
    def beyond(self) -> float:
        """What they leave in space beyond noise, rms, m."""
        return float(np.sqrt(max(self.left**2 - self.noise**2, 0.0)))

    def verdict(self, of_run: str) -> str:
        """The verdict of a run, where rows that no choice saw agree with it: nothing is closed that is open there."""
        return "unexplained" if self.refutes_model else of_run

    def sentence(self) -> str:
        """What is left, in which quantity; nothing where it is no more than noise."""
        if not self.refutes_model:
            return ""
        return (
            f" On {self.poses} held-out poses, which no choice saw, {mm(self.left):.3g} mm are left (rms error in space) "
            f"where noise leaves {mm(self.noise):.3g} mm (p {self.p_value:.1g}): the model is not closed."
        )

    def to_document(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "chi2": self.chi2,
            "freedom": self.freedom,
            "chi2_per_freedom": self.chi2 / self.freedom,
            "p_value": self.p_value,
            "poses": self.poses,
            "left_mm": mm(self.left),
            "noise_mm": mm(self.noise),
            "refuted": self.refutes_model,
            **({} if self.all_rows is None else dict(zip(("chi2_all", "freedom_all"), self.all_rows, strict=True))),
        }


def unseen_fit(held: HoldoutEvaluator, matters_mm: float) -> UnseenFit | None:
    """Judge held-out rows of the tool; None without any, where noise is not known, or places are fitted to them."""
    problem, rows, known = held.search.problem, held.rows, held.fit
    source, noise = problem.settings.source, problem.settings.noise
    plain = source.observes_tool and source.observes_places and not held.moving and problem.settings.inflation <= 1.0
    if rows is None or known is None or not plain or not noise.absolute:
        return None
    total, free = _chi2(held, known, rows, held.valid_row_mask)
    if not free:
        return None
    law = chi2(free, scale=1.0 / free) if np.isinf(noise.freedom) else f(free, max(noise.freedom, 1.0))
    told = held.report()
    size = len(problem.settings.of_row)
    left = source.rms(told.after @ told.lower.T)
    floor = source.rms(np.eye(size) * np.sqrt(size * told.floor) @ told.lower.T)
    whole = None if held.valid_row_mask.all() else _chi2(held, known, rows, np.ones_like(held.valid_row_mask))
    return UnseenFit(total, free, float(law.sf(total / free)), held.poses, left, floor, metres(matters_mm), whole)


def _chi2(held: HoldoutEvaluator, known: Posterior, rows: Observations, kept: Bools) -> tuple[float, int]:
    """Chi-square of the held-out rows that are ``kept (N,)``, by the noise and by what was fitted, and its freedom."""
    problem = held.search.problem
    other, values = on_rows(problem.settings.source, rows, held.search, problem.values)
    back = np.linalg.inv(cholesky_root(problem.settings.of_row + np.nan_to_num(other.doubt(values))))
    seen = np.isfinite(other.residual(values))
    r = np.einsum("nij,nj->ni", back, np.nan_to_num(other.residual(values)))
    B = back @ _spread(other, values, known)
    r, B = np.where(seen, r, 0.0)[kept], np.where(seen[..., None], B, 0.0)[kept]
    visit, count = _independent(held, rows.select(kept))
    r, B = _by_visit(r, visit, count), _by_visit(B, visit, count)
    size = np.sqrt(_variance(held, count))
    r, B = (r / size[:, None]).reshape(-1), (B / size[:, None, None]).reshape(-1, B.shape[2])
    free = int(np.sum(_by_visit(seen[kept] * 1.0, visit, count) > 0.0))
    along = B.T @ r
    return float(r @ r - along @ np.linalg.solve(np.eye(B.shape[1]) + B.T @ B, along)), free


def _spread(source: Source, values: Floats, known: Posterior) -> Floats:
    """Root (N, m, F) of the covariance of the predictions of rows by that of the fit: all rows share its errors."""
    J, names = source.all_columns(values, known.names)
    own = [known.names.index(name) for name in names]
    w, V = np.linalg.eigh(known.covariance[np.ix_(own, own)])
    return np.asarray(J @ (V * np.sqrt(np.maximum(w, 0.0))))


def _independent(held: HoldoutEvaluator, rows: Observations) -> tuple[Ints, Ints]:
    """Visit (N,) of each row and rows (V,) of each; rows of one rounded reading are one, for they share its error."""
    visits = average_visits(rows)
    if held.search.problem.settings.rounding is None:
        return visits.visit, visits.count
    visit = number_readings(rows)
    return visit, np.bincount(visit)


def _variance(held: HoldoutEvaluator, count: Ints) -> Floats:
    """Variance (V,) of the mean of a visit of ``count (V,)`` rows, over that of a row: an approach is shared by its rows."""
    settings = held.search.problem.settings
    noise = settings.noise
    if settings.rounding is not None:
        own, shared = float(np.trace(noise.row)), float(np.trace(settings.rounding.row))
        return np.asarray((own / count + shared) / (own + shared))
    within = 1.0 if noise.within is None else noise.within**2
    between = 0.0 if noise.between is None else noise.between**2
    if noise.within is None and noise.between is not None:
        return np.ones(len(count))
    return np.asarray((between + within / count) / (between + within))


def _by_visit(values: Floats, visit: Ints, count: Ints) -> Floats:
    """Mean over the rows of each visit."""
    out = np.zeros((len(count), *values.shape[1:]))
    np.add.at(out, visit, values)
    return out / count.reshape(-1, *([1] * (values.ndim - 1)))
