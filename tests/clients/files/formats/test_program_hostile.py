"""Programs that nobody wrote: what they cost grows with their length, and no faster."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from kilter_files.formats.programs.found import MOST_LINES
from kilter_files.formats.programs.rapid_moves import _control
from kilter_files.formats.programs.reading import MOST_IN_LINE, read_programs
from kilter_files.ground.errors import FileError

ROW, BEYOND = "1,2,3,4,5,6", "9E9,9E9,9E9,9E9,9E9,9E9"
PROGRAMS = {
    ".mod": (
        f"MODULE m\nCONST jointtarget p1:=[[{ROW}],[{BEYOND}]];\n"
        f"CONST robtarget q1:=[[1,2,3],[1,0,0,0],[0,0,0,0],[{BEYOND}]];\nPROC main()\nMoveAbsJ p1,v100,z10,tool0;\n",
        "\nENDPROC\nENDMODULE\n",
        [
            "a(",
            "a.b,",
            "jointtarget a:=",
            "MoveL ",
            "a{1",
            "[1,",
            "\\WObj:=",
            "IF ",
            "IF a ",
            "ConfL\\Off; IF a ",
            "PROC a(",
            "CONST num a:=1 ",
        ],
    ),
    ".src": (
        "DEF a()\nPTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nLIN {X 1,Y 2,Z 3,A 4,B 5,C 6}\n",
        "\nEND\n",
        ["a(", "{A1 ", "a[1].", "PTP ", "$TOOL={", "a={X 1,", "FRAME a"],
    ),
    ".script": (
        "def a():\n movej([1.5,-1.25,1,1,1,1], a=1.4, v=1.05)\n movel(p[1,2,3,0,0,0])\n",
        "\nend\n",
        ["a(", "a([", "movej([1,", "p[1,", "get_inverse_kin(", "a="],
    ),
    ".ls": (
        "/PROG A\n/MN\n   1:J P[1] 100% FINE ;\n",
        "\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\n\tJ1= 1 deg, J2= 2 deg, J3= 3 deg,\n"
        "\tJ4= 4 deg, J5= 5 deg, J6= 6 deg\n};\n/END\n",
        ["1:J P[", "P[1]{", "PR[1,", "1:", "UFRAME[", "J1="],
    ),
    ".csv": ("q1_deg,q2_deg\n1,2\n", "\n", ['"a,', ',"', '""']),
}
OF_ALL = [
    '"',
    '" ',
    " ",
    "\t",
    "\n",
    "\r",
    "\r\n",
    " \n",
    "(",
    "[",
    "{",
    "},",
    ",",
    "1",
    "-",
    "a ",
    "a",
    "a(b) ",
    "a((b)) ",
    ":",
    ";",
    "!a\n",
    "\xe9",
]
READ = """
import sys
from collections.abc import Sequence
from pathlib import Path
from kilter_files.formats.programs.reading import read_programs
from kilter_files.ground.errors import FileError
for path in sys.argv[1:]:
    try:
        read_programs(Path(path))
    except FileError as error:
        print(error)
"""
BYTES = 70_000
SECONDS = 30  # of the processor: all are read in five or so, where one takes the square of its length all take a minute


@pytest.mark.parametrize("ending", PROGRAMS)
@pytest.mark.parametrize("lines", [True, False])
def test_what_a_program_costs_grows_with_its_length(tmp_path: Path, ending: str, lines: bool) -> None:
    begin, end, own = PROGRAMS[ending]
    paths = []
    for k, unit in enumerate(OF_ALL + own):
        line = unit * ((80 if lines else MOST_IN_LINE - 1) // len(unit))
        paths.append(tmp_path / f"p{k}{ending}")
        paths[-1].write_bytes(f"{begin}{(line + chr(10)) * (BYTES // len(line))}{end}".encode("latin-1"))
    read_within_limit(paths)


LIST = f"[[1,2,3],[1,0,0,0],[0,0,0,0],[{BEYOND}]]"
AXES, POSE = "A1 1,A2 2,A3 3,A4 4,A5 5,A6 6", "X 1,Y 2,Z 3,A 4,B 5,C 6"
# statements that a program repeats, the number of each in place of # (and # of %): the time of each grew with the square
REPEATED = {
    ".mod": [
        "p:=q1;\nMoveJ Offs(q1,#,0,0),v1,z1,tool0;\n",
        "PROC r#()\nConfL\\Off;\nMoveL q1,v1,z1,tool0;\nr#+1;\nENDPROC\n",
        "CONST num n#:=1;\n",
        "MoveJ a{i},v1,z1,tool0;\n",
        "MoveX a{i},v1,z1,tool0;\n",
        "a{i}:=q1;\n",
        "change a{i};\n",
        "PROC r#(robtarget a)\n",
        "MoveJ " + "Offs(" * 90 + "q1" + ",1,2,3)" * 90 + ",v1,z1,tool0;\n",
    ],
    ".script": [
        "q=[0,1,1,0,0,0.#]\nmovej(q)\n",
        "p=p[0,1,1,0,0,#]\nmovel(p)\n",
        "q=[0,1,1,0,0,0.#]\nmovej(get_inverse_kin(p[1,2,3,0,0,0],qnear=q))\n",
        "f=p[0,1,1,0,0,#]\nmovel(pose_trans(f,p[0,0,1,0,0,0]))\n",
        "force_mode(a)\nmovej([0,1,1,0,0,0])\nend_force_mode()\n",
        "force_mode(a)\nend_force_mode()\na()\n",
        "def m#():\nset_tcp(p[0,0,#,0,0,0])\nmovel(p[1,2,3,0,0,0])\nm#()\nend\n",
        "movel(" + "pose_trans(f," * 90 + "p[0,0,1,0,0,0]" + ")" * 90 + ")\n",
        "movej(" * 90 + "[0,1,1,0,0,0]" + ")" * 90 + "\n",
    ],
    ".src": [
        f"P={{{AXES}}}\nPTP P\n",
        f"P[#]={{{POSE}}}\nLIN P[i]\n",
        f"P[#]={{{POSE}}}\nLIN P[i]:{{X 1}}\n",
        f"P[#]={{{AXES}}}\nPTP P[i]\n",
        f"P[#]={{{POSE}}}\nP[i].X=1\nf(P[1])\n",
        f"DEF m#()\n$TOOL={{X 0,Y 0,Z #,A 0,B 0,C 0}}\nLIN {{{POSE}}}\nm#()\nEND\n",
        f"BASE_DATA[#].X=1\n$BASE=BASE_DATA[#]\nLIN {{{POSE}}}\n",
        "DEF m#()\nBAS(%INITMOV,0)\n$BASE={X 0,Y 0,Z 1,A 0,B 0,C 0}\nEND\n",
    ],
}


@pytest.mark.parametrize("ending", REPEATED)
def test_what_a_repeated_statement_costs_does_not_grow(tmp_path: Path, ending: str) -> None:
    begin, end, _ = PROGRAMS[ending]
    array = f"CONST robtarget a{{2000}}:=[{f',{chr(10)}'.join([LIST] * 2000)}];\n" if ending == ".mod" else ""
    paths = []
    for k, unit in enumerate(REPEATED[ending]):
        paths.append(tmp_path / f"p{k}{ending}")
        said = "".join(unit.replace("#", str(number)).replace("%", "#") for number in range(1, 8 * BYTES // len(unit)))
        paths[-1].write_text(begin.replace("PROC main", array + "PROC main") + said + end, encoding="latin-1")
    assert not read_within_limit(paths), "refused: then nothing is said of what it costs"


def read_within_limit(paths: Sequence[Path]) -> str:
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))  # noqa: E731
    done = subprocess.run([sys.executable, "-c", READ, *map(str, paths)], preexec_fn=limit, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    return done.stdout.decode()


def test_a_position_costs_the_same_in_a_long_program(tmp_path: Path) -> None:
    """The whole text was searched for each of them."""
    begin, end, _ = PROGRAMS[".ls"]
    path = tmp_path / "a.ls"
    path.write_text(begin + "},P[1]{\n" * 80_000 + end)
    read_within_limit([path])


@pytest.mark.parametrize("ending", PROGRAMS)
def test_empty_lines_cost_the_same_in_a_long_program(tmp_path: Path, ending: str) -> None:
    """From each of them the text was searched up to the next line that holds something."""
    begin, end, _ = PROGRAMS[ending]
    path = tmp_path / f"a{ending}"
    path.write_text(begin + "\n" * (MOST_LINES - 100) + end)
    read_within_limit([path])


def test_a_displacement_costs_the_same_behind_many_ends(tmp_path: Path) -> None:
    begin, end, _ = PROGRAMS[".ls"]
    path = tmp_path / "a.ls"
    path.write_text(begin + ": Touch Offset End ;\n" * 190_000 + ": Touch Offset PR[1] ;\n" * 190_000 + end)
    read_within_limit([path])


def test_a_position_that_a_line_uses_often_is_named_once(tmp_path: Path) -> None:
    begin, end, _ = PROGRAMS[".ls"]
    path = tmp_path / "a.ls"
    path.write_text(begin + "   2:  PR[2]=P[1]+P[1]-P[1] ;\n" + end)
    named = [what for line, what in read_programs(path)[0].left if line == 4]
    assert named == ["P[1]: used otherwise than as the goal of a move"]


def test_an_if_in_an_if_calls_what_the_outer_calls() -> None:
    _, calls = _control("IF a IF b G;\nIF c H;\nIF d THEN\n G;\nENDIF\n", {"G", "H"})
    assert calls == [(0, "G"), (13, "H"), (32, "G")]


def test_a_target_within_calls_that_are_not_closed_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.script"
    path.write_text("def a():\n movej([1,1,1,1,1,1])\n go(walk([1,1,1,1,1,1]\n step([1,1,1,1,1,1])\nend\n")
    left = read_programs(path)[0].left
    assert left == [
        (3, "go(walk([1,1,1,1,1,1]: go is given a target"), (4, "step([1,1,1,1,1,1]: step is given a target")
    ]  # fmt: skip


def test_what_short_ifs_without_an_end_call_is_noted_only_of_routines_of_the_program() -> None:
    control, calls = _control("if a\n f(b)\nend\n" * 2000, {"G"})
    assert len(control) == 4000
    assert len(calls) == 4000  # the statements f and end; each IF reads on for a hundred words


@pytest.mark.parametrize("ending", PROGRAMS)
@pytest.mark.parametrize("unit", ['"', " ", "[", "1", "\r"])
def test_a_line_of_megabytes_is_refused_with_its_number(tmp_path: Path, ending: str, unit: str) -> None:
    path = tmp_path / f"a{ending}"
    path.write_text(f"first\n{unit * (15 << 20)}")
    with pytest.raises(FileError, match=r"line 2.*has more than 65536 characters in a line.*Break the line"):
        read_programs(path)


@pytest.mark.parametrize("ending", PROGRAMS)
@pytest.mark.parametrize("line", ["\n", "a\n", " \r\n"])
def test_a_program_of_more_lines_than_a_controller_loads_is_refused(tmp_path: Path, ending: str, line: str) -> None:
    begin, end, _ = PROGRAMS[ending]
    path = tmp_path / f"a{ending}"
    path.write_text(f"{begin}{line * (1 << 20)}{end}", newline="")
    with pytest.raises(FileError, match=r"line 400001.*more than 400000 lines.*Part it into several programs"):
        read_programs(path)


@pytest.mark.parametrize(("ending", "move"), [(".mod", "MoveL a;"), (".script", "movej(a) ")])
def test_a_program_of_more_moves_than_a_controller_loads_is_refused(tmp_path: Path, ending: str, move: str) -> None:
    begin, end, _ = PROGRAMS[ending]
    path = tmp_path / f"a{ending}"
    path.write_text(f"{begin}{(move * 4000 + chr(10)) * (MOST_LINES // 4000 + 1)}{end}")
    with pytest.raises(FileError, match=r"is move 400001.*Part the program into several"):
        read_programs(path)


def test_a_program_may_have_long_lists_and_many_remarks(tmp_path: Path) -> None:
    rows = ",".join([f"[[{ROW}],[{BEYOND}]]"] * 800)
    path = tmp_path / "a.mod"
    path.write_text(f"MODULE m\n{'! remark' * 9}\n" + f"CONST jointtarget p{{800}}:=[{rows}];\nENDMODULE\n")
    assert len(read_programs(path)[0].targets) == 800


def test_a_target_within_many_brackets_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.script"
    path.write_text(f"def a():\n movej([1,1,1,1,1,1])\n go{'(' * 9}[1,1,1,1,1,1]{')' * 9}\nend\n")
    assert read_programs(path)[0].left == [(3, f"go({'(' * 8}[1,1,1,1,1,1]{')' * 9}: go is given a target")]


@pytest.mark.parametrize(("tools", "left"), [(1, 0), (21, 2)])
def test_moves_that_compute_which_target_are_taken_while_few_ways_lead_there(
    tmp_path: Path, tools: int, left: int
) -> None:
    declared = "".join(
        f"PERS tooldata t{k}:=[TRUE,[[0,0,{k}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n" for k in range(tools)
    )
    moves = "".join(f"MoveJ a{{i}},v1,z1,t{k};\n" for k in [*range(tools)] * 2)
    path = tmp_path / "a.mod"
    path.write_text(
        f"MODULE m\n{declared}CONST robtarget a{{2}}:=[{LIST},{LIST}];\nCONST jointtarget p1:=[[{ROW}],[{BEYOND}]];\n"
        f"PROC main()\nMoveAbsJ p1,v1,z1,tool0;\n{moves}ENDPROC\nENDMODULE\n"
    )
    program = read_programs(path)[0]
    assert [len(pose.uses) for pose in program.cartesian] == [tools, tools]
    assert len([what for _, what in program.left if "a pose: the program computes which" in what]) == left
