"""A user's model of MuJoCo as the joints that a log commands: their servos, and what their bodies ask along a motion.

The model stays as it is: friction, damping and servos are read from it; loads and inertias are computed along the readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_client.twin.settled import HINGE, JOINT, SLIDE, find_element_id, load_model
from kilter_core.rollout import JointEpisode, JointRecord, Servo
from kilter_files.ground.later import mujoco, np

if TYPE_CHECKING:
    from kilter_client.twin.command_log import CommandLog
    from kilter_files.ground import Floats

SMOOTH_S = 0.16  # over which speeds and accelerations are taken from readings
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
            _refuse_joint(model, path, name, j, driven.get(j))
        if model.opt.timestep > LARGEST_STEP_S:
            raise FileError(
                f"{path}: its time step of {model.opt.timestep * 1e3:g} ms is too long for a servo: "
                'write <option timestep="0.002"/>.',
                file=str(path),
                code="model_step",
            )
        mujoco.set_mju_user_warning(lambda _: None)
        return cls(path, model, tuple(names), tuple(ids), tuple(driven[j] for j in ids), payload)

    def records(self, logs: Sequence[CommandLog]) -> list[JointRecord]:
        """Return what each joint was told and read in all episodes, with the loads of its bodies along the readings."""
        episodes: list[list[JointEpisode]] = [[] for _ in self.joints]
        for log in logs:
            for one in log.episodes:
                self.hang(self.model, one.payload_kg)
                load, slope, inertia = self._loads(one.t, one.reading)
                for j in range(len(self.joints)):
                    command = self._clamped(j, one.command[:, j])
                    own = (load[:, j].copy(), slope[:, j].copy(), inertia[:, j].copy())
                    episodes[j].append(JointEpisode(one.t, command, one.reading[:, j].copy(), *own))
        return [
            JointRecord(
                name,
                tuple(episodes[j]),
                self.servo(j).numbers(),
                float(self.model.opt.timestep),
                int(self.model.jnt_type[self.ids[j]]) == SLIDE,
            )
            for j, name in enumerate(self.joints)
        ]

    def hang(self, model: Any, payload_kg: float) -> None:
        """Let ``model`` carry a payload.

        Raises:
            FileError: it has no body for one.

        """
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.payload)
        if body >= 0:
            model.body_mass[body] = max(payload_kg, 1e-9)
            mujoco.mj_setConst(model, mujoco.MjData(model))
        elif payload_kg > 0.0:
            raise FileError(
                f"{self.path}: a log carries {payload_kg:g} kg, the model has no body for it: name one with --payload-body.",
                file=str(self.path),
                code="model_payload",
            )

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
        )

    def _clamped(self, j: int, command: Floats) -> Floats:
        a = self.actuators[j]
        if not self.model.actuator_ctrllimited[a]:
            return command.copy()
        return np.asarray(np.clip(command, *self.model.actuator_ctrlrange[a]))

    def _loads(self, t: Floats, reading: Floats) -> tuple[Floats, Floats, Floats]:
        """Load, its slope and inertia (N, n) of the bodies at each joint along readings (N, n), without those of the drives."""
        m, data = self.model, mujoco.MjData(self.model)
        q, qd, qdd = _smooth(t, reading)
        places, dofs = [m.jnt_qposadr[j] for j in self.ids], [int(m.jnt_dofadr[j]) for j in self.ids]
        start, torque, unit, product = m.qpos0.copy(), np.zeros(m.nv), np.zeros(m.nv), np.zeros(m.nv)

        def weigh(k: int, at: Floats) -> Floats:
            data.qpos[:] = start
            data.qpos[places], data.qvel[dofs], data.qacc[dofs] = at, qd[k], qdd[k]
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
                stage(m, data)
            mujoco.mj_rne(m, data, 1, torque)
            return torque[dofs].copy()

        load, slope, inertia = (np.zeros_like(reading) for _ in range(3))
        for k in range(len(t)):
            for j in range(len(dofs)):
                moved = q[k].copy()
                moved[j] += SLOPE_RAD
                slope[k, j] = weigh(k, moved)[j]
            whole = weigh(k, q[k])
            mujoco.mj_crb(m, data)
            for j, dof in enumerate(dofs):
                unit[:] = 0.0
                unit[dof] = 1.0
                mujoco.mj_mulM(m, data, product, unit)
                inertia[k, j] = product[dof] - m.dof_armature[dof]
            slope[k] = (slope[k] - whole) / SLOPE_RAD
            load[k] = whole - inertia[k] * qdd[k]
        return load, slope, np.maximum(inertia, 1e-9)


def _actuators_by_joint(model: Any) -> dict[int, int]:
    return {int(model.actuator_trnid[a, 0]): a for a in range(model.nu) if int(model.actuator_trntype[a]) == JOINT}


def _name(model: Any, joint: int) -> str:
    return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint {joint + 1}")


def _refuse_joint(model: Any, path: Path, name: str, joint: int, actuator: int | None) -> None:
    if int(model.jnt_type[joint]) not in (HINGE, SLIDE):
        raise FileError(
            f"{path}: {name} is a free or ball joint, and a log commands hinges and slides: name those with --joints.",
            file=str(path),
            code="model_joint",
        )
    if actuator is None:
        raise FileError(
            f'{path}: no actuator drives {name}. Add <position joint="{name}" kp="..."/>, or leave it out with --joints.',
            file=str(path),
            code="model_without_actuator",
        )
    gain, bias = float(model.actuator_gainprm[actuator, 0]), float(model.actuator_biasprm[actuator, 1])
    if not (bias < 0.0 and abs(gain + bias) < 1e-9 * abs(gain)):
        kind = "a velocity or torque" if bias == 0.0 else "no position"
        raise FileError(
            f"{path}: the actuator of {name} is {kind} actuator, and the log commands positions. Replace it by "
            f'<position joint="{name}" kp="..."/> with the gain of the servo.',
            file=str(path),
            code="model_actuator",
        )


def _smooth(t: Floats, reading: Floats) -> tuple[Floats, Floats, Floats]:
    """Readings, speeds and accelerations (N, n), by cubics over a short while (Savitzky and Golay 1964)."""
    from scipy.signal import savgol_filter

    dt = float(np.median(np.diff(t)))
    width = min(max(5, round(SMOOTH_S / dt) | 1), (len(t) - 1) | 1)
    filtered = [savgol_filter(reading, width, 3, deriv=k, delta=dt, axis=0) for k in range(3)]
    return filtered[0], filtered[1], filtered[2]
