"""Tool measurements in a search: points, poses and markers against the model over the whole library."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.arm.chain import Chain, Element
from kilter_core.effects import Batch, Effect
from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.search.sources.source import Linear, Source
from kilter_core.identify.fit.problem import MOST_NUMBERS, linearised_residual
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.model.prediction import ABOUT, TURNED
from kilter_core.observations import Observations
from kilter_core.parameters import Prior
from kilter_core.types import Bools, Floats, Ints

CHUNK = 20_000  # rows whose residuals are made at a time


@dataclass(frozen=True)
class ToolSource(Source):
    """Tool measurements against a :class:`RobotModel` whose last ``n_library`` parameters are the library's."""

    model: RobotModel
    measurement: Measurement
    free: Ints  # geometric parameters and those of the starting model's effects, ascending
    n_library: int
    batch: Batch
    prior: Prior
    library_sigma: Floats

    @staticmethod
    def from_model(model: RobotModel, measurement: Measurement, free: Ints, n_library: int) -> ToolSource:
        """Wrap a model and its rows."""
        chosen = [model.parameters[k] for k in free]
        library = model.parameters[len(model.names) - n_library :]
        return ToolSource(
            model,
            measurement,
            free,
            n_library,
            model.batch(measurement.observations),
            model.prior_of(chosen),
            np.array([p.prior_sigma for p in library]),
        )

    @property
    def soft(self) -> Bools:
        """Which of the free parameters are load errors, or told by other arms of the type."""
        prior = self.model.of_type
        if prior is None:
            return self._loads
        return self._loads | np.isin(np.array(self.model.names)[self.free], prior.restrict_to_identifiable().names)

    @property
    def of_loads(self) -> Bools:
        """Which of the free parameters are load errors."""
        return self._loads

    @cached_property
    def _loads(self) -> Bools:
        out = np.zeros(len(self.model.names), dtype=bool)
        for effect, where in zip(self.model.effects, self.model.effect_slices().values(), strict=True):
            out[where] = effect.nuisance
        return out[self.free]

    @property
    def observations(self) -> Observations:
        """The rows."""
        return self.measurement.observations

    def on_rows(self, rows: Observations) -> ToolSource:
        """The same model on other rows."""
        return self.with_measurement(
            Measurement.from_observations(with_columns(rows, self.observations), self.measurement.marker_points)
        )

    def with_measurement(self, measurement: Measurement) -> ToolSource:
        """The same model on other rows."""
        batch = replace(self.model.batch(measurement.observations), blur=self.batch.blur)
        return replace(self, measurement=measurement, batch=batch)

    @cached_property
    def tool_numbers(self) -> int:
        """Three of a point, six of a pose, three of every marker."""
        shape = self.measurement.marker_points
        return 3 * len(shape) if shape is not None else self.measurement.equations_per_pose

    @cached_property
    def missing(self) -> float:
        """Numbers beside the tool that a visit lacks, or that only set the zero of a sensor."""
        beside = self.measurement.kinds[1:]
        columns = sum(self.beside_numbers)
        return columns - sum(kind.scalars() for kind in beside) / max(len(self.batch), 1)

    @cached_property
    def beside_numbers(self) -> list[int]:
        """Numbers of a visit of each kind beside the tool."""
        n = self.observations.q.shape[1]
        tilt = self.observations.tilt
        given = ((self.observations.link_q, n), (tilt, 0 if tilt is None else 3 * tilt.shape[1]))
        return [count for column, count in given if column is not None]

    @cached_property
    def sensor_reading_mask(self) -> Bools:
        """Which of those numbers (V, k) were read."""
        numbers = self.residual(self.model.values0())
        return ~np.isnan(numbers[:, numbers.shape[1] - sum(self.beside_numbers) :])

    def only(self, rows: Ints) -> ToolSource:
        """The same model on some of the rows."""
        m = self.measurement
        return (
            self
            if len(rows) == len(self.batch)
            else self.with_measurement(replace(m, observations=m.observations.select(rows)))
        )

    def bears(self, values: Floats) -> bool:
        """Whether an effect that follows loads has any of these values."""
        return any(
            np.any(values[where])
            for e, where in self.model.effects_with_slices
            if "moments" in e.needs and not e.nuisance
        )

    def with_loads_at_values(self, values: Floats) -> ToolSource:
        """The same rows with loads on the chain of these values."""
        return replace(self, model=self.model.with_loads_at_values(values)).with_measurement(self.measurement)

    def with_load_blur(self, blur: Floats | None) -> ToolSource:
        """The same rows with loads as uncertain as ``blur (n, 2)`` where they change their sign."""
        return replace(self, batch=replace(self.batch, blur=blur))

    def doubt(self, values: Floats) -> Floats:
        """Covariance (V, m, m) of the residuals that the blurred signs leave open."""
        prediction, J = self.model.doubts(self.batch, values, self.measurement.reads_joints)
        if not J.shape[2]:
            size = self.residual(values).shape[1]
            return np.zeros((len(J), size, size))
        residual = self.measurement.residual(prediction, J)
        D = residual.derivatives(J.shape[2])
        return np.asarray(np.einsum("vik,vjk->vij", D, D))

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m)."""
        return self.measurement.residual(self.model.predict(self.batch, values)).residuals_by_row

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives."""
        wanted = np.arange(self.n_library) if only is None else np.array(only, dtype=np.int64)
        order = np.argsort(wanted)
        place = slice(None) if np.array_equal(order, np.arange(len(order))) else order
        start = len(self.model.names) - self.n_library
        columns = np.concatenate([self.free, start + wanted[order]])
        count = len(self.free)
        parts = []
        for rows in self._row_slices(len(columns)):
            r, D = self._residuals_and_derivatives(batch or self.batch, rows, values, columns)
            parts.append(r)
            if rows.start == 0:
                G = np.empty((len(self.batch), r.shape[1], count))
                W = np.empty((len(self.batch), r.shape[1], len(wanted)))
            G[rows], W[rows][:, :, place] = D[:, :, :count], D[:, :, count:]
        return Linear(np.concatenate(parts), G, W)

    def _row_slices(self, columns: int) -> list[slice]:
        """Slices of the rows, so large that what is in the making of their derivatives stays small."""
        if len(self.measurement.kinds) > 1:  # the zeros of sensors are those of all rows together
            return [slice(0, max(1, len(self.batch)))]
        size = max(1, MOST_NUMBERS // max(1, columns))
        return [slice(k, k + size) for k in range(0, max(1, len(self.batch)), size)]

    def _residuals_and_derivatives(
        self, batch: Batch, rows: slice, values: Floats, columns: Ints
    ) -> tuple[Floats, Floats]:
        """Residuals of these rows and their derivatives by the parameters ``columns``."""
        whole = rows.start == 0 and rows.stop >= len(batch)
        seen = self.measurement.observations if whole else self.measurement.observations.select(rows)
        measurement = replace(self.measurement, observations=seen)
        part = batch if whole else batch.select_rows(rows)
        residual = linearised_residual(self.model, measurement, part, values, columns)
        D = residual.derivatives(len(columns))
        r = residual.residuals_by_row
        D[np.isnan(r)] = 0.0
        return r, D

    def geometry(self, values: Floats) -> Floats:
        """Values of the free geometric parameters."""
        return values[self.free]

    def apply_step(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Take a step."""
        out = values.copy()
        out[self.free] += geometry
        out[len(out) - self.n_library :] = library
        return out

    def residual_of_rows(self, values: Floats, rows: Observations, tick: Callable[[], None]) -> Floats:
        """Residuals (N, m) of single rows, in chunks; ``tick`` is called after each."""
        parts = []
        size = CHUNK if len(self.measurement.kinds) == 1 else len(rows)
        for k in range(0, len(rows), size):
            parts.append(self.on_rows(rows.select(slice(k, k + size))).residual(values))
            tick()
        return np.concatenate(parts)

    def without_geometry(self) -> ToolSource:
        """The same without derivatives by the geometry."""
        return replace(self, free=np.zeros(0, dtype=np.int64))

    def joint_columns(self, values: Floats) -> Callable[[int], Floats]:
        """Derivative (V, m) of what was measured by each joint's motion."""
        prediction, JQ = self.model.joint_jacobian(self.batch, values, self.measurement.reads_joints)

        def column(joint: int) -> Floats:
            return self.measurement.residual(prediction, JQ[:, :, [joint]]).derivatives(1)[:, :, 0]

        return column

    def residuals_by_joint(self, residual: Floats) -> list[Floats]:
        """All of them: any joint moves the tool."""
        return [residual] * self.model.robot.n_joints

    def rms(self, errors: Floats) -> float:
        """Rms length (m) in space, of the points of markers together."""
        e = errors[:, : self.tool_numbers]
        points = e[:, : 3 * max(1, e.shape[1] // 3)] if e.shape[1] % 3 == 0 and e.shape[1] != 6 else e[:, :3]
        return float(np.sqrt(np.mean(np.sum(points**2, axis=1)) / max(1, points.shape[1] // 3)))

    def in_space(self, errors: Floats) -> Floats:
        """Errors (V, m), or derivatives (V, m, K), with the weights of poses taken off: what a view knows well is weighed
        tenfold.
        """
        weight = self.observations.pose_weight
        if weight is None:
            return errors
        out = errors.reshape(*errors.shape[:2], -1).copy()
        out[:, :6] = np.linalg.solve(weight, out[:, :6])
        return out.reshape(errors.shape)

    def even(self, noise: Noise) -> Noise:
        """Equal weights of all coordinates."""
        return noise.even()

    def simulate_measurements(self, rows: Observations, values: Floats) -> ToolSource:
        """Rows measured exactly as the model predicts, of the same kind as the real ones."""
        prediction = self.model.predict(rows, values)
        rows = _read(rows, self.observations, prediction)
        shape = self.measurement.marker_points
        if shape is not None:
            markers = prediction.position[:, None, :] + np.einsum("nij,mj->nmi", prediction.rotation, shape)
            return self.with_measurement(Measurement(replace(rows, markers=markers), shape))
        rotation = None if self.observations.rotation is None else prediction.rotation
        weight = self.observations.pose_weight
        if weight is not None and rows.pose_weight is None:  # what has no view yet is known as views are on average
            rows = replace(rows, pose_weight=np.broadcast_to(weight.mean(axis=0), (len(rows), 6, 6)))
        return self.with_measurement(Measurement(replace(rows, position=prediction.position, rotation=rotation)))

    def with_effects(self, rows: Observations, effects: Sequence[Effect], fitted: Floats) -> tuple[ToolSource, Floats]:
        """The fitted model on other rows: only the effects in use, so that only their columns are needed."""
        started = len(self.model.effects) - self._library_effects()
        model = replace(self.model, effects=(*self.model.effects[:started], *effects))
        known = dict(zip(self.model.names, fitted, strict=True))
        values = np.array([known[p.name] for p in model.parameters])
        measurement = Measurement.from_observations(
            with_columns(rows, self.observations), self.measurement.marker_points
        )
        return ToolSource.from_model(model, measurement, self.free, 0).with_load_blur(self.batch.blur), values

    def to_calibration(self, values: Floats, model: RobotModel, begin: Calibration) -> Calibration:
        """The fitted state as a calibration of ``model``, which holds the effects to keep; values go by name."""
        known = dict(zip(self.model.names, values, strict=True))
        made = np.array([known.get(p.name, p.value) for p in model.parameters])
        framed, made = model.absorb_frame_increments(made)
        return Calibration(framed.hanging_as(made), made, self.measurement.marker_points)

    def tool_measured(self, used: Bools) -> Measurement | None:
        """What was measured of the tool in the visits used."""
        return Measurement(self.observations.select(used), self.measurement.marker_points)

    def frames(self, begin: Calibration) -> RobotModel:
        """The model that was fitted."""
        return self.model

    def fitted_names(self) -> list[str | None]:
        """Names of the free parameters."""
        return [self.model.names[k] for k in self.free]

    def by_version(
        self, values: Floats, version: Calibration, names: Sequence[str]
    ) -> tuple[Floats, list[str], Floats]:
        """Columns of all named parameters but base and tool; the values are the version's."""
        n = self.model.n_geometric
        frames = {*range(6), *range(n - 6, n)}
        index = [k for k, name in enumerate(self.model.names) if name in names and k not in frames]
        linear = replace(self, free=np.array(index, dtype=np.int64)).linear(values, None, [])
        return linear.G, [self.model.names[k] for k in index], np.zeros(len(index))

    def all_columns(self, values: Floats, names: Sequence[str]) -> tuple[Floats, list[str]]:
        """Derivatives (V, m, K) by all parameters of the model among the names."""
        index = [k for k, name in enumerate(self.model.names) if name in names]
        linear = replace(self, free=np.array(index, dtype=np.int64)).linear(values, None, [])
        return linear.G, [self.model.names[k] for k in index]

    def with_rotation_before(self, element: int, rotation: Element) -> ToolSource:
        """The same rows on a chain with a ``rotation`` before one of its elements."""
        chain = self.model.robot.chain
        elements = (*chain.elements[:element], rotation, *chain.elements[element:])
        robot = replace(self.model.robot, chain=Chain(elements, chain.n_joints))
        return replace(self, model=replace(self.model, robot=robot))

    def _library_effects(self) -> int:
        left, count = self.n_library, 0
        for effect in reversed(self.model.effects):
            if left <= 0:
                break
            left -= len(effect.parameters(self.model.robot))
            count += 1
        return count


def with_columns(rows: Observations, like: Observations) -> Observations:
    """Rows with the columns beside the tool that others have, empty where they have none, and no more of them."""
    n = rows.q.shape[1]
    if like.link_q is None:
        rows = replace(rows, link_q=None)
    elif rows.link_q is None:
        rows = replace(rows, link_q=np.full((len(rows), n), np.nan))
    if like.tilt is None:
        return replace(rows, tilt=None)
    own = np.full((len(rows), *like.tilt.shape[1:]), np.nan)
    if rows.tilt is not None:
        places = min(rows.tilt.shape[1], own.shape[1])
        own[:, :places] = rows.tilt[:, :places]
    return replace(rows, tilt=own)


def _read(rows: Observations, like: Observations, prediction: Prediction) -> Observations:
    """Rows with what the sensors beside the tool would read where others were read."""
    n = rows.q.shape[1]
    if like.link_q is not None:
        turned = rows.q + prediction.joints[:, :n, ABOUT]
        rows = replace(rows, link_q=np.where(np.isnan(like.link_q).all(axis=0), np.nan, turned))
    if like.tilt is not None:
        turned = prediction.joints[:, : like.tilt.shape[1], TURNED]
        rows = replace(rows, tilt=np.where(np.isnan(like.tilt).all(axis=0), np.nan, turned))
    return rows
