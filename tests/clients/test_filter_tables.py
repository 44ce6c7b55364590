"""Many programs in CSV through `kilter filter`: each row is a target and rewritten, and no other cell changes."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run

from .answered import document
from .six_joint_arms import Arm, Floats
from .test_filter_poses import ERRORS, WITHIN_MM, calibrated, taught

PRESET, JOINTS = "ur10e", [f"q{k}" for k in range(1, 7)]
NOTES = ["", "weld", '"weld, slow"', '"say ""go"", then 5.5, 6.25"', "7.125", "-1e-3", "Öffnen"]
OTHERS = ["t_s", "name", "note", "speed_mm_s", "done"]


class Table:
    """A table of targets, its columns in any order, with what else a program may carry."""

    def __init__(self, rng: np.random.Generator, q: Floats) -> None:
        self._rng, self.unit = rng, ("deg", "rad")[rng.integers(2)]
        others = [name for name in OTHERS if rng.random() < 0.6]
        self.columns = [str(one) for one in rng.permutation([*JOINTS, *others])]
        head = ",".join(f"{one}_{self.unit}" if one in JOINTS else one for one in self.columns)
        self.lines, self.q = [f'"{head.replace(",", chr(34) + "," + chr(34))}"' if rng.random() < 0.2 else head], []
        for k, at in enumerate(q):
            if rng.random() < 0.1:
                self.lines.append("")
                self.q.append(None)
            self.lines.append(",".join(self._cell(name, k, at) for name in self.columns))
            self.q.append(at)

    def _cell(self, name: str, k: int, at: Floats) -> str:
        if name in JOINTS:
            value = at[JOINTS.index(name)]
            shown = (f"{value:.9f}", f"{np.radians(value):.12f}")[self.unit == "rad"]
            return (shown, f" {shown}", f"+{shown}" if value > 0 else shown)[self._rng.integers(3)]
        return {"t_s": f"{0.1 * k:.3f}", "speed_mm_s": "250.0", "done": "0"}.get(
            name, NOTES[self._rng.integers(len(NOTES))]
        )

    def joints(self, line: str) -> Floats:
        """Joints of a line, deg, as any reader of CSV has them."""
        cells = next(csv.reader(io.StringIO(line)))
        found = np.array([float(cells[self.columns.index(name)]) for name in JOINTS])
        return np.degrees(found) if self.unit == "rad" else found

    def rest(self, line: str) -> list[str]:
        """The other cells of a line."""
        cells = next(csv.reader(io.StringIO(line)), [])
        return [cell for cell, name in zip(cells, self.columns, strict=False) if name not in JOINTS]


def through(kilter: Kilter, folder: Path, count: int, capsys: pytest.CaptureFixture[str]) -> None:
    name = f"poses-{PRESET}"
    if name not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, PRESET, folder / "measured.csv")
    active = str(kilter.robots.get(name)["active_version"])
    ideal, real, rng = Arm(PRESET), Arm(PRESET, ERRORS), np.random.default_rng(8)
    all_q, worst = taught(PRESET, 60, seed=7), 0.0
    for _ in range(count):
        table = Table(rng, all_q[rng.integers(len(all_q), size=rng.integers(3, 25))])
        path, output, end = folder / "w.csv", folder / "out.csv", ("\n", "\r\n")[rng.integers(2)]
        path.write_bytes((end.join(table.lines) + ("", end)[rng.integers(2)]).encode())
        capsys.readouterr()
        told = document(capsys, "filter", path, "--robot", name, "-o", output)
        before, after = path.read_bytes().decode(), output.read_bytes().decode()
        marked = [line.rpartition(",")[2] for line in after.splitlines() if line.strip()]
        assert marked == ["kilter_corrected", *[active] * (len(marked) - 1)]
        after = re.sub(r",(?:kilter_corrected|ver_\w+)(?=[\r\n]|$)", "", after)
        assert [line[len(line.rstrip("\r\n")) :] for line in before.splitlines(keepends=True)] == [
            line[len(line.rstrip("\r\n")) :] for line in after.splitlines(keepends=True)
        ]
        assert told["left"] == []
        assert told["targets"] == sum(q is not None for q in table.q)
        held = {one["line"] for one in told["not_ok"]}
        old, new = before.splitlines(), after.splitlines()
        assert (len(old), old[0]) == (len(new), new[0])
        for number, (was, now, q) in enumerate(zip(old[1:], new[1:], table.q, strict=True), 2):
            assert table.rest(was) == table.rest(now)
            if q is None:
                assert now == was
            elif number not in held:
                assert now != was
                off = (real.flange(table.joints(now)) - ideal.flange(q))[:3, 3]
                worst = max(worst, float(np.linalg.norm(off)))
    assert 0.0 < worst < WITHIN_MM


def test_every_row_of_a_table_is_accounted_for(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    through(kilter, tmp_path, 8, capsys)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_row_of_fifty_tables_is_accounted_for(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    through(kilter, tmp_path, 50, capsys)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n1,2,3,4,5\n", "5 joints"),
        ("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,nan,6\n", "line 2"),
        ("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,5\n", "line 2"),
        ("q1_deg,q2_rad,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,5,6\n", "two units"),
    ],
)
def test_a_table_that_cannot_be_read_is_refused_with_its_place(
    kilter: Kilter, tmp_path: Path, rows: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"poses-{PRESET}"
    if name not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, PRESET, tmp_path / "measured.csv")
    path = tmp_path / "w.csv"
    path.write_text(rows)
    capsys.readouterr()
    assert run(["filter", str(path), "--robot", name, "-o", str(tmp_path / "out.csv")]) != 0
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()
