"""`python -m tools.lab filter-texts`: processor time to read 16 MB of any text as a robot program, each in its own process."""

from __future__ import annotations

import argparse
import itertools
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from benchmarks.table import Line, show
from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import MOST_LINES
from kilter_files.formats.programs.marks import refuse_corrected
from kilter_files.formats.programs.reading import MOST_BYTES, MOST_IN_LINE, read_programs
from kilter_files.ground.errors import FileError

ASKED_S, GIVEN_UP_S, LARGE, SHOWN = 10.0, 60.0, MOST_BYTES, 12
# What comes before the text: a program that goes on, one whose comment, text, list or branch does not end.
BEGINNINGS = {
    "krl": ("", "DEF w()\n", "DEFDAT w\n", 'DEF w()\nx="'),
    "rapid": ("", "MODULE w\nPROC w()\n", 'MODULE w\nPROC w()\nx:="', "MODULE w\nPROC w()\nMoveJ "),
    "urscript": ("", "def w():\n", 'def w():\n  x="', "def w():\n  movej("),
    "fanuc": ("", "/PROG W\n/MN\n", "/PROG W\n/POS\n", "/PROG W\n/POS\nP[1]{\n"),
    "table": ("", "q1_deg,q2_deg,q3_deg\n", '"q1_deg","', "q1_deg;q2_deg\n"),
}
PIECES = (
    '"', "'", '" ', '"x" ', "' '", " ", "\t", "\r", ";", ":", ",", ".", "=", "-", "1", "1.", "1e", "-1 ", "1,", "a",
    "a ", "a.", "a,", "a=", "a:=", "a(", "a[", "a[1]", "{", "[", "(", "{}", "[]", "()", "{[(", "}", "]", ")", "/*",
    "(*", "#", "!", "%", '\\', "$", "_", "\xe4", '"""', "&", "@", "<", "*", "+-", "{A1 1,", "{A1 1,A2 2,A3 3} ",
    "{X 1,Y 2,Z 3,A 1,B 2,C 3}", "[[1,2,3],[", "[1,2,3,4,5,6],", "p[1,2,3,4,5,6]", "PTP ", "PTP a ", "LIN {", "MoveJ ",
    "MoveJ a,", "MoveL Offs(", "movej(", "movej([", "movel(p[", "J P[1] ", "P[1]{", "P[1]", "PR[1,2]=", "J1= 1 deg,",
    "UFRAME[", "CONFIG : 'N U T, 0, 0, 0'", "DEF a() ", "PROC a() ", "CONST robtarget a:=", "def a(): ", "$BASE=",
    "BASE_DATA[", "DECL E6POS a=", "IF a THEN ", "WHILE ", "if a: ", "end ", "END ", "GLOBAL ", "VAR ", "TRIGGER ",
    "INTERRUPT ", "a=a+", "a:b ", "%%%", "E6AXIS ", "\n", ":\n", ";\n", "=\n", "a:\n ", "\r\n", "jointtarget a:=",
    "robtarget a:=[", "num a:=1;", "MoveAbsJ [[1,2,3,4,5,6],[", "Offs(a,1,2,3),",
)  # fmt: skip


class Case(NamedTuple):
    """A text: what it begins with, and the piece that fills its lines of ``width`` characters."""

    ending: str
    beginning: str
    piece: str
    width: int

    def text(self, size: int) -> bytes:
        """Return the text, of ``size`` bytes, or of as many as its lines may be."""
        line = (self.piece * (self.width // len(self.piece) + 1))[: max(self.width - 1, len(self.piece))] + "\n"
        count = min(size // len(line), MOST_LINES - self.beginning.count("\n") - 2)
        return (self.beginning + line * count).encode("latin-1")[:size]


def cases(width: int | None) -> Iterator[Case]:
    """All texts, of the longest lines that are read and of short ones."""
    for name, dialect in DIALECTS.items():
        widths = (width,) if width else (MOST_IN_LINE, max(80, LARGE // (MOST_LINES - 10) + 1))
        beginnings = next((v for k, v in BEGINNINGS.items() if k in name.lower()), ("",))
        for beginning, piece, one in itertools.product(beginnings, PIECES, widths):
            yield Case(dialect.endings[0], beginning, piece, one)


def seconds(case: Case, size: int) -> float:
    """Processor seconds to read a text; one that takes too long counts as a minute."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"w{case.ending}"
        path.write_bytes(case.text(size))
        child = os.fork()
        if child == 0:
            resource.setrlimit(resource.RLIMIT_CPU, (int(GIVEN_UP_S), int(GIVEN_UP_S)))
            os._exit(_read(path))
        _, status, used = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) == -signal.SIGXCPU or os.waitstatus_to_exitcode(status) == -signal.SIGKILL:
        return GIVEN_UP_S
    if status:
        raise RuntimeError(f"{case!r} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime


def _read(path: Path) -> int:
    try:
        with suppress(FileError):
            refuse_corrected(read_programs(path))
    except BaseException:  # the parent says which text it was
        traceback.print_exc()
        return 1
    return 0


def _warm_up() -> None:
    """Import what reading needs, once for all processes."""
    for dialect in DIALECTS.values():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"w{dialect.endings[0]}"
            path.write_bytes(b"a")
            _read(path)


def main() -> int:
    """Read small texts of all kinds, then those of the slowest at full size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=float, default=0.125, help="MB of the texts by which the slowest are chosen")
    parser.add_argument("--full", type=int, default=SHOWN, help="how many of each dialect are read at 16 MB")
    parser.add_argument("--only", help="an ending")
    given = parser.parse_args()
    _warm_up()
    chosen: dict[str, list[tuple[float, Case]]] = {}
    for case in cases(None):
        if given.only in (None, case.ending):
            took = seconds(case, int(given.first * (1 << 20)))
            chosen.setdefault(case.ending, []).append((took, case))
    worst: list[tuple[float, float, Case]] = []
    for found in chosen.values():
        for small, case in sorted(found, reverse=True)[: given.full]:
            worst.append((seconds(case, LARGE), small, case))
            print(
                f"{worst[-1][0]:6.2f} s  ({small:.2f} s of {given.first:g} MB)  {case!r}", file=sys.stderr, flush=True
            )
    lines = []
    for ending in chosen:
        large, small, case = max(one for one in worst if one[2].ending == ending)
        what = f"16 MB as {ending}, the slowest of {len(chosen[ending])} texts: {case.beginning + case.piece!r}"
        lines.append(Line(what, f"{large:.1f} s", f"<= {ASKED_S:g} s", large <= ASKED_S))
    print(show(lines))
    return 0 if all(line.met for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
