"""From the generator's documents and columns to core's robot and observations: the only bridge between the two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Link, Robot
from kilter_core.observations import Observations
from tests.blind.generator import Campaign

UNIFORM = 3.0**0.5  # half width of an even spread over its standard deviation
NOT_NOTHING = 1e-4  # kg or m: nobody knows a mass exactly


def robot_of(campaign: Campaign) -> Robot:
    """Kilter's robot, from the document, and in some cases how well its user says that the masses are known."""
    robot, options = robot_from_document(campaign.document), campaign.case.options
    if not options.stated_priors or "mass_sigma" not in {f.name for f in fields(Link)}:
        return robot
    share, place = options.mass_error / UNIFORM, options.com_error_mm * 1e-3 / UNIFORM
    links = tuple(replace(link, **_known_to(link.mass * share, place)) for link in robot.links)
    return replace(robot, links=links)


def _known_to(mass_kg: float, place_m: float) -> dict[str, Any]:
    return {"mass_sigma": max(mass_kg, NOT_NOTHING), "com_sigma": max(place_m, NOT_NOTHING)}


def observations_of(columns: Mapping[str, NDArray[Any]]) -> Observations:
    """Columns of the contract (mm, degrees) as observations (SI, radians)."""
    n = sum(name.startswith("q") and name.endswith("_deg") for name in columns)

    def stack(names: list[str], scale: float) -> NDArray[np.float64]:
        return np.stack([np.asarray(columns[name], dtype=np.float64) * scale for name in names], axis=1)

    joints = range(1, n + 1)
    return Observations(
        q=stack([f"q{i}_deg" for i in joints], np.pi / 180.0),
        position=stack(["x_mm", "y_mm", "z_mm"], 1e-3),
        direction=stack([f"dir{i}" for i in joints], 1.0),
        t=np.asarray(columns["t_s"], dtype=np.float64),
        payload_kg=np.asarray(columns["payload_kg"], dtype=np.float64),
        temperature_c=np.asarray(columns["temperature_c"], dtype=np.float64),
        session=np.asarray(columns["session"], dtype=np.int64),
        pose_id=np.asarray(columns["pose_id"], dtype=np.int64),
    )
