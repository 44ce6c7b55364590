"""A whole arm of MuJoCo driven by the commands of a log: its readings, and where its tool is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from kilter_client.twin.command_log import CommandEpisode
from kilter_client.twin.motion_step import TABLE, model_text, parse_table, read_joints
from kilter_client.twin.servo_model import ServoModel
from kilter_client.twin.step import apply
from kilter_files.ground.later import mujoco, np

if TYPE_CHECKING:
    from kilter_files.ground import Floats


def replay_readings(arm: ServoModel, model: Any, episodes: Sequence[CommandEpisode]) -> Floats:
    """Readings (R, n) of an arm, its own model or a patched copy, in some episodes; not finite where it diverges."""
    return np.concatenate([_run(arm, model, one) for one in episodes])


def _run(arm: ServoModel, model: Any, one: CommandEpisode) -> Floats:
    arm.hang(model, one.payload_kg)
    data = mujoco.MjData(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    places = [int(model.joint(name).qposadr[0]) for name in arm.joints]
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    text = model_text(model, TABLE)
    table = {} if text is None else parse_table(text)["joints"]
    data.qpos[places] = one.reading[0] - [table.get(name, {}).get("reading_offset", 0.0) for name in arm.joints]
    data.qvel[dofs] = (one.reading[2] - one.reading[0]) / (one.t[2] - one.t[0])
    _fill_history(arm, model, data, one.command[0])
    mujoco.mj_forward(model, data)
    steps = np.round((one.t - one.t[0]) / model.opt.timestep).astype(int)
    read = np.empty_like(one.reading)
    for k in range(len(one.t)):
        read[k] = data.qpos[places]
        if table:
            sensed = read_joints(model, data)
            read[k] = [sensed.get(name, value) for name, value in zip(arm.joints, read[k], strict=True)]
        data.ctrl[list(arm.actuators)] = one.command[k]
        count = int(steps[k + 1] - steps[k]) if k + 1 < len(steps) else 0
        if not table and count:
            mujoco.mj_step(model, data, count)
        for _ in range(count if table else 0):
            apply(model, data)
            mujoco.mj_step(model, data)
    return read


def _fill_history(arm: ServoModel, model: Any, data: Any, command: Floats) -> None:
    """Let commands that come late be the first one before the log begins."""
    for actuator, value in zip(arm.actuators, command, strict=True):
        count = int(model.actuator_history[actuator, 0]) if hasattr(model, "actuator_history") else 0
        if count:
            times = (np.arange(count) - count) * model.opt.timestep
            mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(count, value))


def tool_points(arm: ServoModel, readings: Floats, site: str) -> Floats:
    """Points (N, 3) m of a site at readings (N, n), by the user's own model."""
    model, data = arm.model, mujoco.MjData(arm.model)
    at = model.site(site).id
    places = [int(model.jnt_qposadr[j]) for j in arm.ids]
    points = np.empty((len(readings), 3))
    for k, reading in enumerate(readings):
        data.qpos[places] = reading
        mujoco.mj_kinematics(model, data)
        points[k] = data.site_xpos[at]
    return points
