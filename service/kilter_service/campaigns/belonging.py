"""Whether the rows of an upload belong to the robot: the question of every job, asked before anything is stored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.errors import CoreError, ObservationError
from kilter_service.campaigns.assemble import observations
from kilter_service.campaigns.columns import Column, has

if TYPE_CHECKING:
    import pyarrow as pa

    from kilter_core.arm.robot import Robot
    from kilter_core.observations import Observations

MOST_ROWS = 50_000  # that are looked at: of more, every second one, every third, ...
MIXED_UP = ("foreign_observations", "markers_swapped")
SEEN = ("x", "marker_x", "link")


class Belonging:
    """Rows of one upload: `take` every piece in order, then ask what was `found`."""

    def __init__(self, columns: Sequence[Column], robot: Robot) -> None:
        self._columns = columns
        self._robot = robot
        self._pieces: list[pa.Table] = []
        self._every = 1
        self._asked = any(has(columns, quantity) for quantity in SEEN)

    def take(self, table: pa.Table) -> None:
        """Keep what is needed of the next rows."""
        if not self._asked:
            return
        self._pieces.append(_thinned(table, self._every))
        while sum(piece.num_rows for piece in self._pieces) > MOST_ROWS:
            self._pieces = [_thinned(piece, 2) for piece in self._pieces]
            self._every *= 2

    def found(self) -> ObservationError | None:
        """What looks mixed up, None where nothing does.

        Rows of which a job could make nothing (markers that are not rigid, too few of them) are left to the job.
        """
        if not self._asked or not any(piece.num_rows for piece in self._pieces):
            return None
        import pyarrow as pa

        return mixed_up(self._robot, observations(pa.concat_tables(self._pieces), self._columns, {}))


def mixed_up(robot: Robot, rows: Observations) -> ObservationError | None:
    """What looks mixed up in rows of a robot, None where nothing does.

    Sessions are judged one by one: the instrument or the tool may have moved between them, and a job says how it takes that.
    """
    from kilter_core.identify.plausibility.belonging import refuse_mixed_up  # compiled kernels: not at the start
    from kilter_core.model import Calibration

    for part in _sessions(rows):
        try:
            refuse_mixed_up(Calibration.nominal(robot), part)
        except ObservationError as error:
            if error.code in MIXED_UP:
                return error
        except CoreError:
            continue
    return None


def _sessions(rows: Observations) -> list[Observations]:
    if rows.session is None:
        return [rows]
    return [rows.select(rows.session == code) for code in np.unique(rows.session)]


def named(error: ObservationError) -> bool:
    """Whether a mix-up is named, and not only that joints and positions do not belong together."""
    return "shuffled_mm" not in error.context


def _thinned(table: pa.Table, every: int) -> pa.Table:
    return table if every == 1 else table.take(list(range(0, table.num_rows, every)))
