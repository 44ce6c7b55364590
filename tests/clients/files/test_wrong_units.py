"""Recordings whose unit is stated wrongly: refused with the factor, and the option that is named mends them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.files.formats.test_bad_recordings import c3d_bytes
from tests.clients.files.simulated import stops
from tests.core.campaigns import MARKERS
from tests.core.truth import ur10

STATED_MM = {"mm": 1.0, "m": 1000.0}
TRUE_MM = {"mm": 1.0, "m": 1000.0, "inch": 25.4}


def told(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> Any:
    assert run([*map(str, words), "--json"]) == code, capsys.readouterr().out
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(("true", "stated"), [("m", "mm"), ("mm", "m"), ("inch", "mm")])
def test_a_c3d_with_another_unit_than_stated(
    true: str, stated: str, server: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm, rng, name = ur10(), np.random.default_rng(2), f"units-{true}-{stated}"
    with Kilter() as kilter:
        kilter.robots.add(arm.document() | {"name": name})
    poses = rng.uniform([-40, -110, 30, -120, -110, -40], [40, -60, 90, -60, -60, 40], (14, 6))
    t = np.arange(0.0, 14 * 2.5, 0.02)
    q = stops(poses, 1.5, 1.0, t)
    position, rotation = arm.poses(np.radians(q))
    points = 1e3 * (position[:, None] + np.einsum("nij,mj->nmi", rotation, MARKERS) + [0.2, 0.3, -2.0])
    points += rng.normal(0.0, 0.02, points.shape)
    path, log = tmp_path / "a.c3d", tmp_path / "log.csv"
    path.write_bytes(c3d_bytes(points / TRUE_MM[true], 50.0, -1.0, "<", stated))
    head = ",".join(f"q{k + 1}_deg" for k in range(6))
    np.savetxt(log, poses, delimiter=",", header=head, comments="", fmt="%.8f")
    if true != "inch":
        inspected = told(capsys, "inspect", path)
        assert any(f"--unit {true}" in text for text in inspected["warnings"]), inspected["warnings"]
    slow = ["--rest-speed", 50 * TRUE_MM[stated] / TRUE_MM[true]] if true != "mm" else ["--rest-speed", 20_000]
    ask = ["match", path, log, "--robot", name]
    refused = told(capsys, *ask, *slow, "--shortest", 0.8, code=1)["detail"]
    assert f"{true} declared as {stated}" in refused
    assert f"--unit {true})" in refused
    right = told(capsys, *ask, "--unit", true)
    assert right["rows"] == 14
    assert any(f"taken as {true}, as you say; the file says {stated}" in text for text in right["warnings"])
