"""Poses as USD has them: Pixar's package, frames at zero joints, and local poses of joints that rounding does not move.

UsdPhysics keeps the local poses of a joint in single precision, which is 0.03 um at 0.5 m. Of the two poses of each body,
where its own joint and where the next one is, only the difference counts: one takes what rounding leaves of the other.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kilter_files.ground.errors import MissingPackageError
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

NOMINAL, TOOL = "kilter:nominalFrames", "kilter_tool"
STEP_TABLE = "kilter:stepTable"


def usd_package() -> Any:
    """Return ``pxr``.

    Raises:
        MissingPackageError: it is not installed.

    """
    try:
        for part in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdPhysics"):
            import_module(f"pxr.{part}")
    except ImportError as error:
        raise MissingPackageError("USD needs its package: pip install usd-core.", package="usd-core") from error
    return import_module("pxr")


def matrix_of(place: Any, turn: Any) -> Floats:
    """Pose (4, 4) by a USD vector and a USD quaternion, which is normalised in double precision."""
    w, (x, y, z) = float(turn.GetReal()), (float(v) for v in turn.GetImaginary())
    length = (w * w + x * x + y * y + z * z) ** 0.5
    w, x, y, z = w / length, x / length, y / length, z / length
    T = np.eye(4)
    T[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    T[:3, 3] = [float(v) for v in place]
    return T


def quaternion(rotation: Floats) -> list[float]:
    """Quaternion (w, x, y, z) of a rotation (3, 3), with the largest of the four divided by, so that small ones stay exact."""
    m = rotation
    squares = np.array([
        1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2],
    ])  # fmt: skip
    k = int(np.argmax(squares))
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    q = np.array(
        ((squares[0], wx, wy, wz), (wx, squares[1], xy, xz), (wy, xy, squares[2], yz), (wz, xz, yz, squares[3]))[k]
    )
    return [float(v) for v in q / np.linalg.norm(q)]


def inverse(T: Floats) -> Floats:
    """Inverse of a pose (4, 4)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return out


def single(T: Floats) -> Floats:
    """A pose (4, 4) as it is read again from single precision."""
    Gf = usd_package().Gf
    place, turn = local_pose(T)
    return matrix_of(Gf.Vec3f(*place), Gf.Quatf(turn[0], *turn[1:]))


def local_pose(T: Floats) -> tuple[list[float], list[float]]:
    """Position and quaternion (w, x, y, z) of a pose (4, 4)."""
    return [float(v) for v in T[:3, 3]], quaternion(T[:3, :3])


def split(before: Floats, behind: Floats) -> tuple[Floats, Floats]:
    """Move a body's frame so that rounding moves none of its joints.

    Args:
        before: pose (4, 4) of the joint that carries the body, in the body.
        behind: pose (4, 4) of the next joint in the body.

    Returns:
        Both poses as they are to be written.

    """
    rounded, link = single(behind), inverse(before) @ behind
    # The first is not what the file will hold, but what is lost there is the rounding of a small number.
    wanted = rounded @ inverse(link)
    return wanted, rounded
