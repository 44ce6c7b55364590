"""The table whose poses come closest to a calibrated arm, and what is lost, over the workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.arm.chain import Chain, Element
from kilter_core.arm.conventions import Row, dh_elements, mdh_elements
from kilter_core.arm.conversions.tables import Screws, chain_frames, link_table
from kilter_core.arm.robot import Link, Robot, moved_link
from kilter_core.effects import Effect
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.model.geometry import arm_screws, flange_frames
from kilter_core.observations import Observations
from kilter_core.transforms import inverse, rotation_log
from kilter_core.types import Bools, Floats, Ints

FREE_SHIFT_M = 0.5  # workspace of a prismatic joint without limits
NOTHING_M = 1e-10
FIT_SIGMA_M = 1e-5  # how closely poses are met that rows of the table cannot meet exactly,
EXACT_SIGMA_M = 1e-9  # and that they can
AWAY_M = 1e-3  # at the tool: a parameter that moves it so far from nominal costs as much as a pose missed by one sigma
LEVER_M = 0.1  # at which orientation counts as length
FIT_STEPS = 12
SETTLED = 1e-12  # of AWAY_M
UNSEEN = 1e-3  # of LEVER_M: a unit of a parameter counts as moving the tool at least so far
TOLD = 0.9  # part of its variance about the start that poses take off a zero which they tell
WORSE = 1.5  # times as far off as rows of another form, which are taken then; or as without the zeros entered
AT_REST = frozenset({"moments", "direction"})  # what an effect may need and still act on an arm at rest without load


@dataclass(frozen=True)
class Loss:
    """Distance between two arms over the workspace: position m, orientation rad."""

    rms_m: float
    max_m: float
    max_rad: float


@dataclass(frozen=True)
class ClosestTable:
    """Rows of a DH or MDH table with base and tool (4, 4), and how far the calibrated arm is from them.

    ``nominal``, ``nominal_base`` and ``nominal_tool`` are the same of the nominal arm: what poses do not tell stays there.
    ``links`` are the robot's bodies in the frames of the rows (``element`` counts joints), ``gravity (3,)`` is in ``base``.
    ``zeros`` says how the joints' zeros in it follow the parameters; None where the rows have another form than nominal.
    ``shared (n,)`` are zeros that go with other numbers of the table: entered into a nominal arm they take it away.
    """

    rows: tuple[Row, ...]
    base: Floats
    tool: Floats
    loss: Loss
    links: tuple[Link, ...]
    gravity: Floats
    nominal: tuple[Row, ...]
    nominal_base: Floats
    nominal_tool: Floats
    zeros: ZerosOfTable | None = None
    shared: Bools | None = None


@dataclass(frozen=True)
class ZerosOfTable:
    """How the zeros of a closest table follow the parameters of the calibration, to first order about the fit."""

    model: RobotModel
    values: Floats
    free: Ints
    follows: bool  # the fit began at the calibration's own parameters, not at nominal

    def derivatives(self, calibration: Calibration, names: Sequence[str]) -> Floats:
        """Derivative (n, K) of each joint's zero (rad; m of a prismatic joint) with respect to parameters ``names``, SI.

        The table minimises |W (Y(p) - f(x))|² + |(x - start) / scale|² over its own parameters x, so that
        (Aᵀ A + S) dx = Aᵀ W dY + S dstart, with A = W df/dx and S = 1 / scale². It does so twice: for the geometry, and from
        there for the arm with its effects.
        """
        rows = workspace(calibration.robot)
        wanted = [names.index(name) if name in names else -1 for name in self.model.names]
        start = np.zeros((len(self.free), len(names)))
        for at, k in enumerate(self.free.tolist()):
            if self.follows and wanted[k] >= 0:
                start[at, wanted[k]] = 1.0
        moved = start
        bare = calibration.with_effects([])
        for arm in (bare, calibration.with_effects([e for e in calibration.model.effects if acts_at_rest(e)])):
            if arm is bare or arm.model.effects:
                moved = self._parameter_derivatives(_arm_derivatives(calibration, arm, rows, names), moved)
        return np.asarray(moved[self._own_zeros()])

    def identifiable_zeros(self) -> Bools:
        """Which zeros (n,) follow from the arm and not from where the fit begins: others share what they are with a frame."""
        if self.follows:
            return np.ones(self.model.robot.n_joints, dtype=bool)
        R = np.linalg.qr(self._stacked_equations[0], mode="r")
        own = np.sum(np.linalg.inv(R) ** 2, axis=1)
        return np.asarray(1.0 - own[self._own_zeros()] >= TOLD)

    def _own_zeros(self) -> list[int]:
        """Where the zeros of the joints are among the free parameters."""
        named = {self.model.names[k]: at for at, k in enumerate(self.free.tolist())}
        return [named[name] for name in zero_names(self.model.robot)]

    @cached_property
    def _stacked_equations(self) -> tuple[Floats, Floats]:
        """The equations of the fit (6 N + F, F) in units of ``scale (F,)``."""
        rows = Observations(workspace(self.model.robot).q)
        J = self.model.jacobian(rows, self.values, self.free)[1]
        A = (J * _weights(FIT_SIGMA_M)[None, :, None]).reshape(-1, len(self.free))
        scale = _scale(A, len(rows), FIT_SIGMA_M)
        return np.vstack([A * scale, np.eye(len(self.free))]), scale

    def _parameter_derivatives(self, dY: Floats, dstart: Floats) -> Floats:
        """How the table's free parameters (F, K) follow the poses (6 N, K) and where the fit begins."""
        stacked, scale = self._stacked_equations
        weight = np.tile(_weights(FIT_SIGMA_M), len(dY) // 6)
        aimed = np.vstack([weight[:, None] * dY, dstart / scale[:, None]])
        return np.asarray(np.linalg.lstsq(stacked, aimed, rcond=None)[0] * scale[:, None])


@dataclass(frozen=True)
class _Table:
    """Rows with base and tool (4, 4)."""

    rows: tuple[Row, ...]
    base: Floats
    tool: Floats


def workspace(robot: Robot, count: int = 400, seed: int = 1) -> Observations:
    """Poses ``count`` spread over the joint limits (one turn, 0.5 m where there are none), each joint moved either way."""
    rng = np.random.default_rng(seed)
    reach = np.array([math.pi if joint.kind == "revolute" else FREE_SHIFT_M for joint in robot.joints])
    lower = np.where(np.isfinite(robot.limits[:, 0]), robot.limits[:, 0], -reach)
    upper = np.where(np.isfinite(robot.limits[:, 1]), robot.limits[:, 1], reach)
    q = rng.uniform(lower, upper, (count, robot.n_joints))
    return Observations(q, direction=rng.choice([-1.0, 1.0], q.shape))


def acts_at_rest(effect: Effect) -> bool:
    """Whether an effect moves an arm that rests without load."""
    return effect.stage != "measurement" and effect.needs <= AT_REST


def arm_poses(calibration: Calibration, rows: Observations) -> Prediction:
    """Tool poses of the whole calibrated arm, at rest without load, seen from the wanted base."""
    kept = calibration.with_effects([effect for effect in calibration.model.effects if acts_at_rest(effect)])
    model, values = kept.model.absorb_frame_increments(kept.values)
    seen_from = inverse(np.asarray(calibration.nominal_in_wanted_frames().model.T_base))
    return replace(model, T_base=seen_from @ np.asarray(model.T_base)).predict(rows, values)


def distance(reference: Prediction, other: Prediction) -> Loss:
    """How far two arms are apart."""
    gap = np.linalg.norm(reference.position - other.position, axis=1)
    turn = np.linalg.norm(rotation_log(reference.rotation.transpose(0, 2, 1) @ other.rotation), axis=1)
    return Loss(float(np.sqrt(np.mean(gap**2))), float(gap.max()), float(turn.max()))


def geometry_loss(calibration: Calibration, arm: Screws | None = None) -> Loss:
    """What is lost when only the geometry (or ``arm``, base to tool) is taken over."""
    rows = workspace(calibration.robot)
    T = (arm or arm_screws(calibration)).poses(rows.q)
    return distance(arm_poses(calibration, rows), Prediction(T[:, :3, 3], T[:, :3, :3]))


def closest_table(calibration: Calibration, convention: str) -> ClosestTable:
    """Table of ``convention`` "dh" or "mdh" closest to the calibrated arm, exact where rows can be, and nearest to nominal.

    Tables leave freedoms: the last joint's zero and the tool's rotation, heights of parallel axes, and the direction of the
    common normal of axes that all but meet. They stay where the version has them if it has these rows, else at nominal.

    Raises:
        RobotError: a joint drives several axes.

    """
    conditions = workspace(calibration.robot)
    wanted, plain = arm_poses(calibration, conditions), Observations(conditions.q)
    nominal = _nominal_table(calibration, convention)
    zeros: ZerosOfTable | None
    table, loss, zeros = _nearest(calibration, nominal, convention, plain, wanted)
    if loss.max_m > NOTHING_M:
        other, closer = _other_rows(calibration, convention, plain, wanted)
        if WORSE * closer.rms_m < loss.rms_m:  # too far from nominal for rows of its form
            table, loss, zeros = other, closer, None
    frames = flange_frames(calibration).elements
    gravity = table.base[:3, :3].T @ frames[0][:3, :3] @ calibration.robot.gravity
    links = _links(calibration.robot, frames, table.rows, convention, table.base)
    here = (table.rows, table.base, table.tool, loss, links, gravity)
    shared = _shared_zeros(_model(calibration.robot, nominal, convention), table.rows, plain, wanted, zeros)
    return ClosestTable(*here, nominal.rows, nominal.base, nominal.tool, zeros, shared)


def _shared_zeros(
    nominal: RobotModel, rows: Sequence[Row], at: Observations, wanted: Prediction, zeros: ZerosOfTable | None
) -> Bools:
    """Zeros of the rows that a controller must not be given, for with them the nominal arm is farther from the real one.

    A common normal rotates by degrees where axes all but meet or are all but parallel; the zeros before and behind it,
    and the tool, rotate back. Rows of another form than nominal have zeros of their own.
    """
    own = [nominal.names.index(name) for name in zero_names(nominal.robot)]
    offset = np.array([row.d or 0.0 if row.prismatic else row.theta_offset for row in rows]) - nominal.values0()[own]
    offset = np.where([row.prismatic for row in rows], offset, np.remainder(offset + np.pi, 2 * np.pi) - np.pi)
    told = np.ones(len(offset), dtype=bool) if zeros is None else zeros.identifiable_zeros()

    def pose_loss(entered: Bools) -> float:
        values = nominal.values0()
        values[own] += np.where(entered, offset, 0.0)
        found = nominal.predict(at, values)
        turn = LEVER_M * rotation_log(wanted.rotation.transpose(0, 2, 1) @ found.rotation)
        return float(np.sum((found.position - wanted.position) ** 2) + np.sum(turn**2))

    most, joints = WORSE**2 * pose_loss(np.zeros_like(told)), np.arange(len(offset))
    if zeros is None and pose_loss(told) > most:
        return told
    entered = told.copy()
    while pose_loss(entered) > most:
        entered[min(np.flatnonzero(entered), key=lambda k: pose_loss(entered & (joints != k)))] = False
    return np.asarray(told & ~entered)


def _nominal_table(calibration: Calibration, convention: str) -> _Table:
    """The nominal arm's own rows where it is written in them, else those of its axes."""
    wanted = calibration.nominal_in_wanted_frames()
    rows = _own_rows(calibration.robot, convention)
    if rows is not None:
        return _Table(rows, np.eye(4), np.asarray(wanted.model.T_tool))
    return _table_from_axes(wanted, convention)


def _table_from_axes(calibration: Calibration, convention: str) -> _Table:
    """Table of the identified axes, by common normals."""
    table = link_table(arm_screws(calibration), hayati=convention == "mdh")
    rows, tool = (table.dh_rows(), table.tool) if convention == "dh" else (table.mdh_rows(), table.mdh_tool())
    return _Table(rows, table.base, tool)


def _own_rows(robot: Robot, convention: str) -> tuple[Row, ...] | None:
    """Rows that the chain is made of; None where it is made of other ones."""
    own = {e.name: e.value for e in robot.chain.elements}
    rows = tuple(
        Row(
            own.get(f"alpha_{k}", 0.0),
            own.get(f"a_{k}", 0.0),
            own.get(f"theta_offset_{k}", 0.0),
            own.get(f"d_{k}"),
            own.get(f"beta_{k}") if convention == "mdh" else None,
            joint.kind == "prismatic",
        )
        for k, joint in enumerate(robot.joints, 1)
    )
    made = _elements(rows, convention)
    same = [(e.axis, e.value, e.name, e.joint, e.ratio) for e in made] == [
        (e.axis, e.value, e.name, e.joint, e.ratio) for e in robot.chain.elements
    ]
    return rows if same else None


def _nearest(
    calibration: Calibration, nominal: _Table, convention: str, rows: Observations, wanted: Prediction
) -> tuple[_Table, Loss, ZerosOfTable]:
    """Table of the nominal form nearest to nominal: first of the geometry alone, then of what effects add."""
    model, values = _model(calibration.robot, nominal, convention), None
    found = calibration.model.absorb_frame_increments(calibration.values)
    start = model.values0()
    free = _free(model, nominal.rows)
    follows = _own_rows(calibration.robot, convention) is not None
    if follows:
        base = inverse(np.asarray(calibration.nominal_in_wanted_frames().model.T_base)) @ np.asarray(found[0].T_base)
        model = replace(model, T_base=base, T_tool=np.asarray(found[0].T_tool))
        named = dict(zip(found[0].names, found[1].tolist(), strict=True))
        start = np.array([named[name] if k in free else 0.0 for k, name in enumerate(model.names)])
    lost = len(free) < len(start)
    T = arm_screws(calibration).poses(rows.q)
    geometry = Prediction(T[:, :3, 3], T[:, :3, :3])
    values = _fit_values(model, rows, geometry, start, free, FIT_SIGMA_M if lost else EXACT_SIGMA_M)
    loss = distance(wanted, model.predict(rows, values))
    if loss.max_m > NOTHING_M:
        values = _fit_values(model, rows, wanted, values, free, FIT_SIGMA_M)
        loss = distance(wanted, model.predict(rows, values))
    return _read(model, values, nominal.rows), loss, ZerosOfTable(model, values, free, follows)


def zero_names(robot: Robot) -> list[str]:
    """The parameter that is each joint's zero in rows of a table."""
    return [f"d_{k}" if joint.kind == "prismatic" else f"theta_offset_{k}" for k, joint in enumerate(robot.joints, 1)]


def _arm_derivatives(calibration: Calibration, arm: Calibration, rows: Observations, names: Sequence[str]) -> Floats:
    """Derivatives (6 N, K) of the arm's tool poses by parameters, seen from the wanted base; 0 for those it does not have."""
    turn = np.asarray(inverse(np.asarray(calibration.nominal_in_wanted_frames().model.T_base)))[:3, :3]
    known = [k for k, name in enumerate(names) if name in arm.names]
    free = np.array([arm.names.index(names[k]) for k in known], dtype=np.int64)
    J = arm.model.jacobian(rows, arm.values, free)[1]
    out = np.zeros((len(rows.q), 6, len(names)))
    out[:, :3, known], out[:, 3:, known] = turn @ J[:, :3], turn @ J[:, 3:]
    return out.reshape(-1, len(names))


def _other_rows(
    calibration: Calibration, convention: str, rows: Observations, wanted: Prediction
) -> tuple[_Table, Loss]:
    """Table by the identified axes' own common normals, fitted where it is not exact."""
    table = _table_from_axes(calibration, convention)
    model = _model(calibration.robot, table, convention)
    start = model.values0()
    fitted = _fit_values(model, rows, wanted, start, _free(model, table.rows), FIT_SIGMA_M)
    losses = [(distance(wanted, model.predict(rows, values)), values) for values in (start, fitted)]
    loss, values = min(losses, key=lambda one: one[0].rms_m)
    return _read(model, values, table.rows), loss


def _read(model: RobotModel, values: Floats, rows: tuple[Row, ...]) -> _Table:
    model, values = model.absorb_frame_increments(values)
    named = dict(zip(model.names, values.tolist(), strict=True))
    return _Table(_rows(rows, named), np.asarray(model.T_base), np.asarray(model.T_tool))


def _links(robot: Robot, frames: Floats, rows: tuple[Row, ...], convention: str, base: Floats) -> tuple[Link, ...]:
    """Bodies of the arm, with all joints at zero, in the frames of the table's rows."""
    elements, at = (dh_elements if convention == "dh" else mdh_elements)(rows)
    table = base @ chain_frames(Chain(elements, len(rows)))
    return tuple(
        replace(moved_link(link, inverse(table[at[j] + 1]) @ frames[link.element + 1]), element=j)
        for j, link in enumerate(robot.links)
    )


def _elements(rows: Sequence[Row], convention: str) -> tuple[Element, ...]:
    return (dh_elements if convention == "dh" else mdh_elements)(rows)[0]


def _model(robot: Robot, table: _Table, convention: str) -> RobotModel:
    elements = _elements(table.rows, convention)
    return RobotModel(Robot(robot.name, robot.joints, Chain(elements, len(table.rows))), (), table.base, table.tool)


def _free(model: RobotModel, rows: Sequence[Row]) -> Ints:
    """Parameters of the table: one without β must not get one."""
    fixed = {f"beta_{k}" for k, row in enumerate(rows, 1) if row.beta is None}
    return np.array([k for k, name in enumerate(model.names) if name not in fixed], dtype=np.int64)


def _fit_values(
    model: RobotModel, rows: Observations, wanted: Prediction, start: Floats, free: Ints, sigma: float
) -> Floats:
    """Gauss-Newton; what poses do not tell stays at ``start``, by what it would move at the tool."""
    values, scale = start.copy(), np.zeros(0)
    weight = _weights(sigma)
    for _ in range(FIT_STEPS):
        found, J = model.jacobian(rows, values, free)
        turn = rotation_log(wanted.rotation @ found.rotation.transpose(0, 2, 1))
        error = (np.hstack([wanted.position - found.position, turn]) * weight).ravel()
        A = (J * weight[None, :, None]).reshape(len(error), -1)
        if not len(scale):
            scale = _scale(A, len(rows), sigma)
        away = (values - start)[free] / scale
        # Stacked, not as normal equations: a million million lies between what poses tell and what they do not.
        step = np.linalg.lstsq(np.vstack([A * scale, np.eye(len(free))]), np.append(error, -away), rcond=None)[0]
        values[free] += step * scale
        if float(np.abs(step).max()) < SETTLED:
            break
    return values


def _weights(sigma: float) -> Floats:
    return np.array([1.0] * 3 + [LEVER_M] * 3) / sigma


def _scale(A: Floats, count: int, sigma: float) -> Floats:
    """How far a parameter goes that moves the tool by ``AWAY_M``."""
    size = np.sqrt(np.sum(A**2, axis=0) / count) * sigma
    return np.asarray(AWAY_M / np.maximum(size, LEVER_M * UNSEEN))


def _rows(rows: Sequence[Row], named: dict[str, float]) -> tuple[Row, ...]:
    return tuple(
        replace(
            row,
            alpha=named[f"alpha_{k}"],
            a=named[f"a_{k}"],
            theta_offset=named[f"theta_offset_{k}"],
            d=None if row.d is None else named[f"d_{k}"],
            beta=None if row.beta is None else named[f"beta_{k}"],
        )
        for k, row in enumerate(rows, 1)
    )
