"""What a kind of job can say about a job before it runs. It computes no more than the job's first steps, and stores nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from kilter_core.errors import CoreError

if TYPE_CHECKING:
    from kilter_core.gap import GapCheck
    from kilter_core.identify import IdentificationCheck
    from kilter_core.observations import Observations

How = Literal["campaigns", "fraction", "folds", "unasked", "none"]


@dataclass(frozen=True)
class Lack:
    """What a job would run without: what, why, and what to measure or to give."""

    what: str
    reason: str
    remedy: str


@dataclass
class JobPreview:
    """What was found; a kind fills it as far as it comes. ``rows`` are those to learn from, with what is held out."""

    rows: int = 0
    poses: int = 0
    how: How = "none"
    held_rows: int = 0
    held_poses: int = 0
    problems: list[CoreError] = field(default_factory=list)
    missing: list[Lack] = field(default_factory=list)
    limited: list[str] = field(default_factory=list)
    identification: IdentificationCheck | None = None
    search: GapCheck | None = None
    seconds: float | None = None  # that the job would take, where its beginning says so

    @contextmanager
    def noting_refusals(self) -> Iterator[None]:
        """Note why the job would fail, instead of failing."""
        try:
            yield
        except CoreError as error:
            self.problems.append(error)

    def count_fitted_rows(self, *parts: Observations) -> None:
        """Count the rows that are fitted, split or compared; of parts that are taken one by one, poses of each."""
        self.rows, self.poses = sum(len(rows) for rows in parts), sum(count_poses(rows) for rows in parts)

    def hold(self, how: How, *parts: Observations) -> None:
        """Count what is held out."""
        self.how = how
        self.held_rows, self.held_poses = sum(len(rows) for rows in parts), sum(count_poses(rows) for rows in parts)


def count_poses(rows: Observations) -> int:
    """Count distinct poses."""
    return int(rows.pose_groups().max()) + 1 if len(rows) else 0
