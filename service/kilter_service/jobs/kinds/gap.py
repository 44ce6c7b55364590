"""Job kind ``gap``: where the model is wrong, what is missing, and how sure that is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from kilter_core.errors import CancelledError
from kilter_core.observations import Observations
from kilter_core.parameters import display_unit_and_scale
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.contract.fits import metrics_with_earlier_names
from kilter_service.contract.gap_details import Detectable, Untestable
from kilter_service.contract.jobs.check import Testability
from kilter_service.contract.jobs.gap import GAP, GapOptions
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_gap, core_motion, core_observations
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.wire import to_metres
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Lack, Progress, VersionContent
from kilter_service.jobs.plotly_figures.gap import gap_figures
from kilter_service.jobs.setups import by_campaign, to_json_types
from kilter_service.jobs.torque_inputs import (
    Pose,
    as_session,
    poses_document,
    refuse_effects_of_torques,
    search_torques,
)
from kilter_service.versions.store import HELD_OUT

if TYPE_CHECKING:
    from kilter_core.gap import GapCheck, GapReport, KnownType

T = TypeVar("T")

LOOK_S = 0.25


def cancellable(compute: Callable[[Progress], T], progress: Progress) -> T:
    """Run ``compute(progress)`` in a thread and report its progress several times a second.

    When the job is cancelled this raises at once; the thread ends when it reports progress the next time.

    Raises:
        CancelledError: the job was cancelled. Whatever ``compute`` raises.

    """
    work = _Work(compute)
    thread = threading.Thread(target=work, name="cancellable", daemon=True)
    thread.start()
    try:
        running = True
        while running:
            thread.join(LOOK_S)
            running = thread.is_alive()
            progress(*work.latest)
    except BaseException:
        work.stop.set()
        raise
    return work.outcome()


class _Work(Generic[T]):
    """The computation, how far it is, and how it ended."""

    def __init__(self, compute: Callable[[Progress], T]) -> None:
        self.stop = threading.Event()
        self.latest = (0.0, "starting")
        self._compute = compute
        self._done: list[T] = []
        self._error: BaseException | None = None

    def __call__(self) -> None:
        try:
            self._done.append(self._compute(self._report))
        except BaseException as error:  # raised again where it is waited for
            self._error = error

    def outcome(self) -> T:
        if self._error is not None:
            raise self._error
        return self._done[0]

    def _report(self, fraction: float, stage: str) -> None:
        self.latest = (fraction, stage)
        if self.stop.is_set():
            raise CancelledError("The job was cancelled.")


NOT_OF_THE_CORE = {"start", "limits", "prior", "masses_from"}


def check(options: GapOptions) -> None:
    """Refuse what the core would.

    Raises:
        OptionError: an effect that is not searched for, or an option of one that the gap search chooses itself.

    """
    core_gap.joints_by_effect(core_motion.split_effects(_core(options).effects)[1])


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Search for the gap in the campaigns; a cancelled search is left at once."""
    return cancellable(lambda report: _search(job, report), progress)


def _search(job: JobInput, progress: Progress) -> JobOutput:
    """Search all campaigns together; the version made holds the named effects and the geometry fitted with them."""
    options = _core(job.options)
    rows, validation, confirmation = _rows(job)
    if core_observations.is_log(rows):
        apart = [one for one in (validation, confirmation) if isinstance(one, Observations)]
        return search_torques(job, rows, apart, progress)
    refuse_effects_of_torques(options.effects)
    progress(0.0, "fitting the geometry")
    train, held = core_gap.split_held_out_rows(rows, validation, options.seed)
    known = _of_type(job, train)
    start = job.start if known is None else known.start
    report = core_gap.find_gap(job.robot, rows, options, start, validation, progress, confirmation)
    if known is not None:
        report = replace(report, warnings=(*known.warnings(), *report.warnings))
    share = core_gap.held_out_share(rows, None) if validation is None and held is not None else None
    found = report.to_document()
    aside = _set_aside(job, found.pop("set_aside"), found.pop("held_aside"))
    result = to_json_types(
        {
            **found,
            "set_aside": aside,
            "figures": gap_figures(found),
            "next_poses_csv": _file(job, found["next_poses"]),
            "prior": None if known is None else known.to_document(),
            "start": job.version_id,
            "version_id": None,
        }
    )
    progress(0.98, "errors of the new version")
    version = _version(job, report, train, held, share, {**found, "set_aside": aside})
    return JobOutput(result, replace(version, report={**version.report, "prior": result["prior"]}))


def _of_type(job: JobInput, rows: Observations) -> KnownType | None:
    """The prior of the type, judged by the rows that are searched; None where it was not asked for."""
    if job.options.prior is None:
        return None
    return core_gap.known_type(job.robot, rows, _core(job.options), job.start, job.fleet)


def _set_aside(
    job: JobInput, searched: Sequence[dict[str, Any]], held: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Rows of the campaigns that the search let go; what was held out is of other campaigns where these were named."""
    counts = {name: len(rows) for name, rows in job.campaigns.items()}
    others = job.validation if isinstance(job.validation, dict) else job.campaigns
    apart = by_campaign(held, {name: len(rows) for name, rows in others.items()})
    return [*by_campaign(searched, counts), *({**one, "held_out": True} for one in apart)]


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Say what would be searched and held out, and which effects these rows can test."""
    options = _core(job.options)
    with found.noting_refusals():
        rows, validation, confirmation = _rows(job)
        found.count_fitted_rows(rows)
        if core_observations.is_log(rows):
            return
        train, held = core_gap.split_held_out_rows(rows, validation, options.seed)
        known = _of_type(job, train)
        start = job.start if known is None else known.start
        if isinstance(validation, Observations):
            found.hold("campaigns", validation)
        elif held is not None:
            found.hold("unasked" if validation is None else "fraction", held)
        found.search = core_gap.check_gap(job.robot, rows, options, start, validation, confirmation)
        found.seconds = found.search.seconds
        if found.search.poses < found.search.of:
            found.limited.append(
                f"What can be tested was judged on {found.search.poses} of {found.search.of} poses, evenly chosen; amplitudes "
                "are those that all of them would show."
            )
        found.missing += [Lack(_label(u.id, u.joints), u.reason, u.remedy) for u in found.search.not_testable]


def _label(effect: str, joints: tuple[int, ...] | None) -> str:
    return effect if joints is None else f"{effect} j{','.join(str(j + 1) for j in joints)}"


def _file(job: JobInput, poses: list[dict[str, Any]]) -> str | None:
    """The poses to measure next as a file, None without any."""
    scale = core_gap.wire_scale(job.robot)
    made = [
        Pose(
            q=np.array(row["q_deg"]) / scale,
            payload_kg=row["payload_kg"],
            payload_com=_metres(row.get("payload_com_mm")),
            direction=None if row["direction"] is None else tuple(row["direction"]),
        )
        for row in poses
    ]
    return str(poses_document(job.robot, made)["csv"]) if made else None


def _metres(place_mm: Sequence[float] | None) -> tuple[float, float, float] | None:
    if place_mm is None:
        return None
    x, y, z = (to_metres(value) for value in place_mm)
    return x, y, z


def _rows(job: JobInput) -> tuple[Observations, Observations | float | None, Observations | None]:
    """Rows to search, what to hold out, and the confirmation, poses and sessions numbered apart."""
    job.refuse_rows_of_start()
    held = job.validation if isinstance(job.validation, dict) else {}
    given = [*job.campaigns.values(), *held.values(), *job.confirmation.values()]
    logs = all(map(core_observations.is_log, given))
    parts = iter(renumber_poses_and_sessions(map(as_session, given) if job.options.refit or logs else given))
    join = core_motion.join_logs if logs else Observations.concatenate
    groups = [[next(parts) for _ in campaigns] for campaigns in (job.campaigns, held, job.confirmation)]
    rows, others, confirmation = (join(group) if group else None for group in groups)
    assert rows is not None
    validation = others if others is not None else job.validation
    assert validation is None or isinstance(validation, Observations | float)
    return rows, validation, confirmation


def _version(
    job: JobInput,
    report: GapReport,
    train: Observations,
    held: Observations | None,
    share: float | None,
    found: Mapping[str, Any],
) -> VersionContent:
    """What an identification stores of its fit, of the search's last one; ``found`` is its document.

    ``share`` of the poses was held out by itself.
    """
    stored = report.stored
    document = {
        "metrics": metrics_with_earlier_names(stored.metrics(train, held, report.spikes)),
        "parameters": stored.parameters(),
        "null_directions": found["null_directions"],
        "noise_mm": report.gap.get("noise_mm"),
        "noise_source": report.noise["source"],
        "load_model": stored.load_model(),
        "warnings": list(report.warnings),
        "set_aside": list(found["set_aside"]),
        "reference": stored.reference(),
        HELD_OUT: share,
    }
    limits = job.options.limits or CorrectionLimits()
    return VersionContent(
        stored.calibration.to_document(), to_json_types(document), to_json_types(stored.covariance()), limits
    )


def _core(options: GapOptions) -> core_gap.GapOptions:
    """What was asked, as the core has it: whatever was not keeps the core's default."""
    return core_gap.GapOptions.from_document(options.model_dump(mode="json", exclude=NOT_OF_THE_CORE))


def describe_preview(found: JobPreview) -> dict[str, Any]:
    """Say what a search could test."""
    return {"testability": None if found.search is None else _testability(found.search)}


def _testability(found: GapCheck) -> Testability:
    testable = []
    for one in found.testable:
        unit, scale = display_unit_and_scale(one.unit)
        testable.append(copy_fields(Detectable, one, unit=unit, smallest_detectable=one.smallest * scale))
    untestable = [
        copy_fields(
            Untestable,
            u,
            joints=None if u.joints is None else [j + 1 for j in u.joints],
            missing=u.missing or None,
        )
        for u in found.not_testable
    ]
    return Testability(testable=testable, not_testable=untestable)


KIND = JobKind(GAP, run, check, preview_job=preview_job, describe_preview=describe_preview)
