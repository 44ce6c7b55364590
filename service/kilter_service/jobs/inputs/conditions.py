"""Conditions and noise of rows that are checked: what was stated, what is taken for granted, and of another instrument."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.core import core_watch
from kilter_service.ground.wire import to_metres, to_metres_if_known, to_mm
from kilter_service.robots.instruments.validity import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Predictive
    from kilter_core.watch import Conditions
    from kilter_service.jobs.kind import JobInput
    from kilter_service.versions.drift.records import StoredCheck

QUANTILE = 1.959963984540054  # of a 95 % interval (kilter_core.types, which loads numpy)
SHIFT = ("x", "y", "z")


def build_check_conditions(job: JobInput, noise: float | None) -> Conditions:
    """Conditions of a check or a re-zeroing whose noise of a coordinate is ``noise`` m, None where nobody stated it."""
    stated = to_metres_if_known(job.options.setup_mm)
    setup = learned_setup(job.fit.agreeing) if stated is None else stated
    return core_watch.Conditions(core_watch.UNSTATED_K, setup, noise is not None)


def learned_setup(agreeing: Sequence[StoredCheck]) -> float:
    """Standard deviation (m) with which the set-up repeats, by the checks that agreed."""
    shown = [one for one in map(_shift, agreeing) if one is not None]
    shifts, sigmas = (np.array([one[k] for one in shown]).reshape(-1, 3) for k in (0, 1))
    return float(core_watch.learned_setup(shifts, sigmas))


def _shift(one: StoredCheck) -> tuple[list[float], list[float]] | None:
    """Shift (3,) m of the base that a check shows, and its standard deviations; None of one that shows it in part."""
    base = next((cause for cause in one.result.get("looked_at") or [] if cause["name"] == "base"), None)
    numbers = {number["name"]: number for number in (base or {}).get("numbers") or []}
    own = [numbers.get(name) or {} for name in SHIFT]
    if any(number.get("summed") is None or number.get("summed_u95") is None for number in own):
        return None
    return [to_metres(number["summed"]) for number in own], [
        to_metres(number["summed_u95"]) / QUANTILE for number in own
    ]


def counted_noise(job: JobInput, known: Predictive) -> float | None:
    """Noise (m) of a coordinate that is stated, else what a coarser instrument may be wrong by; None: that of the fit."""
    stated = to_metres_if_known(job.options.noise_mm)
    return _of_another(job, known) if stated is None else stated


def remark(job: JobInput, known: Predictive) -> dict[str, Any] | None:
    """Say that the rows count as an instrument makes them that the fit does not name; None where they do not."""
    own = _of_another(job, known) if job.options.noise_mm is None else None
    if own is None:
        return None
    ((campaign, _),) = job.campaigns.items()
    return {
        "code": "another_instrument",
        "message": f"{job.names.get(campaign, campaign)} was measured with {job.instruments[campaign].name}, which the version "
        f"was not fitted to. What that may be wrong by counts as the noise of a coordinate, {to_mm(own):.3g} mm, and not the "
        f"{to_mm(known.noise):.3g} mm of the fit: smaller changes are not seen. Where it is better known, state noise_mm.",
        "campaigns": [campaign],
    }


def _of_another(job: JobInput, known: Predictive) -> float | None:
    ((campaign, rows),) = job.campaigns.items()
    instrument = job.instruments.get(campaign)
    if instrument is None or instrument.name in job.fit.instruments or rows.position is None:
        return None
    far = float(np.nanmean(np.linalg.norm(rows.position, axis=1)))  # an instrument measures in its own frame
    own = float(permissible(instrument).standard(np.array([far]))[0])
    return own if np.isfinite(own) and own > known.noise else None
