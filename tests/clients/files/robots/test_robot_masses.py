"""Masses in DH and MDH tables: read, exported and read again, against Pinocchio and bodies placed here."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray
from openpyxl import Workbook

from kilter_client.errors import FileError
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import joint_loads
from kilter_core.arm.presets import preset_document
from kilter_files.robots import Described, read_robot
from kilter_service.robots.exporters.registry import export
from tests.service.exporters.test_exporters import ERRORS, TILTS, calibrated

Floats = NDArray[np.float64]

HEADER = "joint,theta_offset_deg,d_mm,a_mm,alpha_deg,mass_kg,com_x_mm,com_y_mm,com_z_mm"
INERTIA = "ixx_kg_m2,iyy_kg_m2,izz_kg_m2,ixy_kg_m2,ixz_kg_m2,iyz_kg_m2"
ROWS = (
    "base,0,300,0,90,8.5,0,-40,10,0.06,0.05,0.04,0.001,0.002,-0.003",
    "shoulder,10,0,500,0,6.25,-230,5,-12,0.02,0.3,0.29,0.004,-0.001,0.002",
    "elbow,0,20,400,0,3.125,-180,0,7,0.01,0.1,0.09,0,0.001,0",
)
TABLE = "\n".join((f"{HEADER},{INERTIA}", *ROWS)) + "\n"


def read(path: Path, text: str, **said: Any) -> dict[str, Any]:
    path.write_text(text, encoding="utf-8")
    return read_robot(path, Described(**({"name": "arm", "convention": "dh"} | said)))


def refused(path: Path, text: str) -> FileError:
    with pytest.raises(FileError) as caught:
        read(path, text)
    return caught.value


def test_loads_of_a_table_are_those_of_the_bodies_it_describes(tmp_path: Path) -> None:
    robot = robot_from_document(read(tmp_path / "arm.csv", TABLE))
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (10, 3))
    qd, qdd = np.cos(q), np.sin(q)
    found = joint_loads(robot, q, qd=qd, qdd=qdd).joints[:, :, 5]
    model = by_hand()
    data = model.createData()
    torques = [pinocchio.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)]
    assert np.abs(found + np.array(torques)).max() < 1e-9


def by_hand() -> pinocchio.Model:
    """The table's arm, bodies placed behind Tz(d) Rz(theta) Tx(a) Rx(alpha), one joint about z each."""
    model, parent, before = pinocchio.Model(), 0, pinocchio.SE3.Identity()
    for line in ROWS:
        name, *cells = line.split(",")
        theta, d, a, alpha, mass, x, y, z, *inertia = (float(cell) for cell in cells)
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), before, name)
        turn = pinocchio.utils.rotate("z", math.radians(theta)) @ pinocchio.utils.rotate("x", math.radians(alpha))
        shift = pinocchio.utils.rotate("z", math.radians(theta)) @ np.array([a, 0, 0]) / 1e3 + np.array([0, 0, d]) / 1e3
        before = pinocchio.SE3(turn, shift)
        xx, yy, zz, xy, xz, yz = inertia
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pinocchio.Inertia(mass, np.array([x, y, z]) / 1e3, tensor)
        model.appendBodyToJoint(parent, body, before)
    model.gravity.linear = np.array([0, 0, -9.80665])
    return model


def test_a_workbook_and_metres_give_the_same_masses(tmp_path: Path) -> None:
    plain = read(tmp_path / "arm.csv", TABLE)
    book = Workbook()
    names, *rows = (line.split(",") for line in TABLE.splitlines())
    book.active.append([name.replace("com_x_mm", "com_x_m") for name in names])
    for row in rows:
        book.active.append([row[0], *(float(cell) / (1e3 if k == 5 else 1) for k, cell in enumerate(row[1:]))])
    book.save(tmp_path / "arm.xlsx")
    again = read_robot(tmp_path / "arm.xlsx", Described("arm", convention="dh"))
    assert [link["com_mm"] for link in again["links"]] == [pytest.approx(link["com_mm"]) for link in plain["links"]]
    assert [link["mass_kg"] for link in again["links"]] == [8.5, 6.25, 3.125]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (",6.25,", ",,", "line 3, column 'mass_kg': is empty while others are filled"),
        (",-230,", ",,", "line 3, column 'com_x_mm': is empty while others are filled"),
        (",0.29,", ",,", "line 3, column 'izz_kg_m2': is empty while others are filled"),
        (",6.25,", ",-6.25,", "line 3, column 'mass_kg': -6.25 kg: a mass cannot be negative"),
        (",0.29,", ",-0.29,", "line 3, column 'izz_kg_m2': -0.29 kg m2"),
        (",0.004,", ",4,", "line 3, column 'ixy_kg_m2': 4 kg m2 is more than the moments allow"),
        (",-230,", ",left,", "line 3, com_x: 'left' is not a number"),
        (",com_y_mm", ",com_y", "column 'com_y' has no unit"),
        (",mass_kg", ",mass_g", "column 'mass_g' is not known"),
        (",mass_kg", ",mass_kgs", "did you mean 'mass_kg'"),
    ],
)  # fmt: skip
def test_half_filled_and_wrong_cells_name_row_and_column(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(tmp_path / "arm.csv", TABLE.replace(old, new, 1)).detail


def test_half_a_group_of_columns_is_refused(tmp_path: Path) -> None:
    text = "a_mm,mass_kg,com_x_mm,com_y_mm\n100,1,0,0\n"
    found = refused(tmp_path / "arm.csv", text)
    assert "no column 'com_z_mm'" in found.detail
    assert "no column 'mass_kg'" in refused(tmp_path / "arm.csv", "a_mm,com_x_mm\n100,1\n").detail
    text = "a_mm,mass_kg,com_x_mm,com_y_mm,com_z_mm,ixx_kg_m2\n100,1,0,0,0,1\n"
    assert "no column 'iyy_kg_m2'" in refused(tmp_path / "arm.csv", text).detail


def test_empty_columns_are_no_masses_and_nothing_needs_no_centre(tmp_path: Path) -> None:
    header, *rows = (line.split(",")[:9] for line in TABLE.splitlines())
    empty = [header, *([*row[:5], "", "", "", ""] for row in rows)]
    assert "links" not in read(tmp_path / "arm.csv", "\n".join(map(",".join, empty)))
    bare = [header, [*rows[0][:5], "0", "", "", ""], *rows[1:]]
    assert read(tmp_path / "arm.csv", "\n".join(map(",".join, bare)))["links"][0] == {"mass_kg": 0.0}


@pytest.mark.parametrize(("form", "errors"), [("dh-csv", ERRORS), ("mdh-csv", ERRORS | TILTS)])
def test_exported_masses_load_the_joints_as_the_identified_arm(
    tmp_path: Path, form: str, errors: dict[str, float]
) -> None:
    carried = {"payload_kg": 2.5, "payload_com_mm": [1.0, 0.0, 60.0]}
    tilted = preset_document("ur10") | {"gravity_m_s2": [3.0, -2.0, -9.0], "load": carried}
    file, calibration = calibrated(errors, **tilted)
    document = read(tmp_path / "table.csv", export(form, file).text, convention=None)
    again = robot_from_document(document)
    assert document["load"] == carried
    identified = calibration.model.with_loads_at_values(calibration.values).load_robot
    q = np.random.default_rng(2).uniform(-2, 2, (10, 6))
    motion = {"qd": np.cos(q), "qdd": np.sin(q)}
    expected = joint_loads(identified, q, **motion).joints[:, :, 5]
    assert np.abs(joint_loads(again, q, **motion).joints[:, :, 5] - expected).max() < 1e-8
    assert np.abs(expected).max() > 10.0


def test_an_export_says_that_it_leaves_out_how_well_masses_are_known() -> None:
    links = [{**link, "mass_sigma_kg": 0.2} for link in preset_document("ur10")["links"]]
    file, _ = calibrated(ERRORS, links=links)
    assert "standard deviations of masses" in " ".join(export("dh-csv", file).notes)
    plain, _ = calibrated(ERRORS)
    assert "standard deviations" not in " ".join(export("dh-csv", plain).notes)
