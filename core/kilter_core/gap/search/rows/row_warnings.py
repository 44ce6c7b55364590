"""What the rows themselves say before any fit: copies among repeats, and repeats that drifted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kilter_core.effects.physical import joint_numbers
from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.noise.visits import Visits
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.sources.rounding import Rounding, coordinate
from kilter_core.gap.search.sources.source import Source
from kilter_core.parameters import DEG, degrees, mm

Warning_ = dict[str, Any]

# By the model with what it knows at the end.
JUDGED_AGAIN = ("outliers", "repeats_drift", "drift_not_separated", "revisits_bound_noise")
BEYOND = 3.0  # times the instrument, from which repeats show that something moves
FEWEST_AGAIN = 3  # poses visited again from which a person meant to repeat


REPEATS_SET_ASIDE: Warning_ = {
    "code": "no_repeats",
    "message": "Without the visits that were set aside fewer than three repeated approaches are left, so the noise is that of "
    "the fit: every verdict is relative to it. Repeat ten poses thrice, coming from the same pose before.",
}


def no_repeats_warning(visits: Visits) -> Warning_:
    """Say that no visits should agree, and why: no pose was visited again, or every time in another session."""
    again = np.flatnonzero(np.bincount(visits.pose) > 1)
    session = visits.observations.session
    apart = session is not None and any(np.ptp(session[visits.pose == k]) for k in again)
    relative = (
        "so the noise is that of the fit: every verdict is relative to it, and above provisional is only what both "
    )
    relative += "halves, or a confirmation, show alike."
    if len(again) < FEWEST_AGAIN or not apart:
        said = f"No pose was repeated often enough, {relative} Repeat ten poses thrice, others between."
    else:
        said = (
            f"{len(again)} poses were visited again, but in another session, and too few visits are alike to show the noise; "
            f"{relative} Come back to ten poses thrice within a session."
        )
    return {"code": "no_repeats", "message": said}


def rounding_warnings(one: Rounding | None, source: Source, held: bool) -> Iterator[Warning_]:
    """Say to which step joint readings are rounded, how far that moves the tool, and how it counts."""
    if one is None:
        return
    joints = source.model.robot.joints
    said = []
    for step in dict.fromkeys(s for s in one.steps.tolist() if s > 0.0):
        own = [j for j, s in enumerate(one.steps) if s == step]
        slides = joints[own[0]].kind == "prismatic"
        size = f"{mm(step):.4g} mm" if slides else f"{degrees(step):.4g} deg"
        said.append(f"{size} ({joint_numbers(own)})")
    counted = "which the noise holds already" if held else "which counts as noise of its own"
    yield {
        "code": "rounded_readings",
        "message": f"The joint readings are multiples of {' and '.join(said)}: rounding moves the tool by "
        f"{mm(coordinate(one, source)):.2g} mm, rms of a coordinate, {counted}. Record the readings with more digits.",
    }


def noise_warnings(noise: Noise, joint: bool) -> Iterator[Warning_]:
    """Say how far repeats drifted, or that the rows cannot show it."""
    drift = noise.drift
    unit, scale = ("deg", DEG) if joint else ("µm", 1e6)
    if drift is not None and drift.is_significant:
        sizes = {"over the campaign": drift.over_campaign * scale, "per K": drift.per_kelvin * scale}
        said = " and ".join(f"{v:.3g} {unit} {k}" for k, v in sizes.items() if v > 0.0) or f"0 {unit}"
        clock = "" if drift.timed else " (by the order of the rows, because there is no clock)"
        yield {
            "code": "repeats_drift",
            "message": f"The repeats drifted by {said}{clock}, rms of a coordinate. The noise is what is left of them at no "
            "distance in time and temperature. Let arm and instrument warm up, and repeat poses soon after one another.",
        }
    if noise.has_too_few_revisits:
        yield {
            "code": "revisits_bound_noise",
            "message": "The noise is that of poses visited again from other sides or under other loads, and what these do "
            "could not all be fitted: noise is this at most, and no claim is confirmed by it. Come back to ten poses thrice "
            "in the same way.",
        }
    elif noise.most:
        yield {
            "code": "drift_not_separated",
            "message": "The repeats are too few, or all far apart in time, so noise and drift cannot be separated: noise is "
            "this at most, and no claim is confirmed by it. Repeat ten poses with only one other pose in between.",
        }


def instrument_warnings(noise: Noise, stated: float | None) -> Iterator[Warning_]:
    """Say that repeats scatter by far more than the instrument, ``stated`` m of a coordinate, does."""
    if stated is None or not stated > 0.0 or noise.between is None or noise.coordinate < BEYOND * stated:
        return
    ratio = noise.coordinate / stated
    within = "" if noise.within is None else f" ({mm(noise.within):.3g} mm without leaving the pose)"
    yield {
        "code": "noise_beyond_instrument",
        "ratio": ratio,
        "message": f"Repeats differ by {mm(noise.coordinate):.3g} mm (standard deviation of a coordinate){within}, "
        f"{ratio:.2g} times what the instrument states ({mm(stated):.3g} mm): something moves between visits. Hysteresis "
        "and friction memory of the joints (presliding), a loose mount or nest, or warming do that; errors smaller than this "
        "cannot be seen. Approach poses from the same side and on the same way, and check mounts.",
    }


def outlier_warnings(problem: LinearizedProblem) -> Iterator[Warning_]:
    """Say how many visits were set aside."""
    used = problem.settings.used
    if not used.all():
        yield {
            "code": "outliers",
            "visits": int(np.sum(~used)),
            "message": f"{int(np.sum(~used))} of {len(used)} visits could be explained by nothing in the library and were set "
            "aside.",
        }
