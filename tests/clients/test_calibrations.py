"""Relative calibration, contacts and forces on the tool from a file to a version, by the commands a lab types."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_client import Kilter
from kilter_client.cli import run
from tests.core.arm.test_wrench import COMPLIANCE, loaded
from tests.core.campaigns import joints
from tests.core.measurement.test_contacts import lengths, sockets
from tests.core.measurement.test_distances import campaign
from tests.core.truth import ur10

Capture = pytest.CaptureFixture[str]
Floats = NDArray[np.float64]


def write(path: Path, q: Floats, columns: Mapping[str, Any]) -> Path:
    table = {f"q{j + 1}_deg": np.degrees(q[:, j]) for j in range(q.shape[1])} | dict(columns)
    np.savetxt(
        path, np.column_stack([*table.values()]), delimiter=",", header=",".join(table), comments="", fmt="%.14g"
    )
    return path


def said(capsys: Capture, *arguments: str, code: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    assert run([*arguments, "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def xyz(position: Any) -> dict[str, Floats]:
    return {f"{axis}_mm": 1e3 * position[:, k] for k, axis in enumerate("xyz")}


def test_distances_only(server: Path, tmp_path: Path, capsys: Capture) -> None:
    _, train, held = campaign()
    with Kilter() as kilter:
        kilter.robots.add({**ur10().document(), "name": "relative", "links": None})
    ids = []
    for name, rows in (("train", train), ("held", held)):
        path = write(tmp_path / f"{name}.csv", rows.q, xyz(rows.position))
        ids.append(said(capsys, "upload", "relative", str(path))["campaign_id"])
    identify = ("identify", "relative", "--campaign", ids[0], "--validation", ids[1])
    job = said(capsys, *identify, "--base", "removed")
    assert job["result"]["metrics"]["validation"]["identified"]["rms_mm"] < 0.04
    assert not [p["name"] for p in job["result"]["parameters"] if p["name"].startswith("base_")]
    # The version stands beside positions once its base is put where it fits.
    version = ("--version", job["result"]["version_id"], "--refit", "base")
    refit = said(capsys, "evaluate", "relative", "--campaign", ids[1], *version)
    assert refit["result"]["metrics"][ids[1]]["identified"]["rms_mm"] < 0.06
    refused = said(capsys, *identify, "--base", "removed", "--method", "kalman", code=1)
    assert "Distances between poses" in json.dumps(refused)
    assert run([*identify, "--base", "removed"]) == 0
    assert "unseen (413)" in capsys.readouterr().out


def test_a_ball_in_sockets(server: Path, tmp_path: Path, capsys: Capture) -> None:
    drawn, _, rows = sockets()
    with Kilter() as kilter:
        kilter.robots.add({**drawn.document(), "name": "socketed", "links": None})
    path = write(tmp_path / "sockets.csv", rows.q, {"socket_id": rows.socket})
    done = said(capsys, "upload", "socketed", str(path))
    job = said(
        capsys, "identify", "socketed", "--campaign", done["campaign_id"], "--validation", "0.25",
        "--option", f"socket_distances_mm={json.dumps(lengths())}",
    )  # fmt: skip
    block = job["result"]["metrics"]["validation"]
    assert block["identified"]["rms_mm"] < 0.03 < block["nominal"]["rms_mm"] / 10
    gap = said(capsys, "gap", "socketed", "--campaign", done["campaign_id"], "--option", "resamples=5")["result"]
    assert gap["verdict"] in ("no_gap", "not_known", "provisional", "unexplained")
    assert "scale_held" in [warning["code"] for warning in gap["warnings"]]
    assert gap["gap"]["after_mm"] < 0.03


def test_forces_on_the_tool(server: Path, tmp_path: Path, capsys: Capture) -> None:
    rows = loaded(80, 1)
    with Kilter() as kilter:
        kilter.robots.add({**ur10().document(), "name": "pushed", "links": None})
    assert rows.wrench is not None
    names = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
    forces = dict(zip(names, rows.wrench.T, strict=True))
    path = write(tmp_path / "pushed.csv", rows.q, {**xyz(rows.position), **forces})
    done = said(capsys, "upload", "pushed", str(path))
    job = said(
        capsys, "identify", "pushed", "--campaign", done["campaign_id"], "--effects", "axial_compliance",
        "--free", "theta_offset_*",
    )  # fmt: skip
    found = {p["name"]: p["value"] for p in job["result"]["parameters"]}
    assert found["compliance_2"] == pytest.approx(np.degrees(COMPLIANCE), rel=0.05)


def test_a_force_of_the_whole_campaign(server: Path, tmp_path: Path, capsys: Capture) -> None:
    with Kilter() as kilter:
        kilter.robots.add({**ur10().document(), "name": "leaned-on", "links": None})
        path = write(tmp_path / "rows.csv", (q := joints(ur10(), 5, np.random.default_rng(0))), xyz(ur10().poses(q)[0]))
        done = said(capsys, "upload", "leaned-on", str(path), "--tool-force-n", "0,0,-50")
        stored = {c["id"]: c for c in kilter.campaigns.list("leaned-on")}[done["campaign_id"]]
        assert stored["conditions"]["tool_force_n"] == [0, 0, -50]
    assert run(["upload", "leaned-on", str(path), "--tool-force-n", "50"]) == 2


def test_markers_that_changed_places_are_refused_by_client_and_server(
    server: Path, tmp_path: Path, capsys: Capture
) -> None:
    _, train, _ = campaign("markers", rows=40)
    assert train.markers is not None
    swapped = train.markers.copy()
    swapped[20:] = swapped[20:, [2, 1, 0]]
    with Kilter() as kilter:
        kilter.robots.add({**ur10().document(), "name": "swapped", "links": None})
    cells = {f"m{k + 1}{axis}_mm": 1e3 * swapped[:, k, a] for k in range(3) for a, axis in enumerate("xyz")}
    sheet = str(write(tmp_path / "swapped.csv", train.q, cells))
    refused = said(capsys, "upload", "swapped", sheet, code=1)
    assert "markers 'm1' and 'm3' change places between rows 20 and 21" in refused["detail"]
    assert said(capsys, "campaigns", "list", "swapped")["campaigns"] == []
    by_server = said(capsys, "upload", "swapped", sheet, "--unchecked")  # whoever says that they are right is believed
    assert any("From row 21 on" in one for one in by_server["warnings"])
