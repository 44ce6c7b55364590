"""A user's model of MuJoCo as the joints that a log commands: their servos, and what their bodies ask along a motion.

The model stays as it is: friction, damping and servos are read from it; loads and inertias are computed along the readings.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_client.twin.settled import HINGE, JOINT, SLIDE, UNITS, find_element_id, load_model, silence_warnings
from kilter_core.motion import JointEpisode, JointRecord, Servo, smooth_motion
from kilter_files import read_joints
from kilter_files.ground.later import mujoco, np
from kilter_files.tables import JointLog

if TYPE_CHECKING:
    from kilter_files.formats import LogHints
    from kilter_files.ground import Floats


STRIDE = 5  # steps of the simulation between which loads are interpolated
LEAST_INERTIA = 1e-9
SLOPE_RAD = 1e-4
LARGEST_STEP_S = 0.005


@dataclass(frozen=True)
class ServoModel:
    """A model with the joints of a log, in the log's order, and the position actuator of each."""

    path: Path
    model: Any
    joints: tuple[str, ...]
    ids: tuple[int, ...]
    actuators: tuple[int, ...]
    payload: str = "payload"

    @classmethod
    def from_file(cls, path: Path, joints: Sequence[str] = (), payload: str = "payload") -> ServoModel:
        """Load a model.

        ``joints`` names those of the log, by default all that have an actuator, in the model's order; ``payload`` the body
        whose mass is that of a log's payload.

        Raises:
            FileError: MuJoCo refuses it, a joint is missing, free or has no position actuator.

        """
        model = load_model(path)
        driven = _actuators_by_joint(model)
        names = list(joints) or [_name(model, j) for j in sorted(driven)]
        if not names:
            raise FileError(
                f"{path}: no joint has an actuator. Add <position joint=... kp=...> for each joint that the log commands.",
                file=str(path),
                code="model_without_actuator",
            )
        ids = [find_element_id(model, "joint", name, path) for name in names]
        for name, j in zip(names, ids, strict=True):
            _refuse_joint(model, path, name, j, driven.get(j, ()))
        if model.opt.timestep > LARGEST_STEP_S:
            raise FileError(
                f"{path}: its time step of {model.opt.timestep * 1e3:g} ms is too long for a servo: "
                'write <option timestep="0.002"/>.',
                file=str(path),
                code="model_step",
            )
        silence_warnings()
        return cls(path, model, tuple(names), tuple(ids), tuple(driven[j][0] for j in ids), payload)

    def records(self, logs: Sequence[CommandLog]) -> list[JointRecord]:
        """Return what each joint was told and read in all episodes, with the loads of its bodies along the readings."""
        step_s = float(self.model.opt.timestep)
        episodes: list[list[JointEpisode]] = [[] for _ in self.joints]
        for one in (episode for log in logs for episode in log.episodes):
            self.hang(self.model, one)
            bodies = self._bodies_along(np.array([smooth_motion(one.t, reading, step_s) for reading in one.reading.T]))
            for j in range(len(self.joints)):
                command = self._clamped(j, one.command[:, j])
                episodes[j].append(JointEpisode(one.t, command, one.reading[:, j].copy(), bodies[j]))
        return [
            JointRecord(
                name,
                tuple(episodes[j]),
                self.servo(j).numbers(),
                step_s,
                int(self.model.jnt_type[self.ids[j]]) == SLIDE,
            )
            for j, name in enumerate(self.joints)
        ]

    def hang(self, model: Any, one: CommandEpisode) -> None:
        """Let ``model`` carry the payload of an episode.

        Raises:
            FileError: it has no body for one.

        """
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.payload)
        if body >= 0:
            model.body_mass[body] = max(one.payload_kg, 1e-9)
            stated = self._stated_centre  # read before any episode changes it
            model.body_ipos[body] = stated if one.payload_com is None else one.payload_com
            mujoco.mj_setConst(model, mujoco.MjData(model))
        elif one.payload_kg > 0.0:
            raise FileError(
                f"{self.path}: a log carries {one.payload_kg:g} kg, the model has no body for it: name it with --payload-body.",
                file=str(self.path),
                code="model_payload",
            )

    @cached_property
    def _stated_centre(self) -> Floats:
        """Centre (3,) of the payload as the file has it."""
        return np.array(self.model.body(self.payload).ipos)

    def servo(self, j: int) -> Servo:
        """What the model states of the servo of its ``j``-th joint."""
        m, a, dof = self.model, self.actuators[j], int(self.model.jnt_dofadr[self.ids[j]])
        gear = float(m.actuator_gear[a, 0])
        limited = bool(m.actuator_forcelimited[a])
        timeconst, dmax = float(m.dof_solref[dof, 0]), float(m.dof_solimp[dof, 1])
        return Servo(
            float(m.dof_armature[dof]),
            float(m.dof_frictionloss[dof]),
            float(np.ravel(m.dof_damping[dof])[0]),
            -float(m.actuator_biasprm[a, 2]) * gear**2,
            float(m.actuator_gainprm[a, 0]) * gear**2,
            float(m.actuator_forcerange[a, 1]) * abs(gear) if limited else 0.0,
            float(m.dof_solimp[dof, 0]),
            2.0 / (dmax * timeconst) if timeconst > 0.0 else 0.0,
            float(m.actuator_delay[a]) if hasattr(m, "actuator_delay") else 0.0,
        )

    def _clamped(self, j: int, command: Floats) -> Floats:
        a = self.actuators[j]
        if not self.model.actuator_ctrllimited[a]:
            return command.copy()
        return np.asarray(np.clip(command, *self.model.actuator_ctrlrange[a]))

    def _bodies_along(self, motion: Floats) -> Floats:
        """Load, its slope, inertia and angle (n, 4, K) of the bodies at each joint along a motion (n, 3, K), without drives."""
        m, data = self.model, mujoco.MjData(self.model)
        places, dofs = [m.jnt_qposadr[j] for j in self.ids], [int(m.jnt_dofadr[j]) for j in self.ids]
        start, torque, unit, product = m.qpos0.copy(), np.zeros(m.nv), np.zeros(m.nv), np.zeros(m.nv)

        def weigh(at: Floats, k: int) -> Floats:
            data.qpos[:] = start
            data.qpos[places], data.qvel[dofs], data.qacc[dofs] = at, motion[:, 1, k], motion[:, 2, k]
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
                stage(m, data)
            mujoco.mj_rne(m, data, 1, torque)
            return torque[dofs].copy()

        steps = motion.shape[2]
        rows = np.unique(np.append(np.arange(0, steps, STRIDE), steps - 1))
        found = np.empty((len(dofs), 3, len(rows)))
        for i, k in enumerate(rows):
            q = motion[:, 0, k]
            for j in range(len(dofs)):
                moved = q.copy()
                moved[j] += SLOPE_RAD
                found[j, 1, i] = weigh(moved, k)[j]
            whole = weigh(q, k)
            mujoco.mj_crb(m, data)
            for j, dof in enumerate(dofs):
                unit[:] = 0.0
                unit[dof] = 1.0
                mujoco.mj_mulM(m, data, product, unit)
                found[j, 2, i] = max(product[dof] - m.dof_armature[dof], LEAST_INERTIA)
            found[:, 1, i] = (found[:, 1, i] - whole) / SLOPE_RAD
            found[:, 0, i] = whole - found[:, 2, i] * motion[:, 2, k]
        every = np.arange(steps)
        dense = [[np.interp(every, rows, one) for one in joint] for joint in found]
        return np.array([[*joint, motion[j, 0]] for j, joint in enumerate(dense)])


def _actuators_by_joint(model: Any) -> dict[int, list[int]]:
    found: dict[int, list[int]] = {}
    for a in range(model.nu):
        if int(model.actuator_trntype[a]) == JOINT:
            found.setdefault(int(model.actuator_trnid[a, 0]), []).append(a)
    return found


def _name(model: Any, joint: int) -> str:
    return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint {joint + 1}")


def _refuse_joint(model: Any, path: Path, name: str, joint: int, actuators: Sequence[int]) -> None:
    if int(model.jnt_type[joint]) not in (HINGE, SLIDE):
        raise FileError(
            f"{path}: {name} is a free or ball joint, and a log commands neither: name the others with --joints.",
            file=str(path),
            code="model_joint",
        )
    if not actuators:
        raise FileError(
            f'{path}: no actuator drives {name}. Add <position joint="{name}" kp="..."/>, or leave it out with --joints.',
            file=str(path),
            code="model_without_actuator",
        )
    what = _describe_other_actuator(model, name, actuators)
    if what is not None:
        raise FileError(
            f"{path}: {what}, and the log commands positions of one servo. Let "
            f'<position joint="{name}" kp="..." kv="..."/> alone drive the joint, with the gains of the servo.',
            file=str(path),
            code="model_actuator",
        )


def _describe_other_actuator(model: Any, name: str, actuators: Sequence[int]) -> str | None:
    """What drives a joint in place of one position actuator without memory; None where that does."""
    a = actuators[0]
    if len(actuators) > 1:
        names = ", ".join(model.actuator(k).name or f"number {k + 1}" for k in actuators)
        return f"{len(actuators)} actuators drive {name} ({names})"
    gain, bias = float(model.actuator_gainprm[a, 0]), float(model.actuator_biasprm[a, 1])
    if bias == 0.0:
        return f"the actuator of {name} is a velocity or torque actuator"
    if int(model.actuator_dyntype[a]) != int(mujoco.mjtDyn.mjDYN_NONE):
        return f"the actuator of {name} filters or integrates its command"
    if not (bias < 0.0 and abs(gain + bias) < 1e-9 * abs(gain)):
        return f"the actuator of {name} is not a position actuator"
    return None


GAP_ROWS = 10  # of usual steps without a row, by which an episode ends
DROPPED = 1.5  # of a usual step, beyond which a row is missing
FEWEST_ROWS = 50
COMMAND = re.compile(r"cmd(\d+)_(deg|rad|mm|m)")
REMEDY = "Add cmd1_deg, cmd2_deg, ... (the position that each joint was told) beside q1_deg, q2_deg, ..."


@dataclass(frozen=True)
class CommandEpisode:
    """Times (N,) s, commands and readings (N, n), rad and m, and what the arm carried, kg, with its centre.

    ``payload_com (3,)`` m is in the frame of the payload's body; None: where the model has it.
    """

    t: Floats
    command: Floats
    reading: Floats
    payload_kg: float = 0.0
    payload_com: Floats | None = None


@dataclass(frozen=True)
class CommandLog:
    """A file with its episodes; ``dropped`` rows are missing in them."""

    path: Path
    episodes: tuple[CommandEpisode, ...]
    dropped: int


def read_command_log(
    path: Path, joints: int, hints: LogHints | None = None, column_map: Path | None = None
) -> CommandLog:
    """Read a log of ``joints`` joints.

    Raises:
        FileError: no time, no commands, another number of joints, or no episode of 50 rows.

    """
    log = read_joints(path, column_map, hints)
    if log.t_s is None:
        raise _fault(path, "has no clock", "Add t_s, seconds from the start.")
    if len(log.joints) != joints:
        what = f"has {len(log.joints)} joints, the model {joints} with actuators"
        raise _fault(path, what, "Say which of the model's joints they are: --joints A,B,C.")
    commands = {int(m[1]): (name, m[2]) for name in log.columns if (m := COMMAND.fullmatch(name))}
    missing = [f"cmd{k}" for k in range(1, joints + 1) if k not in commands]
    if missing:
        raise _fault(path, f"has no command of joint {missing[0][3:]}", REMEDY)
    command = np.column_stack([log.columns[commands[k][0]] * UNITS[commands[k][1]] for k in range(1, joints + 1)])
    reading = np.column_stack([log.columns[name] * UNITS[name.partition("_")[2]] for name in log.joints])
    parts = [part for part in _episodes(log) if len(part) >= FEWEST_ROWS]
    if not parts:
        raise _fault(path, f"has no episode of {FEWEST_ROWS} rows", "Record longer motions.")
    t = log.t_s
    usual = float(np.median(np.diff(t)))
    dropped = sum(
        int(np.sum(np.round(np.diff(t[part]) / usual - 1.0)[np.diff(t[part]) > DROPPED * usual])) for part in parts
    )
    carried = log.columns.get("payload_kg", np.zeros(len(t)))
    centre = _payload_centres(log)
    episodes = tuple(
        CommandEpisode(
            t[k] - t[k[0]], command[k], reading[k], float(carried[k[0]]), None if centre is None else centre[k[0]]
        )
        for k in parts
    )
    return CommandLog(path, episodes, dropped)


def _payload_centres(log: JointLog) -> Floats | None:
    """Centres (N, 3) m of what was carried, from the origin of its body; None where the log does not say."""
    named = [name for name in log.columns if name.startswith("payload_com_")]
    if not named:
        return None
    centres = np.zeros((len(log), 3))
    for name in named:
        axis, unit = name.removeprefix("payload_com_").split("_")
        centres[:, "xyz".index(axis)] = log.columns[name] * UNITS[unit]
    return centres


def _episodes(log: JointLog) -> Iterator[Floats]:
    """Rows of each episode: of one session and payload, without a gap in time."""
    t = log.t_s
    assert t is not None
    ends = np.diff(t) > GAP_ROWS * float(np.median(np.diff(t)))
    for name, values in log.columns.items():
        if name == "session" or name.startswith("payload_"):
            ends |= np.diff(values) != 0
    return iter(np.split(np.arange(len(t)), np.flatnonzero(ends) + 1))


def _fault(path: Path, what: str, remedy: str) -> FileError:
    return FileError(f"{path}: {what}. {remedy}", file=str(path), code="command_log")
