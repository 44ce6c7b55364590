"""What every fit shares, an identification's and a search's: whitening, linearising, Gaussian priors, and a step.

Parameters are scaled by their prior sigma, so the prior adds the identity to the normal equations: they stay solvable
whatever the poses do not see. (Without priors a rank-deficient fit wandered to 1e13; with them it took 4 evaluations.)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from kilter_core.effects import Batch
from kilter_core.identify.fit.solver import BEND
from kilter_core.measurement import Measurement, Residual
from kilter_core.model import RobotModel
from kilter_core.parameters import Prior
from kilter_core.types import Bools, Floats, Ints

SEEN = 1e-9  # of a noise sigma: directions in which less is shared are left alone


@dataclass(frozen=True)
class SharedErrors:
    """Whitening by (I + S S')^(-1/2) of whitened rows, block by block: ``S`` are a block's columns of one sigma each.

    ``blocks`` are the rows (r,), an orthonormal basis (r, d) of S, and by how much each direction shrinks (d,), less 1.
    """

    blocks: tuple[tuple[Ints, Floats, Floats], ...]

    @staticmethod
    def from_blocks(blocks: Iterable[tuple[Ints, Floats]]) -> SharedErrors:
        """From the rows (r,) and columns (r, n) of each block."""
        made = []
        for rows, S in blocks:
            Q, s, _ = np.linalg.svd(S, full_matrices=False)
            kept = s > SEEN
            made.append((rows, Q[:, kept], 1.0 / np.sqrt(1.0 + s[kept] ** 2) - 1.0))
        return SharedErrors(tuple(made))

    def apply(self, X: Floats) -> Floats:
        """Whiten rows (R,) or (R, K) in their place."""
        for rows, Q, shrink in self.blocks:
            X[rows] += (Q * shrink) @ (Q.T @ X[rows])
        return X

    def undo(self, X: Floats) -> Floats:
        """What whitened rows stand for, in another array."""
        out = X.copy()
        for rows, Q, shrink in self.blocks:
            out[rows] += (Q * (1.0 / (1.0 + shrink) - 1.0)) @ (Q.T @ X[rows])
        return out


HOLD = 1e8  # stiffness of a held direction against a prior of 1
MOST_NUMBERS = 400_000  # rows times columns that are whitened or derived at a time: arrays of 20 MB


@dataclass(frozen=True)
class ByDeviation:
    """Whitening of a block by standard deviations, one number or (V, 1, w): each number by itself."""

    sigma: float | Floats

    def residual(self, r: Floats) -> Floats:
        """Whitened residuals (V, k, w), zero where nothing was measured."""
        scaled = np.asarray(r / self.sigma)
        unseen = np.isnan(scaled)
        if unseen.any():
            scaled[unseen] = 0.0
        return scaled

    def columns(self, J: Floats, r: Floats) -> Floats:
        """Whitened derivatives (V, k, w, F) of what was measured, zero where the residual says nothing was."""
        out = J / (self.sigma if isinstance(self.sigma, float) else self.sigma[..., None])
        unseen = np.isnan(r)
        if unseen.any():
            out[unseen] = 0.0
        return np.asarray(out)


@dataclass(frozen=True)
class ByCovariance:
    """Whitening of visits by the inverse roots ``by (V, m, m)`` of their covariances; only visits ``used (V,)`` count.

    ``shared`` are errors that several of them have in common.
    """

    by: Floats
    used: Bools
    shared: SharedErrors | None = None

    def residual(self, r: Floats) -> Floats:
        """Whitened residuals (V, m), zero where nothing was seen or the visit does not count."""
        white = np.asarray(np.einsum("vij,vj->vi", self.by, np.nan_to_num(r)) * self.used[:, None])
        return white if self.shared is None else self.shared.apply(white.reshape(-1)).reshape(white.shape)

    def columns(self, J: Floats) -> Floats:
        """Whiten columns (V, m, K) in their place; (R, K) of them."""
        size = max(1, MOST_NUMBERS // max(1, J.shape[2]))
        for k in range(0, len(J), size):
            part = slice(k, k + size)
            J[part] = np.matmul(self.by[part] * self.used[part, None, None], J[part])
        white = J.reshape(J.shape[0] * J.shape[1], J.shape[2])
        return white if self.shared is None else self.shared.apply(white)

    def back(self, white: Floats) -> Floats:
        """Residuals (V, m) that whitened ones (R,) stand for."""
        white = white if self.shared is None else self.shared.undo(white.reshape(-1))
        return np.asarray(np.einsum("vij,vj->vi", np.linalg.inv(self.by), white.reshape(-1, self.by.shape[-1])))


def linearised_residual(
    model: RobotModel, measurement: Measurement, batch: Batch, values: Floats, free: Ints
) -> Residual:
    """What a model leaves of a measurement, with the derivatives by its parameters ``free``."""
    sees = measurement.needs_turns, measurement.reads_joints
    return measurement.residual(*model.jacobian(batch, values, free, *sees))


@dataclass(frozen=True)
class Whitened:
    """A problem near some values: ``r (R,)`` and ``J (R, F)``, Jᵀr the downhill slope of the ``loss``."""

    r: Floats
    J: Floats
    loss: float


W = TypeVar("W", bound=Whitened)


class LeastSquares(ABC, Generic[W]):
    """Whitened residuals under free parameters that each have a Gaussian prior, as the solver walks them.

    ``prior`` counts in the units of :meth:`current`.
    ``held (K, F)`` are orthonormal directions, in prior sigmas, along which the parameters stay at ``anchor (F,)``.
    """

    prior: Prior
    held: Floats | None = None
    anchor: Floats | None = None

    @property
    def prior_mean(self) -> Floats:
        """Means (F,) of the priors."""
        return self.prior.mean

    @property
    def prior_sigma(self) -> Floats:
        """Standard deviations (F,) of the priors."""
        return self.prior.sigma

    @property
    @abstractmethod
    def rows(self) -> float:
        """Number of whitened residuals."""

    @abstractmethod
    def required_decrease(self, loss: float) -> float:
        """How much of ``loss`` a step must promise to be worth taking, beside rounding."""

    @abstractmethod
    def evaluate(self, values: Floats) -> W:
        """Linearise there."""

    def weighted_residuals(self, values: Floats) -> Floats:
        """The residuals (R,) that :meth:`evaluate` has."""
        return self.evaluate(values).r

    def surely_higher(self, values: Floats, loss: float) -> bool:
        """Whether the loss at ``values`` is known to be higher; where residuals cost as much as :meth:`evaluate`, never."""
        return False

    @abstractmethod
    def beyond(self, here: W, values: Floats, step: Floats) -> W:
        """What is at ``values``, a small ``step (F,)`` in prior sigmas from ``here``; the Jacobian stays."""

    @abstractmethod
    def current(self, values: Floats) -> Floats:
        """Free parameters (F,) among the values."""

    @abstractmethod
    def apply_change(self, values: Floats, change: Floats) -> Floats:
        """Values with the free parameters changed by ``change (F,)``."""

    def apply_step(self, values: Floats, step: Floats) -> Floats:
        """Values after a step (F,) in prior sigmas."""
        return self.apply_change(values, step * self.prior_sigma)

    def total_loss(self, values: Floats, r: Floats) -> float:
        """Half the sum of squares of ``r``, of the priors and of what strayed along held directions."""
        away = self._prior_deviation(values)
        with np.errstate(over="ignore"):  # a residual beyond all bounds is said in words by the solver
            return 0.5 * (
                float(r @ r)
                + float(away @ self.prior.stiff(away))
                + HOLD * float(np.sum(self._held_displacement(values) ** 2))
            )

    def normal_equations(self, values: Floats, here: W) -> tuple[Floats, Floats]:
        """Matrix (F, F) and slope (F,) in prior sigmas, the priors included, nothing held."""
        scale = self.prior_sigma
        H = (here.J.T @ here.J) * np.outer(scale, scale)
        self.prior.add_to(H)
        return H, self._downhill(values, here)

    def prior_information(self) -> Floats:
        """What the priors know (F, F), in prior sigmas."""
        return np.eye(len(self.prior_sigma)) if self.prior.precision is None else self.prior.precision

    def whole_step(self, values: Floats, here: W) -> Floats:
        """The step (F,) in prior sigmas that Gauss and Newton take with nothing held, neither damped nor shortened."""
        return np.asarray(np.linalg.solve(*self.normal_equations(values, here)), dtype=np.float64)

    def derivatives(self, values: Floats, here: W) -> tuple[Floats, Floats]:
        """Gauss-Newton matrix (F, F) and downhill slope (F,)."""
        H, g = self.normal_equations(values, here)
        if self.held is None:
            return H, g
        return H + HOLD * self.held.T @ self.held, g - self._pull_back(values)

    def slope(self, values: Floats, here: W) -> Floats:
        """Downhill slope (F,)."""
        return self._downhill(values, here) - self._pull_back(values)

    def bend(self, values: Floats, here: W, step: Floats) -> Floats:
        """How the prediction bends along a step."""
        return self._bent(here, self.weighted_residuals(self.apply_step(values, BEND * step)), step)

    def _bent(self, here: W, there: Floats, step: Floats) -> Floats:
        one = bool(np.all(self.prior_sigma == 1.0))  # as a search has them: then no copy of the columns is made
        scaled = here.J if one else here.J * self.prior_sigma
        return np.asarray(scaled.T @ (here.r - there - scaled @ (BEND * step)) * (2.0 / BEND**2))

    def _prior_deviation(self, values: Floats) -> Floats:
        """How far (F,) the parameters are from their priors, in prior sigmas."""
        return self.prior.standardized_deviation(self.current(values))

    def _downhill(self, values: Floats, here: W) -> Floats:
        return np.asarray(self.prior_sigma * (here.J.T @ here.r) - self.prior.stiff(self._prior_deviation(values)))

    def _held_displacement(self, values: Floats) -> Floats:
        """How far the held directions have moved, in prior sigmas."""
        if self.held is None or self.anchor is None:
            return np.zeros(0)
        return np.asarray(self.held @ ((self.current(values) - self.anchor) / self.prior_sigma))

    def _pull_back(self, values: Floats) -> Floats:
        """Slope (F,) by which held directions are pulled back."""
        return np.asarray(0.0 if self.held is None else HOLD * self.held.T @ self._held_displacement(values))
