"""Write the files of the tutorial: the demo's simulated campaigns and the circle, as tables of the contract."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from kilter_client.cli import demo
from kilter_client.cli.trial import CIRCLE_S
from kilter_core.plan.iso9283_poses import iso_poses
from kilter_core.twin import thesis_katana

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "tutorial"
CIRCLE_RATE_HZ = 25.0
APPROACHED_AGAIN = 20  # poses of the fit: repeats tell the noise, without which a hunt confirms nothing


def main() -> None:
    """Write measured.csv, held-out.csv and circle.csv into docs/tutorial."""
    twin = thesis_katana(demo.PRESET)
    for name, count, again, seed in (
        ("measured", demo.TRAIN_POSES, APPROACHED_AGAIN, 1),
        ("held-out", demo.HELD_OUT_POSES, 0, 2),
    ):
        poses = iso_poses(twin.robot, count, seed)
        poses = np.vstack([poses, poses[:again]])
        demo.write_campaign(FOLDER / f"{name}.csv", twin.observe(poses, noise_m=demo.NOISE_MM / 1000.0, seed=seed))
    path = demo.circle(twin.robot, seconds=CIRCLE_S, rate_hz=CIRCLE_RATE_HZ)
    with (FOLDER / "circle.csv").open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        rows.writerow(["t_s", *(f"q{joint + 1}_deg" for joint in range(path.q.shape[1]))])
        for t, q in zip(path.t, np.degrees(path.q), strict=True):
            rows.writerow([f"{t:.3f}", *(f"{value:.8f}" for value in q)])


if __name__ == "__main__":
    main()
