"""How far an arm may be from a version: ranges of its parameters, draws of all of them together, and the arms these are.

A draw is written twice: as Kilter's parameters, and as the numbers of the model that ``--format mjcf`` writes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.identify import Predictive, fit_fleet_prior, restrict_to_what_moves_the_tool
from kilter_core.parameters import FittedNumber, draw_ranges, indices, write_json_for_yaml
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable, Written
from kilter_service.robots.exporters.mjcf_file import model_element

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kilter_core.model import Calibration
    from kilter_core.types import Floats

UNITS = {  # of the attributes that a draw may change, of a revolute joint and of a prismatic one
    "pos": ("m", "m"),
    "quat": ("wxyz", "wxyz"),
    "mass": ("kg", "kg"),
    "fullinertia": ("kg_m2", "kg_m2"),
    "diaginertia": ("kg_m2", "kg_m2"),
    "kp": ("nm_rad", "n_m"),
    "frictionloss": ("nm", "n"),
    "range": ("rad", "m"),
    "armature": ("kg_m2", "kg"),
    "damping": ("nm_s_rad", "n_s_m"),
    "stiffness": ("nm_rad", "n_m"),
    "data": ("", ""),
}


def ranges(version: Exportable) -> Written:
    """Write the ranges, of the arm and, where versions of five others of its type are known, of the type.

    Raises:
        ServiceError: nothing says how well the version is known.
        OptionError: a level that is not between 0 and 1.

    """
    known = Predictive.from_document(version.version.covariance.model_dump(exclude_none=True))
    if known is None:
        raise ServiceError(
            f"Version {version.version.id} has no covariance, so no range: identify the robot from measured poses.",
            code="ranges_unknown",
        )
    calibration, level = version.calibration, version.ranges_percent / 100.0
    scatter = float(np.hypot(known.inadequacy, known.noise))
    spreads: dict[str, tuple[Sequence[str], Floats | None, Floats]] = {"arm": (known.names, None, known.covariance)}
    notes = [
        "arm: how far this arm may be from the version. tool_sigma_m: what a measured coordinate scatters by beside that.",
        "What moves together and leaves the tool where it is, as a base and a first link, is not drawn.",
        "model_draws have the numbers of --format mjcf that a draw changes; all others are those of that file.",
    ]
    try:
        prior = fit_fleet_prior(calibration.model, known.names, version.fleet).prior
    except CoreError:  # too few, or fitted otherwise
        notes.append(
            "No ranges of other arms of the type: they take versions of five other robots with the same effects and free "
            f"parameters, and {len(version.fleet)} have a version."
        )
    else:
        spreads["type"] = (prior.names, prior.mean, prior.covariance)
        notes.append(f"type: how another arm of the type may be, by versions of {len(version.fleet)} others.")

    def write() -> str:
        head = {"format": "kilter-ranges/1", "robot": version.version.robot, "version": version.version.id}
        drawn = {key: _draw_arms(calibration, *spread, scatter, level) for key, spread in spreads.items()}
        return write_json_for_yaml(head | drawn | {"tool_sigma_m": scatter})

    return Written(write, tuple(notes))


def _draw_arms(
    calibration: Calibration,
    names: Sequence[str],
    mean: Floats | None,
    covariance: Floats,
    scatter: float,
    level: float,
) -> dict[str, Any]:
    """Ranges and draws of parameters about their ``mean``, by default their values, and the models that these are."""
    model = calibration.model
    at = indices(calibration.names, names)
    centre = calibration.values[at] if mean is None else mean
    numbers = [FittedNumber(name, model.parameter(name).unit, float(x)) for name, x in zip(names, centre, strict=True)]
    found = draw_ranges(numbers, restrict_to_what_moves_the_tool(calibration, names, covariance, scatter), level)
    models = []
    for draw in found["draws"]:
        values = calibration.values.copy()
        values[at] = [draw[number.key] for number in numbers]
        models.append(dict(_model_numbers(model_element(replace(calibration, values=values)))))
    varied = [key for key in models[0] if any(one[key] != models[0][key] for one in models)]
    return found | {"model_draws": [{key: one[key] for key in varied} for one in models]}


def _model_numbers(element: Element, owner: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers of a model by the name of their element, attribute and unit; a mass has the name of its body."""
    name = element.get("name", owner)
    slides = element.get("type") == "slide"
    for attribute, units in UNITS.items():
        text = element.get(attribute)
        if text is not None:
            inner = "inertial_" if element.tag == "inertial" else ""
            key = f"{name}.{inner}{attribute}_{units[slides]}".rstrip("_")
            yield key, text if element.tag == "text" else _parse(text)
    for child in element:
        yield from _model_numbers(child, name)


def _parse(text: str) -> float | list[float]:
    parts = [float(one) for one in text.split()]
    return parts[0] if len(parts) == 1 else parts
