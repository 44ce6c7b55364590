"""The noise of rows that another instrument measured than a version was fitted to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.wire import to_metres_if_known, to_mm
from kilter_service.robots.instruments.permissible import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Predictive
    from kilter_service.jobs.kind import JobInput


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
