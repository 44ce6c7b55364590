"""Searches in logs of real arms: channels without a signal, structure that nobody named, and an effect hidden in real noise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.core.motion.inject import KUKA, TIAGO, kuka, named_in, search, shapes, tiago

needs_tiago = pytest.mark.skipif(not TIAGO.exists(), reason="the log of TIAGo is not here")


@needs_tiago
def test_channels_without_a_signal_do_not_keep_other_joints_from_a_name() -> None:
    log = tiago()
    found = search(log, log.tau)
    (odd,) = [one for one in found["warnings"] if one["code"] == "torques_unexplained"]
    assert {6, 7, 8} <= set(odd["joints"])
    assert not {joint for _, joint in named_in(found)} & set(odd["joints"])
    assert {3, 4, 5} <= {joint for _, joint in named_in(found)}
    for joint in (2, 3, 4, 5):
        torques = found["motion"]["joints"][joint - 1]
        assert torques["found"] < 0.3 * torques["rigid"]


@needs_tiago
@pytest.mark.parametrize("joint", [2, 4])
def test_a_ripple_that_is_hidden_in_a_real_log_is_named(joint: int) -> None:
    log = tiago()
    left = search(log, log.tau)["motion"]["joints"][joint - 1]["found"]
    hidden, tau = shapes(log)["gear_ripple"](joint - 1), log.tau.copy()
    tau[:, joint - 1] += left * hidden / np.std(hidden)
    found = search(log, tau)
    assert ("gear_ripple", joint) in named_in(found)
    assert {one["verdict"] for one in found["effects"]} <= {"provisional", "contradicted"}  # it is one motion


@pytest.mark.skipif(not KUKA.exists(), reason="the log of the KR300 is not here")
def test_half_a_minute_makes_nothing_certain() -> None:
    log = kuka()
    found = search(log, log.tau)
    assert {one["verdict"] for one in found["effects"]} <= {"provisional", "contradicted"}
    friction = {one["name"]: one["value"] for one in found["motion"]["friction"]}
    for joint in (2, 3):  # published: 500-540 N m
        assert 350.0 < friction[f"coulomb_friction_{joint}"] < 600.0
