"""One run of a job: load, compute, store. It may happen again after a crash, and stores its outcome once."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from kilter_core.errors import CancelledError, CoreError, FindingDocument
from kilter_core.observations import evenly
from kilter_service.contract.jobs.drift import DriftResult
from kilter_service.contract.today import ControlChart, DriftHistory
from kilter_service.contract.wording import as_written
from kilter_service.ground.caller import on_behalf
from kilter_service.ground.core import core_effects, core_identify, core_model
from kilter_service.ground.db import Database, DatabaseAwayError, Session
from kilter_service.ground.db.failures import Failing, in_words, log_failure
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.memory import return_freed_memory
from kilter_service.ground.webhook import Webhook
from kilter_service.ground.wire import to_mm
from kilter_service.jobs import store
from kilter_service.jobs.fan_out import FanOut, fan_out
from kilter_service.jobs.fleet import store as fleet
from kilter_service.jobs.fleet.service import compare_with_previous
from kilter_service.jobs.kind import JobInput, JobOutput
from kilter_service.jobs.records import JobRecord, UsedRecord
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.setups import LAID_AGAIN, to_json_types, with_load_warning
from kilter_service.jobs.work import store as work_store
from kilter_service.jobs.work.store import Claim
from kilter_service.versions import ability
from kilter_service.versions.ability import CODE as CANNOT_CORRECT
from kilter_service.versions.ability import WORKSPACE, suggest_limits
from kilter_service.versions.drift import service as drift
from kilter_service.versions.drift import store as drifts
from kilter_service.versions.drift.wire import height
from kilter_service.versions.objections import objections_from_report
from kilter_service.versions.predictions import at_pose
from kilter_service.web import logs

if TYPE_CHECKING:
    from kilter_core.errors import Finding
    from kilter_core.observations import Observations
    from kilter_service.jobs.kind import JobInput, JobOutput


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
        change = core_identify.set_up_change(calibration, list(parts.values()))
        if change is not None:
            said = _sentence(change, words, ", ".join(job.names.get(c, c) for c in campaigns))
            about = {"campaigns": list(campaigns), "refit": list(change.which), "moved_mm": to_mm(change.moved)}
            return output.with_warnings(FindingDocument.make("set_up_changed", said, **about))
    return output


def _sessions(rows: Observations) -> dict[int, Observations]:
    """The rows of each session, in ascending order; all of them where none is stated."""
    if rows.session is None:
        return {0: rows}
    return {int(code): rows.select(rows.session == code) for code in np.unique(rows.session)}


def _sentence(change: core_identify.SetUpChange, part: str, names: str) -> str:
    which = " and ".join(change.which)
    apart, left = f"{to_mm(change.moved):.2g} mm", f"{to_mm(change.apart):.2g} mm"
    verb, own = ("lies", f"a {which}") if len(change.which) == 1 else ("lie", which)
    return (
        f"{names}: the {which} {verb} {apart} apart between {part}s. With {own} for each {part} {left} are left, "
        f"{to_mm(change.together):.2g} mm with one for all. Identify with --refit {','.join(change.which)}."
    )


def with_clock_warnings(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version which laws of time were not applied to which campaigns: those held out, or all of a check."""
    held = {c: rows for c, rows in job.rows_by_campaign.items() if c not in job.campaigns}
    if output.version is not None and held:
        made = core_model.Calibration.from_document(job.robot, output.version.calibration)
        output = output.with_warnings(*clock_remarks(made, held, job.names))
    anew = {c: rows for c, rows in job.campaigns.items() if c not in job.made_from}
    continued = output.version is not None and len(anew) < len(job.campaigns)
    if job.calibration is None or continued:
        return output
    return output.with_warnings(*clock_remarks(job.calibration, anew, job.names))


def clock_remarks(
    calibration: core_model.Calibration, rows: dict[str, Observations], names: dict[str, str]
) -> list[FindingDocument]:
    """Return which laws of a version each campaign does without, the campaigns of one reason together."""
    found: dict[tuple[str, ...], tuple[Finding, list[str]]] = {}
    for campaign, seen in rows.items():
        for one in core_effects.carried_findings(calibration.model.effects, seen):
            reason = (one.code, one.only_said["laws"], one.only_said["steps"])
            found.setdefault(reason, (one, []))[1].append(campaign)
    return [
        FindingDocument.make(
            one.code,
            f"{', '.join(names.get(c, c) for c in campaigns)}: {one.message(core_effects.SENTENCES)}",
            **one.context,
            campaigns=campaigns,
        )
        for one, campaigns in found.values()
    ]


CAUSES = {"board_scale_differs", "camera_moved"}  # that wider limits or zeros entered in the controller do not mend
MOST_POSES = 500  # looked at, evenly chosen


def with_ability_warning(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that it refuses too many poses, with what helps; activation looks again."""
    version = output.version
    if version is None or not job.campaigns:
        return output
    if any(one.get("code") in CAUSES for one in version.report.get("warnings") or ()):
        return output
    q = np.concatenate([rows.q for rows in job.campaigns.values()])
    q = q[evenly(len(q), MOST_POSES)]
    calibration = core_model.Calibration.from_document(job.robot, version.calibration)
    try:
        found = at_pose.at_poses(calibration, None, version.limits, q)
        objection = ability.of_poses(calibration, found, version.limits)
    except (CoreError, ArithmeticError, ValueError):  # activation says so
        return output
    return output if objection is None else output.with_warnings(FindingDocument.make(**objection.model_dump()))


NEEDED = "direction"


def with_direction_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that directions were derived, where the job looked at directions."""
    derived = [campaign for campaign, rows in job.rows_by_campaign.items() if rows.directions_derived]
    if not derived or not (kind == "gap" or _follows_directions(output, job)):
        return output
    names = ", ".join(job.names.get(campaign, campaign) for campaign in derived)
    said = (
        f"{names}: directions were derived from the order of the rows. State dir1 ... where another order was driven."
    )
    return output.with_warnings(FindingDocument.make("directions_derived", said, campaigns=derived))


def _follows_directions(output: JobOutput, job: JobInput) -> bool:
    """Whether an effect of the version made, else of the version used, depends on the side a joint came from."""
    if output.version is None:
        return job.calibration is not None and NEEDED in job.calibration.model.needs
    return NEEDED in core_model.Calibration.from_document(job.robot, output.version.calibration).model.needs


def with_limits(output: JobOutput, job: JobInput) -> JobOutput:
    """Set the limits of the version, and say in its report what it does within them."""
    version = output.version
    if version is None:
        return output
    calibration = core_model.Calibration.from_document(job.robot, version.calibration)
    known = core_identify.Predictive.from_document(version.covariance, version.report)
    limits, workspace = suggest_limits(calibration, known, version.limits)
    report = {**version.report, WORKSPACE: to_json_types(workspace)}
    return replace(output, version=replace(version, limits=limits, report=report))


SAID = ("version_id", "verdict", "sentence", "remedy", "p_value", "false_alarm")


def verdict_message(
    job: str, robot: str, used: Sequence[UsedRecord], result: Mapping[str, Any]
) -> dict[str, Any] | None:
    """Return what to post; None: all is well."""
    if result.get("verdict") in (None, "ok"):
        return None
    causes = [{"name": one["name"], "words": one["words"]} for one in result.get("causes") or []]
    return {
        "event": "check",
        "job_id": job,
        "robot": robot,
        "campaigns": [one.id for one in used],
        "at": utc_now().isoformat(),
        "headline": as_written(DriftResult, dict(result)).headline,
        **{name: result.get(name) for name in SAID},
        "causes": causes,
    }


def with_doubts(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to the version what its own report says against it, but for limits that are too small: its rows say that."""
    version = output.version
    if version is None:
        return output
    against = [one for one in objections_from_report(version.report, version.limits) if one.code != CANNOT_CORRECT]
    doubts = [core_model.Doubt.everywhere(job.robot.n_joints, 0.0, one.message).to_document() for one in against]
    if not doubts:
        return output
    document = {**version.calibration, "doubts": [*version.calibration.get("doubts", ()), *doubts]}
    return replace(output, version=replace(version, calibration=document))


def with_certificate_warnings(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version what the certificates of the instruments have against the campaigns."""
    return output.with_warnings(
        *(
            FindingDocument.make(one.code, f"{job.names.get(campaign, campaign)}: {one.message}", campaigns=[campaign])
            for campaign, remarks in job.certificates.items()
            for one in remarks
        )
    )


log = logging.getLogger("kilter.worker")

T = TypeVar("T")

REPORT_S = 0.2  # progress is stored, and cancellation looked for, at most this often
ROUTE = "kilterd worker"  # of entries of the audit
AGAIN_S = 1.0  # between two attempts to reach the database


@dataclass(frozen=True)
class Outcome:
    """How a run ended: what the kind made and from which campaigns, or the code and the sentence of its failure.

    ``judged`` is how a version of a fleet job compares with the one before.
    """

    output: JobOutput | None = None
    used: tuple[UsedRecord, ...] = ()
    error: tuple[str, str] | None = None
    judged: dict[str, Any] | None = None


class Runner:
    """Runs claimed jobs."""

    def __init__(
        self,
        database: Database,
        stop: threading.Event | None = None,
        each: FanOut | None = None,
        webhook: Webhook | None = None,
    ) -> None:
        self._database, self._webhook = database, webhook
        self._creeping = None if webhook is None else CreepingPosts(database, webhook)
        self._each = each or fan_out(1)
        self._stop = stop or threading.Event()

    def run(self, claim: Claim) -> None:
        """Compute a job and store its outcome, unless the claim has ended meanwhile."""
        try:
            job = self._patiently(lambda: self._record(claim))
            with (
                logs.about(request_id=job.asked.request_id, job_id=job.id, robot=job.robot),
                logs.job(job.kind, job.id, job.robot, job.asked.traceparent),
            ):
                began = time.monotonic()
                outcome = self._compute(claim)
                self._patiently(lambda: self._finish(claim, outcome))
                self._post_verdict(job, outcome)
                state = "failed" if outcome.error else "succeeded"
                log.info("%s %s after %.1f s", job.kind, state, time.monotonic() - began)
        except CancelledError:
            log.info("job %s was cancelled or given to another worker", claim.job_id)
        finally:
            return_freed_memory()

    def _compute(self, claim: Claim) -> Outcome:
        report = ProgressReporter(self._database, claim)
        try:
            report(0.0, "loading", now=True)
            kind, job, used = self._patiently(lambda: self._load_claimed_job(claim))
            output = with_load_warning(kind, get_job_kind(kind).run(replace(job, each=self._each), report), job)
            output = with_direction_warning(kind, with_certificate_warnings(output, job), job)
            output = with_set_up_warning(kind, with_clock_warnings(output, job), job)
            output = with_doubts(with_ability_warning(with_limits(output, job), job), job)
            report(1.0, "storing", now=True)
            judged = self._patiently(lambda: compare_with_previous(self._database, claim.job_id, output.version, used))
        except (CancelledError, DatabaseAwayError):
            raise
        except CoreError as error:
            return Outcome(error=(error.code, error.message))
        except Exception as error:
            log_failure(log, error, "job %s failed", claim.job_id)
            if known := in_words(error):  # the disk is full, say
                return Outcome(error=(known.code, known.message))
            message = f"Kilter failed. The worker's log has the cause under job {claim.job_id}."
            return Outcome(error=("internal_error", message))
        return Outcome(output, used, judged=judged)

    def _post_verdict(self, job: JobRecord, outcome: Outcome) -> None:
        """Post a verdict that is not well to the operator's address, where there is one, and whether the robot creeps."""
        if self._webhook is None or self._creeping is None or job.kind != "drift" or outcome.output is None:
            return
        message = verdict_message(job.id, job.robot, outcome.used, outcome.output.result)
        if message is not None:
            self._webhook.enqueue_message(job.id, message)
        self._creeping.post_changes_after_check(job.robot)

    def _record(self, claim: Claim) -> JobRecord:
        with self._database.reading() as session:
            return store.get(session, claim.job_id)

    def _load_claimed_job(self, claim: Claim) -> tuple[str, JobInput, tuple[UsedRecord, ...]]:
        with self._database.reading() as session:
            kind, job = store.get(session, claim.job_id).kind, store.load(session, claim.job_id)
            return kind, job, tuple(store.campaigns_used_by_job(session, claim.job_id))

    def _finish(self, claim: Claim, outcome: Outcome) -> None:
        try:
            with self._audit_on_behalf(claim, outcome), self._database.transaction() as session:
                _store(session, claim, outcome)
        except DatabaseAwayError:
            raise
        except Exception as error:
            log_failure(log, error, "the result of job %s could not be stored", claim.job_id)
            message = f"The result could not be stored. The worker's log has the cause under job {claim.job_id}."
            with self._database.transaction() as session:
                _store(session, claim, Outcome(error=("internal_error", message)))

    def _audit_on_behalf(self, claim: Claim, outcome: Outcome) -> AbstractContextManager[None]:
        """Let the audit name who asked for a version that is stored, or a campaign that is retired; else no robot changes."""
        stores = outcome.output is not None and outcome.output.version is not None
        if not stores and outcome.error is None:
            return nullcontext()
        with self._database.reading() as session:
            kind = store.get(session, claim.job_id).kind
            if not stores and outcome.error is not None and not work_store.retires(kind, outcome.error[0]):
                return nullcontext()
            return on_behalf(store.job_requester(session, claim.job_id), ROUTE, {"job": claim.job_id})

    def _patiently(self, ask: Callable[[], T]) -> T:
        """Ask again while the database is away: hours of computing do not depend on its restart."""
        while True:
            try:
                return ask()
            except DatabaseAwayError:
                if self._stop.wait(AGAIN_S):
                    raise


def _store(session: Session, claim: Claim, outcome: Outcome) -> None:
    if not work_store.holds(session, claim):
        log.warning("job %s is no longer this worker's: what it computed is dropped", claim.job_id)
    elif outcome.error is not None:
        code, message = outcome.error
        store.fail(
            session, claim.job_id, code, work_store.retire_refused_campaign(session, claim.job_id, code, message)
        )
    elif outcome.output is not None:
        version = outcome.output.version
        said = [] if version is None else objections_from_report(version.report, version.limits)
        store.succeed(session, claim.job_id, outcome.output.result, version, outcome.used, said)
        if outcome.judged is not None:
            fleet.judge(session, claim.job_id, outcome.judged)


class ProgressReporter:
    """The progress callback of one run."""

    def __init__(self, database: Database, claim: Claim) -> None:
        self._database = database
        self._claim = claim
        self._next = 0.0

    def __call__(self, fraction: float, stage: str, *, now: bool = False) -> None:
        """Store the progress; while the database is away nothing is stored and the computation goes on.

        Raises:
            CancelledError: the job was cancelled, or another worker has it.

        """
        time_s = time.monotonic()
        if time_s < self._next and not now:
            return
        self._next = time_s + REPORT_S
        try:
            with self._database.noting() as session:
                held = work_store.advance(session, self._claim, fraction, stage)
        except DatabaseAwayError:
            self._next = time.monotonic() + AGAIN_S
            return
        if not held:
            raise CancelledError(f"Job {self._claim.job_id} was cancelled.")


EVERY_S = 60.0  # how often robots that creep are looked at: a repair or another version ends it without a check
BEGAN, ENDED = "creeping_began", "creeping_ended"
REMEDY = (
    "`kilter watch drift {robot}` shows the sums. Check with more poses, which name the cause; then repair the arm, "
    "re-zero what "
    "moved (kilter watch rezero), or identify it anew."
)


class CreepingPosts:
    """Looks at the sums of a robot after each of its checks, and at those of robots that creep every minute.

    What was told stands in the database, so that it is told once by any number of workers and after any restart.
    """

    def __init__(self, database: Database, webhook: Webhook, clock: Callable[[], float] = time.monotonic) -> None:
        self._database, self._webhook, self._clock = database, webhook, clock
        self._next_s = clock()
        self._failing = Failing(logging.getLogger("kilter.worker"), "whether robots creep could not be told")

    def post_changes_if_due(self) -> None:
        """See whether robots that were told to creep still do, when it is time."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + EVERY_S
        self._trying(self._post_changes)

    def post_changes_after_check(self, robot: str) -> None:
        """See what a check has changed."""
        self._trying(lambda: self._post_changes_of_robot(robot))

    def _post_changes(self) -> None:
        with self._database.reading() as session:
            told = drifts.told_creeping(session)
        for robot in told:
            self._post_changes_of_robot(robot)

    def _trying(self, see: Callable[[], None]) -> None:
        try:
            see()
        except Exception as error:  # nothing of this holds up a job or ends the worker
            self._failing.report_failure(error)
        else:
            self._failing.report_success()

    def _post_changes_of_robot(self, robot: str) -> None:
        found = drift.of_robot(self._database, robot)
        if found.state == "creeping" and found.last is not None:
            with self._database.transaction() as session:
                began = drifts.note_creeping(session, robot, found.last.job_id)
            if began:
                self._webhook.enqueue_message(f"{found.last.job_id}-{BEGAN}", _message(BEGAN, found.last.job_id, found))
            return
        with self._database.transaction() as session:
            job = drifts.forget_creeping(session, robot)
        if job is not None:
            self._webhook.enqueue_message(f"{job}-{ENDED}", _message(ENDED, job, found))


def _message(event: str, job: str, found: DriftHistory) -> dict[str, Any]:
    alarmed: list[ControlChart] = sorted((one for one in found.charts if one.alarms), key=height, reverse=True)
    alarmed = alarmed if event == BEGAN else []
    since = alarmed[0].since if alarmed else None
    return {
        "event": event,
        "job_id": job,
        "robot": found.robot,
        "version_id": found.version_id,
        "at": utc_now().isoformat(),
        "state": found.state,
        "sentence": found.sentence,
        "remedy": REMEDY.format(robot=found.robot) if event == BEGAN else "",
        "since": None if since is None else since.isoformat(),
        "causes": [{"name": one.name, "words": one.words} for one in alarmed],
    }
