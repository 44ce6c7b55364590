"""Whether the rows of an upload belong to the robot: the question of every job, asked before anything is stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from kilter_core.errors import CoreError, FindingDocument, ObservationError
from kilter_files.ground.later import np, pa
from kilter_service.ground.core import core_identify, core_model, core_observations
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import Column, has

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.observations import Observations

MOST_ROWS = 50_000  # that are looked at: of more, every second block of rows, every fourth, ...
BLOCK = 1000
MIXED_UP = ("foreign_observations", "markers_swapped")
SEEN = ("x", "marker_x", "link")


@dataclass(frozen=True)
class Judged:
    """What rows would be refused for, None where nothing looks mixed up, and what only looks odd in them."""

    refusal: ObservationError | None = None
    warnings: tuple[FindingDocument, ...] = ()

    @property
    def explains_limits(self) -> bool:
        """Whether a mix-up is named that puts readings outside their limits: base or tool that changed does not."""
        return self.refusal is not None and not {"shuffled_mm", "moved_mm"} & set(self.refusal.context)


class Belonging:
    """Rows of one upload: `take` every piece in order, then ask what was `found`."""

    def __init__(self, columns: Sequence[Column], robot: Robot, conditions: dict[str, Any] | None = None) -> None:
        self._columns = columns
        self._unchecked = {"unchecked": (conditions or {}).get("unchecked")}
        self._robot = robot
        self._blocks: list[tuple[int, pa.Table]] = []  # with the number of rows before each
        self._before = 0
        self._every = 1
        self._seen = 0
        self._asked = any(has(columns, quantity) for quantity in SEEN)

    def add_rows(self, table: pa.Table) -> None:
        """Keep what is needed of the next rows: blocks of them, so that the row above a row is there too."""
        for first in range(0, table.num_rows, BLOCK) if self._asked else ():
            if self._seen % self._every == 0:
                rows = range(first, min(first + BLOCK, table.num_rows))
                block = table.take(list(rows))  # a copy: a slice would keep the whole piece in memory
                self._blocks.append((self._before + first, block))
            self._seen += 1
            while sum(block.num_rows for _, block in self._blocks) > MOST_ROWS:
                self._blocks = self._blocks[::2]
                self._every *= 2
        self._before += table.num_rows

    def check_collected_rows(self) -> Judged:
        """What looks mixed up.

        Rows of which a job could make nothing (markers that are not rigid, too few of them) are left to the job.
        """
        blocks = [(first, block) for first, block in self._blocks if block.num_rows]
        if not blocks:
            return Judged()
        index = np.concatenate([np.arange(first, first + block.num_rows) for first, block in blocks])
        rows = observations(pa.concat_tables([block for _, block in blocks]), self._columns, self._unchecked)
        found = check_rows_match_robot(self._robot, rows)
        clock = core_observations.clock_warnings(rows) if self._every == 1 else ()
        return replace(found, warnings=(*core_identify.renumber_warnings(found.warnings, index), *clock))


def check_rows_match_robot(robot: Robot, rows: Observations) -> Judged:
    """What looks mixed up in rows of a robot.

    Sessions are judged one by one: the instrument or the tool may have moved between them, and a job says how it takes that.
    """
    begin = core_model.Calibration.nominal(robot)
    warnings: list[FindingDocument] = []
    for part in core_identify.setups(rows):
        code = None if part.session is None else part.session[0]
        index = np.arange(len(rows)) if code is None else np.flatnonzero(rows.session == code)
        try:
            found = core_identify.renumber_warnings(core_identify.refuse_mixed_up(begin, part), index)
            warnings += [one for one in found if one not in warnings]
        except ObservationError as error:
            if error.code in MIXED_UP:
                return Judged(error)
        except CoreError:
            continue
    return Judged(None, tuple(warnings))


def judged_whole(
    table: pa.Table, columns: Sequence[Column], robot: Robot, conditions: dict[str, Any] | None = None
) -> Judged:
    """What looks mixed up in all rows of a campaign that came in parts."""
    whole = Belonging(columns, robot, conditions)
    whole.add_rows(table)
    return whole.check_collected_rows()
