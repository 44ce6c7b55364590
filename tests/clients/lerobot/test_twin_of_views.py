"""`kilter version twin compare` with views of a board: any model of the arm, in pixels and in millimetres at the tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from tests.clients.files.formats.test_lerobot import calibration
from tests.clients.lerobot.so101_arm import JOINTS
from tests.clients.lerobot.so101_twin import NOMINAL, Twin
from tests.clients.lerobot.webcam import views, written
from tests.clients.test_cli import Command

NOISE_PX, PAYLOADS = 0.5, (0.0, 0.2)
ARM = Twin([0.0, 1.5, -1.0, 0.8, 0.0], [300.0, 33.0, 28.0, 40.0, 300.0], [0.0, 0.0, 1.1, 0.0, 0.0])


def test_a_model_is_scored_on_views_that_no_fit_has_seen(kilter: Kilter, command: Command, tmp_path: Path) -> None:
    """The exported twin leaves the noise of the corners, as does the arm itself; the nominal model what an evaluation says."""
    rows, rig = written(tmp_path, "fit", views(ARM, 12, np.random.default_rng(1), PAYLOADS, NOISE_PX))
    kilter.robots.add({"name": "seen", "convention": "preset", "preset": "so101"})
    fit = command.json(
        "kit", "seen", rows, "--cameras", rig, "--calibration", calibration(tmp_path), "--anyway", code=(0, 4)
    )
    rows, rig = written(tmp_path, "held", views(ARM, 6, np.random.default_rng(2), PAYLOADS, NOISE_PX))
    command("upload", "seen", rows, "--cameras", rig, "--name", "held", "--role", "validation",
            "--calibration", calibration(tmp_path))  # fmt: skip
    twin = tmp_path / "twin.xml"
    command("export", fit["version_id"], "--format", "mjcf", "-o", twin)
    asked = ("held", "--robot", "seen", "--version", fit["version_id"])

    def compared(model: Path) -> tuple[dict[str, Any], dict[str, float]]:
        document = command.json("twin", "compare", model, *asked)
        return document["errors"] | {"own": document["errors"][str(model)]}, document["pixels"]

    errors, pixels = compared(twin)
    assert pixels["noise_px"] == pytest.approx(NOISE_PX, rel=0.1)
    assert pixels["rms_px"] == pytest.approx(NOISE_PX, rel=0.15)
    assert errors["own"]["mean_mm"] < 0.5
    assert errors["own"]["mean_mm"] == pytest.approx(errors["identified"]["mean_mm"], abs=0.1)

    for name, twin_of_it in (("theirs.xml", ARM), ("nominal.xml", NOMINAL)):
        (tmp_path / name).write_text(twin_of_it.xml())
    itself, pixels = compared(tmp_path / "theirs.xml")
    assert pixels["rms_px"] == pytest.approx(NOISE_PX, rel=0.1)
    assert itself["own"]["mean_mm"] < 0.3
    nominal, pixels = compared(tmp_path / "nominal.xml")
    assert nominal["own"]["mean_mm"] == pytest.approx(errors["nominal"]["mean_mm"], rel=0.1)
    assert nominal["own"]["mean_mm"] > 5.0
    assert pixels["rms_px"] > 10.0 * NOISE_PX
    assert pixels["noise_px"] == pytest.approx(NOISE_PX, rel=0.1)

    said = command("twin", "compare", tmp_path / "nominal.xml", *asked, "--rows", 6)
    assert "px (rms of a coordinate of a corner), of which 0." in said
    swapped = ",".join([JOINTS[1], JOINTS[0], *JOINTS[2:]])
    refused = command.json("twin", "compare", tmp_path / "nominal.xml", *asked, "--joints", swapped, code=2)
    assert "do not say where camera and board stand by this model" in refused["detail"]
