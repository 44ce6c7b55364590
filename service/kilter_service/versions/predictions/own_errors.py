"""Two versions that no measured pose is new to both of, by the errors that their own jobs stored of held-out rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kilter_service.contract.versions import Objection
from kilter_service.versions.objections import ERRORS_OF_DOUBT, SHARE_OF_DOUBT, variance

CODE = "larger_own_error"
COMPARED = "own_errors_compared"
REMEDY = " Measure poses that neither was fitted to (kilter upload --role confirmation) and activate again."


@dataclass(frozen=True)
class OwnError:
    """Mean error of a version, mm, on so many rows of its own job, with the variance of its mean, mm^2."""

    mean: float
    rows: int
    doubt: float
    held_out: bool

    @staticmethod
    def from_report(report: Mapping[str, Any], block: str) -> OwnError | None:
        """The error on the rows of a block, "validation" or "train"; None: none is stored."""
        return OwnError.read((report.get("metrics") or {}).get(block) or {}, block == "validation")

    @staticmethod
    def read(rows: Mapping[str, Any], held_out: bool) -> OwnError | None:
        """The error of the identified model in stored errors of some rows; None: none is stored."""
        found = rows.get("identified") or {}
        if found.get("mean_mm") is None:
            return None
        count = max(int(rows.get("n") or 1), 1)
        return OwnError(float(found["mean_mm"]), count, variance(found) / count, held_out)

    def beyond(self, other: OwnError) -> bool:
        """Whether it is larger than another by more than chance explains."""
        margin = max(ERRORS_OF_DOUBT * math.sqrt(self.doubt + other.doubt), SHARE_OF_DOUBT * other.mean)
        return self.mean - other.mean > margin

    @property
    def words(self) -> str:
        """The number with what it is of."""
        return f"{self.mean:.4g} mm on {self.rows} rows that it {'held out' if self.held_out else 'was fitted to'}"


def compare_with_active(
    new: Mapping[str, Any], rival: Mapping[str, Any], active: str
) -> tuple[list[Objection], list[dict[str, Any]]]:
    """What the stored errors of a version say beside those of the active one: an objection, or a remark with both numbers.

    Errors of fitted rows flatter, the more so the fewer the rows: they count against the version only, and of the active
    one held-out rows are needed.
    """
    mine, other = (
        OwnError.from_report(new, "validation") or OwnError.from_report(new, "train"),
        OwnError.from_report(rival, "validation"),
    )
    if mine is None or other is None:
        return [], []
    message = (
        f"No measured pose is new to both it and version {active}, active now, so each is taken by its own rows: it leaves "
        f"{mine.words}, version {active} {other.words}."
    )
    if mine.beyond(other):
        return [Objection(code=CODE, message=message + REMEDY)], []
    return [], [{"code": COMPARED, "message": message}]


def larger(now: Mapping[str, Any], before: Mapping[str, Any]) -> float | None:
    """By how much, mm, the stored mean error of some rows is larger than that of others; None: chance explains it."""
    mine, other = OwnError.read(now, True), OwnError.read(before, True)
    return mine.mean - other.mean if mine is not None and other is not None and mine.beyond(other) else None
