"""The linearised problem at a fit: data and candidates whitened, geometry projected off, everything small after that.

Geometry hides physics: after it is re-fitted only 6-90 % of an effect's variance is left (trap 1). So every statistic
of the search works on A = W'MW and c = W'My, with M the projection off the geometric Jacobian; a set of candidates I
takes c_I' A_II^-1 c_I off chi-square, and conditioning on a set is a Schur complement.

Sizes in space (m, rad) of what a search holds whitened: errors of the visits, noise, and what an effect moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kilter_core.effects import Batch
from kilter_core.gap.search.linear.gram import (
    Gram,
    Projection,
    Soft,
    Stacked,
    lengths,
    orthonormal,
    split_geometry_directions,
)
from kilter_core.gap.search.linear.settings import Derivatives, ProblemSettings, ends, exactly_within
from kilter_core.identify.fit.problem import ByCovariance, LeastSquares, Whitened
from kilter_core.identify.fit.solver import minimise
from kilter_core.parameters import Prior
from kilter_core.types import Bools, Floats, Ints


def less_geometry(
    settings: ProblemSettings, values: Floats, G: Floats, y: Floats, carried: Bools
) -> tuple[Soft, Floats, Floats]:
    """Whitening by what priors know, an orthonormal basis (R, p) of what data know after it, and ``y (R,)`` less both.

    ``G (R, P)`` are the whitened derivatives by the geometry at ``values``; of those held by priors ``carried (P,)`` move.
    """
    source, hard = settings.source, settings.hard
    prior, away = source.prior.select_parameters(carried), source.prior.standardized_deviation(source.geometry(values))
    held, free = prior.columns(G[:, carried]), (G * source.prior_sigma)[:, hard]
    firm, weak = split_geometry_directions(Soft.from_columns(held)(free))
    B = np.hstack([held, free @ weak])
    soft = Soft.from_columns(B)
    U = np.linalg.qr(soft(free @ firm))[0]
    # Taken back into the data: a prior is about what was stated, not about the last fit.
    y = soft(y + B @ np.concatenate([prior.whiten_deviation(away[carried]), weak.T @ away[hard]]))
    return soft, U, y - U @ (U.T @ y)


@dataclass(frozen=True)
class Firm:
    """Columns of a problem whose load errors are geometry that does not move; what a type tells may.

    It has the derivatives and not the problem, whose inner products refer to it: that circle kept problems of thousands of
    poses, 100 MB each, until the interpreter looked for circles.
    """

    settings: ProblemSettings
    values: Floats
    derivatives: Derivatives
    raw: Floats
    size: Floats
    nu: float
    directions: int

    def gram(self) -> Gram:
        """Return the inner products."""
        return self._gram_with_held_loads

    @cached_property
    def _gram_with_held_loads(self) -> Gram:
        source = self.settings.source
        y = self.raw + self.derivatives.W @ (source.library(self.values) * self.size)
        told = source.soft & ~source.of_loads
        soft, U, y = less_geometry(self.settings, self.values, self.derivatives.G, y, told)
        products = Projection.from_columns(soft, U, self.derivatives.W).products(y)
        return Gram(*products, float(y @ y), self.nu + self.directions - U.shape[1])


Tick = Callable[[], None]

PASSES = 3  # re-fits with the scatter of doubtful signs, which follows the size of the effects
CHANGED = 0.05  # of the noise variance: less scatter more or less changes no weight that matters
HOLDING_PASSES = 4  # fits of what is left where amplitudes came out beyond what is physical
ROUNDING = 1e-9  # of a loss, by which residuals with and without derivatives differ at most
BEYOND = 1e-6  # prior sigmas beyond the end of a range that are not rounding
IDLE = 3  # steps in a row that gained less than a change that counts, after which a fit ends
PATIENCE = 20  # slow steps before a fit takes second derivatives: they cost as many looks at thousands of poses
UNMOVED = 0.01  # of what is left or of the noise, rms: loads computed again that move less are not worth the time
SAMPLED = 500  # rows at most on which that is looked at, more or less: loads of thousands take seconds
STILL = 0.1  # change of the fit, in sigmas over all data, that counts as converged


@dataclass(frozen=True)
class LinearizedProblem:
    """Whitened, projected data at ``values``. R = V m rows, Q library columns (unit raw norm), P geometric ones.

    ``y (R,)`` is what the data say with every library effect taken out; ``scale (Q,)`` converts a unit-column coefficient
    to a parameter. ``U (R, p)`` spans the geometry; ``nu`` is the freedom left after it. Projected columns are made
    where they are asked for: those of thousands of poses fill the memory.
    """

    settings: ProblemSettings
    values: Floats
    y: Floats
    U: Floats
    scale: Floats
    nu: float
    A: Floats
    c: Floats
    raw: Floats  # whitened residual at ``values`` (R,)
    derivatives: Derivatives
    soft: Soft

    @property
    def G(self) -> Floats:
        """Whitened geometric columns (R, P)."""
        return self.derivatives.G

    @property
    def W_raw(self) -> Floats:
        """Whitened unit columns before projection (R, Q)."""
        return self.derivatives.W

    def of_unit(self, columns: Sequence[int]) -> Floats:
        """Whitened derivatives (R, P + d) by geometry and library ``columns``, of a unit each; at rest it makes no others."""
        if self.derivatives.kept is None:
            return np.hstack(self.settings.linearise(self.values, columns)[1:])
        return np.hstack([self.G, self.W_raw[:, list(columns)] * self.size[list(columns)]])

    def resting(self) -> None:
        """Let go of what fills the memory: nothing is asked of this fit for a while, or never again."""
        self.derivatives.release_memory()

    @property
    def W(self) -> Floats:
        """Unit columns (R, Q) with geometry projected off."""
        return self.projected_columns(slice(None))

    def projected_columns(self, columns: Sequence[int] | slice) -> Floats:
        """Some of them."""
        return Projection.from_columns(self.soft, self.U, self.W_raw[:, columns]).rows(slice(None))

    @property
    def size(self) -> Floats:
        """Raw whitened norm (Q,) of one unit of each parameter, the inverse of ``scale``."""
        return np.where(self.scale > 0.0, 1.0 / np.where(self.scale > 0.0, self.scale, 1.0), 0.0)

    @property
    def projection(self) -> Projection:
        """All unit columns with geometry projected off, not made."""
        return Projection.from_columns(self.soft, self.U, self.W_raw)

    def within_priors(self) -> tuple[Floats, Stacked]:
        """Whitened data (R,) without any library effect, and the columns (R, P + Q) of one prior sigma each."""
        source = self.settings.source
        sigmas = np.concatenate([np.ones(len(source.prior.sigma)), source.library_sigma * self.size])
        y = self.raw + self.W_raw @ (source.library(self.values) * self.size)
        return y, Stacked(source.prior.columns(self.G), self.W_raw, sigmas, self.settings.whitener.shape[-1])

    @property
    def chi2(self) -> float:
        """Chi-square of the residual at ``values``, nothing taken out, with what the load errors cost by their priors.

        Where doubtful signs widen the noise, what that takes off counts as a Gaussian's norm does: nothing is explained
        by looking away.
        """
        source = self.settings.source
        prior = source.prior.select_parameters(source.soft)
        away = prior.standardized_deviation(source.geometry(self.values)[source.soft])
        return float(self.raw @ self.raw + away @ prior.stiff(away)) + self.settings.log_noise_widening

    @cached_property
    def gram(self) -> Gram:
        """Everything selection needs."""
        yy = float(self.y @ self.y)
        if not len(self.soft.shrink):
            return Gram(self.A, self.c, yy, self.nu)
        there = frozenset(np.flatnonzero(self.settings.source.library(self.values)).tolist())
        if not np.any(self.settings.source.of_loads):
            return Gram(self.A, self.c, yy, self.nu)
        firm = Firm(self.settings, self.values, self.derivatives, self.raw, self.size, self.nu, self.U.shape[1])
        return Gram(self.A, self.c, yy, self.nu, held=firm.gram, there=there)

    @property
    def rows(self) -> int:
        """Number of independent scalars that count."""
        return max(2, int(self.settings.numbers / self.settings.inflation))

    @property
    def row_visit(self) -> Ints:
        """Visit of each row (R,)."""
        size = self.settings.whitener.shape[-1]
        return np.repeat(np.arange(len(self.settings.used)), size)

    def basis(self, columns: Sequence[int]) -> Floats:
        """Orthonormal basis (R, p + d) of geometry and the library ``columns``."""
        if not len(columns):
            return self.U
        return np.hstack([self.U, orthonormal(self.projected_columns(list(columns)))])


def linearise_problem(settings: ProblemSettings, values: Floats) -> LinearizedProblem:
    """Linearise at ``values``: whiten, project off geometry, take the library's own part back into the data."""
    made, r, norm = Derivatives.evaluate_at_values(settings, values)
    G, W, (unit, scale) = made.G, made.W, _units(norm)
    y = r + W @ (settings.source.library(values) * unit)
    soft, U, y = less_geometry(settings, values, G, y, settings.source.soft)
    # Correlated samples carry less freedom than their number: whitening took the same factor off chi-square.
    nu = float(settings.numbers / settings.inflation - U.shape[1])
    return LinearizedProblem(
        settings, values, y, U, scale, nu, *Projection.from_columns(soft, U, W).products(y), r, made, soft
    )


def with_columns_of(problem: LinearizedProblem, settings: ProblemSettings, columns: Sequence[int]) -> LinearizedProblem:
    """The problem under ``settings`` that make some library ``columns`` others, which are zero at its values; all else stays.

    So one that was found elsewhere in time is asked for by itself: the derivatives of thousands of poses take a second. The
    problem before rests.
    """
    index, scale = list(columns), problem.scale.copy()
    G, W = problem.G, problem.W_raw
    problem.resting()
    if problem.derivatives.kept is not None:  # else nobody else has them
        W = W.copy()
    W[:, index], scale[index] = whitened_unit_columns(settings, problem.values, None, index)
    made = replace(problem.derivatives, settings=settings, kept=(G, W))
    A, c = Projection.from_columns(problem.soft, problem.U, W).products(problem.y)
    return replace(problem, settings=settings, scale=scale, A=A, c=c, derivatives=made)


def whitened_unit_columns(
    settings: ProblemSettings, values: Floats, batch: Batch | None, only: Sequence[int]
) -> tuple[Floats, Floats]:
    """Whitened unit columns (R, K) of the library and their scales (K,), as :func:`linearise_problem` has them, no geometry."""
    W = settings.whitening.columns(settings.source.without_geometry().linear(values, batch, only).W)
    unit, scale = _units(lengths(W))
    W /= unit
    return W, scale


def _units(norm: Floats) -> tuple[Floats, Floats]:
    """What columns of these norms (K,) are divided by, and the scales (K,) of unit columns: zero where there is nothing."""
    unit = np.where(norm > 0.0, norm, 1.0)
    return unit, np.where(norm > 0.0, 1.0 / unit, 0.0)


def ignore_step() -> None:
    """Ignore a step."""


def refit(
    settings: ProblemSettings, values: Floats, columns: Sequence[int], tick: Tick = ignore_step
) -> LinearizedProblem:
    """Nonlinear re-fit of geometry and the library ``columns``, each with its prior, from ``values``."""
    values = fit_nonlinear_values(settings, values, columns, tick=tick)
    other = with_updated_loads(settings, values)  # once: the next name, or the next noise, brings the next fit
    for _ in range(PASSES):
        other = with_sign_uncertainty(other, values)
        if other is settings:
            break
        settings, values = other, fit_nonlinear_values(other, values, columns, tick=tick)
    tick()
    return linearise_problem(settings, values)


def with_updated_loads(settings: ProblemSettings, values: Floats) -> ProblemSettings:
    """The setting with loads on the chain of these values; itself where that moves far less than is left anyway."""
    source = settings.source
    if not source.bears(values):
        return settings
    rows = np.arange(len(settings.used))[:: max(1, len(settings.used) // SAMPLED)]
    few = source.only(rows)
    before, after = few.residual(values), few.with_loads_at_values(values).residual(values)
    by = ByCovariance(settings.whitener[rows], settings.used[rows])

    def size(residual: Floats) -> float:
        return float(np.sqrt(np.mean(by.residual(residual) ** 2)))

    if size(after - before) < UNMOVED * max(1.0, size(before)):
        return settings
    return replace(settings, source=source.with_loads_at_values(values))


def with_sign_uncertainty(settings: ProblemSettings, values: Floats) -> ProblemSettings:
    """The setting with the scatter of doubtful signs of loads and of unknown sides at these values; itself if unchanged."""
    source, direction = settings.source, settings.source.batch.direction
    if not source.observes_tool or (source.batch.blur is None and (direction is None or direction.all())):
        return settings
    doubt = source.doubt(values)
    before = 0.0 if settings.doubt is None else settings.doubt
    if np.max(np.abs(doubt - before), initial=0.0) <= CHANGED * np.max(
        np.trace(settings.noise.visit, axis1=1, axis2=2)
    ):
        return settings
    return replace(settings, doubt=doubt if np.any(doubt) else None)


def fit_nonlinear_values(
    settings: ProblemSettings,
    values: Floats,
    columns: Sequence[int],
    held: tuple[int, float] | None = None,
    tick: Tick = ignore_step,
) -> Floats:
    """Values of the nonlinear fit; the rest of the library is zero.

    ``held`` keeps one more library parameter at a value, as a profile does. ``tick`` is called at every step, and may
    raise: on ten thousand poses a fit takes seconds, and who cancels should not wait for its end.
    """
    free = [k for k in columns if held is None or k != held[0]]
    return within_range(SearchProblem(settings, free), _with_only(settings, values, free, held), tick)


def _with_only(
    settings: ProblemSettings, values: Floats, columns: Sequence[int], held: tuple[int, float] | None = None
) -> Floats:
    """Values with no other library columns than these, and one more where it is ``held``."""
    source, free = settings.source, list(columns)
    library = np.zeros(len(source.library(values)))
    library[free] = source.library(values)[free]
    if held is not None:
        library[held[0]] = held[1]
    return source.apply_step(values, np.zeros(len(source.prior_mean)), library)


def nearest(settings: ProblemSettings, starts: Sequence[Floats], columns: Sequence[int]) -> Floats:
    """Of some values those that leave least once all but the library ``columns`` is taken out of them.

    Geometry that was fitted beside a large curve is far off without it: a fit from there walked for 240 looks at the model.
    """
    return min(starts, key=lambda values: loss(settings, _with_only(settings, values, columns), columns))


def loss(settings: ProblemSettings, values: Floats, columns: Sequence[int]) -> float:
    """What a fit of geometry and the library ``columns`` makes least: half its chi-square, with what the priors cost."""
    problem = SearchProblem(settings, list(columns))
    return problem.total_loss(values, problem.weighted_residuals(values))


def within_range(problem: SearchProblem, values: Floats, tick: Tick) -> Floats:
    """Values of the fit in which no amplitude of an effect is beyond what is physical.

    Those that come out beyond it are held at the end of their range, and the rest is fitted again.
    """
    first: float | None = None  # a fit held at its ranges that is worse than its start is not mended by holding more
    for _ in range(HOLDING_PASSES):
        here = problem.evaluate(values)
        first = here.loss if first is None else first
        found = minimise(problem, values, here, lambda *_: tick(), patience=PATIENCE, idle=IDLE)
        values, after = problem.brought_back(found.values)
        if after is problem or found.point.loss > first:
            break
        problem = after
    return values


@dataclass(frozen=True)
class SearchProblem(LeastSquares[Whitened]):
    """Geometry and the library columns ``free``, stepped as an identification is; every one has its prior.

    All are counted from their priors, in prior sigmas: the columns of an effect are many powers of ten apart. Without the
    effects' own priors a candidate that imitates geometry to seven digits ran away with it.
    """

    settings: ProblemSettings
    free: list[int]
    held: Floats | None = None
    anchor: Floats | None = None
    prior: Prior = field(init=False)
    _sigma: Floats = field(init=False)

    def __post_init__(self) -> None:
        whole = self.settings.source.prior_with_columns(self.free)
        count = len(whole.sigma)
        object.__setattr__(self, "_sigma", whole.sigma)
        object.__setattr__(self, "prior", Prior(np.zeros(count), np.ones(count), whole.correlation))

    @property
    def rows(self) -> float:
        """Whitened residuals."""
        return float(max(1, self.settings.used.sum() * self.settings.whitener.shape[-1]))

    def required_decrease(self, loss: float) -> float:
        """What a step must promise: less moves nothing that a statistic would show.

        Where the model lacks something, statistics are in units of what it leaves, not of the noise.
        """
        return 0.5 * STILL**2 * max(1.0, 2.0 * loss / self.rows)

    def evaluate(self, values: Floats) -> Whitened:
        """Linearise there."""
        r, G, W = self.settings.linearise(values, self.free)
        J, split = np.empty((len(r), G.shape[1] + W.shape[1])), G.shape[1]
        np.multiply(G, self._sigma[:split], out=J[:, :split])
        np.multiply(W, self._sigma[split:], out=J[:, split:])
        return Whitened(r, J, self.total_loss(values, r))

    def weighted_residuals(self, values: Floats) -> Floats:
        """Whitened residuals (R,)."""
        return self.settings.whitened_residuals(values).reshape(-1)

    def surely_higher(self, values: Floats, loss: float) -> bool:
        """Whether the loss is higher by more than rounding: residuals alone take a third of the time."""
        return not self.total_loss(values, self.weighted_residuals(values)) < loss * (1.0 + ROUNDING)

    def beyond(self, here: Whitened, values: Floats, step: Floats) -> Whitened:
        """What a tiny step leads to."""
        r = here.r - here.J @ step
        return Whitened(r, here.J, self.total_loss(values, r))

    def current(self, values: Floats) -> Floats:
        """How far geometry and the library columns that are free are from their priors."""
        source = self.settings.source
        away = np.concatenate([source.geometry(values) - source.prior_mean, source.library(values)[self.free]])
        return np.asarray(away / self._sigma)

    def apply_change(self, values: Floats, change: Floats) -> Floats:
        """Change them."""
        source, change = self.settings.source, change * self._sigma
        library, split = source.library(values).copy(), len(source.prior_mean)
        library[self.free] += change[split:]
        return source.apply_step(values, change[:split], library)

    def brought_back(self, values: Floats) -> tuple[Floats, SearchProblem]:
        """Values with every amplitude inside its physical range, and the problem that holds those at its ends.

        The problem is itself where none is beyond that was not held before.
        """
        source, now = self.settings.source, self.current(values)
        low, high = (end / self._sigma for end in ends(source, self.free))
        inside = np.clip(now, low, high)
        if not np.array_equal(inside, now):
            values = exactly_within(source, self.apply_change(values, inside - now), self.free)
        before = np.zeros(len(now), dtype=bool) if self.held is None else self.held.any(axis=0)
        beyond = before | (np.abs(now - inside) > BEYOND)
        if np.array_equal(beyond, before):
            return values, self
        return values, replace(self, held=np.eye(len(now))[beyond], anchor=inside)


def estimate_linear_parameters(problem: LinearizedProblem, columns: Sequence[int]) -> tuple[Floats, Floats]:
    """Parameters (d,) of the columns and their covariance (d, d), geometry re-optimised, no prior on them."""
    index = list(columns)
    scale = problem.scale[index]
    return problem.gram.solve(index) * scale, problem.gram.inverse(index)[0] * np.outer(scale, scale)


def fit_rms(problem: LinearizedProblem) -> float:
    """Rms error (m or rad) of the visits at the values of the fit itself: what a version that holds them leaves."""
    return _rms_in_space(problem.settings, problem.raw)


def rms_error_at_values(settings: ProblemSettings, values: Floats) -> float:
    """Rms error (m or rad) of the visits at other values."""
    return _rms_in_space(settings, settings.whitened_residuals(values).reshape(-1))


def _rms_in_space(settings: ProblemSettings, whitened: Floats) -> float:
    return settings.source.rms(settings.whitening.back(whitened)[settings.used])


def noise_rms(settings: ProblemSettings) -> float:
    """Rms length in space (m; rad of a joint) that the noise alone gives a visit."""
    size = settings.whitener.shape[-1]
    root = cholesky_root(np.mean(settings.of_visit, axis=0)).T * np.sqrt(size)
    return settings.source.rms(root)


def displacement_by_columns(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """Displacement (V, m) in m or rad by the library columns ``own`` at the values of the fit, which a version stores."""
    return problem.settings.source.in_space(weighted_displacement(problem, own))


def weighted_displacement(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """The same as residuals have it: of views, as these weigh it."""
    index = list(own)
    amount = problem.settings.source.library(problem.values)[index] * problem.size[index]
    return problem.settings.whitening.back(problem.W_raw[:, index] @ amount)


def displacement_derivatives(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """How what was measured (V, m, d) moves in m or rad with each of the library columns ``own``."""
    columns = problem.W_raw[:, list(own)] * problem.size[list(own)]
    each = [problem.settings.whitening.back(column) for column in columns.T]
    return problem.settings.source.in_space(np.stack(each, axis=2))


def cholesky_root(covariance: Floats) -> Floats:
    """Lower triangular root (..., m, m) of covariances."""
    return np.asarray(np.linalg.cholesky(covariance + 1e-20 * np.eye(covariance.shape[-1])), dtype=np.float64)
