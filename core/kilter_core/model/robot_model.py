"""The robot model: a chain plus an ordered list of effects; poses, exact Jacobian, and what each effect contributes."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from kilter_core.arm.chain import FRAME_AXES, Chain, Element, frame_parameters, increment
from kilter_core.arm.kernels import kinematics
from kilter_core.arm.load_slopes import LoadSlopes, payload_sensitivity
from kilter_core.arm.load_wrenches import (
    HANGING_ROUNDS,
    SIDED_ROUNDS,
    Deflection,
    LoadChain,
    Loads,
    axial_loads,
    row_load_wrenches,
)
from kilter_core.arm.robot import Robot
from kilter_core.effects import Batch, Effect
from kilter_core.errors import ObservationError
from kilter_core.model.prediction import (
    NOTHING,
    TOOL_ROWS,
    Prediction,
    Reader,
    ToolColumns,
    Total,
    find_instrument,
    joint_rows,
    own_turns,
    rotation_derivatives,
)
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior, Parameter, Prior, indices, refuse_collisions
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Program:
    """The model's elements (base increments, chain, tool increments) as kernel arrays, parameters aside."""

    axis: Ints
    joint: Ints
    ratio: Floats
    value: Floats
    slot: Ints
    tool_at: int
    element_of: Ints  # element of each geometric parameter


def model_program(chain: Chain) -> Program:
    """Kernel arrays of a chain between base and tool increments."""
    frame = [Element(axis) for axis, _ in FRAME_AXES]
    elements = [*frame, *chain.elements, *frame]
    slot = np.full(len(elements), -1, dtype=np.int64)
    for j, k in enumerate(chain.primary):
        slot[6 + k] = j
    slot[5], slot[-1] = chain.n_joints, chain.n_joints + 1
    named = [6 + k for k in chain.named_elements]
    tool_at = 6 + len(chain.elements)
    return Program(
        axis=np.array([e.axis for e in elements], dtype=np.int64),
        joint=np.array([-1 if e.joint is None else e.joint for e in elements], dtype=np.int64),
        ratio=np.array([e.ratio for e in elements]),
        value=np.array([e.value for e in elements], dtype=np.float64),
        slot=slot,
        tool_at=tool_at,
        element_of=np.array([*range(6), *named, *range(tool_at, tool_at + 6)], dtype=np.int64),
    )


ARRAYS = ("marker_points", "wanted_base", "wanted_tool")  # of a calibration, beside its values
THE_ROBOTS_OWN = np.empty((0, 0))


@dataclass(frozen=True)
class RobotModel:
    """Chain and effects. Parameters in order: base increments, chain constants, tool increments, effects.

    ``T_base`` and ``T_tool`` (4, 4) are the frames about which the six increments of each are taken, in their own axes;
    an identification folds the increments back into them, so there is no gimbal lock. Loads are taken on ``load_chain``,
    the nominal chain when None. ``of_type`` is what other arms of the type say before this one is measured.
    """

    robot: Robot
    effects: tuple[Effect, ...] = ()
    T_base: Floats = field(default_factory=lambda: THE_ROBOTS_OWN)
    T_tool: Floats = field(default_factory=lambda: THE_ROBOTS_OWN)
    load_chain: LoadChain | None = None
    of_type: CorrelatedPrior | None = None

    def __post_init__(self) -> None:
        for name in [k for k in ("T_base", "T_tool") if getattr(self, k) is THE_ROBOTS_OWN]:
            object.__setattr__(self, name, getattr(self.robot, name))
        object.__setattr__(self, "effects", tuple(effect.configure_for_robot(self.robot) for effect in self.effects))
        refuse_collisions([p.name for p in self.parameters])

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in order."""
        chain = self.robot.chain
        made = frame_parameters("base") + [chain.elements[k].parameter() for k in chain.named_elements]
        made += frame_parameters("tool")
        for effect in self.effects:
            made += effect.parameters(self.robot)
        return tuple(made)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(p.name for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Look a parameter up by name; unknown names raise :class:`~kilter_core.errors.OptionError`."""
        return self.parameters[int(indices(self.names, [name])[0])]

    def prior_of(self, parameters: Sequence[Parameter]) -> Prior:
        """What is known of some parameters before any row: by themselves, by arms of the type, by torques."""
        return Prior.from_parameters(parameters, self.of_type, self.robot.told_loads)

    @cached_property
    def n_geometric(self) -> int:
        """Number of geometric parameters: base, chain and tool."""
        return len(self.robot.chain.named_elements) + 12

    def values0(self) -> Floats:
        """Nominal values (P,): the nominal robot, without any effect."""
        return np.array([p.value for p in self.parameters], dtype=np.float64)

    def effect_slices(self) -> dict[str, slice]:
        """Where the parameters of each effect are, keyed by ``id`` or ``id#k`` for the k-th of a kind."""
        return dict(self._slices)

    @property
    def effects_with_slices(self) -> tuple[tuple[Effect, slice], ...]:
        """Each effect and where its parameters are."""
        return tuple(zip(self.effects, self._slices.values(), strict=True))

    @cached_property
    def _slices(self) -> dict[str, slice]:
        out: dict[str, slice] = {}
        start = self.n_geometric
        for effect in self.effects:
            count = len(effect.parameters(self.robot))
            out[effect.id if effect.id not in out else f"{effect.id}#{len(out)}"] = slice(start, start + count)
            start += count
        return out

    @cached_property
    def program(self) -> Program:
        """Kernel arrays of base increments, chain and tool increments."""
        return model_program(self.robot.chain)

    def batch(self, observations: Observations) -> Batch:
        """Conditions of the rows with the load on each joint, from the load chain, and where the arm hangs if that says so.

        Raises:
            ObservationError: the rows do not have the robot's number of joints.

        """
        if observations.q.shape[1] != self.robot.n_joints:
            raise ObservationError(
                f"The rows have {observations.q.shape[1]} joints, the robot {self.robot.name!r} has {self.robot.n_joints}."
            )
        o = observations.with_tilt_as_condition() if "base_tilt_x" in self.needs else observations
        return (
            self._hanging(o)
            if self.load_chain is not None and self.load_chain.effects
            else self._batch_for_deflection(o)
        )

    def _hanging(self, o: Observations) -> Batch:
        """The rows with the loads of the arm where the effects of the load chain leave it.

        Each round leaves what the sag of the one before is off times the part of its load that a lever changes by it: after
        three, of joints that sag by 2 deg, less than a tenth of a micrometre. Sides are taken by the loads of the
        arm with backlash and clearance in their middle, and stand still while it settles with them.
        """
        smooth, sided = (self._held_values(sides) for sides in (False, True))
        # A payload's sensitivity takes as long as the loads themselves: only rounds in which an effect reads it have it.
        payload = any("payload_kg" in e.needs and np.any((smooth + sided)[at]) for e, at in self._reader)
        deflection, centre = None, self._batch_for_deflection(o, payload=payload)
        for _ in range(HANGING_ROUNDS):
            deflection = self._compute_deflection(centre, smooth)
            centre = self._batch_for_deflection(o, deflection, payload)
        whole = centre
        if np.any(sided):
            sides = self._compute_deflection(centre, sided)
            for _ in range(SIDED_ROUNDS):
                deflection = self._compute_deflection(whole, smooth) + sides
                whole = self._batch_for_deflection(o, deflection, payload)
            whole = replace(whole, centre_wrench=centre.wrench, centre_axial=centre.axial)
        return whole if payload else replace(whole, payload_axial=self._payload_axial(o, deflection))

    def _held_values(self, sided: bool) -> Floats:
        """Values (P,) of the load chain's effects, of those with sides or of the others; the rest zero."""
        assert self.load_chain is not None
        held = self.load_chain.effects or {}
        values = np.zeros(len(self.names))
        for effect, at in self._reader:
            if effect.stage != "measurement" and effect.sided is sided:
                values[at] = [held.get(name, 0.0) for name in self.names[at]]
        return values

    def _compute_deflection(self, batch: Batch, values: Floats) -> Deflection:
        total, _ = self._local(batch, values)
        return Deflection(total.dq, total.xi[:, : self.robot.n_joints])

    def _batch_for_deflection(
        self, o: Observations, deflection: Deflection | None = None, payload: bool = True
    ) -> Batch:
        robot = self.load_robot
        loads = self._loads(o, deflection)
        return Batch(
            q=o.q,
            wrench=loads.joints,
            axial=axial_loads(robot, loads),
            end_wrench=loads.ends,
            base_wrench=loads.base,
            tool_point=loads.tool_point,
            link_vectors=robot.chain.link_vectors,
            **o.under(),
            payload_axial=self._payload_axial(o, deflection) if payload else None,
            slopes=LoadSlopes(robot, o, deflection) if any(e.changes_loads for e in self.effects) else None,
        )

    def _payload_axial(self, o: Observations, deflection: Deflection | None) -> Floats | None:
        return payload_sensitivity(self.load_robot, o, deflection) if "payload_kg" in self.needs else None

    @cached_property
    def load_robot(self) -> Robot:
        """The robot that loads are computed from: the nominal one on the load chain."""
        return self.robot if self.load_chain is None else self.load_chain.apply_to_robot(self.robot)

    @cached_property
    def _reader(self) -> Reader:
        return Reader(self.effects, self._slices)

    @cached_property
    def needs(self) -> frozenset[str]:
        """Columns that its effects need."""
        return frozenset[str]().union(*(effect.needs for effect in self.effects))

    def _loads(self, o: Observations, deflection: Deflection | None) -> Loads:
        if self.effects:
            return row_load_wrenches(self.load_robot, o, deflection)
        none = np.zeros((*o.q.shape, 6))
        return Loads(none, none, np.zeros((len(o), 6)), np.zeros((len(o), 3)))

    def predict(self, observations: Observations | Batch, values: Floats) -> Prediction:
        """Tool poses at ``values (P,)``.

        Of observations every effect is asked, and may refuse what they lack; of a batch, as fits have it, those with values.
        """
        batch = self._as_batch(observations)
        total, _ = self._local(batch, values, NOTHING if batch is observations else np.arange(len(values)))
        position, rotation = np.empty((len(batch), 3)), np.empty((len(batch), 3, 3))
        kinematics.poses(*self._chain_arguments(batch, values, total), position, rotation)
        position = position if total.stretch is None else position * total.stretch
        return Prediction(position, rotation, total, self._slides, find_instrument(self._cameras, values))

    def jacobian(
        self,
        observations: Observations | Batch,
        values: Floats,
        free: Ints | None = None,
        turns: bool = True,
        joints: bool = False,
    ) -> tuple[Prediction, Floats]:
        """Poses and their exact derivative (N, 6, F) by the parameters ``free`` (ascending indices; all when None).

        Rows 0-2 are the position (m per unit), 3-5, with ``turns``, the rotation vector in the measurements' frame (rad).
        With ``joints`` there are both and then :data:`JOINT_ROWS` for each joint and last the base.
        """
        batch = self._as_batch(observations)
        free = np.arange(len(self.names)) if free is None else free
        total, here = self._local(batch, values, free)
        prediction, J, columns = self._screws(batch, values, total, free, TOOL_ROWS if turns or joints else 3)
        place = {int(k): c for c, k in enumerate(free) if k >= self.n_geometric}
        columns.put_effects(J, total, place, prediction.position)
        errors = [(place[k], error) for k, error in self._reader.load_errors(here, place)]
        if errors and here.slopes is not None:
            columns.put_loads(J, self._reader.slopes(here, values), here.slopes, errors)
        if total.stretch is not None:
            J[:, :3] *= total.stretch[:, :, None]
            prediction = replace(prediction, position=prediction.position * total.stretch)
        return prediction, np.hstack(
            [J, joint_rows(self._reader, here, total, values, (free, self.n_geometric))]
        ) if joints else J

    def apply_load_errors(self, batch: Batch, values: Floats) -> Batch:
        """The rows with the loads that load errors among the effects leave."""
        return self._reader.apply_load_errors(batch, values)

    def doubts(
        self, observations: Observations | Batch, values: Floats, joints: bool = False
    ) -> tuple[Prediction, Floats]:
        """Poses and (N, 6, S) the independent displacements of one standard deviation that blurred loads leave open."""
        batch = self._as_batch(observations)
        total, here = self._local(batch, values)
        prediction, _, columns = self._screws(batch, values, total, NOTHING)
        live = ((effect, values[at]) for effect, at in self._reader if np.any(values[at]))
        found = [d for effect, own in live for d in effect.doubt(here, own)]
        out = np.zeros((*columns.JQ.shape[:2], len(found)))
        for k, d in enumerate(found):
            columns.put(out, k, d)
        return prediction, np.hstack(
            [out, rotation_derivatives(found, len(out), self.robot.n_joints)]
        ) if joints else out

    def joint_jacobian(
        self, observations: Observations | Batch, values: Floats, joints: bool = False
    ) -> tuple[Prediction, Floats]:
        """Poses and their derivative (N, 6, n), longer with ``joints``, by motions of the joints, the effects held still."""
        batch = self._as_batch(observations)
        prediction, _, columns = self._screws(batch, values, self._local(batch, values)[0], NOTHING)
        if not joints:
            return prediction, columns.JQ
        return prediction, np.hstack([columns.JQ, own_turns(len(columns.JQ), self.robot.n_joints)])

    def contribution(self, observations: Observations, values: Floats) -> dict[str, Floats]:
        """Displacement of the tool point (N, 3) m by each effect: the model with all effects minus that without it."""
        batch = self._as_batch(observations)
        whole = self.predict(batch, values).position
        out = {}
        for key, where in self.effect_slices().items():
            without = values.copy()
            without[where] = 0.0
            out[key] = whole - self.predict(batch, without).position
        return out

    def link_angles(self, observations: Observations | Batch, values: Floats) -> Floats:
        """Joint angles (N, n) behind gear and backlash: reading plus zero offset error plus the effects' corrections."""
        batch = self._as_batch(observations)
        return batch.q + self._local(batch, values)[0].dq

    def absorb_frame_increments(self, values: Floats) -> tuple[RobotModel, Floats]:
        """Move the base and tool increments of ``values`` into the frames: an equal model with increments zero."""
        n = self.n_geometric
        T_base = self.T_base @ increment(values[:6])
        T_tool = self.T_tool @ increment(values[n - 6 : n])
        flat = values.copy()
        flat[:6] = flat[n - 6 : n] = 0.0
        return self.in_frames(T_base, T_tool), flat

    def with_loads_at_values(self, values: Floats) -> RobotModel:
        """Return the same model with its loads on the chain, under the tool, where the arm hangs as ``values (P,)`` say."""
        n = self.n_geometric
        T_tool = self.T_tool @ increment(values[n - 6 : n])
        return replace(
            self,
            load_chain=LoadChain.from_fitted_values(self.robot, values[6 : n - 6], T_tool, self._deflecting(values)),
        )

    def hanging_as(self, values: Floats) -> RobotModel:
        """Return the same model with the deflections of ``values (P,)``, where its loads are taken where the arm hangs.

        A fit holds both still; what it found is what the corrector deflects by.
        """
        if self.load_chain is None or self.load_chain.effects is None:
            return self
        return replace(self, load_chain=replace(self.load_chain, effects=self._deflecting(values)))

    def _deflecting(self, values: Floats) -> dict[str, float] | None:
        """Values by name of the effects that have any; None without one that follows loads: then nothing deflects."""
        live = [(effect, at) for effect, at in self._reader if effect.stage != "measurement" and np.any(values[at])]
        if not any("moments" in effect.needs for effect, _ in live):
            return None
        return {name: float(v) for _, at in live for name, v in zip(self.names[at], values[at], strict=True)}

    def in_frames(self, T_base: Floats, T_tool: Floats) -> RobotModel:
        """Return the same model about other base and tool frames (4, 4)."""
        other = copy.copy(self)  # with the cached parameters and kernel arrays, which know nothing of the frames
        object.__setattr__(other, "T_base", T_base)
        object.__setattr__(other, "T_tool", T_tool)
        return other

    def _as_batch(self, observations: Observations | Batch) -> Batch:
        return observations if isinstance(observations, Batch) else self.batch(observations)

    def _chain_arguments(self, batch: Batch, values: Floats, total: Total) -> tuple[Any, ...]:
        """What a kernel walks the chain by."""
        p, element_values = self.program, self._element_values(values)
        q = np.ascontiguousarray(batch.q)  # of another order the kernel would be compiled anew
        return (
            *(p.axis, p.joint, p.ratio, element_values, p.slot, p.tool_at),
            *(self.T_base, self.T_tool, q, total.dq, total.xi),
        )

    def _element_values(self, values: Floats) -> Floats:
        out = self.program.value.copy()
        out[self.program.element_of] = values[: self.n_geometric]
        return out

    def _local(self, batch: Batch, values: Floats, free: Ints = NOTHING) -> tuple[Total, Batch]:
        """Sum of the local corrections of effects with values or ``free`` parameters, and the loads that these read."""
        live = [
            (e, at) for e, at in self._reader if np.any(values[at]) or np.any((free >= at.start) & (free < at.stop))
        ]
        batch = self._reader.read(batch, values, [e for e, _ in live])
        parts = tuple((at.start, effect.local(batch, values[at])) for effect, at in live)
        moves = [bool(np.any(values[at])) for _, at in live]
        return Total.from_local_corrections(parts, moves, len(batch), self.robot.chain.program.joint_frame), batch

    def _screws(
        self, batch: Batch, values: Floats, total: Total, free: Ints, each: int = 6
    ) -> tuple[Prediction, Floats, ToolColumns]:
        """Poses, their derivatives (N, each, F) with the columns of geometry filled in, and those of local corrections."""
        rows, n = batch.q.shape
        p = self.program
        geometric = free[free < self.n_geometric]
        column = np.full(len(p.axis), -1, dtype=np.int64)
        column[p.element_of[geometric]] = np.arange(len(geometric))
        position, rotation = np.empty((rows, 3)), np.empty((rows, 3, 3))
        J, JQ = np.zeros((rows, each, len(free))), np.empty((rows, each, n))
        JX = np.empty((rows if len(total.xi) else 0, each, 6 * n + 12))
        kinematics.screws(*self._chain_arguments(batch, values, total), column, position, rotation, J, JQ, JX)
        made = Prediction(position, rotation, total, self._slides, find_instrument(self._cameras, values, free))
        return made, J, ToolColumns(self.robot.chain.program.joint_frame, JQ, JX)

    @cached_property
    def _cameras(self) -> tuple[tuple[Effect, slice], ...]:
        """The effects whose parameters are unknowns of cameras and boards, and where these are."""
        return tuple((effect, at) for effect, at in self.effects_with_slices if effect.instrument is not None)

    @cached_property
    def _slides(self) -> Bools:
        return np.array([joint.kind == "prismatic" for joint in self.robot.joints])
