"""Do the thesis's experiments again on simulated arms and write docs/explanation/thesis-reproduction.md.

``python -m tools.thesis_reproduction [--seeds 20]``: two minutes on one core. Every verdict on the page is counted.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kilter_core.types import Floats
from tools.influence_and_tilting import HEADING
from tools.thesis import drawing
from tools.thesis import experiments as done
from tools.thesis.drawing import spread, table

Samples = dict[str, Floats]
Texts = dict[str, str]

TEMPLATE = Path(__file__).resolve().parent / "thesis" / "thesis-reproduction.md"
PAGE = Path(__file__).resolve().parent.parent / "docs" / "explanation" / "thesis-reproduction.md"
SEEDS = 20
MODELS = ("before", "conventional", "stiffness only", "full, tilt first", "full, together")
THESIS_118 = {"before": "1.21 (max 2.11)", "conventional": "0.33 (max 0.70)", "full, tilt first": "0.12 (max 0.24)"}
THESIS_10 = {"before": "0.76–1.54", "conventional": "0.25–0.75", "full, tilt first": "0.11–0.16"}
THESIS_CIRCLE = {"before": "0.653", "conventional": "0.312", "stiffness only": "0.211", "full, tilt first": "0.132"}
THESIS_METHODS = {"before": "1.21", "pose_pseudo_inverse": "0.38", "influence": "0.21"}
METHODS = {
    "before": "before",
    "pose_pseudo_inverse": "pseudo-inverse by pose, until settled (eq. 3.6)",
    "influence": "influence-based, until settled (eq. 3.7, 3.8)",
    "least_squares": "stacked least squares",
    "pose_pseudo_inverse, one round": "pseudo-inverse by pose, one round",
    "influence, one round": "influence-based, one round",
}
NEARLY = 0.02  # relative difference of two methods below which neither is called better


def main() -> None:
    """Run everything and write the page but for its last section, and its pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    seeds = parser.parse_args().seeds
    calibrate, unseen = done.poses(done.katana())
    texts = {"seeds": str(seeds)} | influence(calibrate) | methods(seeds, calibrate, unseen)
    texts |= models(seeds, calibrate, unseen)
    _, heading, last = PAGE.read_text(encoding="utf-8").partition(HEADING)
    page = TEMPLATE.read_text(encoding="utf-8").format(**texts)
    PAGE.write_text(f"{page}\n{heading}{last}" if heading else page, encoding="utf-8")


def influence(calibrate: Floats) -> Texts:
    """Figure 3.8."""
    moved = done.influence(calibrate)
    names = sorted(moved, key=lambda name: -float(moved[name].mean()))
    title = "Displacement by +0.05 deg or +0.1 mm over 118 poses: median and range"
    drawing.bars("thesis-influence", title, "mm", {"": {name: moved[name] for name in names}})
    share = float(np.mean(moved["q3"] > moved["q2"]))
    lengths = np.concatenate([moved[n] for n in names if "_" in n and n[0] in "ad" and n[1] == "_"])
    holds = share > 0.0 and bool(np.allclose(lengths, 0.1, atol=1e-6))
    return {
        "influence_verdict": "Holds." if holds else "Does not hold.",
        "elbow_share": f"{share:.0%}",
        "shoulder_mean": f"{moved['q2'].mean():.2f}",
        "shoulder_most": f"{moved['q2'].max():.2f}",
    }


def methods(seeds: int, calibrate: Floats, unseen: Floats) -> Texts:
    """Table 3.4."""
    runs = [done.methods(seed, calibrate, unseen) for seed in range(seeds)]
    train, held = ({name: np.array([run[name][side] for run in runs]) for name in METHODS} for side in (0, 1))
    rows = [[METHODS[n], THESIS_METHODS.get(n, "–"), spread(train[n]), spread(held[n])] for n in METHODS]
    gain = float(np.median(1.0 - held["influence"] / held["least_squares"]))
    once = {n: float(np.median(held[f"{n}, one round"])) for n in ("pose_pseudo_inverse", "influence")}
    verdict = "Does not hold." if gain < NEARLY else "Holds."
    return {
        "methods_table": table(["method", "thesis, 118 poses", "118 poses", "60 poses not used"], rows),
        "methods_verdict": verdict,
        "over_stacked": str(int(np.sum(held["influence"] < held["least_squares"]))),
        "over_plain": str(int(np.sum(held["influence"] < held["pose_pseudo_inverse"]))),
        "gain": f"{gain:.1%}",
        "once": str(int(np.sum(held["influence, one round"] < held["pose_pseudo_inverse, one round"]))),
        "once_influence": f"{once['influence']:.3f}",
        "once_plain": f"{once['pose_pseudo_inverse']:.3f}",
    }


@dataclass
class Tally:
    """Errors of every model over the arms: on the 118 poses (mean, largest), on poses not used, on the circle."""

    train: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MODELS})
    most: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MODELS})
    held: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MODELS})
    ring: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MODELS})

    def samples(self, part: str) -> Samples:
        """One of the four as arrays."""
        return {name: np.array(values) for name, values in getattr(self, part).items()}

    def ordered(self, part: str) -> int:
        """For how many arms before > conventional > stiffness only > full."""
        s = self.samples(part)
        full = np.maximum(s["full, tilt first"], s["full, together"])
        in_order = (s["before"] > s["conventional"]) & (s["conventional"] > s["stiffness only"])
        return int(np.sum(in_order & (s["stiffness only"] > full)))


def models(seeds: int, calibrate: Floats, unseen: Floats) -> Texts:
    """Tables 4.5 and 4.6, and the circle."""
    tally, texts = Tally(), Texts()
    for seed in range(seeds):
        arm, found = done.models(seed, calibrate)
        driven = done.along_circle(arm, found)
        for name, calibration in found.items():
            there = done.errors_mm(calibration, arm, calibrate)
            tally.train[name].append(float(there.mean()))
            tally.most[name].append(float(there.max()))
            tally.held[name].append(float(done.errors_mm(calibration, arm, unseen).mean()))
            tally.ring[name].append(float(driven[name].mean()))
        if seed == 0:
            each = {name: done.errors_mm(c, arm, unseen[: done.TEN]) for name, c in found.items()}
            ten = [[str(k + 1), *(f"{each[name][k]:.3f}" for name in MODELS)] for k in range(done.TEN)]
            texts = {"ten_table": table(["pose", *MODELS], ten), **_circle(driven)}
    return texts | _tables(seeds, tally)


def _tables(seeds: int, tally: Tally) -> Texts:
    train, most, held, ring = (tally.samples(part) for part in ("train", "most", "held", "ring"))
    rows = [
        [
            n,
            THESIS_118.get(n, "–"),
            f"{spread(train[n])}, max {np.median(most[n]):.2f}",
            THESIS_10.get(n, "–"),
            spread(held[n]),
        ]
        for n in MODELS
    ]
    groups = {"118 poses": train, "60 uncalibrated poses": held}
    drawing.bars("thesis-tables", f"Mean |ΔP| of {seeds} arms: median and range", "mm", groups, log=True)
    order = {part: tally.ordered(part) for part in ("train", "held", "ring")}
    ratio = float(np.median(held["full, tilt first"] / held["full, together"]))
    head = ["model", "thesis, 118 poses", "118 poses", "thesis, 10 uncalibrated", "60 uncalibrated"]
    return {
        "models_table": table(head, rows),
        "models_verdict": verdict(min(order["train"], order["held"]), seeds),
        "order_train": str(order["train"]),
        "order_held": str(order["held"]),
        "order_circle": str(order["ring"]),
        "tilt_first": f"{ratio:.2f}",
        "circle_table": table(
            ["corrected by", "thesis", "here"], [[n, THESIS_CIRCLE.get(n, "–"), spread(ring[n])] for n in MODELS]
        ),
        "circle_verdict": verdict(order["ring"], seeds),
    }


def verdict(count: int, of: int) -> str:
    """Say in a word whether a claim held."""
    if count >= 0.9 * of:
        return "Holds."
    return "Holds for most arms." if count > 0.5 * of else "Does not hold."


def _circle(driven: Samples) -> Texts:
    x = np.arange(done.POINTS + 1) / done.POINTS
    place, alone = "part of the circle", done.tilting_alone(0)
    drawing.lines("thesis-circle", "Distance from the wanted circle, first arm", place, "mm", x, driven, log=True)
    drawing.lines("thesis-tilting", "Displacement of the tool by tilting, first arm", place, "mm", x, alone, log=True)
    stiff, whole = alone.values()
    return {
        "stiff_mm": f"{stiff.mean():.3f}",
        "tilt_mm": f"{whole.mean():.3f}",
        "jump_mm": f"{np.max(np.abs(np.diff(whole))):.2f}",
    }


if __name__ == "__main__":
    main()
