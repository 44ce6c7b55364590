"""Robot files of other tools, against kinematics written here or by their makers."""

from __future__ import annotations

import io
import math
import sys
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from openpyxl import Workbook

from kilter_client.errors import FileError, KilterError, MissingPackageError, UsageError
from kilter_core.arm.conversions import screws_of_chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_files.robots import Described, read_robot
from kilter_files.robots.read import described_document
from tests.service.exporters.test_exporters import ERRORS, TILTS, calibrated, joints, poses_of

Floats = NDArray[np.float64]

UR10_CSV = """joint;type;theta_offset_deg;d_m;a_m;alpha_rad;lower_deg;upper_deg
pan;revolute;0;0,1273;0;1,570796326794897;-360;360
lift;revolute;0;0;-0,612;0;-360;360
elbow;revolute;0;0;-0,5723;0;-360;360
w1;revolute;0;0,163941;0;1,570796326794897;-360;360
w2;revolute;0;0,1157;0;-1,570796326794897;-360;360
w3;revolute;0;0,0922;0;0;-360;360
"""


def poses(document: dict[str, Any], q: Floats) -> Floats:
    robot = robot_from_document(document)
    return np.asarray(robot.T_base @ screws_of_chain(robot.chain).poses(q) @ robot.T_tool)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path, kind: type[KilterError] = FileError, **said: Any) -> str:
    with pytest.raises(kind) as caught:
        read_robot(path, Described(**({"name": "arm"} | said)))
    return caught.value.detail


def test_a_table_in_metres_and_radians_with_decimal_commas(tmp_path: Path) -> None:
    document = read_robot(write(tmp_path / "ur10.csv", UR10_CSV), Described("mine", convention="dh"))
    assert [joint["name"] for joint in document["joints"]] == ["pan", "lift", "elbow", "w1", "w2", "w3"]
    assert document["joints"][0]["limits_deg"] == [-360, 360]
    assert np.abs(poses(document, joints(6)) - poses(preset_document("ur10"), joints(6))).max() < 1e-12


def test_a_workbook_is_the_same_table(tmp_path: Path) -> None:
    names, *rows = (line.split(";") for line in UR10_CSV.splitlines())
    cells = [[*row[:2], *(float(cell.replace(",", ".")) for cell in row[2:])] for row in rows]
    (tmp_path / "ur10.xlsx").write_bytes(workbook([names, *cells]))
    document = read_robot(tmp_path / "ur10.xlsx", Described("mine", convention="dh"))
    assert np.abs(poses(document, joints(6)) - poses(preset_document("ur10"), joints(6))).max() < 1e-12


@pytest.mark.parametrize(("form", "errors"), [("dh-csv", ERRORS), ("mdh-csv", ERRORS | TILTS)])
def test_exported_tables_come_back_to_the_same_poses(tmp_path: Path, form: str, errors: dict[str, float]) -> None:
    from kilter_service.robots.exporters.registry import export

    file, calibration = calibrated(errors, tool={"z_mm": 100.0, "rx_deg": 20.0})
    path = write(tmp_path / "table.csv", export(form, file).text)
    document = read_robot(path, Described("again"))
    assert np.abs(poses(document, joints(6)) - poses_of(calibration, joints(6))).max() < 1e-9
    assert robot_from_document(document).limits == pytest.approx(calibration.robot.limits)


def test_an_exported_ur_calibration_comes_back_to_the_same_poses(tmp_path: Path) -> None:
    from kilter_service.robots.exporters.registry import export

    errors = {name: value for name, value in ERRORS.items() if not name.startswith("tool")} | TILTS
    file, calibration = calibrated(errors)
    path = write(tmp_path / "calibration.yaml", export("ur-yaml", file).text)
    document = read_robot(path, Described("again", model="ur10"))
    assert np.abs(poses(document, joints(6)) - poses_of(calibration, joints(6))).max() < 1e-9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta,d_mm,a_mm,alpha_deg\n0,0,0,0\n", "column 'theta' has no unit"),
        ("theta_offset_deg,d_mm,a_mm,twist_deg\n0,0,0,0\n", "column 'twist_deg' is not known"),
        ("theta_offset_deg,d_mm\n0,x1\n", "line 2, d: 'x1' is not a number"),
        ("theta_offset_deg,d_mm\n0,nan\n", "is not a number"),
        ("theta_offset_deg,d_mm\n0\n", "line 2: 1 cells where the header has 2"),
        ("theta_offset_deg,d_deg\n0,1\n", "d of a revolute joint cannot be in deg"),
        ("type,d_mm\nball,1\n", "type 'ball' is neither"),
        ("theta_offset_deg,beta_deg\n0,0\n", "a dh table has no beta"),
        ("theta_offset_deg,d_mm\n", "no rows below its header"),
        ("\n", "has no rows"),
    ],
)
def test_tables_that_are_wrong_name_the_place(tmp_path: Path, text: str, message: str) -> None:
    assert message in refused(write(tmp_path / "t.csv", text), convention="dh")


def test_dh_and_mdh_are_never_guessed(tmp_path: Path) -> None:
    path = write(tmp_path / "t.csv", UR10_CSV)
    assert "--convention dh or --convention mdh" in refused(path, UsageError)
    marked = write(tmp_path / "m.csv", "# kilter mdh table\n" + UR10_CSV)
    assert "says that it is a mdh table" in refused(marked, UsageError, convention="dh")
    assert "give it a name" in refused(path, UsageError, name=None, convention="dh")


def test_workbooks_that_are_none_or_bombs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "is not an XLSX workbook" in refused(write(tmp_path / "t.xlsx", "text"), convention="dh")
    with zipfile.ZipFile(tmp_path / "bomb.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", b"0" * 30_000_000)
    assert "unpacks to 30 MB" in refused(tmp_path / "bomb.xlsx", convention="dh")
    with zipfile.ZipFile(tmp_path / "zip.xlsx", "w") as archive:
        archive.writestr("a.txt", b"0")
    assert "is not a workbook" in refused(tmp_path / "zip.xlsx", convention="dh")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert "save the sheet as CSV" in refused(tmp_path / "zip.xlsx", MissingPackageError, convention="dh")


# Universal Robots' driver description: default_kinematics.yaml of these models has these numbers (m).
DEFAULTS = {
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, -0.1157, 0.0922),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, -0.11985, 0.11655),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, -0.09465, 0.0823),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, -0.08535, 0.0921),
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, -0.08535, 0.0819),
    "ur30": (0.2363, -0.637, -0.5037, 0.201, -0.1593, 0.1543),
}


def ur_file(path: Path, model: str, seed: int | None = None) -> Path:
    """A calibration of this model, errors as large as factories leave them: 1 mm, 2 mrad."""
    d1, a2, a3, d4, d5, d6 = DEFAULTS[model]
    half, turn = math.pi / 2, math.pi
    table = {
        "shoulder": [0, 0, d1, 0, 0, 0], "upper_arm": [0, 0, 0, half, 0, 0], "forearm": [a2, 0, 0, 0, 0, 0],
        "wrist_1": [a3, 0, d4, 0, 0, 0], "wrist_2": [0, d5, 0, half, 0, 0], "wrist_3": [0, d6, 0, half, turn, turn],
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    lines = ["kinematics:"]
    for name, values in table.items():
        noise = np.zeros(6) if seed is None else rng.normal(0, [3e-4] * 3 + [7e-4] * 3)
        lines.append(f"  {name}:")
        lines += [
            f"    {k}: {float(v + e)!r}"
            for k, v, e in zip(("x", "y", "z", "roll", "pitch", "yaw"), values, noise, strict=True)
        ]
    return write(path, "\n".join([*lines, "  hash: calib_1", ""]))


@pytest.mark.parametrize("model", DEFAULTS)
def test_factory_calibrations_are_of_the_model_that_is_named(tmp_path: Path, model: str) -> None:
    for seed in (None, 1, 2, 3):
        path = ur_file(tmp_path / "calibration.yaml", model, seed)
        assert read_robot(path, Described("arm", model=model))["convention"] == "chain"
        for other in DEFAULTS:
            if other != model:
                detail = refused(path, model=other)
                assert f"is not a {other.upper()}" in detail
                assert model.upper() in detail.split(". ")[-1]


def test_a_ur10_that_is_a_ur10e_is_caught_with_the_length_that_tells(tmp_path: Path) -> None:
    detail = refused(ur_file(tmp_path / "c.yaml", "ur10e", 5), model="ur10")
    assert "is not a UR10: d1 is 18" in detail
    assert "a UR10 has 127.3. It is a UR10E or UR12E." in detail


def test_the_nominal_calibration_is_the_table(tmp_path: Path) -> None:
    document = read_robot(ur_file(tmp_path / "c.yaml", "ur10"), Described("arm", model="UR10"))
    assert np.abs(poses(document, joints(6)) - poses(preset_document("ur10"), joints(6))).max() < 1e-12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "is not YAML"),
        ("other: 1", "has no 'kinematics'"),
        ("kinematics: {shoulder: {x: 0}}", "kinematics.shoulder.y is None"),
        ("kinematics: {shoulder: {x: .inf, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}}", "shoulder.x is inf"),
        ("kinematics: {upper_arm: {}}", "kinematics.shoulder is missing"),
    ],
)
def test_yaml_that_is_no_calibration(tmp_path: Path, text: str, message: str) -> None:
    assert message in refused(write(tmp_path / "c.yaml", text), model="ur10")


def test_the_model_must_be_said_and_known(tmp_path: Path) -> None:
    path = ur_file(tmp_path / "c.yaml", "ur10")
    assert "needs --model" in refused(path, UsageError)
    assert "is not known. Known are ur3" in refused(path, UsageError, model="ur11")
    assert "--model belongs to" in refused(
        write(tmp_path / "t.csv", UR10_CSV), UsageError, model="ur10", convention="dh"
    )


KNI = """# configuration
[KATANA]
[GENERAL]
modelName = "Katana6M180";
[ENDEFFECTOR]
segment1 = "190.0";  # mm
segment2 = "139.0";
segment3 = "147.3";
segment4 = "41.0";
"""
# angleOffset and angleRange in degrees of KNI's Katana6M180 motors
RANGES = [(6.65, 346.0), (124.25, -140.0), (52.7, 250.0), (63.5, 230.0), (8.5, 342.0), (-119.5, 329.0)]


def kni_file(path: Path) -> Path:
    motors = [
        f'[MOT[{k}]]\n[GENERAL]\nslvID = "{k + 1}";\n[CALIBRATION]\nangleOffset = "{a}";\nangleRange = "{r}";\n'
        for k, (a, r) in enumerate(RANGES)
    ]
    return write(path, KNI + "".join(motors))


def test_katana_moves_as_its_native_interface_says(tmp_path: Path) -> None:
    document = read_robot(kni_file(tmp_path / "katana6M180.cfg"), Described("katana"))
    limits = [joint["limits_deg"] for joint in document["joints"]]
    assert limits[1] == pytest.approx([-15.75, 124.25])
    assert limits[0] == pytest.approx([6.65, 352.65])
    q = np.random.default_rng(2).uniform(0.5, 2.5, (20, 5))
    for row, T in zip(q, poses(document, q), strict=True):
        # KNI's direct kinematics of the 6M180: position and ZXZ angles.
        t2, t3, t4, t5 = row[1] - math.pi / 2, row[2] - math.pi, math.pi - row[3], -row[4]
        t23, t234 = t2 + t3, t2 + t3 + t4
        out = 190 * math.sin(t2) + 139 * math.sin(t23) + (147.3 + 41) * math.sin(t234)
        up = 190 * math.cos(t2) + 139 * math.cos(t23) + (147.3 + 41) * math.cos(t234)
        assert T[:3, 3] * 1e3 == pytest.approx([out * math.cos(row[0]), out * math.sin(row[0]), up], abs=1e-9)
        assert T[0, 2] == pytest.approx(math.cos(row[0]) * math.sin(t234), abs=1e-12)
        assert T[2, 0] == pytest.approx(math.sin(t234) * math.sin(t5), abs=1e-12)
        assert T[2, 1] == pytest.approx(math.sin(t234) * math.cos(t5), abs=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("segment3 =", "segmentX ="), "segment3 is missing"),
        (('"139.0"', '"long"'), "segment2 is 'long'"),
        (("[MOT[3]]", "[MOT[9]]"), "motor 3 ([MOT[3]]) lacks angleOffset"),
        (("[MOT[", "[MOTOR["), "has no [MOT[0]]"),
    ],
)
def test_katana_files_that_are_wrong(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = kni_file(tmp_path / "k.cfg")
    assert message in refused(write(path, path.read_text().replace(*change)))


def test_fanuc_reads_its_third_joint_against_the_horizontal(tmp_path: Path) -> None:
    """The forearm keeps its direction when J2 moves, and J3 counts up when it rises."""
    text = "joint,d_mm,a_mm,alpha_deg,theta_offset_deg\nJ1,400,0,90,0\nJ2,0,500,0,90\nJ3,0,600,0,-90\n"
    path = write(tmp_path / "f.csv", text)
    document = read_robot(path, Described("f", convention="dh", turned=["J2"], follows=["J3=J2"]))
    q = joints(3)
    for row, T in zip(q, poses(document, q), strict=True):
        lean = row[1]  # forwards, from upright
        out = 0.5 * math.sin(lean) + 0.6 * math.cos(row[2])
        up = 0.4 + 0.5 * math.cos(lean) + 0.6 * math.sin(row[2])
        assert T[:3, 3] == pytest.approx([out * math.cos(row[0]), out * math.sin(row[0]), up], abs=1e-12)
    names = [element.get("name") for element in document["elements"]]
    assert "beta_2" in names  # as the server adds for the plain table


def workbook(rows: list[list[Any]]) -> bytes:
    book, out = Workbook(), io.BytesIO()
    for row in rows:
        book.worksheets[0].append(row)
    book.save(out)
    return out.getvalue()


SEEDS = {
    ".csv": UR10_CSV.encode(),
    ".cfg": (KNI + '[MOT[0]]\nangleOffset = "1";\nangleRange = "2";\n').encode(),
    ".yaml": b"kinematics: {shoulder: {x: 0, y: 0, z: 0.1, roll: 0, pitch: 0, yaw: 0}}",
    ".xlsx": workbook([["theta_offset_deg", "d_mm"], [0, 1]]),
}


@pytest.mark.parametrize("ending", SEEDS)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_refused_and_nothing_else(tmp_path: Path, ending: str, data: st.DataObject) -> None:
    content = bytearray(SEEDS[ending])
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 5))] = data.draw(st.binary(max_size=6))
    path = tmp_path / f"damaged{ending}"
    path.write_bytes(content)
    described = Described("arm", convention="dh" if ending in (".csv", ".xlsx") else None)
    model = replace(described, model="ur10") if ending == ".yaml" else described
    with suppress(KilterError):
        assert read_robot(path, model)["name"] == "arm"


def test_turned_and_coupled_joints_that_cannot_be(tmp_path: Path) -> None:
    path = write(tmp_path / "t.csv", UR10_CSV)
    assert "did you mean 'lift'" in refused(path, UsageError, convention="dh", turned=["lft"])
    assert "must come after" in refused(path, UsageError, convention="dh", follows=["lift=elbow"])
    assert "must come after" in refused(path, UsageError, convention="dh", follows=["lift=pan"])


def test_a_document_takes_what_is_said_beside_it_and_refuses_what_belongs_to_a_file() -> None:
    rows = [{"d_mm": 100.0, "alpha_deg": 90.0}, {"a_mm": 300.0}, {"a_mm": 200.0}]
    joints = [{"name": name} for name in ("pan", "lift", "elbow")]
    document = {"name": "d", "convention": "dh", "rows": rows, "joints": joints}
    found = described_document(document, Described(turned=["lift"], follows=["elbow=lift"]))
    moved = [(e["joint"], e.get("ratio", 1.0)) for e in found["elements"] if e.get("joint")]
    assert moved == [("pan", 1.0), ("lift", -1.0), ("lift", 1.0), ("elbow", 1.0)]
    carried = described_document(document, Described(follows=["elbow = lift : linkage"]))["elements"]
    assert [(e["joint"], e["drive"]) for e in carried if "drive" in e] == [("lift", "linkage")]
    assert not any("drive" in e for e in found["elements"])
    assert described_document(document, Described(name="other")) == {**document, "name": "other"}
    for told, says in (
        (Described(follows=["nonsense=zz"]), "There is no joint"),
        (Described(follows=["elbow"]), "is not a pair of joints"),
        (Described(follows=["elbow=lift:linkages"]), "did you mean 'linkage'"),
        (Described(turned=["lft"]), "did you mean 'lift'"),
        (Described(base_link="base"), "belongs to a .urdf file"),
    ):
        with pytest.raises(UsageError, match=says):
            described_document(document, told)


def _urdf(*joints: tuple[str, str]) -> str:
    links = dict.fromkeys(link for pair in joints for link in pair)
    return (
        "<robot name='arm'>"
        + "".join(f"<link name='{link}'/>" for link in links)
        + "".join(
            f"<joint name='{parent}-{child}' type='revolute'><parent link='{parent}'/><child link='{child}'/></joint>"
            for parent, child in joints
        )
        + "</robot>"
    )


def test_the_only_chain_of_a_urdf_needs_no_links_said(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(_urdf(("world", "upper"), ("upper", "tool0")))
    found = read_robot(path, Described(name="arm"))
    assert (found["base_link"], found["tip_link"]) == ("world", "tool0")
    found = read_robot(path, Described(name="arm", base_link="upper"))
    assert (found["base_link"], found["tip_link"]) == ("upper", "tool0")


def test_where_a_urdf_leaves_a_choice_its_links_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(_urdf(("base", "upper"), ("upper", "tool0"), ("upper", "camera")))
    with pytest.raises(UsageError, match=r"say which is the arm by --tip-link \(tool0, camera\)\.$"):
        read_robot(path, Described(name="arm"))
    assert read_robot(path, Described(name="arm", tip_link="camera"))["base_link"] == "base"
    path.write_text(_urdf(("a", "b"), ("b", "a")))
    with pytest.raises(UsageError, match=r"--base-link \(none was found\) and --tip-link \(none was found\)"):
        read_robot(path, Described(name="arm"))
    path.write_text("<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><link name=</robot>")
    with pytest.raises(FileError, match="is not XML"):
        read_robot(path, Described(name="arm"))


def test_formulas_without_values_are_named_and_never_read_as_empty(tmp_path: Path) -> None:
    path = tmp_path / "arm.xlsx"
    path.write_bytes(workbook([["theta_offset_deg", "d_mm"], [0, 1], ["=90*2", 1]]))
    said = refused(path, convention="dh")
    assert "cell A3 holds a formula without a computed value. Open the workbook" in said


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_an_arm_ends_where_only_a_free_joint_holds_it_or_what_it_carries(tmp_path: Path, kind: str) -> None:
    links = "".join(f'<link name="{name}"/>' for name in ("world", "base", "upper", "tool", "box"))
    joint = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/></joint>'
    joints = [("root", kind, "world", "base"), ("a", "revolute", "base", "upper"), ("b", "revolute", "upper", "tool")]
    text = "".join(joint.format(*one) for one in (*joints, ("grasp", kind, "tool", "box")))
    path = write(tmp_path / "arm.urdf", f'<robot name="r">{links}{text}</robot>')
    found = read_robot(path, Described(name="arm"))
    assert (found["base_link"], found["tip_link"]) == ("base", "tool")
