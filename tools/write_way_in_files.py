"""Write the files of "From your own files to corrected setpoints": a lab's table of a simulated arm, and a path."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects import make_effect
from kilter_core.plan.iso9283_poses import iso_poses
from kilter_core.twin import Twin
from kilter_files.robots.table import read_table

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "tutorial"
ARM, MEASURED, PATH = FOLDER / "own-arm.csv", FOLDER / "own-measurements.csv", FOLDER / "own-path.csv"
POSES, APPROACHED_AGAIN, NOISE_MM = 100, 20, 0.02
SECONDS, RATE_HZ = 4.0, 25.0
GEOMETRY = {"theta_offset_2": 2e-3, "theta_offset_3": -1.5e-3, "theta_offset_5": 1e-3, "a_2": 4e-4, "d_4": -3e-4}
OFF_CENTRE_RAD = 0.8e-3  # the output gear of joint 1


def main() -> None:
    """Write own-measurements.csv and own-path.csv beside own-arm.csv, which is written by hand."""
    robot = robot_from_document(read_table(ARM, "dh", "own-arm"))
    errors = {**GEOMETRY, "eccentricity_sin_1": OFF_CENTRE_RAD, "eccentricity_cos_1": -OFF_CENTRE_RAD / 2}
    twin = Twin(robot, errors, (make_effect("eccentricity", joints=(0,)),))
    poses = iso_poses(robot, POSES, seed=4)
    poses = np.vstack([poses, poses[:APPROACHED_AGAIN]])
    seen = twin.observe(poses, noise_m=NOISE_MM / 1000.0, seed=4)
    assert seen.position is not None
    head = [*(f"A{joint + 1} [deg]" for joint in range(robot.n_joints)), "X [mm]", "Y [mm]", "Z [mm]"]
    rows = np.hstack([np.degrees(seen.q), seen.position * 1000.0])
    _write(MEASURED, head, rows, ";", lambda value: f"{value:.4f}".replace(".", ","))
    t = np.arange(round(SECONDS * RATE_HZ) + 1) / RATE_HZ
    turn = 2.0 * np.pi * t / SECONDS
    joints = np.stack([30 * np.sin(turn), 60 + 15 * np.cos(turn), -70 + 10 * np.sin(turn), 20 * np.cos(turn),
                       40 + 5 * np.sin(turn), 0 * turn], axis=1)  # fmt: skip
    _write(PATH, ["t_s", *(f"q{joint + 1}_deg" for joint in range(6))], np.column_stack([t, joints]))


def _write(
    path: Path, head: Iterable[str], rows: NDArray[np.float64], delimiter: str = ",", cell: Callable[[float], str] = str
) -> None:
    with path.open("w", newline="", encoding="utf-8") as out:
        table = csv.writer(out, delimiter=delimiter, lineterminator="\n")
        table.writerow(head)
        table.writerows([cell(round(float(value), 6)) for value in row] for row in rows)


if __name__ == "__main__":
    main()
