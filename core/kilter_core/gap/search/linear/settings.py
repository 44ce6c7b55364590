"""What stays the same through a search: rows, noise, whitening, ranges and tail probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc, gammaincc

from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.search.linear.gram import lengths
from kilter_core.gap.search.sources.source import Rounding, Source
from kilter_core.identify.fit.problem import ByCovariance, SharedErrors
from kilter_core.parameters import Parameter
from kilter_core.types import Bools, Floats, Ints

MOST_BYTES = 16 << 20  # of derivatives that are kept in any case


@dataclass(frozen=True)
class ProblemSettings:
    """What stays the same through a search: source, whitening, which visits count, and which belong to one pose."""

    source: Source
    noise: Noise
    used: Bools
    group: Ints
    inflation: float = 1.0  # variance of a sum over its variance if samples were independent (trajectories)
    trusted: bool = True  # whether the whitened scale is a floor for every test (repeats, or a measured correlation)
    doubt: Floats | None = None  # covariance (V, m, m) beside the noise: signs of loads near zero
    rounding: Rounding | None = None  # of the joint readings
    whitener: Floats = field(init=False)
    shared: SharedErrors | None = field(init=False)

    def __post_init__(self) -> None:
        noise = (
            self._unshared_noise
            if self.doubt is None
            else replace(self._unshared_noise, visit=self._unshared_noise.visit + self.doubt)
        )
        whitener = noise.whiteners() / np.sqrt(self.inflation)
        object.__setattr__(self, "whitener", whitener)
        object.__setattr__(
            self, "shared", None if self.rounding is None else self.rounding.shared_errors(whitener, self.used)
        )

    @property
    def _unshared_noise(self) -> Noise:
        """The noise of the visits without what they share."""
        if self.rounding is None:
            return self.noise
        return replace(self.noise, visit=self.noise.visit + self.rounding.alone(self.used))

    @property
    def of_row(self) -> Floats:
        """Covariance (m, m) of a row: its noise, and its rounded readings."""
        return self.noise.row if self.rounding is None else self.noise.row + self.rounding.row

    @property
    def of_visit(self) -> Floats:
        """The same of each visit (V, m, m)."""
        return self.noise.visit if self.rounding is None else self.noise.visit + self.rounding.covariance

    @property
    def whitening(self) -> ByCovariance:
        """How residuals and columns are whitened."""
        return ByCovariance(self.whitener, self.used, self.shared)

    @property
    def log_noise_widening(self) -> float:
        """Logarithm of how much the doubt widens the noise, over the visits that count."""
        if self.doubt is None:
            return 0.0
        alone = self._unshared_noise.whiteners() / np.sqrt(self.inflation)
        each = np.linalg.slogdet(alone)[1] - np.linalg.slogdet(self.whitener)[1]
        return float(2.0 * np.sum(each[self.used]))

    @property
    def numbers(self) -> float:
        """Scalars of the visits that count and were measured."""
        return float(self.used.sum() * (self.whitener.shape[-1] - self.source.missing))

    @property
    def hard(self) -> Bools:
        """Geometry (P,) that is projected off; the rest are load errors, which the priors hold."""
        return ~self.source.soft

    def whitened_residuals(self, values: Floats) -> Floats:
        """Whitened residuals (V, m), zero where nothing was seen or the visit does not count."""
        return self.whitening.residual(self.source.residual(values))

    def linearise(self, values: Floats, only: Sequence[int] | None = None) -> tuple[Floats, Floats, Floats]:
        """Whitened residuals (R,), and derivatives by geometry (R, P) and library (R, Q): the columns ``only``, or all."""
        linear, by = self.source.linear(values, None, only), self.whitening
        return by.residual(linear.r).reshape(-1), by.columns(linear.G), by.columns(linear.W)


@dataclass
class Derivatives:
    """Geometric columns ``G (R, P)`` and unit library columns ``W (R, Q)``, with the lengths (Q,) that these had.

    Made at ``values`` and again, to the last bit, where they are asked for after :meth:`release_memory`.
    """

    settings: ProblemSettings
    values: Floats
    kept: tuple[Floats, Floats] | None = None

    @staticmethod
    def evaluate_at_values(settings: ProblemSettings, values: Floats) -> tuple[Derivatives, Floats, Floats]:
        """With the whitened residual (R,) and the lengths of the library's columns (Q,)."""
        made = Derivatives(settings, values)
        r, norm = made._make()
        return made, r, norm

    @property
    def G(self) -> Floats:
        """Whitened geometric columns."""
        return self._geometry_and_library_columns()[0]

    @property
    def W(self) -> Floats:
        """Whitened library columns, each of length 1; those that move nothing are zero."""
        return self._geometry_and_library_columns()[1]

    def release_memory(self) -> None:
        """Keep nothing until it is asked for again; a few hundred poses are not worth the time."""
        if self.kept is not None and sum(part.nbytes for part in self.kept) > MOST_BYTES:
            self.kept = None

    def _geometry_and_library_columns(self) -> tuple[Floats, Floats]:
        if self.kept is None:
            self._make()
        assert self.kept is not None
        return self.kept

    def _make(self) -> tuple[Floats, Floats]:
        r, G, W = self.settings.linearise(self.values)
        norm = lengths(W)
        W /= np.where(norm > 0.0, norm, 1.0)
        self.kept = (G, W)
        return r, norm


def tail(taken: ArrayLike, d: ArrayLike, freedom: ArrayLike = np.inf) -> Floats:
    """Chance of chi-square ``taken`` of ``d`` directions over a variance that rests on ``freedom`` numbers.

    F where those are finite: a variance from thirty numbers is off by a quarter, and a chi-square tail would call what
    that makes large certain.
    """
    size = np.maximum(np.asarray(taken, dtype=np.float64), 0.0)
    known, count = np.asarray(freedom, dtype=np.float64), np.maximum(np.asarray(d, dtype=np.float64), 1.0)
    finite = np.isfinite(known)
    if not finite.any():  # a selection asks tens of thousands of times, of a noise of one kind
        return np.asarray(gammaincc(count / 2.0, size / 2.0))
    if finite.all():
        return np.asarray(fdtrc(count, np.maximum(known, 1.0), size / count))
    estimated = fdtrc(count, np.where(finite, np.maximum(known, 1.0), 1.0), size / count)
    return np.where(finite, estimated, gammaincc(count / 2.0, size / 2.0))


def ends(source: Source, free: Sequence[int]) -> tuple[Floats, Floats]:
    """Lowest and highest values (P + F,) of the geometry, counted from its priors, and of the library columns ``free``; SI.

    Only amplitudes of effects have ends: what is known of a geometry is in its priors, as what is known of the loads is.
    """
    model, library = source.model, library_parameters(source)
    effects = {p.name: p for p in model.parameters[model.n_geometric :]}
    size = len(source.prior_mean)
    out = np.full((size + len(free), 2), (-np.inf, np.inf))
    for k, (name, soft) in enumerate(zip(source.fitted_names(), source.soft, strict=True)):
        if name in effects and not soft:
            p, mean = effects[name], source.prior_mean[k]
            out[k] = p.lower - mean, p.upper - mean
    for n, k in enumerate(free, size):
        out[n] = library[k].lower, library[k].upper
    low, high = out.T
    return low, high


def exactly_within(source: Source, values: Floats, free: Sequence[int]) -> Floats:
    """Values whose library columns ``free`` end exactly where their ranges do: rounding left a compliance of -1e-22."""
    library, known = source.library(values).copy(), library_parameters(source)
    for k in free:
        library[k] = min(max(library[k], known[k].lower), known[k].upper)
    return source.apply_step(values, np.zeros(len(source.prior_mean)), library)


def library_parameters(source: Source) -> tuple[Parameter, ...]:
    """The parameters of the library's columns, in their order: the last of the model's."""
    parameters = source.model.parameters
    return tuple(parameters[len(parameters) - source.n_library :])
