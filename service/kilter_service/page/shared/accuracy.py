"""How accurate a version is, in a few numbers: its error on poses that were held out, beside what simpler models leave."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kilter_service.contract.fits import Errors, Metrics, StageErrors
from kilter_service.contract.today import UNUSED, Today
from kilter_service.contract.words import interval, widest
from kilter_service.versions.today.sentences import largest


@dataclass(frozen=True)
class Accuracy:
    """Errors of a version on ``n`` points, mm; ``low`` and ``high`` are the ends of the 95 % interval of the mean.

    The interval takes the points as independent. Without held-out rows the errors are those of the fit, which look too good.
    """

    held_out: bool
    n: int | None
    mean: float
    low: float | None
    high: float | None
    p95: float | None
    largest: float | None
    nominal: float | None
    registration: float | None
    widest: float  # the largest of the errors that stand beside the mean: its unit is that of all
    place: float | None = None  # of the nominal error, what is where instrument, base and tool are
    left_out: int | None = None  # rows that the errors leave out
    geometry: float | None = None  # what the geometry fitted without effects leaves
    unused: bool = False  # of rows that no fit used, and not of those that its own job held out

    @property
    def half(self) -> float | None:
        """Half the width of the interval, mm."""
        return None if self.low is None or self.high is None else (self.high - self.low) / 2

    @property
    def without(self) -> float:
        """The largest error of the version and of what simpler models leave, mm."""
        return max(one for one in (self.mean, self.registration, self.nominal) if one is not None)

    @property
    def better(self) -> float | None:
        """How many times smaller the error is than with base and tool alone."""
        return self.registration / self.mean if self.registration and self.mean > 0 else None


def accuracy_from_metrics(metrics: Metrics) -> Accuracy | None:
    """Read the errors on held-out poses, else those on the rows that were fitted; None when no tool was measured."""
    for held_out, block in ((True, metrics.validation), (False, metrics.train)):
        if block is not None and block.identified is not None:
            return _read(held_out, block, block.identified)
    return None


def accuracy_today(today: Today) -> Accuracy | None:
    """Read the newest errors of a robot, in the unit of the sentences on them; None when nothing is known."""
    newest = today.newest
    if newest is None or newest.errors.identified is None:
        return None
    found = _read(newest.source != "fitted", newest.errors, newest.errors.identified)
    return replace(found, unused=newest.source in UNUSED, widest=largest(newest, today.own))


def _read(held_out: bool, block: StageErrors, found: Errors) -> Accuracy:
    ends = interval(found, block.n)
    low, high = ends or (None, None)
    return Accuracy(
        held_out,
        block.n,
        found.mean_mm,
        low,
        high,
        found.p95_mm,
        found.max_mm,
        _mean(block.nominal),
        _mean(block.registration_only),
        widest(found, block.n),
        block.place_mm,
        block.left_out,
        _mean(block.best_rigid),
    )


def _mean(found: Errors | None) -> float | None:
    return None if found is None else found.mean_mm
