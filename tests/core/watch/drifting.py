"""Arms that drift, in plain numpy: a DH chain with encoder zeros, joints that sag under gravity, base, tool and scale."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.observations import Observations

Floats = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class DriftingArm:
    """``rows (6, 3)`` d m, a m, alpha rad; masses kg at ``centres`` m in the frame after their row; compliance rad/(N m)."""

    rows: Floats
    masses: Floats
    centres: Floats
    base: Floats
    tool: Floats
    zeros: Floats
    compliance: Floats
    scale: float = 0.0

    def frames(self, q: Floats) -> list[Floats]:
        """Frames (..., 4, 4) of the base and after each row, of one joint vector (6,) or many (..., 6)."""
        d, a, alpha = self.rows.T
        c, s, ca, sa = np.cos(q), np.sin(q), np.cos(alpha), np.sin(alpha)
        steps = np.zeros((*q.shape, 4, 4))
        steps[..., 0, :] = np.stack([c, -s * ca, s * sa, a * c], axis=-1)
        steps[..., 1, :] = np.stack([s, c * ca, -c * sa, a * s], axis=-1)
        steps[..., 2, 1:] = np.stack([sa, ca, d], axis=1)
        steps[..., 3, 3] = 1.0
        out = [np.broadcast_to(self.base, (*q.shape[:-1], 4, 4))]
        for k in range(q.shape[-1]):
            out.append(out[-1] @ steps[..., k, :, :])
        return out

    def torques(self, q: Floats) -> Floats:
        """Moments (..., 6) of gravity about each axis, N m; where the arm is meant to be."""
        frames = np.stack(self.frames(q), axis=-3)
        places = np.einsum("...kij,kj->...ki", frames[..., 1:, :3, :3], self.centres) + frames[..., 1:, :3, 3]
        forces = self.masses[:, None] * (self.base[:3, :3] @ GRAVITY)
        # The moment about an axis is that of all forces beyond it: those about the origin, moved there.
        about_origin = np.cumsum(np.cross(places, forces)[..., ::-1, :], axis=-2)[..., ::-1, :]
        beyond = np.cumsum(forces[::-1], axis=0)[::-1]
        moments = about_origin - np.cross(frames[..., :6, :3, 3], beyond)
        return np.asarray(np.sum(frames[..., :6, :3, 2] * moments, axis=-1))

    def point(self, q: Floats) -> Floats:
        """Where an instrument sees the tool point (..., 3) m of one joint vector (6,) or many (..., 6)."""
        moved = q + self.zeros
        if self.compliance.any():
            moved = moved + self.compliance * self.torques(q)
        return np.asarray((1.0 + self.scale) * (self.frames(moved)[-1] @ self.tool)[..., :3, 3])

    def measured(self, q: Floats, rng: np.random.Generator, noise: float) -> Observations:
        seen = self.point(q)
        return Observations(q, position=seen + rng.normal(0.0, noise, seen.shape))

    def document(self) -> dict[str, Any]:
        """The nominal arm: no zeros, no sag, base and tool as they are."""
        return {
            "name": "arm", "convention": "dh",
            "rows": [{"theta_offset_deg": 0.0, "d_mm": d * 1e3, "a_mm": a * 1e3, "alpha_deg": float(np.degrees(alpha))}
                     for d, a, alpha in self.rows],
            "joints": [{"name": f"j{k + 1}", "limits_deg": [-170, 170]} for k in range(6)],
            "links": [{"mass_kg": float(m), "com_mm": (c * 1e3).tolist(), "inertia_kg_m2": [0.0] * 6}
                      for m, c in zip(self.masses, self.centres, strict=True)],
            "tool": {"x_mm": float(self.tool[0, 3] * 1e3), "y_mm": float(self.tool[1, 3] * 1e3),
                     "z_mm": float(self.tool[2, 3] * 1e3), "rx_deg": 0, "ry_deg": 0, "rz_deg": 0},
        }  # fmt: skip

    def after(self, change: str, size: float) -> DriftingArm:
        """The arm after ``zero_3``, ``sag_2``, ``base``, ``tool`` or ``scale`` changed by a size (SI)."""
        kind, _, joint = change.partition("_")
        if joint:
            field = {"zero": "zeros", "sag": "compliance"}[kind]
            return replace(self, **{field: getattr(self, field) + size * np.eye(6)[int(joint) - 1]})
        if kind == "scale":
            return replace(self, scale=self.scale + size)
        shift = np.eye(4)
        shift[:3, 3] = size * np.array([0.6, -0.64, 0.48])
        if kind == "tool":
            return replace(self, tool=self.tool @ shift)
        shift[:3, :3] = Rotation.from_rotvec(size * np.array([1.2, 0.9, -0.4])).as_matrix()
        return replace(self, base=shift @ self.base)


def some_arm(rng: np.random.Generator) -> DriftingArm:
    """A 6R arm of ordinary proportions with a reflector off its last axis."""
    upper, fore = rng.uniform(0.3, 0.7, 2)
    d = np.array(
        [rng.uniform(0.1, 0.4), 0.0, 0.0, rng.uniform(0.1, 0.2), rng.uniform(0.08, 0.15), rng.uniform(0.05, 0.15)]
    )
    a = np.array([0.0, -upper, -fore, 0.0, 0.0, 0.0])
    alpha = np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0]) * np.pi / 2.0
    tool = np.eye(4)
    tool[:3, 3] = [rng.uniform(0.06, 0.12), rng.uniform(-0.05, 0.05), rng.uniform(0.05, 0.15)]
    centres = np.array([[0, 0, 0], [0.5 * upper, 0, 0.1], [0.5 * fore, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0.02]])
    return DriftingArm(
        np.stack([d, a, alpha], axis=1), np.array([7.0, 12.0, 4.0, 2.0, 2.0, 0.5]), centres, np.eye(4), tool,
        rng.normal(0.0, 1e-3, 6), np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * 1e-5,
    )  # fmt: skip


def some_poses(count: int, rng: np.random.Generator) -> Floats:
    return rng.uniform(-2.5, 2.5, (count, 6))


def warmed(arm: DriftingArm, kelvin: float, rng: np.random.Generator) -> DriftingArm:
    """Links of steel or aluminium, each a little otherwise, and zeros that follow."""
    links = 1.0 + kelvin * (rng.uniform(11e-6, 24e-6) + rng.normal(0.0, 4e-6, (6, 1)))
    rows = arm.rows * np.hstack([links, links, np.ones((6, 1))])
    return replace(arm, rows=rows, zeros=arm.zeros + kelvin * rng.normal(0.0, 5e-6, 6))


def set_up_again(arm: DriftingArm, sigma: float, rng: np.random.Generator) -> DriftingArm:
    """The instrument shifted by ``sigma`` m of a coordinate and rotated about a place among the poses."""
    shift, middle = np.eye(4), np.array([0.3, 0.0, 0.5])
    shift[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, sigma / 0.8, 3)).as_matrix()
    shift[:3, 3] = rng.normal(0.0, sigma, 3) + middle - shift[:3, :3] @ middle
    return replace(arm, base=shift @ arm.base)
