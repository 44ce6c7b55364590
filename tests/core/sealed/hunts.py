"""Gap searches on halves of real campaigns: which effects the other half bears out, and which gate stops those it does.

Errors on the other half are means of poses, without the effect and with it, m (of encoders rad); * is beyond chance.

``python -m tests.core.sealed.hunts`` is ``python -m tools.lab real-hunts``.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import CoreError
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.identify import identify
from kilter_core.identify.comparison import Difference, errors_by_pose
from kilter_core.observations import Observations
from kilter_core.types import Floats
from tests.core.real import real_campaign
from tests.core.sealed.score import FOLDER, splits

SETS = ("ipa-a", "ipa-b", "talos", "fanuc", "kr300")
MOST = 300  # rows of a set: a search of 300 rows of the UR10 takes five minutes
MOTIONS = ("a", "b", "c")  # of kr300, each a campaign


class Hunt(NamedTuple):
    """One search: the arm, which half was searched, the report, and seconds.

    ``errors`` are those (P,) m of poses of the other half by the version and by an identification of the geometry, base and
    tool fitted to it; None where no tool was measured.
    """

    arm: str
    half: str
    report: GapReport
    seconds: float
    errors: tuple[Floats, Floats] | None

    @property
    def is_worse(self) -> bool:
        """Whether the version errs more than the geometry there, beyond chance."""
        return self.errors is not None and Difference.from_paired_errors(*self.errors).worse


def campaigns(folder: Path, name: str) -> Iterator[tuple[str, Robot, Observations, Observations]]:
    """What to search and what to confirm it by: motions in a circle, else each half of poses by the other."""
    if name == "kr300":
        read = [real_campaign(folder, f"kr300-{motion}") for motion in MOTIONS]
        for k, motion in enumerate(MOTIONS):
            other = (k + 1) % len(MOTIONS)
            yield f"motion {motion} by {MOTIONS[other]}", read[k][0], read[k][1], read[other][1]
        return
    robot, rows = real_campaign(folder, name)
    rows = rows.select(np.arange(0, len(rows), max(1, -(-len(rows) // MOST))))
    for split, shown, sealed in splits(rows.q):
        yield f"{split}, first", robot, rows.select(shown), rows.select(sealed)
        yield f"{split}, second", robot, rows.select(sealed), rows.select(shown)


def hunts(folder: Path, name: str, options: GapOptions, begin: str = "") -> Iterator[Hunt]:
    """Search each half of a set, of splits whose names ``begin`` so; what cannot be searched is said and left out."""
    for half, robot, shown, sealed in campaigns(folder, name):
        if not half.startswith(begin):
            continue
        began = time.monotonic()
        try:
            report = find_gap(robot, shown, options, confirmation=sealed)
        except CoreError as error:
            print(f"{name}, {half}: {error.code}: {error.message[:100]}", flush=True)
            continue
        seconds, errors = time.monotonic() - began, None
        if sealed.link_q is None:
            both = (report.calibration, identify(robot, shown).calibration)
            one, other = (errors_by_pose(own.for_another_campaign(sealed), sealed) for own in both)
            errors = one, other
        yield Hunt(name.split("-")[0], half, report, seconds, errors)


def describe(hunt: Hunt) -> Iterator[str]:
    """The table of one search: a line for each effect, and the gates that stopped those the other half bears out."""
    codes = sorted({str(w["code"]) for w in hunt.report.warnings} & {"confirmation_worse", "worse_than_geometry"})
    told = (
        ""
        if hunt.errors is None
        else f"version {1e3 * hunt.errors[0].mean():.4f}, geometry {1e3 * hunt.errors[1].mean():.4f} mm "
    )
    worse = "WORSE " if hunt.is_worse else ""
    yield f"{hunt.arm}, {hunt.half}: {hunt.report.verdict}, {told}{worse}{' '.join(codes)} ({hunt.seconds:.0f} s)"
    for judged in hunt.report.effects:
        again = judged.evidence.replication
        told = None if again is None else again.guarded
        moved = "" if told is None else f"{told.without:.3e} -> {told.with_it:.3e}{' *' * told.better}"
        outcome = "" if again is None else again.outcome
        failed = ",".join(name for name, passed in judged.gates.items() if not passed)
        stored = "" if judged.storable else " not stored"
        yield f"   {judged.verdict:16}{outcome:13}{moved:28}{judged.claim.words[:76]:78}{failed}{stored}"


def main() -> None:
    """Print the table of every hunt, then how many effects were replicated and contradicted by arm."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--sets", default=",".join(SETS), help="names, by commas")
    asked.add_argument("--data", type=Path, default=Path(os.environ.get("KILTER_SHARED_DATA", FOLDER)))
    asked.add_argument("--budget-s", type=float, help="seconds that a search may take")
    asked.add_argument("--splits", default="", help="begin of the names of the splits that are searched")
    given = asked.parse_args()
    options = GapOptions(next_poses=0, budget_s=given.budget_s)
    worse, run = 0, 0
    counted: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for name in given.sets.split(","):
        for hunt in hunts(given.data, name, options, given.splits):
            print("\n".join(describe(hunt)), flush=True)
            run, worse = run + (hunt.errors is not None), worse + hunt.is_worse
            for judged in hunt.report.effects:
                counted[hunt.arm][judged.verdict].add(judged.claim.words)
    for arm, by_verdict in counted.items():
        print(f"{arm}: " + ", ".join(f"{len(words)} {verdict}" for verdict, words in by_verdict.items()))
    print(f"{worse} of {run} versions are worse than geometry on the other half, beyond chance")


if __name__ == "__main__":
    main()
