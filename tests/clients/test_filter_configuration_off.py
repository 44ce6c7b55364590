"""RAPID with ConfL or ConfJ off: the controller takes the posture next to the one it has, whatever the confdata says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter

from .answered import document
from .six_joint_arms import Arm, Floats, limits_deg
from .test_filter_poses import (
    BASE,
    ERRORS,
    TOOL,
    WITHIN_MM,
    calibrated,
    confdata,
    lines_left,
    quaternion,
    rapid_back,
    taught,
)

NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
HEAD = f"""MODULE w
  PERS tooldata grip := [TRUE,[{quaternion(TOOL)}],[1,[0,0,1],[1,0,0,0],0,0,0]];
  PERS wobjdata bench := [FALSE,TRUE,"",[{quaternion(BASE)}],[[0,0,0],[1,0,0,0]]];
"""
WITH = "v100, z10, grip\\WObj:=bench;"
WRONG = "[1,-2,1,7]"  # what programs made offline state, which the controller does not look at


@pytest.fixture
def arm(kilter: Kilter, tmp_path: Path) -> str:
    """An arm that is calibrated once for all tests of the module."""
    if "poses-irb120" not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, "irb120", tmp_path / "measured.csv")
    return "poses-irb120"


def joints(q: Floats) -> str:
    return f"  MoveAbsJ [[{','.join(f'{v:.9f}' for v in q)}],{NO_AXES}], v200, z50, grip;"


def target(name: str, q: Floats, stated: str) -> str:
    pose = np.linalg.inv(BASE) @ Arm("irb120").flange(q) @ TOOL
    return f"  CONST robtarget {name} := [{quaternion(pose)},{stated},{NO_AXES}];"


def near(q: Floats, by: float) -> Floats:
    """Joints some degrees away, towards the middle of the limits."""
    return q - by * np.array([1.0, 0.6, 0.8, 1.2, 0.7, 0.9]) * np.sign(q - limits_deg("irb120").mean(axis=1))


def off_mm(before: Floats, line: str, q: Floats) -> float:
    """How far the real arm is from the taught point, where the nominal controller takes the posture next to the last one."""
    ideal, real = Arm("irb120"), Arm("irb120", ERRORS)
    pose, _ = rapid_back(f"robtarget {line.partition('robtarget ')[2]}")[0]
    command = ideal.joints(BASE @ pose @ np.linalg.inv(TOOL), before)
    assert np.abs(command - q).max() < 3.0
    return float(np.linalg.norm((real.flange(command) @ TOOL - ideal.flange(q) @ TOOL)[:3, 3]))


def filtered(
    arm: str, folder: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> tuple[dict[int, str], dict[str, str]]:
    """What is left, and the lines of the targets as corrected by their names."""
    (folder / "w.mod").write_text(text)
    told = document(capsys, "filter", folder / "w.mod", "--robot", arm, "-o", folder / "out.mod")
    new = [line for line in (folder / "out.mod").read_text().splitlines() if "robtarget" in line]
    return lines_left(told), {line.split()[2]: line for line in new}


def test_with_confl_off_poses_follow_the_joints_before_them(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The layout of programs made offline: both off at first, joints, then lines to targets of any confdata."""
    for k, q in enumerate(taught("irb120", 6, seed=23)):
        one, two, three = near(q, 3.0), near(q, 6.0), near(q, 8.0)
        targets = [target("p1", one, WRONG), target("p2", two, WRONG), target("p3", three, WRONG)]
        moves = [joints(q), f"  MoveL p1, {WITH}", f"  WaitTime 0.5;\n  MoveL p2, {WITH}", f"  MoveJ p3, {WITH}"]
        text = "\n".join(
            [HEAD, *targets, "PROC main()", "  ConfJ\\Off;", "  ConfL \\Off;", *moves, "ENDPROC", "ENDMODULE"]
        )
        left, new = filtered(arm, tmp_path, text, capsys)
        assert not left, (q, left)
        assert new["p1"] != targets[0], k
        assert WRONG in new["p1"]  # nobody looks at it, so nobody changes it
        assert off_mm(q, new["p1"], one) < WITHIN_MM
        assert off_mm(one, new["p2"], two) < WITHIN_MM


def test_what_is_off_for_lines_counts_for_joint_moves(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    q = taught("irb120", 1, seed=29)[0]
    one = near(q, 3.0)
    body = ["PROC main()", "  ConfJ \\On;", "  ConfL\\Off;", f"  MoveJ p0, {WITH}", f"  MoveL p1, {WITH}"]
    targets = [target("p0", q, confdata(q)), target("p1", one, WRONG)]
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, *targets, *body, "ENDPROC", "ENDMODULE"]), capsys)
    assert left == {}
    assert off_mm(q, new["p0"], q) < WITHIN_MM
    assert off_mm(q, new["p1"], one) < WITHIN_MM
    again = [*body, "  ConfL\\On;", f"  MoveL p1, {WITH}"]  # where it is on, the confdata counts, and does not fit
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, *targets, *again, "ENDPROC", "ENDMODULE"]), capsys)
    assert "have its configuration" in left[6]
    assert new["p1"] == targets[1]


def test_where_the_text_does_not_say_whether_it_is_off_both_must_agree(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    q = taught("irb120", 1, seed=31)[0]
    one, two = near(q, 3.0), near(q, 5.0)
    targets = [target("p1", one, confdata(one)), target("p2", two, WRONG), target("p3", two, confdata(two))]
    body = [
        "PROC main()", "  IF di1=1 THEN", "  ConfL\\Off;", "  ENDIF", joints(q), f"  MoveL p1, {WITH}", f"  MoveL p2, {WITH}",
        "  go;", f"  MoveL p3, {WITH}", "ENDPROC", "PROC go()", "ENDPROC", "ENDMODULE",
    ]  # fmt: skip
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, *targets, *body]), capsys)
    assert off_mm(q, new["p1"], one) < WITHIN_MM
    assert new["p2"] == targets[1]
    assert "have its configuration" in left[6]
    assert (
        "ConfL \\Off may be in force, and the target from which the arm comes is not known: write ConfL \\On" in left[7]
    )
    body[4:4] = ["  ConfL \\On;"]  # the remedy
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, *targets, *body]), capsys)
    assert 7 not in left
    assert off_mm(two, new["p3"], two) < WITHIN_MM


def test_elements_that_a_loop_moves_to_by_a_computed_index_are_corrected(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    q = taught("irb120", 3, seed=37)
    whole = [target("p", one, confdata(one)).partition(":= ")[2].rstrip(";") for one in q]
    rows = f"  CONST robtarget row{{3}} := [{','.join(whole)}];"
    body = ["PROC main()", "  FOR i FROM 1 TO 3 DO", f"  MoveL row{{i}}, {WITH}", "  ENDFOR", "ENDPROC", "ENDMODULE"]
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, rows, *body]), capsys)
    assert left == {}
    corrected = new["row{3}"].partition(":= [")[2].replace("]],[[[", "]],[[").split("]],[[")
    assert len(corrected) == 3
    for one, text in zip(q, new["row{3}"].split(f",{NO_AXES}]")[:3], strict=True):
        body_of = text.rpartition("[[[")[2] if "[[[" in text else text.rpartition(",[[")[2]
        assert off_mm(one, f"robtarget p := [[{body_of},{NO_AXES}];", one) < WITHIN_MM


@pytest.mark.parametrize(
    ("inside", "known"), [("  ConfL\\Off;", True), ("  IF di1=1 THEN\n  ConfL\\Off;\n  ENDIF", False)]
)
def test_a_routine_that_is_called_may_switch_it_off(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], inside: str, known: bool
) -> None:
    q = taught("irb120", 1, seed=67)[0]
    one = near(q, 3.0)
    body = [
        "PROC main()", "  init;", joints(q), f"  MoveL p1, {WITH}", "ENDPROC", "PROC init()", inside, "  AccSet 50,50;",
        "ENDPROC", "ENDMODULE",
    ]  # fmt: skip
    left, new = filtered(arm, tmp_path, "\n".join([HEAD, target("p1", one, WRONG), *body]), capsys)
    assert (left == {}) == known
    assert (new["p1"] != target("p1", one, WRONG)) == known
    if known:
        assert off_mm(q, new["p1"], one) < WITHIN_MM
