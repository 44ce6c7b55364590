"""What a check says to do where a frame moved: the remedies are carried out."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.watch import Check, check
from kilter_core.watch.arm_check import Judged
from kilter_core.watch.causes import Cause
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


@pytest.mark.parametrize(
    ("cause", "names", "said", "unsaid"),
    [
        (Cause("scale", None), (), "Check the instrument with a known length", "kilter watch rezero"),
        (Cause("sag", 2), ("theta_offset_2",), "identify one anew with axial_compliance", "kilter watch rezero"),
        (Cause("sag", 2), ("compliance_2",), "state it (payload_kg) and check again. Else: Repair it", "no number"),
    ],
)
def test_no_remedy_asks_for_a_version_that_a_re_zeroing_refuses(
    cause: Cause, names: tuple[str, ...], said: str, unsaid: str
) -> None:
    one = Judged(cause, 90.0, 1, 20.0, np.ones(1), np.ones(1), np.zeros(0), False, np.ones(1), np.ones(1))
    told = wire.remedy(Check("moved", (one,), (one,), 1e-9, 99.0, 18, 6, 1e-4, 5e-5, {}, (), ()), names)
    assert told is not None
    assert said in told
    assert unsaid not in told
