"""What stays the same through a search: rows, noise and what whitens; and the whitened derivatives at a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.search.linear.projection import lengths
from kilter_core.gap.search.sources.rounding import Rounding
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.fit.problem import ByCovariance, SharedErrors
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
