"""Job kind ``evaluate``: any version against any campaign."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kilter_core.errors import FindingDocument, OptionError
from kilter_service.contract.fits import with_earlier_names
from kilter_service.contract.jobs.evaluate import EVALUATE, EvaluateOptions
from kilter_service.ground.core import core_evaluate, core_identify, core_model
from kilter_service.jobs.budgets import uncertainty_budget
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Lack, Progress

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations

MOST_CHECKED = 500  # poses of a campaign that a check looks at
REMEDY = "Plan its poses with `kilter plan --purpose iso9283`, and drive them as often as the standard demands."


def check(options: EvaluateOptions) -> None:
    """Refuse options that do not go together.

    Raises:
        OptionError: criteria without their standard.

    """
    if options.criteria and options.metrics != "iso9283":
        raise OptionError('options.criteria goes with metrics "iso9283": give both, or none.', option="criteria")


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Compare the version named (else the active one, else the nominal robot) with the rows of every campaign."""
    options: EvaluateOptions = job.options
    if options.metrics == "iso9283":
        return _iso9283(job, _calibration(job), progress)
    known = core_identify.Predictive.from_document(job.covariance or {}, job.report)
    metrics, rows, warnings = {}, {}, []
    for number, (campaign, seen) in enumerate(job.campaigns.items()):
        progress(number / len(job.campaigns), f"campaign {number + 1} of {len(job.campaigns)}")
        calibration = _calibration(job, campaign)
        metrics[campaign] = with_earlier_names(core_evaluate.evaluate(calibration, seen, options.refit, known))
        rows[campaign] = metrics[campaign].pop("rows")
        used = job.instruments.get(campaign)
        metrics[campaign]["budget"] = uncertainty_budget(calibration, known, seen, used, options.refit)
        metrics[campaign]["fitted"] = job.fit.fitted.get(campaign, 0)
        metrics[campaign]["name"] = name = job.names.get(campaign, campaign)
        said = [*metrics[campaign].pop("warnings"), *_flattering(metrics[campaign]["fitted"], len(seen))]
        warnings += [{**one, "message": f"{name}: {one['message']}", "campaigns": [campaign]} for one in said]
    result = {"version_id": job.version_id, "refit": options.refit, "metrics": metrics, "rows": rows}
    return JobOutput(result | {"warnings": warnings})


def _calibration(job: JobInput, campaign: str | None = None) -> core_model.Calibration:
    """The version, as it predicts the rows of a campaign; else the nominal robot."""
    return (job.calibration if campaign is None else job.applied_to(campaign)) or core_model.Calibration.nominal(
        job.robot
    )


def _criteria(commanded: Calibration, rows: Observations, asked: Any) -> dict[str, Any]:
    return core_evaluate.criteria(core_evaluate.Trial.from_observations(commanded.predict(rows), rows), asked)


def _flattering(fitted: int, rows: int) -> list[FindingDocument]:
    if not fitted:
        return []
    said = (
        f"The version was fitted to {fitted} of these {rows} rows, in whatever file they came: their errors are smaller than "
        "elsewhere, and count as no number of today. Measure some poses that are only checked."
    )
    return [FindingDocument.make("rows_fitted", said)]


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Evaluate some of the rows, or see which criteria all of them support."""
    options: EvaluateOptions = job.options
    calibration = _calibration(job)
    found.count_fitted_rows(*job.campaigns.values())
    for campaign, rows in job.campaigns.items():
        with found.noting_refusals():
            if options.metrics == "errors":
                core_evaluate.evaluate(
                    job.applied_to(campaign) or calibration,
                    core_identify.thin_poses(rows, MOST_CHECKED),
                    options.refit,
                    None,
                )
                continue
            refused = _criteria(calibration.nominal_in_wanted_frames(), rows, options.criteria)["refused"]
            found.missing += [Lack(f"{one['symbol']} of {campaign}", one["message"], REMEDY) for one in refused]


def _iso9283(job: JobInput, calibration: Calibration, progress: Progress) -> JobOutput:
    """Criteria of every campaign; commanded is where the nominal chain in the version's wanted frames says."""
    commanded, reports = calibration.nominal_in_wanted_frames(), {}
    for number, (campaign, rows) in enumerate(job.campaigns.items()):
        progress(number / len(job.campaigns), f"campaign {number + 1} of {len(job.campaigns)}")
        reports[campaign] = _criteria(commanded, rows, job.options.criteria)
    return JobOutput({"version_id": job.version_id, "standard": "ISO 9283:1998", "iso9283": reports})


KIND = JobKind(EVALUATE, run, check, preview_job=preview_job)
