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
    except FileError:
        pass
"""
BYTES = 140_000
SECONDS = 120  # of the processor: all are read in ten or so, where one took the square of its length all took minutes


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


def read_within_limit(paths: Sequence[Path]) -> None:
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))  # noqa: E731
    done = subprocess.run([sys.executable, "-c", READ, *map(str, paths)], preexec_fn=limit, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]


def test_a_position_costs_the_same_in_a_long_program(tmp_path: Path) -> None:
    """The whole text was searched for each of them."""
    begin, end, _ = PROGRAMS[".ls"]
    path = tmp_path / "a.ls"
    path.write_text(begin + "},P[1]{\n" * 80_000 + end)
    read_within_limit([path])


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
