"""What a search measures against what the model says, and rounded joint readings as noise.

The variance of a joint is step² / 12 (Widrow, Kollar and Liu 1996). Repeats do not show it: a pose that is visited again
is rounded the same way again, so its visits share one error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kilter_core.arm.chain import Element
from kilter_core.effects import Batch, Effect
from kilter_core.errors import ObservationError
from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.noise.visits import Visits
from kilter_core.identify.fit.problem import SharedErrors
from kilter_core.measurement import Measurement
from kilter_core.measurement.kind import Unit
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.observations.repeats import numbered_rows, reading_steps
from kilter_core.parameters import DEG, MM, Prior, mm
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Linear:
    """Residuals ``r (V, m)``; derivatives of the prediction by geometry ``G (V, m, P)`` and library ``W (V, m, Q)``."""

    r: Floats
    G: Floats
    W: Floats


class Source(ABC):
    """A model over the whole library and the rows it is compared with.

    ``prior`` is that of the geometry (P,), ``library_sigma (Q,)`` are of the library, the last ``n_library`` parameters of
    the model. ``batch`` has the conditions of the rows.
    """

    unit: ClassVar[Unit] = "m"  # of a residual
    observes_tool: ClassVar[bool] = True
    observes_places: ClassVar[bool] = True  # a row tells by itself where the tool is

    model: RobotModel
    n_library: int
    batch: Batch
    prior: Prior
    library_sigma: Floats

    @property
    def prior_mean(self) -> Floats:
        """Means (P,) of the geometry's prior."""
        return self.prior.mean

    @property
    def prior_sigma(self) -> Floats:
        """Standard deviations (P,) of the geometry's prior."""
        return self.prior.sigma

    def prior_with_columns(self, columns: Sequence[int]) -> Prior:
        """The prior (P + d,) of the geometry and of library ``columns``, which it knows nothing of."""
        return self.prior.append_prior(Prior(np.zeros(len(columns)), self.library_sigma[list(columns)]))

    @property
    @abstractmethod
    def observations(self) -> Observations:
        """The rows."""

    @property
    @abstractmethod
    def soft(self) -> Bools:
        """Which of the geometry (P,) are known about as well by their priors as by the data: load errors, or what other arms
        of the type say.
        """

    @property
    def of_loads(self) -> Bools:
        """Which of the geometry (P,) are load errors."""
        return self.soft

    @property
    def tool_numbers(self) -> int:
        """How many of a visit's numbers are of the tool (of joints where nothing else was measured), which come first."""
        return 0

    @property
    def beside_numbers(self) -> list[int]:
        """Numbers of a visit of each kind beside the tool."""
        return []

    @property
    def sensor_reading_mask(self) -> Bools:
        """Which of those numbers (V, k) were read."""
        return np.zeros((len(self.observations), 0), dtype=bool)

    @property
    def missing(self) -> float:
        """Numbers of a visit that were not measured, or only set a sensor's zero, on average."""
        return 0.0

    def geometry_freedom_share(self, numbers: int) -> float:
        """Share of the freedom of so many measured numbers that the geometry takes."""
        return min(0.9, int(np.sum(~self.soft)) / max(numbers, 1))

    @property
    def left_share(self) -> float:
        """Share of the numbers of held-out rows that is left when what does not belong to the arm was fitted to them."""
        return 1.0

    def model_values(self, values: Floats) -> Floats:
        """Values of the model among those of a fit."""
        return values

    @property
    def live(self) -> Bools:
        """Joints (n,) that were measured."""
        return np.ones(self.model.robot.n_joints, dtype=bool)

    @abstractmethod
    def on_rows(self, rows: Observations) -> Source:
        """The same model on other rows."""

    @abstractmethod
    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m), NaN where nothing was seen."""

    @abstractmethod
    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives; ``batch`` replaces the conditions the effects see, not the rows.

        ``only`` gives the library columns wanted, in order; all when None.
        """

    @abstractmethod
    def geometry(self, values: Floats) -> Floats:
        """Values (P,) of the geometric parameters."""

    @abstractmethod
    def apply_step(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Values with the geometry moved by ``geometry (P,)`` and the library set to ``library (Q,)``."""

    def library(self, values: Floats) -> Floats:
        """Values (Q,) of the library's parameters."""
        return values[len(values) - self.n_library :]

    def residual_of_rows(self, values: Floats, rows: Observations, tick: Callable[[], None]) -> Floats:
        """Residuals (N, m) of single rows; ``tick`` is called now and then."""
        return self.on_rows(rows).residual(values)

    def without_geometry(self) -> Source:
        """The same without derivatives by the geometry, where that saves work."""
        return self

    @abstractmethod
    def joint_columns(self, values: Floats) -> Callable[[int], Floats]:
        """Derivative (V, m) of what was measured by each joint's motion, joint by joint."""

    @abstractmethod
    def residuals_by_joint(self, residual: Floats) -> list[Floats]:
        """What each joint can move of residuals (V, m)."""

    @abstractmethod
    def rms(self, errors: Floats) -> float:
        """Root mean square size of errors (V, m): of a point in space (m), or of a joint (rad)."""

    def in_space(self, errors: Floats) -> Floats:
        """Errors (V, m), or derivatives (V, m, K), in m and rad where the rows weigh them otherwise."""
        return errors

    @abstractmethod
    def even(self, noise: Noise) -> Noise:
        """Noise that comes from the fit, as weights of the geometry: those that an identification takes."""

    def bears(self, values: Floats) -> bool:
        """Whether an effect that follows loads on the fitted chain has any of these values."""
        return False

    def only(self, rows: Ints) -> Source:
        """The same model on some of the rows."""
        return self.on_rows(self.observations.select(rows))

    def with_loads_at_values(self, values: Floats) -> Source:
        """The same rows with loads on the chain of these values."""
        return self

    def with_load_blur(self, blur: Floats | None) -> Source:
        """The same rows with loads as uncertain as ``blur (n, 2)`` where they change their sign."""
        return self

    def doubt(self, values: Floats) -> Floats:
        """Covariance (V, m, m) of the residuals that the blurred signs leave open."""
        size = self.residual(values).shape[1]
        return np.zeros((len(self.batch), size, size))

    def simulate_measurements(self, rows: Observations, values: Floats) -> Source:
        """Rows measured exactly as the model predicts, in the same way as the real ones."""
        raise ObservationError("Encoders on the links alone plan no poses: measure the tool.")

    @abstractmethod
    def with_effects(self, rows: Observations, effects: Sequence[Effect], fitted: Floats) -> tuple[Source, Floats]:
        """The fitted model on other rows, of the library with these effects only where that saves work; and its values."""

    @abstractmethod
    def to_calibration(self, values: Floats, model: RobotModel, begin: Calibration) -> Calibration:
        """The fitted state as a calibration of ``model``, which holds the effects to keep; values go by name."""

    def tool_measured(self, used: Bools) -> Measurement | None:
        """What was measured of the tool in the visits ``used (V,)``, None where only joints were."""
        return None

    @abstractmethod
    def frames(self, begin: Calibration) -> RobotModel:
        """The model whose base, tool and load chain the fit leaves."""

    @abstractmethod
    def fitted_names(self) -> list[str | None]:
        """Names (P,) of the geometry's parameters; None of those that no version has."""

    def follows(self, begin: Calibration, count: int) -> Mapping[str, Floats]:
        """How constants of a version follow (count,) from what was fitted, by their names."""
        return {}

    def own_zeros(self, G: Floats) -> Floats | None:
        """Columns (R, K) of the geometry ``G (R, P)`` that are the instrument's, None where those are base and tool."""
        return None

    @abstractmethod
    def by_version(
        self, values: Floats, version: Calibration, names: Sequence[str]
    ) -> tuple[Floats, list[str], Floats]:
        """Columns (V, m, K) of a version's parameters, of the ``names`` those that these rows tell, and how far ``values``
        are from the version (K,).
        """

    def with_rotation_before(self, element: int, rotation: Element) -> Source | None:
        """The same rows on a chain with a ``rotation`` before one of its elements; None where no chain is fitted."""
        return None

    def all_columns(self, values: Floats, names: Sequence[str]) -> tuple[Floats, list[str]]:
        """Derivatives (V, m, K) by all parameters of the model among the ``names``, base and tool too."""
        raise ObservationError("Encoders on the links alone predict no place of the tool: measure it.")

    def without_instrument_offsets(self, residual: Floats) -> Floats:
        """Residuals (V, m) as held-out motions are judged: less what belongs to the instrument alone."""
        return residual


COUNTS = 0.25  # of the noise of a coordinate, below which rounding is not worth its weights
AS_LARGE = 0.7  # of what rounding gives, that the fit must leave: less says that the arm was where the readings are
ALIKE = 1e-9  # rad or m: readings nearer than this are one
HELD = 0.5  # share of repeats with another reading, from which their scatter holds the rounding


@dataclass(frozen=True)
class Rounding:
    """``steps (n,)`` of the readings, rad or m; ``by (V, m, n)`` what one sigma of each joint's moves of a visit's numbers.

    ``reading (V,)`` numbers the readings: visits of one share its error.
    """

    steps: Floats
    by: Floats
    reading: Ints

    @staticmethod
    def from_source(source: Source, values: Floats, steps: Floats) -> Rounding:
        """At a fit, by how each joint moves what was measured."""
        rows = source.observations
        seen = ~np.isnan(source.residual(values))
        column = source.joint_columns(values)
        joints = [np.nan_to_num(column(j)) * step / np.sqrt(12.0) for j, step in enumerate(steps)]
        by = np.stack(joints, axis=2) * seen[:, :, None]
        return Rounding(steps, by, number_readings(rows))

    @property
    def covariance(self) -> Floats:
        """Covariance (V, m, m) of a visit's numbers."""
        return np.asarray(self.by @ self.by.transpose(0, 2, 1))

    @property
    def row(self) -> Floats:
        """The same on average (m, m)."""
        return np.asarray(self.covariance.mean(axis=0))

    def alone(self, used: Bools) -> Floats:
        """Covariance (V, m, m) at the visits whose reading no other visit has; zero elsewhere."""
        count = np.bincount(self.reading[used], minlength=int(self.reading.max()) + 1)
        return np.where((count[self.reading] < 2)[:, None, None], self.covariance, 0.0)

    def shared_errors(self, whitener: Floats, used: Bools) -> SharedErrors:
        """What visits of one reading share, whitened by each one's own noise."""
        size = whitener.shape[-1]
        blocks = []
        visits = np.flatnonzero(used)[np.argsort(self.reading[used], kind="stable")]
        for own in np.split(visits, np.flatnonzero(np.diff(self.reading[visits])) + 1):
            if len(own) > 1:
                rows = (own[:, None] * size + np.arange(size)).reshape(-1)
                blocks.append((rows, (whitener[own] @ self.by[own]).reshape(len(rows), -1)))
        return SharedErrors.from_blocks(blocks)


def rounding(source: Source, values: Floats, q: Floats, visits: Visits, noise: Noise) -> tuple[Rounding | None, bool]:
    """Rounding of the readings ``q (N, n)`` where it counts beside the noise, and whether the noise holds it already.

    Where readings are commands that the arm obeyed, the fit leaves less than their rounding would give: none then.
    """
    steps = reading_steps(q, [joint.kind == "prismatic" for joint in source.model.robot.joints])
    if not np.any(steps) or not source.observes_tool or not source.observes_places:
        return None, False
    one = Rounding.from_source(source, values, steps)
    size = coordinate(one, source)
    left = source.residual(values)[:, : source.tool_numbers][:, : noise.lengths]
    if size < COUNTS * noise.coordinate or np.sqrt(np.nanmean(left**2)) < AS_LARGE * size:
        return None, False
    return one, not noise.absolute or (noise.repeats is not None and in_repeats(visits))


def number_readings(rows: Observations) -> Ints:
    """Number the readings (N,): rows of equal joint vectors share one."""
    return numbered_rows(np.round(rows.q / ALIKE).astype(np.int64))


def in_repeats(visits: Visits) -> bool:
    """Whether repeats were mostly rounded anew, so that their scatter holds the rounding already."""
    cells, readings = visits.condition, number_readings(visits.observations)
    pairs = len(cells) - len(np.unique(cells))
    return pairs > 0 and len(np.unique(np.stack([cells, readings]), axis=1).T) - len(np.unique(cells)) > HELD * pairs


def coordinate(one: Rounding, source: Source) -> float:
    """Rms of a coordinate of the tool by rounding, m."""
    lengths = 3 if source.observations.rotation is not None else source.tool_numbers
    return float(np.sqrt(np.mean(np.diagonal(one.covariance, axis1=1, axis2=2)[:, :lengths])))


def rounding_document(one: Rounding | None, source: Source) -> dict[str, Any]:
    """Step of each joint (deg, or mm of a prismatic one; 0: none), and the rms of a coordinate of the tool by rounding."""
    if one is None:
        return {"rounding_steps": None, "rounding_mm": None}
    slides = [joint.kind == "prismatic" for joint in source.model.robot.joints]
    steps = [s * (MM if slid else DEG) for s, slid in zip(one.steps.tolist(), slides, strict=True)]
    return {"rounding_steps": steps, "rounding_mm": mm(coordinate(one, source))}
