"""Stored columns into core's observations: units to SI once, orientations to rotations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.observations import CONDITIONS, Board, Camera, Observations, Rig
from kilter_core.types import Floats
from kilter_files.ground.later import transform
from kilter_service.contract.columns import BASE, LOAD_PARTS, PAYLOAD_CENTRE, PLAIN_UNITS, TILTS
from kilter_service.ground.tables.columns import Column
from kilter_service.ground.wire import to_metres

if TYPE_CHECKING:
    import pyarrow as pa

    from kilter_core.arm import Robot


MM = 1e-3
BY_JOINT = {"q": "q", "link": "link_q", "cmd": "command", "dir": "direction", "qd": "qd", "qdd": "qdd", "tau": "tau"}
# Plain columns of whole numbers and others whose field has another name; a condition's field is named as its column.
PLAIN = {"bar": "bar_length"} | {
    quantity: field
    for quantity, units in PLAIN_UNITS.items()
    for field in (quantity, *(f"{quantity}_{unit}" for unit in units))
    if field in CONDITIONS and field not in ("session", "row")
}
WHOLE = {
    "session": "session",
    "pose_id": "pose_id",
    "row": "row",
    "socket_id": "socket",
    "plane_id": "plane",
    "bar_id": "bar",
}


def observations(table: pa.Table, columns: Sequence[Column], conditions: dict[str, Any]) -> Observations:
    """Build observations (SI) of a table; the campaign's conditions fill what the rows do not say."""
    si = {(c.quantity, c.number): table.column(c.name).to_numpy(zero_copy_only=False) * c.factor for c in columns}
    fields: dict[str, Any] = {field: _by_joint(si, quantity) for quantity, field in BY_JOINT.items()}
    fields |= {field: si.get((quantity, None)) for quantity, field in PLAIN.items()}
    fields |= {field: _whole(si.get((quantity, None))) for quantity, field in WHOLE.items()}
    fields["position"] = _vector(si, ("x", "y", "z"))
    fields["sigma"] = _vector(si, ("sx", "sy", "sz"))
    fields["tip"] = _vector(si, ("tipx", "tipy", "tipz"))
    fields["payload_com"] = _vector(si, PAYLOAD_CENTRE)
    fields["wrench"] = _wrench(si, conditions, table.num_rows)
    fields["rotation"] = _rotation(si)
    fields["tilt"] = _tilt(si, table.num_rows)
    fields["link_mass"] = _on_links(si, table.num_rows, (LOAD_PARTS[0],))
    fields["link_wrench"] = _on_links(si, table.num_rows, LOAD_PARTS[1:])
    fields["markers"] = _markers(si)
    fields |= views(si, conditions, table.num_rows)
    return Observations(**_fill_from_conditions(fields, conditions, table.num_rows))


def with_default_load(rows: Observations, robot: Robot) -> Observations:
    """Return the rows under the robot's default load where they state none; as they are when the robot has none."""
    return rows if robot.load is None else rows.carrying(robot.load.mass, robot.load.com)


def _by_joint(si: dict[tuple[str, int | None], Floats], quantity: str) -> Floats | None:
    numbers = sorted(number for q, number in si if q == quantity and number is not None)
    return np.stack([si[quantity, number] for number in numbers], axis=1) if numbers else None


def _vector(si: dict[tuple[str, int | None], Floats], names: Sequence[str]) -> Floats | None:
    return np.stack([si[name, None] for name in names], axis=1) if (names[0], None) in si else None


def _wrench(si: dict[tuple[str, int | None], Floats], conditions: dict[str, Any], rows: int) -> Floats | None:
    """Force and moment (N, 6) on the tool point; where only one of them is known the other is zero."""
    parts = []
    for names, condition in ((("fx", "fy", "fz"), "tool_force_n"), (("mx", "my", "mz"), "tool_moment_nm")):
        whole = conditions.get(condition)
        found = _vector(si, names)
        parts.append(np.tile(np.asarray(whole, dtype=np.float64), (rows, 1)) if found is None and whole else found)
    if all(part is None for part in parts):
        return None
    return np.concatenate([np.zeros((rows, 3)) if part is None else part for part in parts], axis=1)


def _whole(values: Floats | None) -> NDArray[np.int64] | None:
    return None if values is None else values.astype(np.int64)


def _rotation(si: dict[tuple[str, int | None], Floats]) -> Floats | None:
    quaternion = _vector(si, ("qx", "qy", "qz", "qw"))
    euler = _vector(si, ("phi", "theta", "psi"))
    if quaternion is None and euler is None:
        return None
    given = euler if quaternion is None else quaternion
    assert given is not None
    seen = ~np.isnan(given).any(axis=1)
    out = np.full((len(given), 3, 3), np.nan)
    if seen.any():
        made = (
            transform.Rotation.from_euler("ZXZ", given[seen])
            if quaternion is None
            else transform.Rotation.from_quat(given[seen])
        )
        out[seen] = made.as_matrix()
    return out


def _tilt(si: dict[tuple[str, int | None], Floats], rows: int) -> Floats | None:
    """Readings (N, n, 3) of inclinometers, (N, n + 1, 3) with the base, nan where nothing was read; None without any."""
    given = [(TILTS.index(q), number) for q, number in si if q in TILTS and number is not None]
    if not given:
        return None
    places = sum(q == "q" for q, _ in si) + any(place == BASE for _, place in given)
    out = np.full((rows, places, len(TILTS)), np.nan)
    for axis, place in given:
        out[:, place, axis] = si[TILTS[axis], place]
    return out


def _on_links(si: dict[tuple[str, int | None], Floats], rows: int, groups: Sequence[Sequence[str]]) -> Floats | None:
    """Loads (N, n, parts) on links, zero where none is stated; None without any."""
    parts = [part for group in groups for part in group]
    given = [(parts.index(q), number) for q, number in si if q in parts and number is not None]
    if not given:
        return None
    out = np.zeros((rows, sum(q == "q" for q, _ in si), len(parts)))
    for part, link in given:
        out[:, link, part] = si[parts[part], link]
    return out


def _markers(si: dict[tuple[str, int | None], Floats]) -> Floats | None:
    numbers = sorted(number for quantity, number in si if quantity == "marker_x" and number is not None)
    if not numbers:
        return None
    return np.stack([np.stack([si[f"marker_{axis}", k] for axis in "xyz"], axis=1) for k in numbers], axis=1)


def _fill_from_conditions(fields: dict[str, Any], conditions: dict[str, Any], rows: int) -> dict[str, Any]:
    for name in ("payload_kg", "temperature_c"):
        if fields[name] is None and conditions.get(name) is not None:
            fields[name] = np.full(rows, float(conditions[name]))
    com = conditions.get("payload_com_mm")
    if fields["payload_com"] is None and com is not None:
        fields["payload_com"] = np.tile(np.asarray(com, dtype=np.float64) * MM, (rows, 1))
    if conditions.get("unchecked"):
        fields["unchecked"] = np.ones(rows, dtype=bool)
    return fields


PERCENT = 1e-2


def rig_from_conditions(conditions: Mapping[str, Any]) -> Rig | None:
    """The cameras and boards of a campaign, SI; None where it names none.

    Raises:
        ObservationError: ``camera_invalid`` or ``board_invalid``.

    """
    if not conditions.get("cameras") or not conditions.get("boards"):
        return None
    return Rig(tuple(map(_camera, conditions["cameras"])), tuple(map(_board, conditions["boards"])))


def _camera(one: Mapping[str, Any]) -> Camera:
    sigmas = one.get("sigmas_px")
    return Camera(
        one["name"],
        one["mount"],
        (one["width_px"], one["height_px"]),
        (one["fx_px"], one["fy_px"]),
        (one["cx_px"], one["cy_px"]),
        one.get("distortion_model", "none"),
        tuple(one.get("distortion") or ()),
        one.get("intrinsics") or ("fixed" if sigmas is None else "prior"),
        None if sigmas is None else tuple(sigmas),
    )


def _board(one: Mapping[str, Any]) -> Board:
    corners = tuple((to_metres(x), to_metres(y), to_metres(z)) for x, y, z in one["corners_mm"])
    return Board(one["name"], one["mount"], corners, PERCENT * (one.get("scale_sigma_percent") or 0.0))


def views(si: Mapping[tuple[str, int | None], Floats], conditions: Mapping[str, Any], rows: int) -> dict[str, Any]:
    """Fields of the observations; none without pixels, or where nobody describes the cameras."""
    rig = rig_from_conditions(conditions)
    if rig is None or not any(quantity == "pixel_u" for quantity, _ in si):
        return {}
    pixels = _corners(si, rig.most_corners, "", rows)
    out = {"pixels": pixels, "rig": rig}
    seen = ~np.isnan(pixels).all(axis=(1, 2))
    for name in ("camera", "board"):
        number = si.get((name, None), np.ones(rows))
        out[name] = np.where(seen, np.nan_to_num(number, nan=1.0).astype(np.int64) - 1, -1)
    if any(quantity == "pixel_su" for quantity, _ in si):
        out["pixel_sigma"] = _corners(si, rig.most_corners, "s", rows)
    return out


def _corners(si: Mapping[tuple[str, int | None], Floats], corners: int, prefix: str, rows: int) -> Floats:
    out = np.full((rows, corners, 2), np.nan)
    for k in range(corners):
        for axis, letter in enumerate("uv"):
            column = si.get((f"pixel_{prefix}{letter}", k))
            if column is not None:
                out[:, k, axis] = column
    return out
