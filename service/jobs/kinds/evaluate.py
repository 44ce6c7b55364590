"""Job kind ``evaluate``: any version against any campaign."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from core.errors import OptionError
from service.jobs.kind import JobInput, JobKind, JobOutput, Progress

if TYPE_CHECKING:
    from core.model import Calibration

VERSION, REFIT, METRICS, CRITERIA = "version", "refit", "metrics", "criteria"
KINDS_OF_METRICS = ("errors", "iso9283")
REFITS: tuple[list[str], ...] = ([], ["base"], ["base", "tool"])


def check(options: dict[str, Any]) -> None:
    """Refuse options that evaluate does not have.

    Raises:
        OptionError: one that does not exist or cannot be.

    """
    unknown = sorted(set(options) - {VERSION, REFIT, METRICS, CRITERIA})
    if unknown:
        raise OptionError(
            f"evaluate has no option {unknown[0]!r}. It has: {VERSION}, {REFIT}, {METRICS}, {CRITERIA}.",
            option=unknown[0],
        )
    if options.get(REFIT, []) not in REFITS:
        raise OptionError(f'refit is {options[REFIT]}: give [], ["base"] or ["base", "tool"].', option=REFIT)
    if options.get(METRICS, "errors") not in KINDS_OF_METRICS:
        raise OptionError(f"metrics is {options[METRICS]!r}: give {' or '.join(KINDS_OF_METRICS)}.", option=METRICS)
    wanted = options.get(CRITERIA, [])
    if not isinstance(wanted, list) or (wanted and options.get(METRICS) != "iso9283"):
        raise OptionError(
            'criteria is a list of symbols such as ["AP", "RP"], with metrics "iso9283".', option=CRITERIA
        )


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Compare the version named (else the active one, else the robot as drawn) with the rows of every campaign."""
    from core.evaluate import evaluate  # compiled kernels: only the worker needs them
    from core.identify.predictive import Predictive
    from core.model import Calibration

    calibration = job.calibration or Calibration.nominal(job.robot)
    if job.options.get(METRICS) == "iso9283":
        return _iso9283(job, calibration, progress)
    known = Predictive.from_document(job.covariance or {}, job.report)
    metrics, rows = {}, {}
    for number, (campaign, seen) in enumerate(job.campaigns.items()):
        progress(number / len(job.campaigns), f"campaign {number + 1} of {len(job.campaigns)}")
        metrics[campaign] = evaluate(calibration, seen, job.options.get(REFIT, []), known)
        rows[campaign] = metrics[campaign].pop("rows")
    refit = job.options.get(REFIT, [])
    return JobOutput({"version_id": job.version_id, "refit": refit, "metrics": metrics, "rows": rows})


def _iso9283(job: JobInput, calibration: Calibration, progress: Progress) -> JobOutput:
    """Criteria of every campaign; commanded is where the nominal chain in the version's wanted frames says."""
    from core.iso9283 import Trial, criteria

    commanded, reports = calibration.wanted(), {}
    for number, (campaign, rows) in enumerate(job.campaigns.items()):
        progress(number / len(job.campaigns), f"campaign {number + 1} of {len(job.campaigns)}")
        reports[campaign] = criteria(Trial.of(commanded.predict(rows), rows), job.options.get(CRITERIA, []))
    return JobOutput({"version_id": job.version_id, "standard": "ISO 9283:1998", "iso9283": reports})


EVALUATE = JobKind("evaluate", check, run, version_option=VERSION)
