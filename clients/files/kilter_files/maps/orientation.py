"""The table [orientation] of a column map: the columns that say how the tool is oriented."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_files.ground.orientation import MATRICES, is_sequence
from kilter_files.ground.units import UNKNOWN, units_like
from kilter_files.maps.section import Section

QUATERNIONS = ("wxyz", "xyzw")


@dataclass(frozen=True)
class Orientation:
    """Three Euler angles, four quaternion parts, or a matrix of nine by ``order``, that become qw, qx, qy, qz."""

    sources: tuple[str | int, ...]
    order: str
    unit: str = "rad"


def read_orientation(top: Section) -> Orientation | None:
    """Read the table [orientation] of a map or of a join, None where there is none.

    Raises:
        FileError: columns that give no orientation.

    """
    section = top.child_section("orientation")
    if section is None:
        return None
    sources = tuple(section.items("from"))
    euler, quaternion, unit = section.text("euler"), section.text("quaternion"), section.text("unit")
    matrix = section.text("matrix")
    section.finish()
    if UNKNOWN in (euler, quaternion, unit, *sources):
        raise section.error('the draft could not determine: fill in what is "?", or delete the table')
    if matrix is not None and (matrix not in MATRICES or euler or quaternion or unit or len(sources) != 9):
        raise section.error('a rotation matrix is nine columns and matrix = "rows" or "columns", without unit')
    if matrix is not None:
        return Orientation(sources, matrix)
    if quaternion is not None and (quaternion not in QUATERNIONS or euler or unit or len(sources) != 4):
        raise section.error('a quaternion is four columns and quaternion = "wxyz" or "xyzw", without unit')
    if quaternion is not None:
        return Orientation(sources, quaternion)
    if euler is None or not is_sequence(euler) or len(sources) != 3 or unit not in units_like("rad"):
        raise section.error(
            'Euler angles are three columns in the order of rotation, unit = "deg" or "rad", and euler = three letters: '
            '"XYZ" about the moving axes (intrinsic), "xyz" about the fixed ones (extrinsic)'
        )
    return Orientation(sources, euler, unit or "rad")
