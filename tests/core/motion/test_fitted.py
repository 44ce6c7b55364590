"""Effects that somebody chose for a log: those that it does not show name nothing, and hide nothing."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion import MotionOptions, find_missing_torque, to_document
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Logger, ur_like


def test_a_delay_that_does_not_show_is_no_other_clock() -> None:
    logger = Logger(ur_like(np.random.default_rng(12)), seed=12, motions=4)
    log, robot = logger.log(), robot_from_document(logger.arm.document())
    options = MotionOptions(wanted={"torque_delay": None}, fitted=True)
    found = to_document(find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"]), options))
    assert found["effects"] == []
    assert [one["code"] for one in found["warnings"]] == ["effect_not_shown"]
    assert found["warnings"][0]["joints"] == [1, 2, 3, 4, 5, 6]
