"""What a value outside its physical range means: a backlash below 0 is none, or contradicts the load."""

from __future__ import annotations

import re

# Parameters of effects that physics keeps above 0; those by the load say what to check.
BY_LOAD = re.compile(
    r"(backlash_load|compliance|bending|gravity_spring|hardening|strain_wave_\d+|radial_compliance|telescope|torsion)_\d+"
    r"|(base_compliance|clearance)_\w+|sag_per_kg"
)
NEVER_NEGATIVE = re.compile(rf"{BY_LOAD.pattern}|(lag|link_expansion)_\d+|expansion")
WITHIN_95 = 1.96  # standard deviations


def below_zero(name: str, value: float | None) -> bool:
    """Whether a parameter that cannot be negative is."""
    return value is not None and value < 0.0 and NEVER_NEGATIVE.fullmatch(name) is not None


def why_unusual(name: str, value: float | None, sigma: float | None) -> str:
    """Words for a value outside its physical range; ``value`` and ``sigma`` in one unit."""
    if value is None or not below_zero(name, value):
        return "outside its physical range: look for what is missing in the model"
    if sigma is not None and value + WITHIN_95 * sigma >= 0.0:
        return "not seen: below 0 by less than its uncertainty"
    check = "check masses, payload and how the base stands, or " if BY_LOAD.fullmatch(name) else ""
    return f"below 0, which cannot be: {check}look for what is missing in the model"
