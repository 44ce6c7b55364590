"""Calibrations of Universal Robots arms as a controller keeps them: the same arm as the product of its own table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.model.geometry import missing_directions
from kilter_files.robots import Described, read_robot

from .test_robot_files import DEFAULTS, poses, refused, ur_file, write

Floats = NDArray[np.float64]
ALPHA = np.array([np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0])


def deltas(seed: int) -> dict[str, Floats]:
    """Errors of a factory: metres along three nearly parallel axes that add up to nothing, and any angle about them."""
    rng = np.random.default_rng(seed)
    found = {"theta": rng.normal(0, 1e-4, 6), "a": rng.normal(0, 3e-4, 6), "d": rng.normal(0, 3e-4, 6)}
    found["alpha"] = rng.normal(0, 2e-3, 6)
    along, turn = rng.uniform(-20, 20, 2), rng.uniform(-3, 3, 2)
    found["d"][1:4] += [along[0], along[1], -along.sum()]
    found["theta"][1:4] += [turn[0], turn[1], -turn.sum()]
    return found


def conf(path: Path, found: dict[str, Floats], stem: str = "delta_", sign: str = " = ") -> Path:
    lines = [f"{stem}{name}{sign}[ {', '.join(f'{v:.12g}' for v in values)}]" for name, values in found.items()]
    return write(path, "\n".join(["[mounting]", *lines, "calibration_status = 2", ""]))


def whole(model: str, found: dict[str, Floats]) -> dict[str, Floats]:
    d1, a2, a3, d4, d5, d6 = np.abs(DEFAULTS[model]) * [1, -1, -1, 1, 1, 1]
    return {
        "theta": found["theta"], "a": found["a"] + [0, a2, a3, 0, 0, 0], "d": found["d"] + [d1, 0, 0, d4, d5, d6],
        "alpha": found["alpha"] + ALPHA,
    }  # fmt: skip


def product(table: dict[str, Floats], q: Floats) -> Floats:
    """Flanges (N, 4, 4) m of joints (N, 6) rad by the definition of the table."""
    out = []
    for row in q:
        T = np.eye(4)
        for k, angle in enumerate(row):
            c, s = np.cos(angle + table["theta"][k]), np.sin(angle + table["theta"][k])
            ca, sa = np.cos(table["alpha"][k]), np.sin(table["alpha"][k])
            a, d = table["a"][k], table["d"][k]
            T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        out.append(T)
    return np.array(out)


@pytest.mark.parametrize("model", ["ur3", "ur5", "ur10e"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_controllers_calibration_is_added_to_the_table_of_the_model(tmp_path: Path, model: str, seed: int) -> None:
    found, q = deltas(seed), np.random.default_rng(seed).uniform(-3, 3, (20, 6))
    document = read_robot(conf(tmp_path / "calibration.conf", found), Described("arm", model=model))
    assert np.abs(poses(document, q) - product(whole(model, found), q)).max() < 1e-9
    assert missing_directions(robot_from_document(document)).tolist() == [0] * 6
    near = {element["name"]: element["value"] for element in document["elements"] if "name" in element}
    assert abs(near["forearm_z"]) < 1e-6
    assert (
        max(abs(near[f"forearm_{turn}"]) for turn in ("roll", "pitch", "yaw")) < 1.0
    )  # deg: frames near the drawing's


def test_whole_tables_are_checked_against_the_model(tmp_path: Path) -> None:
    found, q = deltas(4), np.random.default_rng(4).uniform(-3, 3, (20, 6))
    found["d"][1:4] = found["theta"][1:4] = 0.0
    table = whole("ur5", found)
    path = conf(tmp_path / "calibration.yaml", table, "dh_", ": ")
    document = read_robot(path, Described("arm", model="ur5"))
    assert np.abs(poses(document, q) - product(table, q)).max() < 1e-9
    assert "It is a UR5" in refused(path, model="ur10")
    nested = {"kinematics": {f"dh_{name}": values.tolist() for name, values in table.items()}, "hash": 5}
    other = write(tmp_path / "nested.yaml", yaml.safe_dump(nested, default_flow_style=False))
    assert np.abs(poses(read_robot(other, Described("arm", model="ur5")), q) - product(table, q)).max() < 1e-9


def test_a_controllers_calibration_is_known_by_what_it_holds(tmp_path: Path) -> None:
    found = deltas(5)
    for name in ("calibration.conf", "calibration.txt", "calibration"):
        path = conf(tmp_path / name, found)
        assert read_robot(path, Described("arm", model="ur5"))["source"] == (
            f"factory calibration {name}, added to the table of a UR5"
        )
    short = write(
        tmp_path / "short.conf", "delta_a = [0,0,0,0,0]\ndelta_d = [0,0,0,0,0,0]\ndelta_alpha = [0,0,0,0,0,0]\n"
    )
    assert "delta_a is not six numbers" in refused(short, model="ur5")
    assert "has no 'kinematics'" in refused(write(tmp_path / "none.conf", "delta_a = [0,0,0,0,0,0]\n"), model="ur5")


@pytest.mark.parametrize("model", [*DEFAULTS])
@pytest.mark.parametrize("seed", [None, 1])
def test_the_yaml_of_a_calibration_has_all_directions(tmp_path: Path, model: str, seed: int | None) -> None:
    document = read_robot(ur_file(tmp_path / "c.yaml", model, seed), Described("arm", model=model))
    assert missing_directions(robot_from_document(document)).tolist() == [0] * 6
