"""Whether influence weights and tilting help each other: writes the last section of docs/explanation/thesis-reproduction.md.

``python -m tools.influence_and_tilting [--seeds 10]``: four minutes on one core.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.stats

from kilter_core.types import Floats
from tools.thesis import combining, drawing
from tools.thesis.drawing import table

TEMPLATE = Path(__file__).resolve().parent / "thesis" / "influence-and-tilting.md"
PAGE = Path(__file__).resolve().parent.parent / "docs" / "explanation" / "thesis-reproduction.md"
HEADING = "## Do influence weights and joint tilting help each other?"
SEEDS = 10
COUNTS = (118, 30)
PAIRS = {"none": "no tilting", "first": "tilting measured first", "both": "tilting identified too"}


def main() -> None:
    """Run everything and write the section and its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    seeds = parser.parse_args().seeds
    groups: dict[str, dict[str, Floats]] = {}
    for label, make in combining.MAKES.items():
        robot = combining.robot_of(make)
        calibrate, unseen = combining.poses(robot, max(COUNTS))
        for count in COUNTS:
            runs = [combining.compared(robot, make, seed, calibrate[:count], unseen) for seed in range(seeds)]
            groups[f"{label}, {count} poses"] = {name: np.array([run[name] for run in runs]) for name in runs[0]}
    drawing.bars(
        "influence-and-tilting", f"Error on poses not used, {seeds} arms of each make", "mm",
        {name: group for name, group in groups.items() if "118" in name}, log=True,
    )  # fmt: skip
    above = PAGE.read_text(encoding="utf-8").partition(HEADING)[0]
    PAGE.write_text(above + TEMPLATE.read_text(encoding="utf-8").format(**texts(seeds, groups)), encoding="utf-8")


def texts(seeds: int, groups: dict[str, dict[str, Floats]]) -> dict[str, str]:
    """What the template leaves open; every claim is counted."""
    names = list(next(iter(groups.values())))
    rows = [[name, *(f"{np.median(group[name]):.3f}" for group in groups.values())] for name in names]
    whole = {name: np.concatenate([group[name] for group in groups.values()]) for name in names}
    out = {"seeds": str(seeds), "table": table(["", *groups], rows), "of": str(len(whole["before"]))}
    ratios = {}
    for key, label in PAIRS.items():
        ratio = whole[f"{label}, influence"] / whole[f"{label}, least squares"]
        better = int(np.sum(ratio < 1.0))
        p = float(scipy.stats.binomtest(better, len(ratio)).pvalue)
        ratios[key] = float(np.median(ratio))
        out |= {f"{key}_better": str(better), f"{key}_ratio": f"{np.median(ratio):.2f}", f"{key}_p": f"{p:.2g}"}
        out |= {f"{key}_low": f"{ratio.min():.2f}", f"{key}_high": f"{ratio.max():.2f}"}
    gain = whole["no tilting, least squares"] / whole["tilting measured first, least squares"]
    helps = ratios["first"] < 0.98 and float(out["first_p"]) < 0.01
    out["tilt_gain"] = f"{np.median(gain):.0f}"
    out["verdict"] = (
        "**Yes, together they are better than either alone.**"
        if helps
        else "**No.** Once tilting is known, influence weights do not make the identification more accurate."
    )
    return out


if __name__ == "__main__":
    main()
