"""A corrected trajectory as the YAML of ROS 2's ``trajectory_msgs/msg/JointTrajectory``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_service.ground.correction_outcome import OK
from kilter_service.ground.wire import to_mm

if TYPE_CHECKING:
    from kilter_service.ground.correction_outcome import Outcome

NANO = 1_000_000_000


def joint_trajectory(
    names: Sequence[str], t: NDArray[np.float64] | None, found: Outcome, notes: Sequence[str] = ()
) -> bytes:
    """Write positions (rad, m) over the time from the first row; comments have the notes, and what is left of rows.

    Raises:
        ObservationError: no ``t_s``, times that do not rise, or a row that was refused: a trajectory has no gaps.

    """
    if t is None:
        raise ObservationError("A JointTrajectory needs the time of each point: add the column 't_s'.", column="t_s")
    late = np.flatnonzero(np.diff(t) <= 0)
    if len(late):
        row = int(late[0]) + 2
        raise ObservationError(f"Row {row}, column 't_s': the time must rise from row to row.", row=row, column="t_s")
    _refuse_gaps(found)
    return "".join((*(f"# {note}\n" for note in notes), *_lines(names, t - t[0], found))).encode()


def _refuse_gaps(found: Outcome) -> None:
    bad = np.flatnonzero(~found.answered_rows)
    if len(bad):
        word = found.words[int(bad[0])]
        raise ObservationError(
            f"Row {int(bad[0]) + 1} is not corrected ({word}), {len(bad)} rows in all: a JointTrajectory cannot have a "
            "gap. Take CSV, which marks such rows, or leave them out.",
            row=int(bad[0]) + 1,
            status=word,
        )


def _lines(names: Sequence[str], t: NDArray[np.float64], found: Outcome) -> Iterator[str]:
    yield "header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: ''\njoint_names:\n"
    yield from (f"- '{name.replace(chr(39), chr(39) * 2)}'\n" for name in names)
    yield "points:\n"
    times, left = np.round(t * NANO).astype(np.int64).tolist(), to_mm(found.remaining_errors).tolist()
    for time, row, word, kept in zip(times, found.done.q.tolist(), found.words, left, strict=True):
        remark = "" if word == OK else f"  # {word}: {kept:.3g} mm left"
        yield f"- positions: [{', '.join(_yaml(value) for value in row)}]{remark}\n"
        yield f"  time_from_start: {{sec: {time // NANO}, nanosec: {time % NANO}}}\n"


def _yaml(value: float) -> str:
    """Every digit; YAML takes 1e-05 for text unless it has a point."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
