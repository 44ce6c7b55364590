"""Public-style programs through `kilter filter`: no crash, and no number changes that is not right by other kinematics."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client import Kilter

from .answered import document
from .public_programs import WRITERS, Row, Truth, Writer
from .six_joint_arms import Arm, Floats, shift
from .test_filter_poses import ERRORS, calibrated, of_zyx, taught

WITHIN_MM = {
    "rapid": 1e-4,
    "krl": 1e-5,
    "fanuc": 1e-3,
    "urscript": 1e-6,
}  # a rail that reads some um costs RAPID and KRL some
NUMBER = r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?"


def numbers_of(text: str) -> list[float]:
    return [float(v) for v in re.findall(NUMBER, text)]


def pose_of(dialect: str, text: str) -> Floats:
    """Pose (4, 4) mm of the target in a row."""
    if dialect == "rapid":
        v = numbers_of(
            re.findall(r"\[\[[^\]]*\],\[[^\]]*\],\[[^\]]*\],\[[^\]]*\]\]?", text.replace(":=[[[", ":=[["))[0]
        )
        T = shift(*v[:3])
        T[:3, :3] = Rotation.from_quat([*v[4:7], v[3]]).as_matrix()
        return T
    if dialect == "krl":
        said = text.partition("{")[2].partition("}")[0]
        return of_zyx(np.array([float(re.findall(rf"\b{n} ({NUMBER})", said)[0]) for n in "XYZABC"]))
    if dialect == "fanuc":
        x, y, z, w, p, r = (float(re.findall(rf"\b{n} = +({NUMBER})", text)[0]) for n in "XYZWPR")
        return of_zyx(np.array([x, y, z, r, p, w]))
    v = numbers_of(text.rpartition("p[")[2].partition("]")[0])
    T = shift(*np.array(v[:3]) * 1e3)
    T[:3, :3] = Rotation.from_rotvec(v[3:6]).as_matrix()
    return T


def joints_of(dialect: str, text: str) -> Floats:
    """Joints deg of the target in a row."""
    if dialect in ("krl", "fanuc"):
        sign = "A" if dialect == "krl" else "J"
        return np.array([float(re.findall(rf"\b{sign}{k}(?: |= *)({NUMBER})", text)[0]) for k in range(1, 7)])
    inside = numbers_of(text.partition("[[" if dialect == "rapid" else "[")[2].partition("]")[0])
    return np.array(inside) if dialect == "rapid" else np.degrees(inside)


def off_mm(dialect: str, text: str, truth: Truth) -> float:
    """How far the real arm is from where it was taught, if the nominal controller carries the text out."""
    preset = WRITERS[dialect][0]
    ideal, real = Arm(preset), Arm(preset, ERRORS)
    if truth.joints:
        command = joints_of(dialect, text)
        assert np.abs(command - truth.q).max() < 3
    else:
        command = ideal.joints(truth.base @ pose_of(dialect, text) @ np.linalg.inv(truth.tool), truth.q)
    return float(np.linalg.norm((real.flange(command) @ truth.tool - ideal.flange(truth.q) @ truth.tool)[:3, 3]))


def check(
    dialect: str, rows: list[Row], new: list[str], told: dict[str, list[dict[str, int]]], seen: Counter[str]
) -> None:
    """Each row is byte for byte the same, or right; a target that stays is named."""
    named = {one["line"] for one in told["left"]}
    held = {one["line"] for one in told["not_ok"]}
    at = 0
    for row in rows:
        lines = row.text.split("\n")
        text, place = "\n".join(new[at : at + len(lines)]), set(range(at + 1, at + len(lines) + 1))
        at += len(lines)
        if text != row.text:
            assert row.truth is not None, (row.text, text)
            seen["changed"] += 1
            if not place & held:
                assert off_mm(dialect, text, row.truth) < WITHIN_MM[dialect], (row.text, text)
        elif row.truth is not None:
            seen["left"] += 1
            assert place & (named | held), row.text
    assert at == len(new)


def through(kilter: Kilter, folder: Path, dialect: str, count: int, capsys: pytest.CaptureFixture[str]) -> Counter[str]:
    """Filter programs: how many targets were corrected and left, and how many programs had none that could be."""
    preset, ending, write = WRITERS[dialect]
    name = f"poses-{preset}"
    if name not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, preset, folder / "measured.csv")
    q, seen = taught(preset, 80, seed=61), Counter[str]()
    options = ["--fanuc-j3", "same"] if dialect == "fanuc" else []
    for seed in range(count):
        rng = np.random.default_rng([sum(map(ord, dialect)), seed])
        rows = write(Writer(rng, preset, q), int(rng.integers(3, 14)))
        end = ("\n", "\r\n")[seed % 2]
        path, output = folder / f"w{seed}{ending}", folder / f"out{seed}{ending}"
        path.write_bytes(end.join("\n".join(row.text for row in rows).split("\n")).encode() + end.encode())
        capsys.readouterr()
        told = document(capsys, "filter", path, "--robot", name, "-o", output, *options)
        new = output.read_bytes().decode().removesuffix(end).split(end)
        marks = [line for line in new if "Kilter corrected" in line]
        assert len(marks) == 1
        new.remove(marks[0])
        check(dialect, rows, new, told, seen)
    return seen


@pytest.mark.parametrize("dialect", [*WRITERS])
def test_public_style_programs_are_corrected_or_left_by_name(
    kilter: Kilter, tmp_path: Path, dialect: str, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = through(kilter, tmp_path, dialect, 3, capsys)
    assert seen["changed"] > seen["left"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("dialect", [*WRITERS])
def test_three_hundred_public_style_programs(
    kilter: Kilter, tmp_path: Path, dialect: str, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = through(kilter, tmp_path, dialect, 75, capsys)
    assert seen["changed"] > seen["left"]
