"""Link-side encoders in a search: what happens between motor and link, joint by joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from kilter_core.effects import Batch, Effect
from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.search.sources.source import Linear, Source
from kilter_core.measurement.kind import Unit
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.observations.groups import segments
from kilter_core.parameters import Prior
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class LinkSource(Source):
    """Link-side encoders: measured minus read joint angle, with a constant offset per joint as the only geometry.

    Values are the offsets (n,) of each motion in turn, then the starting effects' and the library's parameters.
    ``segment (V,)`` numbers the motions, since encoders are referenced anew between them. ``moving (n,)`` marks joints
    whose encoder moves; a measured torque, where there is one, replaces the computed load about the axis.
    """

    unit: ClassVar[Unit] = "rad"
    observes_tool: ClassVar[bool] = False

    model: RobotModel
    rows: Observations
    moving: Bools
    segment: Ints
    n_library: int
    batch: Batch
    prior: Prior
    library_sigma: Floats

    @staticmethod
    def from_model(model: RobotModel, observations: Observations, n_library: int) -> LinkSource:
        """Wrap a model and its rows."""
        assert observations.link_q is not None
        started = model.parameters[model.n_geometric : len(model.names) - n_library]
        library = model.parameters[len(model.names) - n_library :]
        segment = segments(observations)
        n = model.robot.n_joints * (int(segment.max()) + 1)
        return LinkSource(
            model,
            observations,
            np.ptp(np.nan_to_num(observations.link_q), axis=0) > 0.0,
            segment,
            n_library,
            with_torque(model.batch(observations), observations),
            Prior(np.zeros(n), np.full(n, 0.1)).append_prior(Prior.from_parameters(started)),
            np.array([p.prior_sigma for p in library]),
        )

    @property
    def observations(self) -> Observations:
        """The rows."""
        return self.rows

    @property
    def tool_numbers(self) -> int:
        """One of every encoder that moves."""
        return int(self.moving.sum())

    @property
    def live(self) -> Bools:
        """Joints whose encoder moves."""
        return self.moving

    def on_rows(self, observations: Observations) -> LinkSource:
        """The same model and joints on other rows."""
        batch = with_torque(self.model.batch(observations), observations)
        segment = np.minimum(segments(observations), self.segment.max())
        return replace(self, rows=observations, batch=batch, segment=segment)

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
        assert self.rows.link_q is not None
        started = len(values) - len(self.model.names) + self.model.n_geometric
        effects = np.concatenate([np.zeros(self.model.n_geometric), values[started:]])
        offsets = values[:started].reshape(-1, self.model.robot.n_joints)[self.segment]
        r = self.rows.link_q - self.model.link_angles(self.batch, effects) - offsets
        return r[:, self.moving]

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives."""
        n = self.model.robot.n_joints
        rows, start = len(self.rows), len(values) - len(self.model.names) + self.model.n_geometric
        D = np.zeros((rows, n, len(values)))
        for j in range(n):
            D[np.arange(rows), j, n * self.segment + j] = 1.0
        for effect in self.model.effects:
            count = len(effect.parameters(self.model.robot))
            for d in effect.local(batch or self.batch, values[start : start + count]).derivatives:
                if d.dq is not None:
                    D[:, d.joint, start + d.parameter] += d.dq
            start += count
        D = D[:, self.moving]
        split = len(values) - self.n_library
        wanted = D[:, :, split:] if only is None else D[:, :, split:][:, :, list(only)]
        return Linear(self.residual(values), D[:, :, :split], wanted)

    def geometry(self, values: Floats) -> Floats:
        """Offsets and the starting effects."""
        return values[: len(values) - self.n_library]

    def apply_step(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Take a step."""
        return np.concatenate([self.geometry(values) + geometry, library])

    def joint_columns(self, values: Floats) -> Callable[[int], Floats]:
        """A joint moves its own encoder and no other."""
        live = np.flatnonzero(self.moving)
        return lambda joint: np.tile((live == joint) * 1.0, (len(self.rows), 1))

    def residuals_by_joint(self, residual: Floats) -> list[Floats]:
        """Its own encoder's of each joint, nothing of one without."""
        place = np.cumsum(self.moving) - 1
        return [residual[:, k : k + 1] if seen else residual[:, :0] for k, seen in zip(place, self.moving, strict=True)]

    def rms(self, errors: Floats) -> float:
        """Rms angle (rad) of a joint."""
        return float(np.sqrt(np.mean(errors**2)))

    def even(self, noise: Noise) -> Noise:
        """As it is: each encoder has its own scatter."""
        return noise

    def with_effects(self, rows: Observations, effects: Sequence[Effect], fitted: Floats) -> tuple[LinkSource, Floats]:
        """The fitted model on other rows."""
        return self.on_rows(rows), fitted

    def to_calibration(self, values: Floats, model: RobotModel, begin: Calibration) -> Calibration:
        """The fitted state as a calibration of ``model``, which holds the effects to keep; values go by name.

        Joint data say nothing of the chain, the base or the tool: those stay as ``begin`` has them, with its wanted frames.
        """
        offsets = values[: self.n_offsets].reshape(-1, self.model.robot.n_joints).mean(axis=0)
        known = dict(zip(begin.names, begin.values, strict=True))
        known |= dict(zip(self.model.names[self.model.n_geometric :], values[self.n_offsets :], strict=True))
        known |= {
            name: model.parameter(name).value + ratio * float(offsets[j]) for name, (j, ratio) in zeros(begin).items()
        }
        return replace(begin, model=model, values=np.array([known.get(p.name, p.value) for p in model.parameters]))

    def frames(self, begin: Calibration) -> RobotModel:
        """Those the search began with."""
        return begin.model

    def fitted_names(self) -> list[str | None]:
        """Offsets have none; then the effects of the start."""
        model = self.model
        return [*[None] * self.n_offsets, *model.names[model.n_geometric : len(model.names) - self.n_library]]

    def follows(self, begin: Calibration, count: int) -> Mapping[str, Floats]:
        """How each joint's zero follows from the offsets of its motions: their mean, by the joint's ratio."""
        n = self.model.robot.n_joints
        out = {}
        for name, (joint, ratio) in zeros(begin).items():
            row = np.zeros(count)
            row[joint : self.n_offsets : n] = ratio * n / self.n_offsets
            out[name] = row
        return out

    def own_zeros(self, G: Floats) -> Floats | None:
        """Columns of the encoder offsets of the motions."""
        return G[:, : self.n_offsets]

    def by_version(
        self, values: Floats, version: Calibration, names: Sequence[str]
    ) -> tuple[Floats, list[str], Floats]:
        """Columns of the effects of the start."""
        own = [str(name) for name in self.fitted_names()[self.n_offsets :]]
        at = dict(zip(version.names, version.values, strict=True))
        moved = self.geometry(values)[self.n_offsets :] - np.array([at[name] for name in own])
        return self.linear(values).G[:, :, self.n_offsets :], own, moved

    def without_instrument_offsets(self, residual: Floats) -> Floats:
        """Residuals of joints less their mean in each motion: encoders are referenced anew, as a tool registered."""
        motion = segments(self.rows)
        count = np.bincount(motion)
        mean = np.stack([np.bincount(motion, c) for c in residual.T], axis=1) / count[:, None]
        return np.asarray(residual - mean[motion])


def with_torque(batch: Batch, observations: Observations) -> Batch:
    """Replace the load about each axis by the measured torque: wrong masses blur names, a torque does not.

    The motor holds against the load, so the load is the torque's negative; only constant factors matter to a name.
    """
    if observations.tau is None:
        return batch
    wrench = batch.wrench.copy()
    wrench[:, :, 5] = -observations.tau
    return replace(batch, axial=-observations.tau, wrench=wrench, centre_wrench=None, centre_axial=None)


def zeros(begin: Calibration) -> dict[str, tuple[int, float]]:
    """Joint and ratio of the constants that hold the joints' zeros, by name, where link-side encoders may set them.

    They may while the chain is nominal. Zeros that an instrument found of the tool are worth more: encoders are
    referenced anew from motion to motion.
    """
    n, chain = begin.model.n_geometric, begin.robot.chain
    if not np.array_equal(begin.values[6 : n - 6], begin.model.values0()[6 : n - 6]):
        return {}
    elements = ((j, chain.elements[k]) for j, k in enumerate(chain.primary))
    return {e.name: (j, e.ratio) for j, e in elements if e.name is not None}
