"""Cameras and boards as a result tells them: mm, degrees and pixels, fixed ones in the robot's base, others on its flange."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from kilter_core.identify.views.cameras import rig_from_calibration
from kilter_core.measurement.camera.view_scatter import ViewScatter
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import Place, PlacedRig
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import inverse, xyz_rpy_from_pose
from kilter_core.types import Floats


def on_the_robot(calibration: Calibration) -> PlacedRig | None:
    """The rig of a calibration with fixed parts in the robot's base frame and the others in that of its flange."""
    rig, model = rig_from_calibration(calibration), calibration.model.absorb_frame_increments(calibration.values)[0]
    return None if rig is None else rig.transform_frames(base=inverse(model.T_base), tool=model.T_tool)


def cameras_document(calibration: Calibration, sigmas: Mapping[str, float] | None = None) -> dict[str, Any]:
    """``cameras`` and ``boards`` of a result; empty where none measured."""
    rig = on_the_robot(calibration)
    if rig is None:
        return {}
    known = sigmas or {}
    cameras = [
        {
            "name": one.name, "mount": one.mount, "frame": _frame(one.mount), **_pose(place.pose),
            **_sigmas("camera", one.name, known), "width_px": one.size[0], "height_px": one.size[1],
            **dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), map(float, place.values[:4]), strict=True)),
            "distortion_model": one.model, "distortion": place.values[4:].tolist(),
            "intrinsics_sigmas": [known.get(f"camera_{one.name}_{n}", 0.0) for n in one.names] if known else None,
        }
        for one, place in zip(rig.rig.cameras, rig.cameras, strict=True)
    ]  # fmt: skip
    boards = [
        {
            "name": one.name, "mount": one.mount, "frame": _frame(one.mount), **_pose(place.pose),
            **_sigmas("board", one.name, known), **_scale(place, known.get(f"board_{one.name}_scale")),
        }
        for one, place in zip(rig.rig.boards, rig.boards, strict=True)
    ]  # fmt: skip
    return {"cameras": cameras, "boards": boards}


def pixels_document(found: ViewScatter, open_rms: float, open_high: float) -> dict[str, Any]:
    """How noisy corners are, and how far off the tool is in views that were fitted, the noise of the views taken off; and how
    far off it may be by what the fit leaves open, m.
    """
    return {
        "noise_px": found.sigma_px, "between_views": found.beyond, "train": tool_document(found), "validation": None,
        "left_open": {"rms_mm": mm(open_rms), "high_mm": mm(open_high)},
    }  # fmt: skip


def tool_document(found: ViewScatter) -> dict[str, float]:
    """How far off the tool is, with its 95 % interval."""
    root = math.sqrt(3.0)  # of the three coordinates of a point
    return {
        "rms_mm": mm(found.rms_m), "low_mm": mm(root * found.place_low), "high_mm": mm(root * found.place_high),
        "orientation_deg": degrees(root * found.turn),
    }  # fmt: skip


def _frame(mount: str) -> str:
    return "base" if mount == "fixed" else "flange"


def _pose(T: Floats) -> dict[str, float]:
    xyz, rpy = xyz_rpy_from_pose(T)
    out = {f"{k}_mm": mm(float(v)) for k, v in zip("xyz", xyz, strict=True)}
    return out | {f"r{k}_deg": degrees(float(v)) for k, v in zip("xyz", rpy, strict=True)}


def _sigmas(what: str, name: str, known: Mapping[str, float]) -> dict[str, Any]:
    if not known:
        return {"sigma_mm": None, "sigma_deg": None}
    place = [mm(known.get(f"{what}_{name}_{k}", 0.0)) for k in "xyz"]
    turn = [degrees(known.get(f"{what}_{name}_r{k}", 0.0)) for k in "xyz"]
    return {"sigma_mm": place, "sigma_deg": turn}


def _scale(place: Place, sigma: float | None) -> dict[str, float | None]:
    return {
        "scale_percent": 1e2 * float(place.values[0]),
        "scale_sigma_percent": None if sigma is None else 1e2 * sigma,
    }
