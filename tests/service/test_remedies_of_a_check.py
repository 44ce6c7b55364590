"""What a check says to do where a frame moved: the remedies are carried out."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.watch import check
from kilter_service.versions.drift import wire
from tests.core.watch.drifting import some_arm, some_poses

EFFECTS = ({"id": "axial_compliance", "joints": [2, 3]},)


@pytest.mark.parametrize("moved", ["base", "tool"])
def test_a_frame_that_moved_may_have_been_set_up_anew(moved: Literal["base", "tool"]) -> None:
    rng = np.random.default_rng(3)
    arm = some_arm(rng)
    rows = arm.measured(some_poses(50, rng), rng, 5e-5)
    options = IdentifyOptions(effects=EFFECTS, masses="as_stated")
    version = identify(robot_from_document(arm.document()), rows, options=options)
    assert version.predictive is not None
    shift = np.eye(4)
    shift[:3, 3] = 0.03, -0.02, 0.01
    other = replace(arm, **{moved: shift @ getattr(arm, moved)})
    again = other.measured(some_poses(6, rng), rng, 5e-5)
    found = check(version.calibration, again, version.predictive)
    assert [one.cause.name for one in found.causes] == [moved]
    said = wire.remedy(found)
    assert said is not None
    anew = {"base": ("base",), "tool": ("base", "tool")}[moved]
    assert f"(--new-setup {','.join(anew)}). Else: Repair it and check again" in said
    assert check(version.calibration, again, version.predictive, new_setup=anew).verdict == "ok"
    zero = arm.after("zero_3", 4e-3).measured(some_poses(6, rng), rng, 5e-5)
    assert wire.remedy(check(version.calibration, zero, version.predictive)) == wire.MOVED
