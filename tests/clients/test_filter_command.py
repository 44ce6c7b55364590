"""`kilter filter`: a corrected program takes the real arm where the nominal arm was taught."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kilter_client import FileError, Kilter, UsageError, connect, connect_async
from kilter_client.cli import run

from .answered import document
from .three_joint_arm import Floats, tip_mm
from .three_joint_arm import arm as three_joint_arm

REAL_MM = (400.0, 300.6, 199.5)
OFF_DEG = np.array([0.1, -0.05, 0.08])
TAUGHT = np.array([[0.0, 30.0, 40.0], [50.0, 20.0, -30.0], [-40.0, 45.0, 60.0]])


def add_arm(kilter: Kilter, name: str, lengths: tuple[float, float, float], off_deg: Floats, path: Path) -> None:
    """Add the arm and activate what exact measurements of the arm with these lengths and offsets identify."""
    kilter.robots.add(three_joint_arm(name))
    rng = np.random.default_rng(3)
    q = rng.uniform((-90, 0, -80), (90, 70, 80), (60, 3))
    seen = tip_mm(q + off_deg, lengths) + rng.normal(0, 1e-3, q.shape)
    lines = [",".join(f"{v:.9g}" for v in row) for row in np.hstack([q, seen])]
    path.write_text("\n".join(["q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm", *lines, ""]))
    assert run(["upload", name, str(path), "--name", "monday"]) == 0
    fit = ["identify", name, "-c", "monday", "--level", "2", "--tool", "fixed", "--base", "fixed"]
    assert run(fit) == 0
    assert run(["activate", "latest", "--robot", name, "--force"]) == 0


@pytest.fixture(scope="module")
def added() -> list[str]:
    """The arm that the first test adds, and the others use as it is."""
    return []


@pytest.fixture
def arm(kilter: Kilter, tmp_path: Path, added: list[str]) -> str:
    if not added:
        add_arm(kilter, "filtered", REAL_MM, OFF_DEG, tmp_path / "measured.csv")
        added.append("filtered")
    return added[0]


def krl(rows: Floats) -> bytes:
    moves = "".join(f"PTP {{A1 {a:.3f}, A2 {b:.3f},A3 {c:.3f}}} ; {{A1 9}}\r\n" for a, b, c in rows)
    return f"DEF w()\r\n$VEL.CP=0.2\r\n{moves}END\r\n".encode()


def fanuc(rows: Floats) -> bytes:
    said = "".join(
        f"P[{k}]{{J1= {a:.3f} deg, J2= {b:.3f} deg, J3= {c:.3f} deg}};\n" for k, (a, b, c) in enumerate(rows)
    )
    return f"/PROG W\n/POS\n{said}/END\n".encode()


NUMBERS = re.compile(r"[AJ]\d=? (-?[\d.]+)")


def joints(text: bytes) -> Floats:
    moves = [line.partition(";")[0] for line in text.decode().splitlines() if line.startswith(("PTP", "P["))]
    return np.array([[float(v) for v in NUMBERS.findall(line)] for line in moves])


Writer = Callable[[Floats], bytes]


@pytest.mark.parametrize(
    ("name", "written", "options", "into", "tolerance_mm"),
    [
        ("w.src", krl, [], lambda q: q, 0.01),
        ("w.src", krl, ["--signs=+,-,+"], lambda q: q * [1, -1, 1], 0.01),
        ("w.ls", fanuc, ["--fanuc-j3", "coupled"], lambda q: q - np.outer(q[:, 1], [0, 0, 1]), 0.02),
    ],
)
def test_the_real_arm_goes_where_the_nominal_was_taught(
    arm: str, tmp_path: Path, name: str, written: Writer, options: list[str], into: Callable[[Floats], Floats],
    tolerance_mm: float, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path, output = tmp_path / name, tmp_path / f"out-{name}"
    path.write_bytes(written(into(TAUGHT)))
    told = document(capsys, "filter", path, "--robot", arm, "-o", output, "--diff", *options)
    assert told["targets"] == 3
    assert told["left"] == told["not_ok"] == []
    assert 0.05 < told["largest_change_deg"] < 2
    assert told["diff"].count("\n+") == 5  # the heading, three lines and the mark
    back = joints(output.read_bytes())
    if "coupled" in options:
        back[:, 2] += back[:, 1]
    if "--signs=+,-,+" in options:
        back[:, 1] *= -1
    wanted = tip_mm(TAUGHT)
    before = np.linalg.norm(tip_mm(TAUGHT + OFF_DEG, REAL_MM) - wanted, axis=1)
    after = np.linalg.norm(tip_mm(back + OFF_DEG, REAL_MM) - wanted, axis=1)
    assert before.min() > 0.3
    assert after.max() < tolerance_mm


def test_a_controller_that_compensates_is_named(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = "compensating"
    add_arm(kilter, arm, REAL_MM, OFF_DEG, tmp_path / "measured.csv")
    path, output = tmp_path / "weld.dat", tmp_path / "out.dat"
    path.write_bytes(krl(TAUGHT))
    for value, said in (("factory", "corrected twice"), ("unknown", "Check once whether"), ("none", "")):
        kilter.set_controller_compensation(arm, value)
        told = document(capsys, "filter", path, "--robot", arm, "-o", output)
        about = [note for note in told["notes"] if "controller" in note]
        assert said in "".join(about)
        assert bool(about) == bool(said)
    kilter.set_controller_compensation(arm, "kilter")
    assert run(["filter", str(path), "--robot", arm, "-o", str(output)]) == 0
    assert "Note: The controller of" in capsys.readouterr().err


def test_what_cannot_be_rewritten_is_refused_and_nothing_is_written(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_bytes(krl(TAUGHT).replace(b"END\r\n", b"LIN {X 1,Y 2,Z 3}\r\nEND\r\n"))
    told = document(capsys, "filter", path, "--robot", arm, "-o", output, "--strict", code=1)
    assert told["code"] == "file_invalid"
    assert "line 6: a move, a pose: without A, B, C" in told["detail"]
    assert not output.exists()
    told = document(capsys, "filter", path, "--robot", arm, "-o", output)
    assert told["left"] == [{"file": "w.src", "line": 6, "what": "a move, a pose: without A, B, C"}]
    assert b"LIN {X 1,Y 2,Z 3}\r\n" in output.read_bytes()
    output.unlink()
    path.write_bytes(krl(np.array([[0.0, 30, 40], [999, 0, 0]])))
    for options, remedy in (([], "within reach."), (["--strict"], "within reach. Or leave --strict out.")):
        said = document(capsys, "filter", path, "--robot", arm, "-o", output, *options, code=1)["detail"]
        assert "line 4: axis target: JOINT_LIMIT, j1 at 999 deg is beyond its limit of 170 deg" in said
        assert said.endswith(remedy)
    path.write_bytes(b"PTP {A1 1,A2 2}\n")
    assert "has 2 joints" in document(capsys, "filter", path, "--robot", arm, "-o", output, code=1)["detail"]
    assert not output.exists()
    assert document(capsys, "filter", path, "--robot", arm, "-o", path, code=2)["code"] == "usage"
    assert document(capsys, "filter", path, "--robot", arm, code=2)["code"] == "usage"
    (tmp_path / "w.ls").write_bytes(fanuc(TAUGHT))
    assert "--fanuc-j3" in document(capsys, "filter", tmp_path / "w.ls", "--robot", arm, "-o", output, code=2)["detail"]


def test_a_target_out_of_reach_after_its_correction_names_joint_angle_and_limit(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_bytes(krl(np.array([[0.0, 30, 40], [-170, 30, 40], [10, -171.5, 40], [20, 30, 170.25]])))
    said = document(capsys, "filter", path, "--robot", arm, "-o", output, code=1)["detail"]
    assert "line 5: axis target: JOINT_LIMIT, j2 at -171.5 deg is beyond its limit of -170 deg" in said
    assert "line 6: axis target: JOINT_LIMIT, j3 at 170.25 deg is beyond its limit of 170 deg" in said
    path.write_bytes(krl(np.array([[0.0, 30, 40], [-170, 30, 40], [10, 30, 40]])))
    told = document(capsys, "filter", path, "--robot", arm, "-o", output)
    held = (
        "j1 at -170 deg is held at its limit of -170 deg"  # j1 reads 0.1 deg too little: the correction is away from it
    )
    assert told["not_ok"] == [
        {"file": "w.src", "line": 4, "name": "axis target", "status": "LIMITED", "at_limits": held}
    ]
    assert run(["filter", str(path), "--robot", arm, "-o", str(output)]) == 0
    assert f"w.src, line 4: axis target is LIMITED: {held}" in capsys.readouterr().out
    path.write_bytes(krl(np.array([[0.0, 30, 40], [-169, 30, 40], [10, 30, 40]])))  # a degree away from the limit
    assert document(capsys, "filter", path, "--robot", arm, "-o", output, "--strict")["not_ok"] == []


def test_the_library_gives_what_the_command_writes(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_bytes(krl(TAUGHT).replace(b"END\r\n", b"LIN {X 1,Y 2,Z 3}\r\nEND\r\n"))
    told = document(capsys, "filter", path, "--robot", arm, "-o", output, "--diff", "--signs=+,-,+")
    with connect() as k:
        done = k.filter(arm, path, signs=(1, -1, 1))
        assert done.text.encode("latin-1") == output.read_bytes()
        assert done.save(tmp_path / "saved.src").read_bytes() == output.read_bytes()
        assert {key: told[key] for key in done if key != "texts"} == {key: done[key] for key in done if key != "texts"}
        assert repr(done).startswith("KRL: targets: 3, largest change 0.")
        assert repr(done).endswith("; left as they are: line 6")
        with pytest.raises(FileError, match=r"line 6: a move, a pose.* leave strict= out"):
            k.filter(arm, path, strict=True)
        with pytest.raises(UsageError, match=r"signs= \+,-: give \+ or - for each of the 3 joints"):
            k.filter(arm, path, signs="+,-")
        (tmp_path / "w.ls").write_bytes(fanuc(TAUGHT))
        with pytest.raises(UsageError, match='fanuc_j3="same" or fanuc_j3="coupled"'):
            k.filter(arm, tmp_path / "w.ls")

    async def awaited() -> str:
        async with connect_async() as k:
            return (await k.filter(arm, path, signs="+,-,+")).text

    assert asyncio.run(awaited()) == done.text


def told_version(robot: str) -> str:
    with connect() as k:
        return str(k.robots.get(robot)["active_version"])


SRC = """DEF weld( )
DECL INT N
BAS(#INITMOV,0 )
PTP XP2 C_PTP ; {A1 9}
{inline}
LIN XP3
PTP XP1
END
"""
DAT = """DEFDAT WELD PUBLIC
DECL E6AXIS XP1={A1 0.0,A2 30.0,A3 40.0,E1 0.0}
DECL E6AXIS XP2={A1 50.0,A2 20.0,A3 -30.0,E1 0.0} ; {A1 7}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}
DECL E6POS XP3={X 100.0,Y 0.0,Z 5.0,A 0.0,B 0.0,C 0.0,S 2,T 35}
ENDDAT
"""
NO_BASE = "its base is not set before it: state it, --base X,Y,Z,A,B,C"
INLINE = "PTP {A1 -40.0,A2 45.0,A3 60.0}"


@pytest.mark.parametrize("given", ["weld.src", "weld.DAT"])
def test_both_files_of_a_krl_program_are_rewritten_together(
    arm: str, tmp_path: Path, given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = {"weld.src": SRC.replace("{inline}", INLINE), "weld.DAT": DAT}
    for name, text in texts.items():
        (tmp_path / name).write_bytes(text.encode())
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / f"new{given[4:]}"
    told = document(capsys, "filter", tmp_path / given, "--robot", arm, "-o", output, "--diff")
    other = tmp_path / "out" / ("new.DAT" if given == "weld.src" else "new.src")
    assert told["written"] == [str(output), str(other)]
    assert told["targets"] == 3
    assert sorted((one["file"], one["line"], one["what"]) for one in told["left"]) == [
        ("weld.DAT", 5, f"XP3, a pose: {NO_BASE}"), ("weld.src", 6, "LIN XP3: a pose that is left"),
    ]  # fmt: skip
    after = {name: (tmp_path / "out" / f"new{name[4:]}").read_text().split("\n") for name in texts}
    marks = {name: lines.pop(-3) for name, lines in after.items()}
    assert {*marks.values()} == {f";Kilter corrected {told_version(arm)}"}
    changed = {
        (name, k): after[name][k] for name, text in texts.items() for k, line in enumerate(text.split("\n"))
        if line != after[name][k]
    }  # fmt: skip
    assert [*changed] == [("weld.src", 4), ("weld.DAT", 1), ("weld.DAT", 2)]
    assert all(len(after[name]) == len(text.split("\n")) for name, text in texts.items())
    assert told["diff"].count("\n+") == 7  # two headings, three lines and two marks
    assert changed["weld.DAT", 2].endswith(",E1 0.0} ; {A1 7}")
    back = np.array([[float(v) for v in NUMBERS.findall(line.partition(";")[0])] for line in changed.values()])
    taught = TAUGHT[[2, 0, 1]]
    before_mm = np.linalg.norm(tip_mm(taught + OFF_DEG, REAL_MM) - tip_mm(taught), axis=1)
    after_mm = np.linalg.norm(tip_mm(back + OFF_DEG, REAL_MM) - tip_mm(taught), axis=1)
    assert before_mm.min() > 0.3
    assert after_mm.max() < 0.01
    refused = document(capsys, "filter", tmp_path / given, "--robot", arm, "-o", output, "--strict", code=1)
    assert "weld.DAT, line 5: XP3, a pose" in refused["detail"]
    assert "weld.src, line 6: LIN XP3: a pose that is left" in refused["detail"]
    with connect() as k, pytest.raises(FileError) as caught:
        k.filter(arm, tmp_path / given, strict=True)
    places = {(Path(one["file"]).name, one["line"]) for one in caught.value.context["places"]}
    assert places == {("weld.DAT", 5), ("weld.src", 6)}


def test_the_second_file_is_named_before_it_is_written(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "weld.src").write_text(SRC.replace("{inline}", INLINE))
    (tmp_path / "weld.dat").write_text(DAT)
    assert run(["filter", str(tmp_path / "weld.src"), "--robot", arm, "-o", str(tmp_path / "new.txt")]) == 2
    assert "weld.dat is written beside it, so name a file that ends in .src" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.glob("new*")) == []
    (tmp_path / "weld.dat").write_text(DAT.replace("A1 50.0", "A1 999.0"))
    detail = document(capsys, "filter", tmp_path / "weld.src", "--robot", arm, "--diff", code=1)["detail"]
    assert "weld.dat, line 3: XP2: " in detail
    (tmp_path / "weld.dat").write_text(DAT.replace("ENDDAT", ";Kilter corrected ver_7\nENDDAT"))
    detail = document(capsys, "filter", tmp_path / "weld.src", "--robot", arm, "--diff", code=1)["detail"]
    assert "weld.dat, line 6: its targets are corrected already, by version ver_7. Filter the program as" in detail
    (tmp_path / "weld.dat").write_text(DAT)
    own = ["filter", str(tmp_path / "weld.src"), "--robot", arm, "-o", str(tmp_path / "weld.src"), "--overwrite"]
    assert run(own) == 0
    assert (tmp_path / "weld.dat").read_text() != DAT


def test_both_files_are_written_or_neither(arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "weld.src").write_text(SRC.replace("{inline}", INLINE))
    (tmp_path / "weld.dat").write_text(DAT)
    out = tmp_path / "out"
    out.mkdir()
    (out / "new.src").write_text("what was there")
    (out / "new.dat").mkdir()  # the second file cannot be put there
    options = [str(tmp_path / "weld.src"), "--robot", arm, "-o", str(out / "new.src")]
    assert run(["filter", *options]) == 1
    assert "new.dat: cannot be written" in capsys.readouterr().err
    assert (out / "new.src").read_text() == "what was there"
    (out / "new.src").unlink()
    assert run(["filter", *options]) == 1
    assert [path.name for path in out.iterdir()] == ["new.dat"]
    (out / "new.dat").rmdir()
    assert run(["filter", *options]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["new.dat", "new.src"]


FORMS = {
    "w.src": ("DEF w()\nPTP {A1 0.0,A2 30.0,A3 40.0}\nEND\n", [], 3),
    "w.script": ("def w():\n  movej([0.0,0.5,0.7])\nend\n", [], 3),
    "plain.script": ("movej([0.0,0.5,0.7])\n", [], 1),
    "w.ls": (
        "/PROG W\n/MN\n   1:J P[1] 100% FINE ;\n/POS\nP[1]{\n J1= 0.0 deg, J2= 30.0 deg, J3= 40.0 deg\n};\n/END\n",
        ["--fanuc-j3", "same"], 4,
    ),
    "w.csv": ("note,q1_deg,q2_deg,q3_deg\na\x85b,0.0,30.0,40.0\n\n", [], 2),
}  # fmt: skip


@pytest.mark.parametrize("name", [*FORMS])
def test_a_program_that_was_corrected_says_so_and_is_not_corrected_once_more_unless_asked(
    arm: str, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text, options, line = FORMS[name]
    (tmp_path / "old").mkdir()
    path, once, twice = tmp_path / "old" / name, tmp_path / name, tmp_path / f"twice-{name}"
    path.write_bytes(text.encode("latin-1"))
    document(capsys, "filter", path, "--robot", arm, "-o", once, *options)
    refused = document(capsys, "filter", once, "--robot", arm, "-o", twice, *options, code=1)
    version = told_version(arm)[:15]
    assert f"{once}, line {line}: its targets are corrected already, by version {version}" in refused["detail"]
    assert (refused["code"], twice.exists()) == ("file_invalid", False)
    told = document(capsys, "filter", once, "--robot", arm, "-o", twice, "--again", *options)  # as the remedy says
    assert told["targets"] == 1
    assert once.read_text("latin-1").count(version) == twice.read_text("latin-1").count(version) == 1
    assert once.read_bytes() != twice.read_bytes()
    assert twice.read_bytes().count(b"\n") == once.read_bytes().count(b"\n")
    assert once.read_bytes().count(b"\r") == (0 if b"\r" not in path.read_bytes() else once.read_bytes().count(b"\n"))
    with connect() as k, pytest.raises(FileError, match="again=True") as caught:
        k.filter(arm, once, fanuc_j3="same")
    assert caught.value.context["line"] == line


def test_what_is_to_be_known_of_the_whole_program_is_told(
    arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "w.src").write_bytes(b"DEF w()\nPTP {A1 10,A2 20,A3 30,E1 500}\nEND\n")
    capsys.readouterr()
    assert run(["filter", str(tmp_path / "w.src"), "--robot", arm, "--diff"]) == 0
    assert "Note: external axes are left out: what they move belongs to the base or the tool" in capsys.readouterr().err
    with connect() as k:
        done = k.filter(arm, tmp_path / "w.src")
    assert any("external axes" in note for note in done.notes)


def test_many_lines_that_are_left_fit_on_a_screen(arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = "".join(f"PTP X{k}\n" for k in range(40))
    (tmp_path / "w.src").write_text(f"DEF w()\nPTP {{A1 10,A2 20,A3 30}}\n{left}END\n")
    capsys.readouterr()
    assert run(["filter", str(tmp_path / "w.src"), "--robot", arm, "-o", str(tmp_path / "out.src")]) == 0
    out, err = capsys.readouterr()
    assert len((err + out).splitlines()) <= 25
    assert "34 more lines are left as they are (all: --json)" in err
    assert len(document(capsys, "filter", tmp_path / "w.src", "--robot", arm, "-o", tmp_path / "out.src")["left"]) == 40


def test_an_unknown_dialect_is_named_before_an_output_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "w.job").write_text("/JOB\n")
    assert run(["filter", str(tmp_path / "w.job"), "--robot", "any"]) == 1
    assert (
        "the ending '.job' is of no known dialect. Known are .mod, .modx, .sys, .sysx, .prg, .ls"
        in capsys.readouterr().err
    )
