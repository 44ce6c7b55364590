"""Job kind ``identify``: observations into a new parameter version."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING, Any

from core.errors import OptionError
from service.jobs.identify_pictures import pictures, workspace_picture
from service.jobs.kind import JobInput, JobKind, JobOutput, Progress, VersionContent
from service.jobs.setups import Setups
from service.jobs.sheets import OPTION, bar_lengths, check_option, doubts
from service.jobs.wire import plain, version_limits

if TYPE_CHECKING:
    from core.identify import IdentifyOptions, Prior

START, LIMITS = "start", "limits"


def check(options: dict[str, Any]) -> None:
    """Refuse options that identify does not have.

    Raises:
        OptionError: one that does not exist or cannot be.

    """
    _options(options).make_effects()
    check_option(options.get(OPTION))
    version_limits(options.get(LIMITS))


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Identify the robot from all campaigns together."""
    from core.identify import Folds, identify  # compiled kernels: only the worker needs them
    from core.observations import Observations
    from service.campaigns.store import numbered

    options = _options(job.options)
    setups = Setups(options.refit, job.devices)
    named = [*job.campaigns.items(), *(job.validation.items() if isinstance(job.validation, dict) else ())]
    remarks = doubts(job.robot, named, job.devices, job.options.get(OPTION)) + bar_lengths(job.robot, named)
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
        found.calibration.to_document(), report, covariance, version_limits(job.options.get(LIMITS))
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

    from core.identify import Prior

    known = job.covariance or {}
    return Prior(tuple(known["names"]), np.array(known["matrix"])) if known.get("names") else None


def _options(options: dict[str, Any]) -> IdentifyOptions:
    from core.identify import IdentifyOptions

    own = {key: value for key, value in options.items() if key not in (START, LIMITS, OPTION)}
    try:
        return IdentifyOptions.from_document(own)
    except TypeError as error:
        raise OptionError(f"The options cannot be read: {error}.") from error


IDENTIFY = JobKind("identify", check, run, version_option=START)
