"""Documents of the complete models (``poe``, ``cpc``, ``mcpc``) into chains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.arm.complete_models import (
    MovingAxis,
    Place,
    cpc_elements,
    mcpc_elements,
    poe_elements,
    rotation_to,
)
from kilter_core.arm.documents.parts import MM, Document, parse_joint, parse_pose
from kilter_core.arm.robot import Joint
from kilter_core.errors import RobotError
from kilter_core.transforms import pose_from_xyz_rpy
from kilter_core.types import Floats

Read = tuple[tuple[Joint, ...], Chain, tuple[int, ...]]

SHORTEST = 1e-6


def read_poe(document: Document) -> Read:
    """Joints, chain and link frames of ``axes`` and ``home``.

    Raises:
        RobotError: no axes, an axis without direction, or a joint that is not one of the joints.

    """
    described: Sequence[Document] = document.get("joints") or ()
    axes: Sequence[Document] = document.get("axes") or ()
    if not axes:
        raise RobotError("A robot of convention poe needs axes, at least one per joint.", field="axes")
    names = [str(axis.get("joint") or f"j{k}") for k, axis in enumerate(axes, 1)]
    order = [str(j["name"]) for j in described] or list(dict.fromkeys(names))
    if described and not any(axis.get("joint") for axis in axes) and len(axes) == len(order):
        names = order
    for k, name in enumerate(names):
        if name not in order:
            raise RobotError(f"axes[{k}] names joint {name!r}, not one of the joints.", field=f"axes[{k}].joint")
    moving = [_axis(k, axis, order.index(names[k])) for k, axis in enumerate(axes)]
    chain = Chain(poe_elements(moving, parse_pose(document.get("home"))), len(order))
    return _joints(described or [{"name": name} for name in order], chain), chain, chain.primary


def read_places(document: Document, convention: str) -> Read:
    """Joints, chain and link frames of ``rows`` and ``flange`` of convention "cpc" or "mcpc".

    Raises:
        RobotError: no rows, another number of joints, or a direction of no length.

    """
    rows: Sequence[Document] = document.get("rows") or ()
    if not rows:
        raise RobotError(f"A robot of convention {convention} needs rows, one per joint.", field="rows")
    joints: Sequence[Document] = document.get("joints") or [{} for _ in rows]
    if len(joints) != len(rows):
        raise RobotError(f"There are {len(rows)} rows but {len(joints)} joints: give one of each.", field="joints")
    places = [_place(k, row) for k, row in enumerate(rows)]
    flange, make = document.get("flange") or {}, cpc_elements if convention == "cpc" else mcpc_elements
    chain = Chain(make(places, _flange(flange)), len(rows))
    return _joints(joints, chain), chain, chain.primary


def _joints(described: Sequence[Document], chain: Chain) -> tuple[Joint, ...]:
    kinds = ["revolute" if chain.elements[k].axis.rotates else "prismatic" for k in chain.primary]
    return tuple(parse_joint(i, joint, kind) for i, (joint, kind) in enumerate(zip(described, kinds, strict=True)))


def _axis(k: int, axis: Document, joint: int) -> MovingAxis:
    return MovingAxis(
        _direction(axis.get("direction") or (0.0, 0.0, 0.0), f"axes[{k}].direction"),
        np.array(axis.get("point_mm") or (0.0, 0.0, 0.0), dtype=np.float64) * MM,
        joint,
        axis.get("type", "revolute") == "prismatic",
        float(axis.get("ratio") or 1.0),
        axis.get("drive"),
    )


def _place(k: int, row: Document) -> Place:
    return Place(
        alpha=math.radians(row.get("alpha_deg", 0.0)),
        beta=math.radians(row.get("beta_deg", 0.0)),
        x=row.get("x_mm", 0.0) * MM,
        y=row.get("y_mm", 0.0) * MM,
        offset=math.radians(row.get("theta_offset_deg", 0.0)),
        prismatic=row.get("type", "revolute") == "prismatic",
        before=rotation_to(_direction(row["b"], f"rows[{k}].b")) if "b" in row else np.eye(4),
    )


def _flange(flange: Document) -> Floats:
    """Flange pose: [direction b] Rx(alpha) Ry(beta) Rz(gamma) Tx Ty Tz; for ``cpc`` R(b) Rz(beta) Tx Ty Tz."""
    shift = np.array([flange.get(f"{axis}_mm", 0.0) for axis in "xyz"]) * MM
    angles = {name: math.radians(flange.get(f"{name}_deg", 0.0)) for name in ("alpha", "beta", "gamma")}
    if "b" in flange:
        rotated = rotation_to(_direction(flange["b"], "flange.b")) @ _rotation(0.0, 0.0, angles["beta"])
    else:
        rotated = (
            _rotation(angles["alpha"], 0.0, 0.0)
            @ _rotation(0.0, angles["beta"], 0.0)
            @ _rotation(0.0, 0.0, angles["gamma"])
        )
    return np.asarray(rotated @ pose_from_xyz_rpy(shift, np.zeros(3)))


def _rotation(rx: float, ry: float, rz: float) -> Floats:
    return pose_from_xyz_rpy(np.zeros(3), np.array([rx, ry, rz]))


def _direction(vector: Sequence[float], field: str) -> Floats:
    z = np.array(vector, dtype=np.float64)
    size = float(np.linalg.norm(z))
    if z.shape != (3,) or size < SHORTEST:
        raise RobotError(
            f"{field} is {list(vector)}: give a direction, three numbers that are not all zero.", field=field
        )
    return np.asarray(z / size)
