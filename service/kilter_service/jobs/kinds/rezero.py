"""Job kind ``rezero``: a version of the one or few parameters that moved, by a few poses measured again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import FindingDocument
from kilter_service.contract.jobs.rezero import REZERO, RezeroOptions
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_evaluate, core_identify, core_watch
from kilter_service.jobs.budgets import uncertainty_budget
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Progress, VersionContent
from kilter_service.jobs.kinds.drift import applied_calibration, comparable_rows, get_predictive
from kilter_service.jobs.setups import build_check_conditions, counted_noise, to_json_types
from kilter_service.versions.drift import wire
from kilter_service.versions.store import REZEROED

if TYPE_CHECKING:
    from kilter_core.watch import Rezeroed

STAGES = ("n", "left_out", "nominal", "registration_only", "identified")
OF_THE_START = ("metrics", "warnings", "figures", "set_aside", "influence", "workspace", "parameters", REZEROED)


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Change in the version named, else the active one, what the rows of the campaign say."""
    progress(0.0, "comparing")
    found = _estimate_rezero(job)
    progress(0.5, "predicting")
    options: RezeroOptions = job.options
    ((campaign, rows),) = job.campaigns.items()
    report = _report(job, found)
    said = wire.rezero_sentence(found, job.version_id or "", len(rows), job.names.get(campaign, campaign))
    remark = FindingDocument.make(REZEROED, said, campaigns=[campaign])
    report |= {"warnings": [remark], REZEROED: {"campaign": campaign, "start": job.version_id, "names": found.names}}
    own = [row for row in report["parameters"] if row["name"] in found.names]
    result = {
        "sentence": said,
        "start": job.version_id,
        "causes": [wire.cause_document(one) for one in found.changed_causes],
        "parameters": own,
        "p_before": found.before.p_value,
        "p_after": found.after.p_value,
        "metrics": report["metrics"],
        "warnings": [],
    }
    content = VersionContent(
        found.calibration.to_document(),
        to_json_types(report),
        found.known.to_document(),
        options.limits or CorrectionLimits(),
        parent_id=job.version_id,
    )
    return JobOutput(to_json_types(result), content)


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Re-zero, which takes no time, and say only what would be refused."""
    found.count_fitted_rows(*job.campaigns.values())
    with found.noting_refusals():
        _estimate_rezero(job)


def _estimate_rezero(job: JobInput) -> Rezeroed:
    options: RezeroOptions = job.options
    rows, known = comparable_rows(job), get_predictive(job)
    noise = counted_noise(job, known)
    return core_watch.rezero(
        applied_calibration(job),
        rows,
        known,
        options.causes,
        noise=noise,
        new_setup=options.new_setup,
        fitted_c=job.fit.temperatures_c,
        conditions=build_check_conditions(job, noise),
    )


def _report(job: JobInput, found: Rezeroed) -> dict[str, Any]:
    """The report of the start with the parameters as they are now, and the errors on these rows."""
    start = {key: value for key, value in (job.report or {}).items() if key not in OF_THE_START}
    names = [name for name in found.known.names if name in found.calibration.names]
    sigma = np.sqrt(np.diag(found.known.covariance))[[found.known.names.index(name) for name in names]]
    before = {row["name"]: row for row in (job.report or {}).get("parameters") or []}
    told = np.array([name in found.names or bool(before.get(name, {}).get("identifiable", True)) for name in names])
    ((campaign, rows),) = job.campaigns.items()
    errors = core_evaluate.evaluate(found.calibration, rows, found.before.new_setup, found.known)
    budget = uncertainty_budget(
        found.calibration, found.known, rows, job.instruments.get(campaign), found.before.new_setup
    )
    return start | {
        "parameters": core_identify.build_parameter_rows(found.calibration, names, sigma, told),
        "metrics": {"train": {stage: errors[stage] for stage in STAGES} | {"budget": budget}},
    }


KIND = JobKind(REZERO, run, preview_job=preview_job)
