"""What a job says when campaigns, or sessions, fit one by one and not together: tool or base were others in each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.core import core_model, set_up_changes
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.inputs.setups import LAID_AGAIN
from kilter_service.jobs.kind import JobInput, JobOutput

if TYPE_CHECKING:
    from kilter_core.observations import Observations

KINDS = ("identify", "gap")


def with_set_up_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that tool or base differ between campaigns, and the option that gives each its own."""
    if kind not in KINDS or output.version is None or job.options.refit:
        return output
    calibration = core_model.Calibration.from_document(job.robot, output.version.calibration)
    campaigns = {
        c: rows for c, rows in job.campaigns.items() if job.devices.get(c, "").strip().lower() not in LAID_AGAIN
    }
    sessions = {(c, s): part for c, rows in campaigns.items() for s, part in _sessions(rows).items()}
    for parts, words in ((campaigns, "campaign"), (sessions, "session")):
        change = set_up_changes.set_up_change(calibration, list(parts.values()))
        if change is not None:
            said = _sentence(change, words, ", ".join(job.names.get(c, c) for c in campaigns))
            remark: dict[str, Any] = {"code": "set_up_changed", "message": said, "campaigns": list(campaigns)}
            return output.with_warnings({**remark, "refit": list(change.which), "moved_mm": to_mm(change.moved)})
    return output


def _sessions(rows: Observations) -> dict[int, Observations]:
    """The rows of each session, in ascending order; all of them where none is stated."""
    if rows.session is None:
        return {0: rows}
    return {int(code): rows.select(rows.session == code) for code in np.unique(rows.session)}


def _sentence(change: set_up_changes.SetUpChange, part: str, names: str) -> str:
    which = " and ".join(change.which)
    apart, left = f"{to_mm(change.moved):.2g} mm", f"{to_mm(change.apart):.2g} mm"
    verb, own = ("lies", f"a {which}") if len(change.which) == 1 else ("lie", which)
    return (
        f"{names}: the {which} {verb} {apart} apart between {part}s. With {own} for each {part} {left} are left, "
        f"{to_mm(change.together):.2g} mm with one for all. Identify with --refit {','.join(change.which)}."
    )
