"""Job kind ``evaluate``: any version against any campaign."""

from __future__ import annotations

from typing import Any

from core.errors import OptionError
from service.jobs.kind import JobInput, JobKind, JobOutput, Progress

VERSION, REFIT = "version", "refit"
REFITS: tuple[list[str], ...] = ([], ["base"], ["base", "tool"])


def check(options: dict[str, Any]) -> None:
    """Refuse options that evaluate does not have.

    Raises:
        OptionError: one that does not exist or cannot be.

    """
    unknown = sorted(set(options) - {VERSION, REFIT})
    if unknown:
        raise OptionError(f"evaluate has no option {unknown[0]!r}. It has: {VERSION}, {REFIT}.", option=unknown[0])
    if options.get(REFIT, []) not in REFITS:
        raise OptionError(f'refit is {options[REFIT]}: give [], ["base"] or ["base", "tool"].', option=REFIT)


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Compare the version named (else the active one, else the robot as drawn) with the rows of every campaign."""
    from core.evaluate import evaluate  # compiled kernels: only the worker needs them
    from core.model import Calibration

    calibration = job.calibration or Calibration.nominal(job.robot)
    metrics = {}
    for number, (campaign, rows) in enumerate(job.campaigns.items()):
        progress(number / len(job.campaigns), f"campaign {number + 1} of {len(job.campaigns)}")
        metrics[campaign] = evaluate(calibration, rows, job.options.get(REFIT, []))
    return JobOutput({"version_id": job.version_id, "refit": job.options.get(REFIT, []), "metrics": metrics})


EVALUATE = JobKind("evaluate", check, run, version_option=VERSION)
