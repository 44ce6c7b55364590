"""Logs of servo arms in MuJoCo in which an effect is hidden: commands at 50 Hz, readings in ticks of a 12-bit encoder.

Nothing here imports the core. What MuJoCo has no element for is done at each of its steps.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
TICK_RAD = 2.0 * np.pi / 4096
AXES = ("0 0 1", "0 1 0", "0 1 0")
BODIES = (
    ("0 0 0", "0 0 .05", 0.2, "2e-4 2e-4 2e-4"),
    ("0 0 .06", "0 0 .06", 0.15, "2e-4 2e-4 5e-5"),
    ("0 0 .12", ".07 0 0", 0.18, "5e-5 3e-4 3e-4"),
)
PLAY = 'solreflimit="{} 1" solimplimit="0.99 0.9999 1e-6 0.5 2"'  # in twice a step, the shortest that MuJoCo takes


@dataclass(frozen=True)
class Hidden:
    """An effect at a joint (from 0), as large as ``size`` in SI; ``read`` names the side of the gear that is logged."""

    effect: str
    joint: int
    size: float
    read: str = "motor"


@dataclass(frozen=True)
class Servos:
    """What each joint has: armature kg m2, friction N m, damping N m s/rad, gain N m/rad."""

    armature: tuple[float, ...] = (0.03, 0.028, 0.02)
    friction: tuple[float, ...] = (0.06, 0.08, 0.05)
    damping: tuple[float, ...] = (0.6, 0.7, 0.4)
    gain: tuple[float, ...] = (18.0, 22.0, 15.0)
    payload_kg: float = 0.0
    lever_m: float = 0.0  # of the payload, beyond the tool

    def of_joint(self, j: int) -> Servos:
        """The last joint of an arm alone, with the servo of joint ``j``."""
        own = ((each[j],) for each in (self.armature, self.friction, self.damping, self.gain))
        return Servos(*own, payload_kg=self.payload_kg, lever_m=self.lever_m)


NOMINAL = Servos((0.01,) * 3, (0.0,) * 3, (0.3,) * 3, (30.0,) * 3)


@dataclass(frozen=True)
class Log:
    """Times (N,) s, commands and readings (N, n) rad."""

    t: Floats
    command: Floats
    reading: Floats
    payload_kg: float = 0.0
    lever_m: float = 0.0

    def write(self, path: object) -> None:
        n = self.command.shape[1]
        names = [
            "t_s",
            "payload_kg",
            "payload_com_x_mm",
            *(f"q{k + 1}_deg" for k in range(n)),
            *(f"cmd{k + 1}_deg" for k in range(n)),
        ]
        table = np.column_stack(
            [
                self.t,
                np.full(len(self.t), self.payload_kg),
                np.full(len(self.t), 1e3 * self.lever_m),
                np.degrees(self.reading),
                np.degrees(self.command),
            ]
        )
        np.savetxt(str(path), table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")


def arm_xml(servos: Servos, hidden: Hidden | None = None, timestep_s: float = 0.002) -> str:
    """The arm as MJCF, with elements for hidden play or a hidden soft gear."""
    carried = max(servos.payload_kg, 1e-9)
    load = f'<inertial pos="{servos.lever_m} 0 0" mass="{carried}" diaginertia="1e-9 1e-9 1e-9"/>'
    inner = f'<site name="tool" pos=".15 0 0"/><body name="payload" pos=".15 0 0">{load}</body>'
    count = len(servos.gain)
    for k in reversed(range(count)):
        axis, (where, com, mass, inertia) = AXES[k - count], BODIES[k - count]
        own = f'armature="{servos.armature[k]}" frictionloss="{servos.friction[k]}" damping="{servos.damping[k]}"'
        joints = f'<joint name="j{k + 1}" axis="{axis}" {own}/>'
        if hidden is not None and hidden.joint == k and hidden.effect == "backlash":
            half = 0.5 * hidden.size
            limits = f'limited="true" range="{-half} {half}" {PLAY.format(2.0 * timestep_s)}'
            joints += f'<joint name="play" axis="{axis}" armature="1e-4" damping="1e-3" {limits}/>'
        if hidden is not None and hidden.joint == k and hidden.effect == "flexible_gear":
            stiff = 1.0 / hidden.size
            joints += f'<joint name="soft" axis="{axis}" stiffness="{stiff}" damping="{0.003 * stiff}"/>'
        inner = (
            f'<body name="b{k + 1}" pos="{where}">{joints}<inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/>'
            f"{inner}</body>"
        )
    drives = "".join(f'<position name="a{k + 1}" joint="j{k + 1}" kp="{servos.gain[k]}"/>' for k in range(count))
    return (
        f'<mujoco model="servo_arm"><compiler angle="radian"/><option timestep="{timestep_s}" integrator="implicitfast"/>'
        f"<worldbody>{inner}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def some_commands(rng: np.random.Generator, seconds: float, dt: float, joints: int) -> tuple[Floats, Floats]:
    """Times and commands of all joints: sums of sines, with steps that are held for a second."""
    t: Floats = np.arange(int(seconds / dt), dtype=np.float64) * dt
    command = np.zeros((len(t), joints))
    for j in range(joints):
        for _ in range(5):
            f = rng.uniform(0.05, 0.9)
            command[:, j] += rng.normal(0, 0.25) / (1 + f) * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
        for _ in range(int(seconds / 4)):
            k = int(rng.integers(len(t)))
            command[k : k + int(1 / dt), j] += rng.normal(0, 0.12)
    if joints == 1:
        command -= 1.4  # about upright, where the load changes its sign
    return t, command


def record(
    seed: int,
    hidden: Hidden | None = None,
    servos: Servos | None = None,
    seconds: float = 15.0,
    dt: float = 0.02,
    step_s: float = 0.002,
) -> Log:
    """Drive the arm and log what it reads."""
    servos = servos or Servos()
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(arm_xml(servos, hidden, step_s))
    data = mujoco.MjData(model)
    t, command = some_commands(rng, seconds, dt, len(servos.gain))
    qpos = [int(model.jnt_qposadr[model.joint(f"j{k + 1}").id]) for k in range(len(servos.gain))]
    data.qpos[qpos] = command[0]
    j = -1 if hidden is None else hidden.joint
    effect, size = (None, 0.0) if hidden is None else (hidden.effect, hidden.size)
    if effect == "torque_limit":
        model.actuator_forcelimited[j], model.actuator_forcerange[j] = 1, [-size, size]
    dof = int(model.jnt_dofadr[model.joint(f"j{j + 1}").id]) if hidden is not None else 0
    past: deque[float] = deque(maxlen=1 + max(0, round(size / step_s)) if effect == "effort_delay" else 1)
    reading = np.zeros_like(command)
    for k in range(len(t)):
        reading[k] = data.qpos[qpos]
        if hidden is not None and hidden.read == "body":
            reading[k, j] += data.qpos[qpos[j] + 1]
        if effect == "reading_offset":
            reading[k, j] += size
        for s in range(round(dt / step_s)):
            data.ctrl[:] = command[k]
            if effect == "command_delay":
                data.ctrl[j] = command[max(int(np.floor((t[k] + s * step_s - size) / dt + 1e-9)), 0), j]
            elif effect == "load_friction":
                model.dof_frictionloss[dof] = servos.friction[j] + size * abs(data.qfrc_bias[dof])
            elif effect == "effort_delay":
                torque = servos.gain[j] * (data.ctrl[j] - data.qpos[qpos[j]])
                past.append(torque)
                data.qfrc_applied[dof] = past[0] - torque
            mujoco.mj_step(model, data)
    return Log(t, command, np.round(reading / TICK_RAD) * TICK_RAD, servos.payload_kg, servos.lever_m)
