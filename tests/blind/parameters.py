"""Intervals of parameters against the true values, which the generator and Kilter call by different names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tests.blind.claims import names

# Parameters of the truth by Kilter's names, with what one of the truth's makes of Kilter's (SI); {} is the joint.
# A drift and a settling are left out: their sizes depend on the origin of the foot's frame, which position data do not
# fix; so are a random walk, which has no parameters of its own, and shifts between sessions, which lie in the tool's frame.
PARAMETERS: dict[tuple[str, str], str] = {
    ("clearance_tilt", "C"): "clearance_{}",
    ("backlash", "b"): "backlash_{}",
    ("friction_windup", "k"): "windup_{}",
    ("backlash_load", "b"): "backlash_load_{}",
    ("axial_compliance", "c"): "compliance_{}",
    ("radial_compliance", "c"): "radial_compliance_{}",
    ("eccentricity", "a"): "eccentricity_sin_{}",
    ("eccentricity", "b"): "eccentricity_cos_{}",
    ("second_harmonic", "a"): "second_harmonic_sin_{}",
    ("second_harmonic", "b"): "second_harmonic_cos_{}",
    ("gear_error", "a"): "gear_sin1_{}",
    ("gear_error", "b"): "gear_cos1_{}",
    ("encoder_scale", "k"): "encoder_scale_{}",
    ("link_bending", "1/EI"): "bending_{}",
    ("base_compliance", "cx"): "base_compliance_x",
    ("base_compliance", "cy"): "base_compliance_y",
    ("thermal_growth", "alpha"): "expansion",
    ("zero_drift", "r"): "zero_drift_{}",
    ("zero_thermal", "k"): "zero_thermal_{}",
    ("link_growth", "alpha"): "link_expansion_{}",
    ("hardening", "h"): "hardening_{}",
    ("direction_compliance", "h"): "direction_compliance_{}",
    ("reading_tilt", "kx"): "reading_tilt_x_{}",
    ("reading_tilt", "ky"): "reading_tilt_y_{}",
    ("column_bending", "kx"): "column_bending_x",
    ("column_bending", "ky"): "column_bending_y",
    ("tool_sag", "s"): "sag_per_kg",
    ("payload_error", "mass"): "payload_mass",
}
SI = {"mm": 1e-3, "deg": math.pi / 180.0, "deg/(N m)": math.pi / 180.0}


def intervals(records: Sequence[Mapping[str, Any]]) -> list[bool]:
    """For each parameter of a rightly named effect, whether its interval holds the true value."""
    return [
        low <= value <= high
        for r in records
        for h in r["truth"]["effects"]
        for effect in r["report"]["effects"]
        if names(effect, h)
        for value, low, high in _compared(effect, h)
    ]


def _compared(effect: Mapping[str, Any], hidden: Mapping[str, Any]) -> list[tuple[float, float, float]]:
    said = {p["name"]: p for p in effect["parameters"]}
    out = []
    for key, value in hidden["parameters"].items():
        symbol, _, joint = key.rpartition("_")
        name = PARAMETERS.get((hidden["id"], symbol))
        if hidden["id"] == "joint_coupling":
            driven, driver = hidden["joints"]
            name = f"coupling_q{driver}_{driven}"
        p = said.get(name.format(joint)) if name else None
        if p is not None:
            scale = SI.get(p["unit"], 1.0)
            out.append((value, p["interval_low"] * scale, p["interval_high"] * scale))
    return out
