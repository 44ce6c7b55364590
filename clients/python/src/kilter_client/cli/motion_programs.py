"""Planned motions as programs that a controller follows in their time: URScript, RAPID, KRL."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kilter_client.errors import UsageError

Floats = NDArray[np.float64]
CSV = ".csv"
AXES = 6
STEP_S = 0.1  # between targets that a controller blends; a servo gets every row
STILL_DEG = 1e-4  # from the posture between motions
FIRST_DEG_S = 10.0  # on the way to the first posture
UNUSED = "9E9"  # an external axis that is not there
SAID = ("Planned motions of {name}: {seconds:.0f} s.", "Nobody checked them for collisions: run them slowly first.")


def refuse_other_endings(output: Path) -> None:
    """Refuse a file whose ending names no dialect, with a UsageError."""
    if output.suffix.lower() not in (CSV, *DIALECTS):
        raise UsageError(f"{output}: motions are written as {CSV}, {', '.join(DIALECTS)}; name one of these.")


def write_motions(output: Path, robot: str, text: str) -> str:
    """Return what a file holds of the motions in ``text`` (CSV: t_s and joints): that, or a program where its name ends so.

    Raises:
        UsageError: the arm does not have the axes that the program moves.

    """
    ending = output.suffix.lower()
    if ending == CSV:
        return text
    head, *rows = csv.reader(io.StringIO(text))
    fewest, most, write = DIALECTS[ending]
    if not all(one.endswith("_deg") for one in head[1:]) or not fewest <= len(head) - 1 <= most:
        axes = "6" if fewest == most else "up to 6"
        raise UsageError(
            f"{output}: such a program moves {axes} revolute joints, and this arm has {', '.join(head[1:])}: write {CSV}."
        )
    table = np.array(rows, dtype=np.float64)
    comments = [one.format(name=robot, seconds=table[-1, 0]) for one in SAID]
    return "\n".join([*write(comments, table[:, 0], table[:, 1:]), ""])


def _write_urscript(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    """Every row as a target of the servo, which holds its time."""
    radians = [f"[{', '.join(f'{value:.6f}' for value in row)}]" for row in np.radians(q).tolist()]
    first = np.radians(FIRST_DEG_S)
    moves = [
        f"  servoj({place}, 0, 0, {step:.4f}, 0.1, 300)" for place, step in zip(radians[1:], np.diff(t), strict=True)
    ]
    begin = ["def kilter_motions():", f"  movej({radians[0]}, a=0.5, v={first:.3f})", "  sleep(1.0)"]
    return [*(f"# {one}" for one in comments), *begin, *moves, "  stopj(1.0)", "end", "kilter_motions()"]


def _write_rapid(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    targets = [_rapid_target(row) for row in q.tolist()]
    lines = ["MODULE KilterMotions", *(f"  ! {one}" for one in comments), "  PROC kilter_motions()"]
    lines.append(f"    MoveAbsJ {targets[0]},v50,fine,tool0;")
    for rest_s, steps in _list_motions(t, q):
        lines.append(f"    WaitTime {rest_s:.3f};")
        lines += [f"    MoveAbsJ {targets[k]},v200\\T:={span:.3f},z10,tool0;" for k, span in steps]
    return [*lines, "  ENDPROC", "ENDMODULE"]


def _rapid_target(row: Sequence[float]) -> str:
    axes = [*row, *([0.0] * (AXES - len(row)))]
    return f"[[{','.join(f'{value:.4f}' for value in axes)}],[{','.join([UNUSED] * AXES)}]]"


def _write_krl(comments: Sequence[str], t: Floats, q: Floats) -> list[str]:
    """A spline block for each motion, whose whole time is given and divided."""
    targets = [f"{{{', '.join(f'A{j + 1} {value:.4f}' for j, value in enumerate(row))}}}" for row in q.tolist()]
    lines = ["DEF kilter_motions()", *(f"; {one}" for one in comments), "BAS(#INITMOV,0)", "BAS(#VEL_PTP,10)"]
    lines.append(f"PTP {targets[0]}")
    for rest_s, steps in _list_motions(t, q):
        lines += [f"WAIT SEC {rest_s:.3f}", "PTP_SPLINE", "  TIME_BLOCK START"]
        lines += [line for k, span in steps for line in (f"  SPTP {targets[k]}", f"  TIME_BLOCK PART = {span:.3f}")]
        lines += [f"  TIME_BLOCK END = {sum(span for _, span in steps):.3f}", "ENDSPLINE"]
    return [*lines, "END"]


def _list_motions(t: Floats, q: Floats) -> Iterator[tuple[float, list[tuple[int, float]]]]:
    """Of each motion the seconds of rest before it, then its targets: rows, and the seconds that the way to each takes."""
    away = np.any(np.abs(q - q[0]) > STILL_DEG, axis=1)
    edges = np.flatnonzero(np.diff(away.astype(np.int64), prepend=0, append=0))
    usual, rested = max(1, round(STEP_S / float(np.median(np.diff(t))))), 0
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, last = max(first - 1, 0), min(end, len(t) - 1)
        rows = [*range(begin + usual, last - usual // 2, usual), last]
        steps = [(k, float(t[k] - t[j])) for j, k in pairwise([begin, *rows])]
        yield float(t[begin] - t[rested]), steps
        rested = last


DIALECTS: dict[str, tuple[int, int, Callable[[Sequence[str], Floats, Floats], list[str]]]] = {
    ".script": (AXES, AXES, _write_urscript),
    ".mod": (1, AXES, _write_rapid),
    ".src": (1, AXES, _write_krl),
}
