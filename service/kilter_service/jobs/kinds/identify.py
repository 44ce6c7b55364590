"""Job kind ``identify``: observations into a new parameter version."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING, Any

from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.jobs.identify_pictures import pictures, workspace_picture
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, Progress, VersionContent
from kilter_service.jobs.plain import plain
from kilter_service.jobs.setups import Setups
from kilter_service.jobs.sheets import bar_lengths, doubts

if TYPE_CHECKING:
    from kilter_core.identify import IdentifyOptions as Asked
    from kilter_core.identify import Prior

NOT_OF_THE_CORE = {"start", "limits", "sheet_order"}


def check(options: IdentifyOptions) -> None:
    """Refuse options that do not go together.

    Raises:
        OptionError: a method without what another option needs, effects at a level without them, ...

    """
    _core(options).make_effects()


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Identify the robot from all campaigns together."""
    from kilter_core.identify import Folds, identify  # compiled kernels: only the worker needs them
    from kilter_core.observations import Observations
    from kilter_service.campaigns.store import numbered

    options = _core(job.options)
    setups = Setups(options.refit, job.devices)
    named = [*job.campaigns.items(), *(job.validation.items() if isinstance(job.validation, dict) else ())]
    remarks = doubts(job.robot, named, job.devices, job.options.sheet_order) + bar_lengths(job.robot, named)
    parts = numbered(setups.marked(named))
    validation: Observations | float | Folds | None
    if isinstance(job.validation, dict):
        train = Observations.concatenate(parts[: len(job.campaigns)])
        validation = Observations.concatenate(parts[len(job.campaigns) :])
    else:
        train = Observations.concatenate(parts)
        validation = Folds(job.validation) if isinstance(job.validation, int) else job.validation
    found = identify(job.robot, train, validation, options, job.calibration, progress, _prior(job))
    report = found.to_document()
    report["base_refitted"] = setups.named(report["base_refitted"])
    counts = {name: len(rows) for name, rows in job.campaigns.items()}
    report["set_aside"] = _by_campaign(report["set_aside"], counts)
    warning = setups.warning(report["base_refitted"])
    report["warnings"] += [*([] if warning is None else [warning]), *remarks]
    covariance = found.predictive.to_document()
    content = VersionContent(
        found.calibration.to_document(), report, covariance, job.options.limits or CorrectionLimits()
    )
    drawn = pictures(found, report, job) | workspace_picture(found, train, options.seed)
    return JobOutput({**report, "figures": plain(drawn)}, content)


def _by_campaign(rows: list[dict[str, Any]], counts: dict[str, int]) -> list[dict[str, Any]]:
    """Rows of all campaigns together, as rows of each, counted from 1."""
    out, names = [], list(counts)
    starts = [sum(list(counts.values())[:k]) for k in range(len(names))]
    for one in rows:
        k = bisect_right(starts, one["row"]) - 1
        out.append({"campaign": names[k], **one, "row": one["row"] - starts[k] + 1})
    return out


def _prior(job: JobInput) -> Prior | None:
    """What the start knows of its parameters, for the methods that continue from it."""
    import numpy as np

    from kilter_core.identify import Prior

    known = job.covariance or {}
    return Prior(tuple(known["names"]), np.array(known["matrix"])) if known.get("names") else None


def _core(options: IdentifyOptions) -> Asked:
    """What was asked, as the core has it: whatever was not keeps the core's default."""
    from kilter_core.identify import IdentifyOptions as Asked

    return Asked.from_document(options.model_dump(mode="json", exclude=NOT_OF_THE_CORE))


IDENTIFY = JobKind("identify", IdentifyOptions, check, run, version_option="start")
