"""An SO-101 as MuJoCo has it, with what low-cost arms have: zeros off, links off, soft drives, backlash, whole ticks.

Written here from the public model's numbers; it shares nothing with Kilter's own export.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.clients.lerobot.so101_arm import JOINTS, PRESET, elements, move

Floats = NDArray[np.float64]

TICK_DEG = 360.0 / 4096.0
REACH = np.radians(3.0)  # before a pose, from which its joints come
STEP_S, MOVES_S, RESTS_S = 2e-3, 0.6, 1.2
LIMITS = 'solreflimit="0.01 1" solimplimit="0.99 0.9999 1e-6 0.5 2"'


@dataclass(frozen=True)
class Twin:
    """Of each joint ``zeros_deg`` (real less reading), ``stiffness`` N m/rad, ``play_deg`` (whole); ``errors`` of links."""

    zeros_deg: Sequence[float]
    stiffness: Sequence[float]
    play_deg: Sequence[float]
    errors: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def model(self) -> Any:
        return mujoco.MjModel.from_xml_string(self.xml())

    def xml(self) -> str:
        """A body for each joint, a second hinge with limits where there is play, a payload and a site at the tool."""
        links: list[dict[str, Any]] = json.loads(PRESET.read_text())["links"]
        T, opened, drives = np.eye(4), [], []
        for one in elements():
            value = one.get("value", 0.0) + self.errors.get(one.get("name", ""), 0.0)
            if "joint" in one:
                k = JOINTS.index(one["joint"])
                T = T @ move("Rz", np.radians(value + self.zeros_deg[k]))
                opened.append(self._body(k, T, links[k]))
                drives.append(
                    f'<position name="{one["joint"]}" joint="{one["joint"]}" kp="{self.stiffness[k]}" dampratio="1"/>'
                )
                T = np.eye(4)
            else:
                T = T @ move(one["axis"], np.radians(value) if one["axis"][0] == "R" else value)
        tool = (
            f'<body name="payload" {_place(T)}><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            f'<site name="tool"/></body>'
        )
        return (
            f'<mujoco><compiler angle="radian"/><option timestep="{STEP_S}" integrator="discrete"/><worldbody>'
            + "".join(opened) + tool + "</body>" * len(opened)
            + f'</worldbody><actuator>{"".join(drives)}</actuator></mujoco>'
        )  # fmt: skip

    def _body(self, k: int, T: Floats, link: Mapping[str, Any]) -> str:
        half = np.radians(self.play_deg[k]) / 2.0
        play = ""
        if half > 0.0:
            own = f'limited="true" range="{-half} {half}" armature="0.01" damping="0.05" {LIMITS}'
            play = f'<joint name="{JOINTS[k]}_play" axis="0 0 1" {own}/>'
        com = " ".join(f"{0.001 * one}" for one in link["com_mm"])
        return (
            f'<body name="{JOINTS[k]}" {_place(T)}><joint name="{JOINTS[k]}" axis="0 0 1" armature="0.028"/>{play}'
            f'<inertial pos="{com}" mass="{link["mass_kg"]}" diaginertia="1e-4 1e-4 1e-4"/>'
        )

    def settled(self, reading_deg: Floats, side: Floats, payload_kg: float) -> Floats:
        """Pose (4, 4) of the tool, mm, after the joints came to their readings (5,) from their sides."""
        model, data = self.model, mujoco.MjData(self.model)
        model.body_mass[model.body("payload").id] = max(payload_kg, 1e-6)
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        reading = np.radians(reading_deg)
        start = reading - REACH * side
        for joint, value in zip(JOINTS, start, strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = value
        moves = round(MOVES_S / STEP_S)
        for k in range(moves + round(RESTS_S / STEP_S)):
            data.ctrl[:] = start + (reading - start) * min(1.0, (k + 1) / moves)
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.site("tool").xmat.reshape(3, 3), 1e3 * data.site("tool").xpos
        return T


def gravity_nm(reading_deg: Floats, payload_kg: float) -> Floats:
    """Moments (5,) of gravity about the joints of an arm without errors: against what MuJoCo says holds it."""
    model, data = NOMINAL.model, mujoco.MjData(NOMINAL.model)
    model.body_mass[model.body("payload").id] = max(payload_kg, 1e-6)
    mujoco.mj_setConst(model, data)
    data.qpos[:] = np.radians(reading_deg)
    mujoco.mj_forward(model, data)
    return np.array(-data.qfrc_bias)


def ticks(angles_deg: Floats) -> Floats:
    """Angles as servos read them."""
    return np.round(angles_deg / TICK_DEG) * TICK_DEG


def _place(T: Floats) -> str:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T[:3, :3]).ravel())
    pos = " ".join(repr(0.001 * float(one)) for one in T[:3, 3])
    return f'pos="{pos}" quat="{" ".join(repr(float(one)) for one in quat)}"'


NOMINAL = Twin([0.0] * 5, [1e4] * 5, [0.0] * 5)
