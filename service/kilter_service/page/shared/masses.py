"""Which parameters are errors of masses: a page lists them as masses, not among what the poses cannot tell."""

from __future__ import annotations

STEMS = ("link_mass_", "link_moment_", "load_payload_")


def of_a_mass(name: str) -> bool:
    """Whether a parameter is an error of a mass or a centre, as `load_error` names them."""
    return name.startswith(STEMS)
