"""Sentences of what jobs find about their inputs, by code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_core.errors import Sentences
from kilter_service.campaigns.unstated_load import REMEDY, counted_as_nothing


def load_not_stated(said: Mapping[str, Any]) -> str:
    """Say which campaigns state no payload, and which effects follow it."""
    state = "state" if len(said["campaigns"]) > 1 else "states"
    return counted_as_nothing(f"{', '.join(said['names'])} {state}", said["effects"])


def _default_load_used(said: Mapping[str, Any]) -> str:
    at = ", ".join(f"{value * 1e3:.6g}" for value in said["com_m"])
    return (
        f"{', '.join(said['names'])}: no payload is stated, so the robot's default load counts, {said['mass_kg']:.6g} kg at "
        f"({at}) mm in the tool frame. If it carried another, state payload_kg."
    )


SENTENCES: Sentences = {
    "load_not_stated": lambda said: f"{load_not_stated(said)} {REMEDY.format(whole='campaign')}",
    "default_load_used": _default_load_used,
}
