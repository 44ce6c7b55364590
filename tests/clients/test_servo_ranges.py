"""Draws of `kilter gap --model --ranges` cover motion that the search never read: MuJoCo drives each draw, here alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from kilter_client.twin.servo_gap import find_servo_gap
from tests.clients.servo_arm import Floats, Hidden, Log, record
from tests.clients.test_servo_gap import ONE, write_model

DELAY = Hidden("command_delay", 0, 0.05)
FROM_S = 1.0


def drawn_model(text: str, draw: dict[str, float]) -> Any:
    """The copy with the numbers of a draw, by their names."""
    spec = mujoco.MjSpec.from_string(text)
    joint, servo = spec.joint("j1"), spec.actuators[0]
    joint.armature, joint.frictionloss = draw["j1.armature_kg_m2"], draw["j1.friction_nm"]
    joint.damping = [draw["j1.damping_nm_s_rad"], 0.0, 0.0]
    servo.gainprm[0], servo.biasprm[1] = draw["j1.gain_nm_rad"], -draw["j1.gain_nm_rad"]
    if "j1.command_delay_s" in draw:
        servo.delay = draw["j1.command_delay_s"]
    return spec.compile()


def replay(model: Any, log: Log) -> Floats:
    model.body("payload").mass[:] = log.payload_kg
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    data.qpos[0] = log.reading[0, 0]
    count = int(model.actuator_history[0, 0])
    if count:
        times = (np.arange(count) - count) * model.opt.timestep
        mujoco.mj_initCtrlHistory(model, data, 0, times, np.full(count, log.command[0, 0]))
    read = np.empty(len(log.t))
    steps = round((log.t[1] - log.t[0]) / model.opt.timestep)
    for k in range(len(log.t)):
        read[k] = data.qpos[0]
        data.ctrl[0] = log.command[k, 0]
        mujoco.mj_step(model, data, steps)
    return read


def coverage(folder: Path, hidden: Hidden | None, seed: int, draws: int) -> tuple[float, float]:
    """Share of held-out readings within the ranges, and how much of their width is that of the draws."""
    logs = [folder / f"log{k}.csv" for k in range(5)]
    for k, path in enumerate(logs):
        record(100 * seed + k, hidden, ONE, 12.0).write(path)
    found, copy = find_servo_gap(write_model(folder), logs)
    ranges = found["ranges"]
    inside, widths = [], []
    for k in range(3):
        log = record(100 * seed + 50 + k, hidden, ONE, 12.0)
        rows = log.t > FROM_S
        paths = np.array([replay(drawn_model(copy.text, one), log)[rows] for one in ranges["draws"][:draws]])
        spread = np.std(paths, axis=0)
        half = np.hypot(1.96 * spread, ranges["readings"]["j1.reading_within_rad"])
        inside.append(np.abs(log.reading[rows, 0] - paths.mean(axis=0)) <= half)
        widths.append(1.96 * spread / half)
    return float(np.mean(inside)), float(np.mean(widths))


@pytest.mark.parametrize(("hidden", "seed"), [(None, 1), (DELAY, 1)])
def test_draws_cover_readings_that_no_search_saw(tmp_path: Path, hidden: Hidden | None, seed: int) -> None:
    covered, of_draws = coverage(tmp_path, hidden, seed, 30)
    assert covered == pytest.approx(0.95, abs=0.015)
    assert of_draws > 0.0
