"""Fit campaigns from a file and write what was found: run once under each kind of processor."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.procedures.circle_points import robot_from_circles
from tests.core.processors.made import Campaign


def fitted(campaign: Campaign) -> dict[str, Any]:
    """Names, values, standard deviations, held directions (as a projector, which no choice of basis changes) and words."""
    try:
        return _circles(campaign) if campaign.circles is not None else _identified(campaign)
    except CoreError as error:
        return {"refused": error.code}


def _identified(campaign: Campaign) -> dict[str, Any]:
    found = identify(robot_from_document(campaign.robot), campaign.rows, None, IdentifyOptions(**campaign.options))
    held = found.fit.problem.held
    values = dict(zip(found.calibration.names, found.calibration.values, strict=True))
    return {
        "names": list(found.free_names),
        "values": np.array([values[name] for name in found.free_names]),
        "sigma": found.fit.sigma,
        "held": np.zeros((len(found.free_names),) * 2) if held is None else held.T @ held,
        "said": [d.sentence() for d in found.null_directions],
        "codes": [warning["code"] for warning in found.warnings],
        "together": [group["parameters"] for group in found.to_document()["correlated_groups"]],
    }


def _circles(campaign: Campaign) -> dict[str, Any]:
    assert campaign.circles is not None
    slides = np.array([joint.get("limits_mm") is not None for joint in campaign.robot["joints"]])
    found = robot_from_circles(campaign.rows.q, slides, campaign.circles, name="found")
    axes = found.axes
    return {
        "names": [f"{what}_{k}_{i}" for what in ("direction", "point") for k in range(len(axes)) for i in range(3)],
        "values": np.concatenate([*(a.direction for a in axes), *(a.point for a in axes)]),
        "sigma": np.repeat([*(a.sigma_rad for a in axes), *(a.sigma_m or a.rms for a in axes)], 3),
        "held": np.zeros((1, 1)),
        "said": [element["joint"] for element in found.document["elements"] if "joint" in element],
        "codes": [],
        "together": [],
    }


def main(source: str, target: str) -> None:
    """Fit what ``source`` holds and write the answers to ``target``."""
    campaigns = pickle.loads(Path(source).read_bytes())  # noqa: S301 - the test's own file
    Path(target).write_bytes(pickle.dumps({one.name: fitted(one) for one in campaigns}))


if __name__ == "__main__":
    main(*sys.argv[1:])
