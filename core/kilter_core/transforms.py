"""Rigid transforms as 4x4 arrays: building, inverting, and the logarithm of a rotation with its Jacobian."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def scipy_rotation() -> type[Rotation]:
    """Return scipy's rotations, imported at their first use: 40 MB that a process which only corrects does without."""
    from scipy.spatial.transform import Rotation

    return Rotation


def pose_from_xyz_rpy(xyz_m: Floats, rpy_rad: Floats) -> Floats:
    """T (4, 4) = Trans(xyz) Rz(rz) Ry(ry) Rx(rx), the convention of URDF; ``rpy_rad`` is (rx, ry, rz)."""
    T = np.eye(4)
    T[:3, :3] = scipy_rotation().from_euler("xyz", rpy_rad).as_matrix()
    T[:3, 3] = xyz_m
    return T


def xyz_rpy_from_pose(T: Floats, near: Floats | None = None) -> tuple[Floats, Floats]:
    """Return (xyz (3,) m, rpy (3,) rad) of a pose (4, 4), exact to rounding at and near pitch 90 degrees too.

    Two triples of angles, and any with 360 degrees more, say one rotation: those next to ``near (3,)`` rad, or without it
    pitch within 90 and the others within 180 degrees. The inverse of :func:`pose_from_xyz_rpy`.
    """
    R = T[:3, :3]
    yaw = float(np.arctan2(R[1, 0], R[0, 0])) if np.hypot(R[0, 0], R[1, 0]) > 1e-15 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    # Near pitch 90 degrees yaw is rounding noise; what is taken off as yaw comes back as roll.
    rest = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    roll = float(np.arctan2(-rest[1, 2], rest[1, 1]))
    rpy = np.array([roll, float(np.arctan2(-rest[2, 0], rest[0, 0])), yaw])
    if near is not None:
        both = np.array([rpy, [rpy[0] + np.pi, np.pi - rpy[1], rpy[2] + np.pi]])
        both -= 2.0 * np.pi * np.round((both - near) / (2.0 * np.pi))
        rpy = both[np.argmin(np.sum((both - near) ** 2, axis=1))]
    return T[:3, 3] + 0.0, rpy + 0.0  # no zero has a sign, which tables would show


def rotation_between(T: Floats, other: Floats) -> float:
    """Angle (rad) of the rotation from one pose (4, 4) to another."""
    return float(np.linalg.norm(rotation_log((T[:3, :3].T @ other[:3, :3])[None])))


def align_z_axis(R: Floats, z: Floats) -> Floats:
    """Rotation (3, 3) with this z axis, rotated as little as possible from ``R``."""
    # A rotation by 180 degrees has no nearest: then the frame is rotated about its own x.
    x = R[:, 0] - z * (R[:, 0] @ z)
    if np.linalg.norm(x) < 0.5:
        y = R[:, 1] - z * (R[:, 1] @ z)
        y /= np.linalg.norm(y)
        return np.column_stack([np.cross(y, z), y, z])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def inverse(T: Floats) -> Floats:
    """Inverse of a rigid transform (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def inverses(p: Floats, R: Floats) -> tuple[Floats, Floats]:
    """Inverses of poses given as positions (N, 3) and rotations (N, 3, 3)."""
    R = R.transpose(0, 2, 1)
    return -np.einsum("nij,nj->ni", R, p), R


def nearest_rotation(M: Floats) -> Floats:
    """Rotations (..., 3, 3) nearest to M in the Frobenius norm, never a reflection."""
    U, _, Vt = np.linalg.svd(M)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


def rotation_along(k: int, angle: float) -> Floats:
    """Rotation (3, 3) by ``angle`` about coordinate axis ``k``: 0 for x, 1 for y, 2 for z."""
    a, b = (k + 1) % 3, (k + 2) % 3
    out = np.eye(3)
    out[a, a] = out[b, b] = np.cos(angle)
    out[b, a] = np.sin(angle)
    out[a, b] = -out[b, a]
    return out


def rotations_about(axis: Floats, angles: Floats) -> Floats:
    """Rotations (N, 3, 3) by ``angles (N,)`` about a unit vector (3,): Rodrigues' formula."""
    W = skew(axis[None])[0]
    return np.asarray(np.eye(3) + np.sin(angles)[:, None, None] * W + (1.0 - np.cos(angles))[:, None, None] * (W @ W))


def rotation_log(R: Floats) -> Floats:
    """Rotation vectors (N, 3) of rotations (N, 3, 3)."""
    return np.asarray(scipy_rotation().from_matrix(R).as_rotvec())


def rotation_exp(w: Floats) -> Floats:
    """Rotations (..., 3, 3) by rotation vectors (..., 3), of one dimension or two."""
    return np.asarray(scipy_rotation().from_rotvec(w).as_matrix())


def pose_from_twist(v: Floats, w: Floats) -> Floats:
    """Pose (4, 4) of a twist: the exponential of (v, w), m and rad."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation_exp(w), left_jacobian(w) @ v
    return out


def left_jacobian(w: Floats) -> Floats:
    """Left Jacobian (3, 3) of SO(3) at a rotation vector: Exp(w + d) = Exp(J d) Exp(w); its transpose is the right one."""
    angle = float(np.linalg.norm(w))
    W = skew(w[None])[0]
    small = angle < 1e-4  # below, the next terms are beyond the last digit
    a = 0.5 - angle**2 / 24.0 if small else (1.0 - np.cos(angle)) / angle**2
    b = 1.0 / 6.0 - angle**2 / 120.0 if small else (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * W + b * (W @ W))


def skew(v: Floats) -> Floats:
    """Cross-product matrices (N, 3, 3) of vectors (N, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = -v[:, 2], v[:, 1]
    out[:, 1, 0], out[:, 1, 2] = v[:, 2], -v[:, 0]
    out[:, 2, 0], out[:, 2, 1] = -v[:, 1], v[:, 0]
    return out


def right_jacobian_inverse(w: Floats) -> Floats:
    """Inverse right Jacobian of SO(3) (N, 3, 3) at rotation vectors w (N, 3): d Log(E exp(d)) = J^-1 d."""
    t = np.linalg.norm(w, axis=1)
    small = t < 1e-4
    safe = np.where(small, 1.0, t)
    c = np.where(small, 1.0 / 12.0 + t**2 / 720.0, 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe)))
    W = skew(w)
    return np.asarray(np.eye(3) + 0.5 * W + c[:, None, None] * (W @ W))
