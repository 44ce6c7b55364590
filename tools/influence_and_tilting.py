"""Whether influence weights and tilting help each other: writes the last section of docs/explanation/thesis-reproduction.md.

``python -m tools.influence_and_tilting [--seeds 10]``: four minutes on one core.

Influence weights and joint tilting together (thesis, future work 6.2), on several makes of arm.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.types import Floats
from tools.thesis import drawing
from tools.thesis.arms import ELBOW, KATANA, SKEWED, Arm, Make, built
from tools.thesis.drawing import table
from tools.thesis.experiments import UNSEEN, by_inclinometer, mean_mm, measured

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
    for label, make in MAKES.items():
        robot = robot_of(make)
        calibrate, unseen = poses(robot, max(COUNTS))
        for count in COUNTS:
            runs = [compared(robot, make, seed, calibrate[:count], unseen) for seed in range(seeds)]
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


MAKES: Mapping[str, Make] = {"Katana 450": KATANA, "elbow arm, 6 axes": ELBOW, "skewed Katana": SKEWED}
BASE_MM = (55.0, 55.0, 201.5)
TOOL_MM = 130.0
PLAIN = IdentifyOptions(base="fixed", tool="fixed", level=2)
FULL = replace(PLAIN, level=3)
# What is said of tilting, by which method the geometry is found.
TREATMENTS: Mapping[str, IdentifyOptions] = {
    "no tilting, least squares": PLAIN,
    "no tilting, influence": replace(PLAIN, method="influence"),
    "tilting measured first, least squares": replace(FULL, tilt_first=True),
    "tilting measured first, influence": replace(FULL, tilt_first=True, method="influence"),
    "tilting identified too, least squares": FULL,
    "tilting identified too, influence": replace(FULL, method="influence"),
}


def robot_of(make: Make) -> Robot:
    """The make as Kilter is given it."""
    joints = [{"name": f"j{k + 1}", "limits_deg": list(limits)} for k, limits in enumerate(make.limits_deg)]
    elements: list[dict[str, Any]] = []
    for name, axis, value in make.elements:
        if name[0] == "q":
            elements.append({"joint": f"j{name[1:]}", "axis": "Rz"})
        else:
            elements.append({"name": name, "axis": axis.capitalize(), "value": value})
    links = [{"mass_kg": m, "com_mm": list(com)} for m, com in zip(make.mass, make.com_mm, strict=True)]
    frame = dict.fromkeys(("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"), 0.0)
    base = {**frame, **dict(zip(("x_mm", "y_mm", "z_mm"), BASE_MM, strict=True))}
    return robot_from_document({
        "name": "arm", "convention": "chain", "joints": joints, "elements": elements, "links": links,
        "base": base, "tool": {**frame, "z_mm": TOOL_MM},
    })  # fmt: skip


def poses(robot: Robot, count: int) -> tuple[Floats, Floats]:
    """Joints to calibrate with (count, n) and never to calibrate with (60, n)."""
    q = iso_poses(robot, count + UNSEEN, seed=0)
    return q[:count], q[count:]


def compared(robot: Robot, make: Make, seed: int, calibrate: Floats, unseen: Floats) -> dict[str, float]:
    """Mean |ΔP| mm on poses not used, before and by every treatment."""
    arm: Arm = built(seed, make)
    rows, start = measured(arm, calibrate, seed), by_inclinometer(robot, arm, seed)
    out = {"before": mean_mm(Calibration.nominal(robot), arm, unseen)}
    for name, options in TREATMENTS.items():
        found = identify(robot, rows, options=options, start=start if options.tilt_first else None).calibration
        out[name] = mean_mm(found, arm, unseen)
    return out
