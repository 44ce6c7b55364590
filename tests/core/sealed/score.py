"""Real campaigns of which half is sealed: what Kilter's identification leaves there, beside an independent fit.

``python -m tests.core.sealed.score`` is ``python -m tools.lab sealed``.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_core.identify import identify
from kilter_core.observations import Observations
from tests.core.real import real_campaign
from tests.core.sealed.independent_fit import Campaign, fanuc, held_out_rms_mm, talos, ur10

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "data"
SETS = ("ipa-a", "ipa-b", "talos", "fanuc")
MOST = 800  # rows of a set
SAME = 1e-6  # rad: both readers read the same joints
AT = 1.01  # share by which an error counts as no larger: fits of the same rows differ as much in what rows leave open

Rows = NDArray[np.int64]


class Score(NamedTuple):
    """Errors (mm, rms) on sealed rows: of frames alone, of Kilter's identification, and of the independent fit."""

    name: str
    split: str
    rows: int
    sealed: int
    frames: float
    kilter: float
    independent: float

    @property
    def at_or_below(self) -> bool:
        """Whether Kilter leaves no more."""
        return self.kilter <= AT * self.independent


def splits(q: NDArray[np.float64]) -> Iterator[tuple[str, Rows, Rows]]:
    """Five ways to seal half of the poses: twice by chance, the later half, and the upper sector of joints 1 and 2."""
    _, pose = np.unique(np.round(q, 5), axis=0, return_inverse=True)
    pose = pose.reshape(-1)
    first = np.array([np.flatnonzero(pose == k)[0] for k in range(pose.max() + 1)])
    for seed in (1, 2):
        drawn = np.random.default_rng(seed).permutation(len(first))
        yield f"by chance {seed}", *_halves(drawn, pose)
    yield "later half", *_halves(np.argsort(np.argsort(first)), pose)
    for joint in (0, 1):
        yield f"sector of joint {joint + 1}", *_halves(np.argsort(np.argsort(q[first, joint], kind="stable")), pose)


def _halves(rank: Rows, pose: Rows) -> tuple[Rows, Rows]:
    late = rank[pose] >= (pose.max() + 1) / 2
    return np.flatnonzero(~late), np.flatnonzero(late)


def read_both(folder: Path, name: str) -> tuple[object, Observations, Campaign]:
    """A robot and its rows as Kilter reads them, and the same rows read independently."""
    robot, rows = real_campaign(folder, name)
    other = {"talos": talos, "fanuc": fanuc}[name](folder) if "ipa" not in name else ur10(folder, name[-1].upper())
    step = max(1, len(rows) // MOST)
    some = np.arange(0, len(rows), step)
    rows, other = rows.select(some), other.select(some)
    assert np.abs(rows.q - other.q).max() < SAME
    return robot, rows, other


def score(folder: Path, name: str) -> Iterator[Score]:
    """Scores of a set, one for each split."""
    robot, rows, other = read_both(folder, name)
    for split, shown, sealed in splits(other.q):
        found = identify(robot, rows.select(shown), rows.select(sealed)).metrics["validation"]  # type: ignore[arg-type]
        theirs = held_out_rms_mm(other.select(shown), other.select(sealed))
        frames, kilter = found["registration_only"]["rms_mm"], found["identified"]["rms_mm"]
        yield Score(name, split, len(shown), len(sealed), frames, kilter, theirs)


def main() -> None:
    """Print a line for each sealed campaign, and how many are at or below the independent fit."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--sets", default=",".join(SETS), help="names, by commas")
    asked.add_argument("--data", type=Path, default=Path(os.environ.get("KILTER_SHARED_DATA", FOLDER)))
    given = asked.parse_args()
    print(f"{'set':8} {'sealed':18} {'fitted':>6} {'rows':>5} {'frames':>8} {'kilter':>8} {'independent':>11}  mm rms")
    found = []
    for name in given.sets.split(","):
        for one in score(given.data, name):
            found.append(one)
            mark = "" if one.at_or_below else "  ABOVE"
            sizes = f"{one.rows:6} {one.sealed:5} {one.frames:8.4f} {one.kilter:8.4f} {one.independent:11.4f}"
            print(f"{one.name:8} {one.split:18} {sizes}{mark}", flush=True)
    print(f"{sum(one.at_or_below for one in found)} of {len(found)} at or below (within {AT - 1.0:.0%})")


if __name__ == "__main__":
    main()
