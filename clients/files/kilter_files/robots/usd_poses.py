"""Poses as USD has them: Pixar's package, frames at zero joints, and local poses of joints that rounding does not move.

UsdPhysics keeps the local poses of a joint in single precision, which is 0.03 um at 0.5 m. Of the two poses of each body,
where its own joint and where the next one is, only the difference counts: one takes what rounding leaves of the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kilter_files.ground.later import need, np, transform

if TYPE_CHECKING:
    from kilter_files.ground.arrays import Floats

NOMINAL, TOOL = "kilter:nominalFrames", "kilter_tool"
STEP_TABLE = "kilter:stepTable"
_PARTS = tuple(f"pxr.{part}" for part in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdPhysics"))


def usd_package() -> Any:
    """Return ``pxr``.

    Raises:
        MissingPackageError: it is not installed.

    """
    usd = need("USD needs", "usd-core", *_PARTS, "pxr")
    need("USD needs", "scipy", "scipy.spatial.transform")
    return usd


def pose_matrix(place: Any, turn: Any) -> Floats:
    """Pose (4, 4) by a USD vector and a USD quaternion, which is normalised in double precision."""
    T = np.eye(4)
    T[:3, :3] = transform.Rotation.from_quat(
        [*(float(v) for v in turn.GetImaginary()), float(turn.GetReal())]
    ).as_matrix()
    T[:3, 3] = [float(v) for v in place]
    return T


def single(T: Floats) -> Floats:
    """A pose (4, 4) as it is read again from single precision."""
    Gf = usd_package().Gf
    place, turn = local_pose(T)
    return pose_matrix(Gf.Vec3f(*place), Gf.Quatf(turn[0], *turn[1:]))


def local_pose(T: Floats) -> tuple[list[float], list[float]]:
    """Position and quaternion (w, x, y, z) of a pose (4, 4)."""
    x, y, z, w = (float(v) for v in transform.Rotation.from_matrix(T[:3, :3]).as_quat())
    return [float(v) for v in T[:3, 3]], [w, x, y, z]


def split(before: Floats, behind: Floats) -> tuple[Floats, Floats]:
    """Move a body's frame so that rounding moves none of its joints.

    Args:
        before: pose (4, 4) of the joint that carries the body, in the body.
        behind: pose (4, 4) of the next joint in the body.

    Returns:
        Both poses as they are to be written.

    """
    rounded, link = single(behind), np.linalg.inv(before) @ behind
    # The first is not what the file will hold, but what is lost there is the rounding of a small number.
    wanted = rounded @ np.linalg.inv(link)
    return wanted, rounded
