"""Many programs of every dialect through `kilter filter`: each line is a target and rewritten, or named, or untouched."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter

from .answered import document
from .program_generator import OPTIONS, Generator
from .program_lines import Line
from .six_joint_arms import Arm, Floats, limits_deg
from .test_filter_poses import (
    BASE,
    ERRORS,
    TOOL,
    WITHIN_MM,
    calibrated,
    fanuc_back,
    of_zyx,
    rapid_back,
    taught,
    urscript_back,
)

DIALECTS = {
    "krl": ("kr6-r900", ".src"), "rapid": ("irb120", ".mod"), "urscript": ("ur10e", ".script"), "fanuc": ("irb120", ".ls"),
}  # fmt: skip
MARKS = {
    "krl": r";Kilter corrected ver_\w{16}", "rapid": r"  ! Kilter corrected ver_\w{16}",
    "urscript": r"# Kilter corrected ver_\w{16}", "fanuc": r" *\d*:  !Kilter corrected ver_\w{11} ;",
}  # fmt: skip
NEAR_DEG = 0.01
LIST = r"\[[^\[\]]*\]"
COMPUTED = re.compile(r"(?:Offs|RelTool) *\([^()]*\)", re.I)
NUMBER = r"-?\d+\.\d+(?:[eE]-?\d+)?"


def joints_of(text: str, dialect: str) -> Floats:
    """Joints of a corrected line, deg."""
    if dialect == "krl":
        axes = dict(re.findall(rf"(?i)\bA(\d)\s+({NUMBER})", text.partition(";")[0]))
        return np.array([float(axes[k]) for k in sorted(axes)])
    start = r"J\d = " if dialect == "fanuc" else ""
    found = np.array([float(v) for v in re.findall(f"{start}({NUMBER})", text)[:6]])
    return np.degrees(found) if dialect == "urscript" else found


def poses_of(text: str, dialect: str) -> list[Floats]:
    """The poses of a corrected line."""
    if dialect == "krl":
        lists = re.findall(r"\{([^}]*)\}", text.partition(";")[0])
        return [of_zyx(np.array([float(v) for v in re.findall(r"(?i)\b[XYZABC]\s+(-?[\d.]+)", one)])) for one in lists]
    if dialect == "rapid":
        lists = re.findall(r"\[\[[^\]]*\],\[[^\]]*\],\[[^\]]*\],\[[^\]]*\]\]", text)
        return [rapid_back(f"robtarget :={one}")[0][0] for one in lists]
    return [urscript_back(f"movel(p[{one}]")[0][0] for one in re.findall(r"p\[(.*?)\]", text)]


def off_mm(arm: tuple[Arm, Arm], line: Line, text: str, dialect: str) -> float:
    """How far the real arm is from where the line was taught, if the nominal controller carries the new text out."""
    ideal, real = arm
    assert line.q is not None
    if line.what == "joints":
        return float(np.linalg.norm((real.flange(joints_of(text, dialect)) - ideal.flange(line.q))[:3, 3]))
    base = np.eye(4) if dialect == "urscript" and "pose_trans(ref_frame" not in text else BASE
    goals, poses = [q for q in (line.via, line.q) if q is not None], poses_of(text, dialect)
    return max(of_pose(arm, q, base @ pose) for q, pose in zip(goals, poses, strict=True))


def of_pose(arm: tuple[Arm, Arm], q: Floats, pose: Floats) -> float:
    """The same for the pose of the tool in the frame of the root."""
    ideal, real = arm
    command = ideal.joints(pose @ np.linalg.inv(TOOL), q)
    return float(np.linalg.norm((real.flange(command) @ TOOL - ideal.flange(q) @ TOOL)[:3, 3]))


def is_limited(arm: tuple[Arm, Arm], q: Floats, bounds: Floats, most_deg: float) -> bool:
    """Whether the command that brings the real arm there is beyond a joint's limit, or further than a version corrects."""
    ideal, real = arm
    command = real.joints(ideal.flange(q), q)
    beyond = (command < bounds[:, 0] + NEAR_DEG) | (command > bounds[:, 1] - NEAR_DEG)
    return bool(beyond.any() or np.abs(command - q).max() > most_deg - NEAR_DEG)


def check(
    dialect: str, lines: list[Line], new: list[str], told: dict[str, object], arm: tuple[Arm, Arm], most_deg: float
) -> float:
    """Every line is accounted for; the largest distance from a taught point, mm."""
    assert len(new) == len(lines)
    left = told["left"]
    assert isinstance(left, list)
    named = {one["line"] for one in left}
    held = told["not_ok"]  # targets that a limit holds, or that are damped: listed, and not exact
    assert isinstance(held, list)
    not_exact, names = {one["line"] for one in held}, {one["name"] for one in held}
    for one in held:
        assert one["status"] == "LIMITED", one  # the taught joints are away from singular postures
        line = lines[one["line"] - 1]  # of an arc, either point may be held
        goals = [q for q in (line.via, line.q) if q is not None]
        bounds = limits_deg(DIALECTS[dialect][0])
        assert not goals or any(is_limited(arm, q, bounds, most_deg) for q in goals), (one, goals)
    worst = 0.0
    for number, (line, text) in enumerate(zip(lines, new, strict=True), 1):
        if line.what in ("joints", "pose", "turns"):
            assert number not in named, (line, left)
            assert text != line.text or line.what == "turns"
            assert re.sub(NUMBER, "#", text) == re.sub(NUMBER, "#", line.text)
            if (dialect != "fanuc" or line.what == "joints") and not not_exact & {number, header(lines, number)}:
                worst = max(worst, off_mm(arm, line, text, dialect))
        elif line.what == "computed":  # written out in its place
            assert number not in named, (line, left)
            assert re.sub(rf"\[{LIST},{LIST},{LIST},{LIST}\]", "#", text) == COMPUTED.sub("#", line.text)
            if number not in not_exact:
                worst = max(worst, off_mm(arm, line, text, dialect))
        else:
            assert text == line.text
            assert (number in named) == (line.what == "named"), (number, line, left)
    if dialect == "fanuc":
        positions = [line for line in lines if line.q is not None and " mm" in line.text]
        for (name, pose), line in zip(fanuc_poses("\n".join(new)), positions, strict=True):
            assert line.q is not None
            if name not in names and line.what == "pose":
                worst = max(worst, of_pose(arm, line.q, BASE @ pose))
    return worst


def header(lines: list[Line], number: int) -> int:
    """The line, from 1, at which the position of a FANUC program begins in which a line is; its own elsewhere."""
    return next((k for k in range(number, 0, -1) if re.match(r"P\[\d+\]\{", lines[k - 1].text)), number)


def fanuc_poses(text: str) -> list[tuple[str, Floats]]:
    """Names and poses of the positions that are not shown as joints."""
    blocks = re.findall(r"(P\[\d+\])(\{.*?\};)", text, re.S)
    return [(name, fanuc_back(f"P[1]{block}")[0][0]) for name, block in blocks if "X = " in block]


def through(kilter: Kilter, folder: Path, dialect: str, count: int, capsys: pytest.CaptureFixture[str]) -> None:
    preset, ending = DIALECTS[dialect]
    name = f"poses-{preset}"
    if name not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, preset, folder / "measured.csv")
    arm, q = (Arm(preset), Arm(preset, ERRORS)), taught(preset, 60, seed=7)
    rng = np.random.default_rng(sum(map(ord, dialect)))
    active = str(kilter.robots.get(name)["active_version"])
    worst, most_deg = 0.0, kilter.versions.get(active)["limits"]["max_joint_deg"]
    for _ in range(count):
        lines: list[Line] = getattr(Generator(rng, preset, q), dialect)(int(rng.integers(8, 30)))
        path, output = folder / f"w{ending}", folder / f"out{ending}"
        end = ("\n", "\r\n")[rng.integers(2)]
        path.write_bytes(end.join(line.text for line in lines).encode())
        capsys.readouterr()
        told = document(capsys, "filter", path, "--robot", name, "-o", output, *OPTIONS.get(dialect, []))
        new = output.read_bytes().decode().split(end)
        marks = [line for line in new if "Kilter corrected" in line]
        assert [re.fullmatch(MARKS[dialect], line) is not None for line in marks] == [True]
        new.remove(marks[0])
        again = document(capsys, "filter", output, "--robot", name, "--diff", *OPTIONS.get(dialect, []), code=1)
        assert "its targets are corrected already" in again["detail"]
        worst = max(worst, check(dialect, lines, new, told, arm, most_deg))
    assert 0.0 < worst < WITHIN_MM


@pytest.mark.parametrize("dialect", [*DIALECTS])
def test_every_line_of_a_program_is_accounted_for(
    kilter: Kilter, tmp_path: Path, dialect: str, capsys: pytest.CaptureFixture[str]
) -> None:
    through(kilter, tmp_path, dialect, 4, capsys)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("dialect", [*DIALECTS])
def test_every_line_of_fifty_programs_is_accounted_for(
    kilter: Kilter, tmp_path: Path, dialect: str, capsys: pytest.CaptureFixture[str]
) -> None:
    through(kilter, tmp_path, dialect, 50, capsys)
