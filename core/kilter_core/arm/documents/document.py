"""The one place where a robot document (mm, degrees) becomes a :class:`~kilter_core.arm.robot.Robot` (SI, radians)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.conventions import (
    MovingAxis,
    Place,
    Row,
    cpc_elements,
    dh_elements,
    mcpc_elements,
    mdh_elements,
    poe_elements,
    rotation_to,
    s_model_elements,
)
from kilter_core.arm.documents.parts import (
    MM,
    Document,
    parse_joint,
    parse_links,
    parse_load,
    parse_pose,
    payload_sigma_of,
)
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import STANDARD_GRAVITY, Joint, Robot
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


def robot_from_document(document: Document) -> Robot:
    """Build a robot from a document: ``chain``, ``dh``, ``mdh``, ``s_model``, ``poe``, ``cpc``, ``mcpc`` or ``preset``.

    URDF is converted to ``chain`` before.

    Fields of a ``preset`` document other than those in ``_OVERRIDABLE`` come from the preset.

    Raises:
        RobotError: a field is missing or cannot be; the message names it.

    """
    convention = document.get("convention")
    if convention == "preset":
        base = preset_document(str(document.get("preset")))
        return robot_from_document(
            {**base, **{k: v for k, v in document.items() if v is not None and k in _OVERRIDABLE}}
        )
    joints, chain, frames = _read(document, str(convention))
    gravity = document.get("gravity_m_s2")
    return Robot(
        name=str(document.get("name", "robot")),
        joints=joints,
        chain=chain,
        links=parse_links(document.get("links") or (), frames, chain),
        gravity=np.array([0.0, 0.0, -STANDARD_GRAVITY] if gravity is None else gravity, dtype=np.float64),
        T_base=parse_pose(document.get("base")),
        T_tool=parse_pose(document.get("tool")),
        payload_sigma=payload_sigma_of(document.get("payload_sigma")),
        load=parse_load(document.get("load")),
    )


def _read(document: Document, convention: str) -> Read:
    if convention == "chain":
        return _from_elements(document)
    if convention in TABLES:
        return _from_rows(document, convention)
    if convention == "poe":
        return read_poe(document)
    if convention in ("cpc", "mcpc"):
        return read_places(document, convention)
    raise RobotError(
        f"convention is {convention!r}: give chain, dh, mdh, s_model, poe, cpc, mcpc, urdf or preset.",
        field="convention",
        value=convention,
    )


TABLES = {"dh": dh_elements, "mdh": mdh_elements, "s_model": s_model_elements}
_OVERRIDABLE = {"name", "gravity_m_s2", "tool", "base", "links", "payload_sigma", "load"}


def _from_rows(document: Document, convention: str) -> tuple[tuple[Joint, ...], Chain, tuple[int, ...]]:
    rows = document.get("rows") or document.get(convention)
    if not rows:
        raise RobotError(f"A robot of convention {convention} needs rows, one per joint.", field="rows")
    joints: Sequence[Document] = document.get("joints") or [{} for _ in rows]
    if len(joints) != len(rows):
        raise RobotError(f"There are {len(rows)} rows but {len(joints)} joints: give one of each.", field="joints")
    table = [_row(row) for row in rows]
    elements, frames = TABLES[convention](table)
    kinds = ["prismatic" if row.prismatic else "revolute" for row in table]
    made = tuple(parse_joint(i, joint, kind) for i, (joint, kind) in enumerate(zip(joints, kinds, strict=True)))
    return made, Chain(elements, len(made)), frames


def _row(row: Document) -> Row:
    d, beta = row.get("d_mm", 0.0), row.get("beta_deg")
    return Row(
        alpha=math.radians(row.get("alpha_deg", 0.0)),
        a=row.get("a_mm", 0.0) * MM,
        theta_offset=math.radians(row.get("theta_offset_deg") or 0.0),
        d=None if d is None else d * MM,
        beta=None if beta is None else math.radians(beta),
        prismatic=row.get("type", "revolute") == "prismatic",
        gamma=math.radians(row.get("gamma_deg", 0.0)),
        b=row.get("b_mm", 0.0) * MM,
    )


def _from_elements(document: Document) -> tuple[tuple[Joint, ...], Chain, tuple[int, ...]]:
    described: Sequence[Document] = document.get("joints") or ()
    elements: Sequence[Document] = document.get("elements") or ()
    order = [str(j["name"]) for j in described] or list(
        dict.fromkeys(str(e["joint"]) for e in elements if e.get("joint"))
    )
    if not order:
        raise RobotError("A robot of convention chain needs elements, at least one with a joint.", field="elements")
    seen: set[str] = set()
    made = tuple(_element(k, element, order, seen) for k, element in enumerate(elements))
    chain = Chain(made, len(order))
    kinds = ["revolute" if made[k].axis.rotates else "prismatic" for k in chain.primary]
    by_name = {str(j["name"]): j for j in described}
    joints = tuple(
        parse_joint(i, by_name.get(name, {"name": name}), kind)
        for i, (name, kind) in enumerate(zip(order, kinds, strict=True))
    )
    return joints, chain, chain.primary


def _element(k: int, element: Document, order: Sequence[str], seen: set[str]) -> Element:
    try:
        axis = Axis[str(element["axis"]).upper()]
    except KeyError:
        raise RobotError(
            f"elements[{k}] has axis {element.get('axis')!r}: give Rx, Ry, Rz, Tx, Ty or Tz.",
            field=f"elements[{k}].axis",
        ) from None
    value = float(element.get("value") or 0.0)
    joint = element.get("joint")
    if joint is not None and joint not in order:
        raise RobotError(f"elements[{k}] names joint {joint!r}, not one of the joints.", field=f"elements[{k}].joint")
    return Element(
        axis=axis,
        value=math.radians(value) if axis.rotates else value * MM,
        name=None if element.get("fixed") else element.get("name") or _default_name(k, axis, joint, order, seen),
        joint=None if joint is None else order.index(joint),
        ratio=float(element.get("ratio", 1.0)),
        dependent=bool(element.get("spare")),
        drive=element.get("drive"),
    )


def _default_name(k: int, axis: Axis, joint: str | None, order: Sequence[str], seen: set[str]) -> str | None:
    """Name of an unnamed element: the zero offset of a joint's first element, else axis and place."""
    if joint is None:
        return f"{axis.name.lower()}_{k + 1}"
    if joint in seen:
        return None
    seen.add(joint)
    return f"{'theta' if axis.rotates else 'd'}_offset_{order.index(joint) + 1}"
