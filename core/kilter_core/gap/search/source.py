"""What a search measures: the tool (points, poses, markers) or the joints themselves; residuals and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from kilter_core.effects import Batch
from kilter_core.gap.noise.motion import segments
from kilter_core.measurement import Measurement, Residual
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

MOST_NUMBERS = 400_000  # rows times columns whose derivatives are made at a time: they pass through arrays of 20 MB


@dataclass(frozen=True)
class Linear:
    """Residuals ``r (V, m)``; derivatives of the prediction by geometry ``G (V, m, P)`` and library ``W (V, m, Q)``."""

    r: Floats
    G: Floats
    W: Floats


class Source(Protocol):
    """A model over the whole library and the rows it is compared with."""

    @property
    def prior_mean(self) -> Floats:
        """Prior mean (P,) of the geometry."""

    @property
    def prior_sigma(self) -> Floats:
        """Prior standard deviation (P,) of the geometry."""

    @property
    def library_sigma(self) -> Floats:
        """Prior standard deviation (Q,) of the library."""

    @property
    def batch(self) -> Batch:
        """Conditions of the rows."""

    @property
    def soft(self) -> Bools:
        """Which of the geometry (P,) are load errors: known about as well by their priors as by the data."""

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m), NaN where nothing was seen."""

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives; ``batch`` replaces the conditions the effects see, not the rows.

        ``only`` gives the library columns wanted, in order; all when None.
        """

    def geometry(self, values: Floats) -> Floats:
        """Values (P,) of the geometric parameters."""

    def moved(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Values with the geometry moved by ``geometry (P,)`` and the library set to ``library (Q,)``."""

    def library(self, values: Floats) -> Floats:
        """Values (Q,) of the library's parameters."""


@dataclass(frozen=True)
class ToolSource:
    """Tool measurements against a :class:`RobotModel` whose last ``n_library`` parameters are the library's."""

    model: RobotModel
    measurement: Measurement
    free: Ints  # geometric parameters and those of the starting model's effects, ascending
    n_library: int
    batch: Batch
    prior_mean: Floats
    prior_sigma: Floats
    library_sigma: Floats

    @staticmethod
    def of(model: RobotModel, measurement: Measurement, free: Ints, n_library: int) -> ToolSource:
        """Wrap a model and its rows."""
        chosen = [model.parameters[k] for k in free]
        library = model.parameters[len(model.names) - n_library :]
        return ToolSource(
            model, measurement, free, n_library, model.batch(measurement.observations),
            np.array([p.value for p in chosen]), np.array([p.prior_sigma for p in chosen]),
            np.array([p.prior_sigma for p in library]),
        )  # fmt: skip

    @cached_property
    def soft(self) -> Bools:
        """Which of the free parameters are load errors."""
        out = np.zeros(len(self.model.names), dtype=bool)
        for effect, where in zip(self.model.effects, self.model.effect_slices().values(), strict=True):
            out[where] = effect.nuisance
        return out[self.free]

    def on(self, measurement: Measurement) -> ToolSource:
        """The same model on other rows."""
        batch = replace(self.model.batch(measurement.observations), blur=self.batch.blur)
        return replace(self, measurement=measurement, batch=batch)

    def only(self, rows: Ints) -> ToolSource:
        """The same model on some of the rows."""
        m = self.measurement
        return self if len(rows) == len(self.batch) else self.on(replace(m, observations=m.observations.select(rows)))

    def bears(self, values: Floats) -> bool:
        """Whether an effect that follows loads has any of these values."""
        return any(np.any(values[where]) for e, where in self.model.placed if "moments" in e.needs and not e.nuisance)

    def reloaded(self, values: Floats) -> ToolSource:
        """The same rows with loads on the chain of these values."""
        return replace(self, model=self.model.loads_at(values)).on(self.measurement)

    def blurred(self, blur: Floats | None) -> ToolSource:
        """The same rows with loads as uncertain as ``blur (n, 2)`` where they change their sign."""
        return replace(self, batch=replace(self.batch, blur=blur))

    def doubt(self, values: Floats) -> Floats:
        """Covariance (V, m, m) of the residuals that the blurred signs leave open."""
        prediction, J = self.model.doubts(self.batch, values)
        if not J.shape[2]:
            size = self.residual(values).shape[1]
            return np.zeros((len(J), size, size))
        residual = self.measurement.residual(prediction, J)
        D = _derivatives(residual, J.shape[2])
        return np.asarray(np.einsum("vik,vjk->vij", D, D))

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m)."""
        return _stacked(self.measurement.residual(self.model.predict(self.batch, values)))

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives."""
        wanted = np.arange(self.n_library) if only is None else np.array(only, dtype=np.int64)
        order = np.argsort(wanted)
        place = slice(None) if np.array_equal(order, np.arange(len(order))) else order
        start = len(self.model.names) - self.n_library
        columns = np.concatenate([self.free, start + wanted[order]])
        count = len(self.free)
        parts = []
        for rows in self._parts(len(columns)):
            r, D = self._derived(batch or self.batch, rows, values, columns)
            parts.append(r)
            if rows.start == 0:
                G = np.empty((len(self.batch), r.shape[1], count))
                W = np.empty((len(self.batch), r.shape[1], len(wanted)))
            G[rows], W[rows][:, :, place] = D[:, :, :count], D[:, :, count:]
        return Linear(np.concatenate(parts), G, W)

    def _parts(self, columns: int) -> list[slice]:
        """Slices of the rows, so large that what is in the making of their derivatives stays small."""
        size = max(1, MOST_NUMBERS // max(1, columns))
        return [slice(k, k + size) for k in range(0, max(1, len(self.batch)), size)]

    def _derived(self, batch: Batch, rows: slice, values: Floats, columns: Ints) -> tuple[Floats, Floats]:
        """Residuals of these rows and their derivatives by the parameters ``columns``."""
        whole = rows.start == 0 and rows.stop >= len(batch)
        seen = self.measurement.observations if whole else self.measurement.observations.select(rows)
        measurement = replace(self.measurement, observations=seen)
        turns = measurement.sees_orientation
        prediction, J = self.model.jacobian(batch if whole else batch.part(rows), values, columns, turns)
        residual = measurement.residual(prediction, J)
        D = _derivatives(residual, len(columns))
        r = _stacked(residual)
        D[np.isnan(r)] = 0.0
        return r, D

    def geometry(self, values: Floats) -> Floats:
        """Values of the free geometric parameters."""
        return values[self.free]

    def moved(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Take a step."""
        out = values.copy()
        out[self.free] += geometry
        out[len(out) - self.n_library :] = library
        return out

    def library(self, values: Floats) -> Floats:
        """Values of the library's parameters."""
        return values[len(values) - self.n_library :]


@dataclass(frozen=True)
class LinkSource:
    """Link-side encoders: measured minus read joint angle, with a constant offset per joint as the only geometry.

    Values are the offsets (n,) of each motion in turn, then the starting effects' and the library's parameters.
    ``segment (V,)`` numbers the motions, since encoders are referenced anew between them. ``live (n,)`` marks joints
    whose encoder moves; a measured torque, where there is one, replaces the computed load about the axis.
    """

    model: RobotModel
    observations: Observations
    live: Bools
    segment: Ints
    n_library: int
    batch: Batch
    prior_mean: Floats
    prior_sigma: Floats
    library_sigma: Floats

    @staticmethod
    def of(model: RobotModel, observations: Observations, n_library: int) -> LinkSource:
        """Wrap a model and its rows."""
        assert observations.link_q is not None
        started = model.parameters[model.n_geometric : len(model.names) - n_library]
        library = model.parameters[len(model.names) - n_library :]
        segment = segments(observations)
        n = model.robot.n_joints * (int(segment.max()) + 1)
        return LinkSource(
            model, observations, np.ptp(np.nan_to_num(observations.link_q), axis=0) > 0.0, segment, n_library,
            with_torque(model.batch(observations), observations),
            np.concatenate([np.zeros(n), [p.value for p in started]]),
            np.concatenate([np.full(n, 0.1), [p.prior_sigma for p in started]]),
            np.array([p.prior_sigma for p in library]),
        )  # fmt: skip

    def on(self, observations: Observations) -> LinkSource:
        """The same model and joints on other rows."""
        batch = with_torque(self.model.batch(observations), observations)
        segment = np.minimum(segments(observations), self.segment.max())
        return replace(self, observations=observations, batch=batch, segment=segment)

    @property
    def soft(self) -> Bools:
        """No load errors: a torque is measured, or encoders say too little of masses."""
        return np.zeros(len(self.prior_mean), dtype=bool)

    @property
    def n_offsets(self) -> int:
        """Number of offsets: joints times motions."""
        return self.model.robot.n_joints * (int(self.segment.max()) + 1)

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, live joints)."""
        assert self.observations.link_q is not None
        started = len(values) - len(self.model.names) + self.model.n_geometric
        effects = np.concatenate([np.zeros(self.model.n_geometric), values[started:]])
        offsets = values[:started].reshape(-1, self.model.robot.n_joints)[self.segment]
        r = self.observations.link_q - self.model.link_angles(self.batch, effects) - offsets
        return r[:, self.live]

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives."""
        n = self.model.robot.n_joints
        rows, start = len(self.observations), len(values) - len(self.model.names) + self.model.n_geometric
        D = np.zeros((rows, n, len(values)))
        for j in range(n):
            D[np.arange(rows), j, n * self.segment + j] = 1.0
        for effect in self.model.effects:
            count = len(effect.parameters(self.model.robot))
            for d in effect.local(batch or self.batch, values[start : start + count]).derivatives:
                if d.dq is not None:
                    D[:, d.joint, start + d.parameter] += d.dq
            start += count
        D = D[:, self.live]
        split = len(values) - self.n_library
        wanted = D[:, :, split:] if only is None else D[:, :, split:][:, :, list(only)]
        return Linear(self.residual(values), D[:, :, :split], wanted)

    def geometry(self, values: Floats) -> Floats:
        """Offsets and the starting effects."""
        return values[: len(values) - self.n_library]

    def moved(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Take a step."""
        return np.concatenate([self.geometry(values) + geometry, library])

    def library(self, values: Floats) -> Floats:
        """Values of the library's parameters."""
        return values[len(values) - self.n_library :]


def with_torque(batch: Batch, observations: Observations) -> Batch:
    """Replace the load about each axis by the measured torque: wrong masses blur names, a torque does not.

    The motor holds against the load, so the load is the torque's negative; only constant factors matter to a name.
    """
    if observations.tau is None:
        return batch
    wrench = batch.wrench.copy()
    wrench[:, :, 5] = -observations.tau
    return replace(batch, axial=-observations.tau, wrench=wrench)


def calibrated(source: Source, values: Floats, model: RobotModel, begin: Calibration) -> Calibration:
    """The fitted state as a calibration of ``model``, which holds the effects to keep; values go by name.

    Joint data say nothing of the chain, the base or the tool: those stay as ``begin`` has them, with its wanted frames.
    """
    if isinstance(source, ToolSource):
        known = dict(zip(source.model.names, values, strict=True))
        made = np.array([known.get(p.name, p.value) for p in model.parameters])
        return Calibration(*model.absorb_frame_increments(made), source.measurement.marker_points)
    assert isinstance(source, LinkSource)
    offsets = values[: source.n_offsets].reshape(-1, source.model.robot.n_joints).mean(axis=0)
    known = dict(zip(begin.names, begin.values, strict=True))
    known |= dict(zip(source.model.names[source.model.n_geometric :], values[source.n_offsets :], strict=True))
    known |= {
        name: model.parameter(name).value + ratio * float(offsets[j]) for name, (j, ratio) in zeros(begin).items()
    }
    return replace(begin, model=model, values=np.array([known.get(p.name, p.value) for p in model.parameters]))


def zeros(begin: Calibration) -> dict[str, tuple[int, float]]:
    """Joint and ratio of the constants that hold the joints' zeros, by name, where link-side encoders may set them.

    They may while the chain is as drawn. Zeros that an instrument found of the tool are worth more: encoders are
    referenced anew from motion to motion.
    """
    n, chain = begin.model.n_geometric, begin.robot.chain
    if not np.array_equal(begin.values[6 : n - 6], begin.model.values0()[6 : n - 6]):
        return {}
    elements = ((j, chain.elements[k]) for j, k in enumerate(chain.primary))
    return {e.name: (j, e.ratio) for j, e in elements if e.name is not None}


def _derivatives(residual: Residual, columns: int) -> Floats:
    """Derivatives (V, m, columns) of the prediction, points first."""
    assert residual.d_points is not None
    points = residual.d_points.reshape(len(residual.points), -1, columns)
    return points if residual.d_turns is None else np.concatenate([points, residual.d_turns], axis=1)


def _stacked(residual: Residual) -> Floats:
    points = residual.points.reshape(len(residual.points), -1)
    return points if residual.turns is None else np.concatenate([points, residual.turns], axis=1)
