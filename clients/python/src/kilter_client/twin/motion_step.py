"""The step for what a servo lacks and MuJoCo has no element for, from the table that ``kilter gap --model`` writes.

Call :func:`kilter.twin.apply` before every ``mj_step``; :func:`read_joints` gives what the sensors of the arm would read.
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from typing import Any

from kilter_client.errors import UsageError

TABLE, FORMAT = "kilter_motion", 1


def apply_motion(model: Any, data: Any, text: bytes) -> None:
    """Set friction and torques of the joints in a table for the next step.

    Args:
        model: an ``mjModel``; its friction and its actuators' offsets are set.
        data: its ``mjData``; ``userdata`` keeps what lies in the past.
        text: the table.

    """
    for name, own in parse_table(text)["joints"].items():
        joint = model.joint(name)
        dof, actuator = int(joint.dofadr[0]), model.actuator(own["actuator"]).id
        if "load_friction" in own or "stick" in own:
            speed = float(data.qvel[dof])
            moving = own.get("moving_load") and data.time > 0.0
            carried = abs(_carried_torque(model, data, dof) if moving else float(data.qfrc_bias[dof]))
            friction = own["friction"] + own.get("load_friction", 0.0) * carried
            if "stick" in own:
                friction += own["stick"] * math.exp(-((speed / own["slip_speed"]) ** 2))
            model.dof_frictionloss[dof] = friction
        if own.get("servo_behind"):
            second = float(data.qpos[model.joint(own["second"]).qposadr[0]])
            model.actuator_biasprm[actuator, 0] = model.actuator_biasprm[actuator, 1] * second
        if "effort_delay" in own:
            data.qfrc_applied[dof] = _late_torque(model, data, own, actuator, dof, int(joint.qposadr[0]))
        if "sensor_lag" in own:
            _lag(model, data, own, name)


def read_joints(model: Any, data: Any) -> dict[str, float]:
    """Return what the encoders of the joints in the table would read, rad (m); other joints are ``data.qpos`` itself."""
    text = model_text(model, TABLE)
    if text is None:
        return {}
    joints = parse_table(text)["joints"]
    return {
        name: float(data.userdata[own["lag_at"]]) + own.get("reading_offset", 0.0)
        if "sensor_lag" in own
        else _angle(model, data, own, name) + own.get("reading_offset", 0.0)
        for name, own in joints.items()
    }


def model_text(model: Any, name: str) -> bytes | None:
    """Return a text among a model's ``<custom>``."""
    named = bytes(model.names)
    at = next((k for k, start in enumerate(model.name_textadr) if named.startswith(name.encode() + b"\0", start)), None)
    if at is None:
        return None
    start = int(model.text_adr[at])
    return bytes(model.text_data[start : start + int(model.text_size[at])]).rstrip(b"\0")


@lru_cache(maxsize=16)
def parse_table(text: bytes) -> dict[str, Any]:
    """Read a table of this release.

    Raises:
        UsageError: it is of a later one.

    """
    table: dict[str, Any] = json.loads(text)
    if table.get("format") != FORMAT:
        raise UsageError(
            f"The model's table has format {table.get('format')!r}, this release knows {FORMAT}: update kilter-client, "
            "or export the version again."
        )
    return table


def _carried_torque(model: Any, data: Any, dof: int) -> float:
    """Torque that the gear passed on to the bodies in the last step."""
    torque = data.qfrc_actuator[dof] + data.qfrc_passive[dof] + data.qfrc_constraint[dof] + data.qfrc_applied[dof]
    return float(torque - model.dof_armature[dof] * data.qacc[dof])


def _late_torque(model: Any, data: Any, own: dict[str, Any], actuator: int, dof: int, place: int) -> float:
    """What has to be added to the torque of the servo so that it comes late; the past lies in a ring of ``userdata``."""
    first, length = own["ring"]
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
    now = float(gain * data.ctrl[actuator] + bias[0] + bias[1] * data.qpos[place] + bias[2] * data.qvel[dof])
    step = round(data.time / model.opt.timestep)
    ring = data.userdata[first : first + length]
    if step == 0:
        ring[:] = now
    ring[step % length] = now
    late = min(own["effort_delay"] / model.opt.timestep, length - 2)
    n = int(late)
    share = late - n
    past = (1.0 - share) * ring[(step - n) % length] + share * ring[(step - n - 1) % length]
    return float(past - now)


def _lag(model: Any, data: Any, own: dict[str, Any], name: str) -> None:
    at, reading = own["lag_at"], _angle(model, data, own, name)
    if data.time == 0.0:
        data.userdata[at] = reading
    data.userdata[at] += (reading - data.userdata[at]) * (1.0 - math.exp(-model.opt.timestep / own["sensor_lag"]))


def _angle(model: Any, data: Any, own: dict[str, Any], name: str) -> float:
    angle = float(data.qpos[model.joint(name).qposadr[0]])
    if own.get("reads_behind"):
        angle += float(data.qpos[model.joint(own["second"]).qposadr[0]])
    return angle
