"""The public campaigns as observations: read by the client's readers, put together by the service, without a server."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.csv
from pyarrow import BufferReader

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations
from kilter_files import prepare
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns

EXAMPLES = Path(__file__).resolve().parents[2] / "clients/python/examples"
UR10 = "ipa-ur10-lasertracker"

CAMPAIGNS = ("ipa-a", "ipa-b", "talos", "fanuc", "kr300-a", "kr300-b", "kr300-c")
WITH_TOOL = CAMPAIGNS[:4]


def real_campaign(folder: Path, name: str) -> tuple[Robot, Observations]:
    """A robot and what was measured of it."""
    if name == "talos":
        file, kind = folder / "talos-arm/talos_left_arm_02_10_contact.csv", {"column_map": EXAMPLES / "talos.toml"}
    elif name == "fanuc":
        file, kind = folder / "fanuc-r2000-3markers/calibration_dataset.mat", {"column_map": EXAMPLES / "fanuc.toml"}
    elif name.startswith("kr300"):
        file = folder / f"kuka-kr300-secondary-encoder/traj_{name[-1].upper()}.mat"
        kind = {"column_map": EXAMPLES / "kr300.toml"}
    else:
        series = {"ipa-a": "Series_A/measurements_grid.csv", "ipa-b": "Series_B/measurements_joint_configurations.csv"}
        file, kind = folder / UR10 / series[name], {"device": "ipa-lasertracker"}
    robot = robot_from_document(_document(folder, name))
    content = prepare(file, **kind).content  # type: ignore[arg-type]
    table = pyarrow.csv.read_csv(BufferReader(content))
    table = table.cast(pyarrow.schema([(c, pyarrow.float64()) for c in table.column_names]))
    columns = read_columns(table.column_names, [j.kind for j in robot.joints])
    return robot, observations(table, columns, {})


def _document(folder: Path, name: str) -> dict[str, Any]:
    if name == "talos":
        urdf = (folder / "talos-arm/talos_full_v2.urdf").read_text(encoding="utf-8")
        links = {"base_link": "base_link", "tip_link": "arm_left_7_link"}
        return _understood({"name": name, "convention": "urdf", "urdf": urdf, **links})
    if name in ("fanuc", "kr300-a", "kr300-b", "kr300-c"):
        file = EXAMPLES / ("fanuc-r2000.json" if name == "fanuc" else "kr300.json")
        return _understood(json.loads(file.read_text(encoding="utf-8")))
    return preset_document("ur10")


def _understood(posted: dict[str, Any]) -> dict[str, Any]:
    from kilter_service.robots.documents import core_document

    return core_document(posted).document
