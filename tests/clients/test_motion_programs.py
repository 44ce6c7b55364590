"""Planned motions as programs: what a controller would do by them is what was planned, read back without Kilter's readers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kilter_client.cli.plans import refuse_other_endings, write_motions
from kilter_client.errors import UsageError

HZ = 50.0
NUMBER = r"-?\d+(?:\.\d+)?"


def planned(joints: int = 6) -> tuple[str, np.ndarray, np.ndarray]:
    """Two motions from rest to rest, a second of rest about each."""
    s = np.arange(0.0, 6.0, 1.0 / HZ)
    lift = np.sin(np.pi * s / 6.0) ** 4
    one = [lift * 30.0 * np.sin(0.9 * s * (j + 1) / 3.0 + k) for k in range(2) for j in range(joints)]
    rest = np.zeros((int(HZ), joints))
    first, second = np.array(one[:joints]).T, np.array(one[joints:]).T
    q = np.linspace(-40.0, 40.0, joints) + np.concatenate([rest, first, rest, second, rest])
    t = np.arange(len(q)) / HZ
    rows = [",".join(["t_s", *(f"q{j + 1}_deg" for j in range(joints))])]
    rows += [",".join(f"{value:.5f}" for value in row) for row in np.column_stack([t, q])]
    return "\n".join([*rows, ""]), t, q


def numbers(text: str) -> list[float]:
    return [float(one) for one in re.findall(NUMBER, text)]


def driven_urscript(text: str) -> tuple[np.ndarray, np.ndarray]:
    first = numbers(re.search(r"movej\(\[(.*?)\]", text)[1])
    t, q = [0.0], [first]
    for place, rest in re.findall(r"servoj\(\[(.*?)\], 0, 0, (.*)\)", text):
        t.append(t[-1] + float(rest.split(",")[0]))
        q.append(numbers(place))
    return np.array(t), np.degrees(q)


def driven_rapid(text: str) -> tuple[np.ndarray, np.ndarray]:
    t, q = [0.0], []
    for line in text.splitlines():
        if "WaitTime" in line:
            t.append(t[-1] + numbers(line)[0])
            q.append(q[-1])
        elif "MoveAbsJ" in line:
            place = numbers(re.search(r"\[\[(.*?)\]", line)[1])
            if q:
                t.append(t[-1] + float(re.search(r"\\T:=([\d.]+)", line)[1]))
            q.append(place)
    return np.array(t), np.array(q)


def driven_krl(text: str) -> tuple[np.ndarray, np.ndarray]:
    t, q, parts = [0.0], [], 0.0
    for line in text.splitlines():
        if line.startswith("PTP {"):
            q.append([float(one) for one in re.findall(rf"A\d ({NUMBER})", line)])
        elif "WAIT SEC" in line:
            t.append(t[-1] + numbers(line)[0])
            q.append(q[-1])
        elif "SPTP" in line:
            q.append([float(one) for one in re.findall(rf"A\d ({NUMBER})", line)])
        elif "TIME_BLOCK PART" in line:
            t.append(t[-1] + numbers(line)[0])
            parts += numbers(line)[0]
        elif "TIME_BLOCK END" in line:
            assert numbers(line)[0] == pytest.approx(parts, abs=0.01)
            parts = 0.0
    return np.array(t), np.array(q)


def driven_tp(text: str) -> tuple[np.ndarray, np.ndarray]:
    moves, places = text.split("/POS")
    told = {int(k): [float(x) for x in re.findall(rf"J\d = ({NUMBER}) deg", of)] for k, of in
            re.findall(r"P\[(\d+)\]\{(.*?)\};", places, re.S)}  # fmt: skip
    t, q = [0.0], []
    for line in moves.splitlines():
        if wait := re.search(rf"WAIT ({NUMBER})\(sec\)", line):
            t.append(t[-1] + float(wait[1]))
            q.append(q[-1])
        elif move := re.search(r":J P\[(\d+)\] (\d+)(msec|%)", line):
            if move[3] == "msec":
                t.append(t[-1] + float(move[2]) / 1e3)
            q.append(told[int(move[1])])
    return np.array(t), np.array(q)


@pytest.mark.parametrize(
    ("ending", "drive"),
    [(".script", driven_urscript), (".mod", driven_rapid), (".src", driven_krl), (".ls", driven_tp)],
)
def test_a_program_drives_what_was_planned(ending: str, drive: object) -> None:
    text, t, q = planned()
    at, driven = drive(write_motions(Path(f"motions{ending}"), "ur10", text))
    assert at[-1] == pytest.approx(t[-1], abs=1.1)  # the last rest needs no target
    inside = t <= at[-1]
    between = np.stack([np.interp(t[inside], at, one) for one in driven.T], axis=1)
    assert (
        np.abs(between - q[inside]).max() < 0.5
    )  # straight between targets 0.1 s apart; a controller's spline is nearer
    assert len(at) > 60


def test_a_program_says_that_nobody_checked_it() -> None:
    for ending in (".script", ".mod", ".src", ".ls"):
        assert "collisions" in write_motions(Path(f"m{ending}"), "ur10", planned()[0])


def test_a_tp_program_stops_after_each_motion_and_says_that_its_times_are_rough() -> None:
    text = write_motions(Path("m.ls"), "fanuc", planned()[0])
    assert len(re.findall(r"msec FINE ;", text)) == 2
    assert "times are about" in " ".join(re.findall(r":!(.*?) ;", text))
    assert max(len(one) for one in re.findall(r":!(.*?) ;", text)) <= 32


def test_what_a_dialect_cannot_move_is_refused() -> None:
    with pytest.raises(UsageError, match="6 revolute joints"):
        write_motions(Path("m.script"), "seven", planned(7)[0])
    with pytest.raises(UsageError, match="up to 6"):
        write_motions(Path("m.src"), "rail", planned()[0].replace("q1_deg", "q1_mm"))
    assert "A4" in write_motions(Path("m.src"), "four", planned(4)[0])
    with pytest.raises(UsageError, match="name one of these"):
        refuse_other_endings(Path("m.jbi"))
    assert write_motions(Path("m.csv"), "ur10", planned()[0]) == planned()[0]
