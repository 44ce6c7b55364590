"""Moment of gravity about each joint of an arm at rest, by the document of its chain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np

G_M_S2 = (0.0, 0.0, -9.80665)


def gravity_moments(chain: Mapping[str, Any], q_deg: Floats, payload_kg: Floats) -> Floats | None:
    """Moments (N, n), N m, about the joints in their directions, at readings (N, n), with masses (N,) at the tool point.

    ``chain`` is a robot document of convention ``chain``. None where it states no masses, has a prismatic joint, or one
    that drives several axes. The numbers are nominal: which way a load pulls is meant, and roughly how much.
    """
    links, names = chain.get("links"), [joint["name"] for joint in chain["joints"]]
    driven = [one for one in chain["elements"] if one.get("joint")]
    if not links or [one["joint"] for one in driven] != names or any(one["axis"][0] == "T" for one in driven):
        return None
    frames, tool = _frames(chain["elements"], q_deg, names), chain.get("tool") or {}
    gravity = np.array(chain.get("gravity_m_s2") or G_M_S2, dtype=float)
    held = (
        _points_in_base(frames[-1], [float(tool.get(f"{axis}_mm") or 0.0) for axis in "xyz"]),
        payload_kg[:, None] * gravity,
    )
    hung = [
        (_points_in_base(frame, link.get("com_mm") or [0.0, 0.0, 0.0]), float(link.get("mass_kg") or 0.0) * gravity)
        for frame, link in zip(frames, links, strict=False)
    ]
    told = []
    for j, (frame, one) in enumerate(zip(frames, driven, strict=False)):
        axis = math.copysign(1.0, one.get("ratio") or 1.0) * frame[:, :3, "xyz".index(one["axis"][1])]
        moment = sum(np.cross(centre - frame[:, :3, 3], weight) for centre, weight in [*hung[j:], held])
        told.append(1e-3 * np.einsum("ni,ni->n", axis, moment))
    return np.column_stack(told)


def flange(chain: Mapping[str, Any], q_deg: Floats) -> Floats:
    """Frames (N, 4, 4) of the flange in the base, mm, at readings (N, n) of an arm that is as its document says."""
    return _frames(chain["elements"], q_deg, [joint["name"] for joint in chain["joints"]])[-1]


def _frames(elements: Sequence[Mapping[str, Any]], q_deg: Floats, names: Sequence[str]) -> list[Floats]:
    """Frames (N, 4, 4) right after each joint, and last that of the flange; lengths in mm."""
    T, frames = np.tile(np.eye(4), (len(q_deg), 1, 1)), []
    for one in elements:
        joint = one.get("joint")
        turned = float(one.get("ratio") or 1.0) * q_deg[:, names.index(joint)] if joint else np.zeros(len(q_deg))
        T = T @ _step(one["axis"], float(one.get("value") or 0.0) + turned)
        if joint:
            frames.append(T)
    return [*frames, T]


def _points_in_base(frame: Floats, point_mm: Sequence[float]) -> Floats:
    """A point (N, 3), mm, that stands still in frames (N, 4, 4)."""
    placed: Floats = frame[:, :3, :3] @ np.array(point_mm, dtype=float) + frame[:, :3, 3]
    return placed


def _step(axis: str, value: Floats) -> Floats:
    """Elementary transforms (N, 4, 4): ``Tx`` in mm along an axis, ``Rx`` in degrees about it."""
    T = np.tile(np.eye(4), (len(value), 1, 1))
    k = "xyz".index(axis[1])
    if axis[0] == "T":
        T[:, k, 3] = value
        return T
    c, s = np.cos(np.radians(value)), np.sin(np.radians(value))
    i, j = (k + 1) % 3, (k + 2) % 3
    T[:, i, i], T[:, j, j], T[:, i, j], T[:, j, i] = c, c, -s, s
    return T
