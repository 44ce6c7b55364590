"""What FANUC's CONFIG says of the joints, by literal positions as real controllers write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.reading import read_program

PLACE = "X = 1595.138 mm, Y = 477.921 mm, Z = 1218.451 mm, W = -136.725 deg, P = 42.713 deg, R = -120.854 deg"


def program(folder: Path, config: str) -> Path:
    path = folder / "w.ls"
    pose = f"P[1]{{\n   GP1:\n\tUF : 0, UT : 0,\tCONFIG : '{config}',\n\t{PLACE}\n}};"
    path.write_text("\n".join(["/PROG W", "/MN", "   1:J P[1] 50% FINE    ;", "/POS", pose, "/END", ""]))
    return path


# J1, J4, J6 by the public meaning of CONFIG: 0 within half a turn, 1 from 180 to 540 deg, -1 from -540 to -180 deg.
@pytest.mark.parametrize(
    ("config", "joints", "beyond"),
    [
        ("F U T, 0, 1, 0", (16.0, 12.0, -8.0, 200.0, 41.0, -77.0), 3),
        ("F U T, 0, -1, 0", (16.0, 12.0, -8.0, -190.5, 95.0, 20.0), 3),
        ("N U T, 0, 0, 1", (-60.0, 30.0, 10.0, -20.0, -20.0, 250.0), 5),
        ("F D B, -1, 0, 0", (-181.0, 12.0, -8.0, 20.0, 41.0, -77.0), 0),
    ],
)
def test_the_three_turn_numbers_are_those_of_j1_j4_and_j6(
    tmp_path: Path, config: str, joints: tuple[float, ...], beyond: int
) -> None:
    stated = read_program(program(tmp_path, config)).cartesian[0].configuration
    assert stated is not None
    assert all(stated.fits_joint(k, value) for k, value in enumerate(joints))
    assert stated.edits_for_joints(joints) == {}
    turned_back = joints[beyond] - 360.0 if joints[beyond] > 0 else joints[beyond] + 360.0
    assert not stated.fits_joint(beyond, turned_back)


@pytest.mark.parametrize(
    ("joint", "value", "wanted"),
    [(0, 180.004, "1, 0, 0"), (3, 180.031, "0, 1, 0"), (3, -180.2, "0, -1, 0"), (5, 180.01, "0, 0, 1")],
)
def test_a_joint_that_passes_half_a_turn_gets_its_own_number(
    tmp_path: Path, joint: int, value: float, wanted: str
) -> None:
    read = read_program(program(tmp_path, "F U T, 0, 0, 0"))
    stated, joints = read.cartesian[0].configuration, [10.0, 20.0, -5.0, 30.0, 40.0, 50.0]
    assert stated is not None
    joints[joint] = value
    assert f"CONFIG : 'F U T, {wanted}'" in read.rewritten([], stated.edits_for_joints(joints))
