"""What speaks against activating a version: its own identification, and measurements that it was not fitted to.

It is compared with the nominal robot in frames of its own (registration only) and with the version that is active. Worse is
what `kilter_core.identify.comparison` calls so. Where there is nothing to compare on, a warning says so
and nothing is refused for it.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError, FindingDocument
from kilter_core.types import Floats
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.versions import Comparison, CorrectionLimits, Objection, Rival
from kilter_service.ground.core import core_identify, core_model
from kilter_service.ground.db import Database, Session
from kilter_service.ground.naming import plural
from kilter_service.ground.wire import to_mm
from kilter_service.robots import store as robots
from kilter_service.versions import store, wire
from kilter_service.versions.objections import objections_from_report, of_calibration
from kilter_service.versions.predictions import unfitted_rows
from kilter_service.versions.predictions.unfitted_rows import Archive, Unseen
from kilter_service.versions.store import Training

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations


MOST_POSES = 2000  # compared at most, evenly chosen: one to two seconds

NOTHING = (
    "Not compared: no measured pose is left that neither this version nor the active one was fitted to. Measure some poses "
    "that are only checked (kilter upload --role confirmation) before you rely on it."
)
ONLY_PLAIN = (
    "Version {active}, active now, was fitted to every pose that this one was not: compared with registration only."
)

NOTHING_SINCE = (
    "Not compared with rows that no fit used: there are none from after {since}. Check the arm once the version is active "
    "(kilter check)."
)

_ONE_AT_A_TIME = threading.Lock()  # a comparison holds the rows of a robot


@dataclass(frozen=True)
class Verdict:
    """What was found when ``active`` was the active version of the robot."""

    active: str | None
    objections: tuple[Objection, ...]
    compared: Comparison | None
    warnings: tuple[FindingDocument, ...]


def judge(database: Database, version_id: str) -> Verdict:
    """Compare a version with the active one and with registration only; takes up to some seconds."""
    with _ONE_AT_A_TIME:
        with database.reading() as session:
            row = store.get(session, version_id)
            own = objections_from_report(row.report, CorrectionLimits(**row.limits))
            last = store.active_entry(session, row.robot_id)
            if last is not None and last.version_id == version_id:
                return Verdict(version_id, (), None, ())
            new, active = store.calibration(session, version_id), None if last is None else last.version_id
            cases = _cases(session, row.robot_id, new, store.trainings(session, version_id), active, row.report)
            rival = None if active is None else store.get(session, active).report
        return _verdict(cases, [*own, *of_calibration(new, own)], row.report, rival)


def judge_unstored(
    database: Database,
    robot_id: int,
    calibration: Mapping[str, Any],
    report: Mapping[str, Any],
    limits: CorrectionLimits,
    training: Training,
    active: str | None,
) -> Verdict:
    """Compare what a job has found, before it is stored, with the version ``active`` and with registration only."""
    with database.reading() as session:
        new = core_model.Calibration.from_document(robots.core_robot(session, robot_id), calibration)
        cases = _cases(session, robot_id, new, [training], active, report)
        rival = None if active is None else store.get(session, active).report
    own = objections_from_report(report, limits)
    return _verdict(cases, [*own, *of_calibration(new, own)], report, rival)


def _verdict(cases: Cases, own: list[Objection], report: Mapping[str, Any], rival: Mapping[str, Any] | None) -> Verdict:
    """The verdict of the first case that compares anything; beside it the active version, where that left it out.

    It counts by stored errors of held-out rows, else by the rows that both versions were fitted to. Those of a re-zeroed
    version are not compared: the rows of the other are of the arm as it was before, or after.
    """
    verdicts = (case.verdict(own) for case in cases.unseen)
    verdict = next(verdicts)
    if not (verdict.compared or verdict.objections):
        verdict = next((v for v in verdicts if v.compared), verdict)
    if (
        cases.fitted is None
        or rival is None
        or verdict.active is None
        or store.REZEROED in report
        or store.REZEROED in rival
        or (verdict.compared is not None and verdict.compared.active is not None)
    ):
        return verdict
    objections, remarks = unfitted_rows.compare_with_active(report, rival, verdict.active)
    if not objections and not remarks:
        objections, remarks = cases.fitted.compare_fitted_rows()
    return replace(verdict, objections=(*verdict.objections, *objections), warnings=(*verdict.warnings, *remarks))


@dataclass(frozen=True)
class Part:
    """Errors by pose (P,) m at one set-up of a campaign: of the new version, of registration only, of the active one."""

    campaign: str
    rows: int
    new: Floats
    plain: Floats
    rival: Floats | None


def _cases(
    session: Session,
    robot_id: int,
    new: Calibration,
    trainings: Sequence[Training],
    active: str | None,
    report: Mapping[str, Any],
) -> Cases:
    """The version beside the active one; by itself, for where the active one was fitted to all that is left; and beside it
    on the rows that both were fitted to.
    """
    archive = Archive(session, robot_id)
    reports = [report] if active is None else [report, store.get(session, active).report]
    was = AsItWas.from_repairs_and_reports(session, robot_id, *reports)
    own = frozenset(campaign for training in trainings for campaign, _ in training.campaigns)
    unseen = was.left_out(archive.unfitted_rows(trainings))
    names = {one: campaigns.get(session, one).name for one in unseen.rows}
    alone = Case(new, active, None, unseen, own, since=was.since, names=names)
    if active is None:
        return Cases((alone,))
    both = was.left_out(archive.unfitted_rows([*trainings, *store.trainings(session, active)]))
    rival, rival_own = store.calibration(session, active), store.training_campaign_ids(session, active)
    beside = Case(new, active, rival, both, own, rival_own, was.since, names)
    alone.warn("active_not_compared", ONLY_PLAIN.format(active=active))
    fitted = was.left_out(archive.fitted_by_each([trainings, store.trainings(session, active)]))
    return Cases((beside, alone), replace(beside, unseen=fitted, warnings=[], unpredictable=[]))


@dataclass(frozen=True)
class Cases:
    """What a version is compared on: rows new to it, the best case first, and rows that it and the active one fitted."""

    unseen: tuple[Case, ...]
    fitted: Case | None = None


@dataclass
class Case:
    """A version, its rivals, and the rows that they are compared on: those none of them was fitted to, or all were.

    ``rival`` is the active version, if it may be.

    ``own`` and ``rival_own`` are the campaigns that they were made from; rows ``since`` then show the arm as it is, if that is
    known. ``names`` are those of the campaigns.
    """

    new: Calibration
    active: str | None
    rival: Calibration | None
    unseen: Unseen
    own: frozenset[str]
    rival_own: frozenset[str] = frozenset()
    since: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    warnings: list[FindingDocument] = field(default_factory=list)
    unpredictable: list[Objection] = field(default_factory=list)

    def verdict(self, own: list[Objection]) -> Verdict:
        """Compare, and say what speaks against the version."""
        found = [part for part in self._compare_campaigns() if part is not None]
        own = [*own, *self.unpredictable]
        if not found:
            self.warn("nothing_to_compare", NOTHING_SINCE.format(since=self.since) if self.since else NOTHING)
            return Verdict(self.active, tuple(own), None, tuple(self.warnings))
        new, plain = (
            core_identify.pool_setup_errors([getattr(part, name) for part in found]) for name in ("new", "plain")
        )
        with_rival = [part for part in found if part.rival is not None]
        rival = core_identify.pool_setup_errors([part.rival for part in with_rival if part.rival is not None])
        against_plain = core_identify.Difference.from_paired_errors(new, plain)
        used = sorted({part.campaign for part in found})
        against_rival = (
            core_identify.Difference.from_paired_errors(
                core_identify.pool_setup_errors([part.new for part in with_rival]), rival
            )
            if with_rival
            else None
        )
        compared = Comparison(
            rows=sum(part.rows for part in found),
            poses=len(new),
            campaigns=used,
            campaign_names=[self.campaign_label(one) for one in used],
            mean_mm=to_mm(float(new.mean())),
            registration_only=wire.rival(against_plain, plain),
            active_version=self.active,
            active=None if against_rival is None else wire.rival(against_rival, rival),
        )
        worse = [] if not against_plain.worse else [_objection("registration", compared, compared.registration_only)]
        if against_rival is not None and compared.active is not None and against_rival.worse:
            worse.append(_objection("active", compared, compared.active))
        return Verdict(self.active, (*own, *worse), compared, tuple(self.warnings))

    def compare_fitted_rows(self) -> tuple[list[Objection], list[FindingDocument]]:
        """What rows that both versions were fitted to say: an objection, or a remark with both numbers."""
        found = [part for part in self._compare_campaigns() if part is not None and part.rival is not None]
        if not found:
            return [], []
        new = core_identify.pool_setup_errors([part.new for part in found])
        rival = core_identify.pool_setup_errors([part.rival for part in found if part.rival is not None])
        names = ", ".join(sorted({self.campaign_label(part.campaign) for part in found}))
        message = (
            f"Version {self.active}, active now, and this one were both fitted to {len(new)} poses of {names}: this one "
            f"leaves {to_mm(float(new.mean())):.4g} mm there, version {self.active} {to_mm(float(rival.mean())):.4g} mm."
        )
        if core_identify.Difference.from_paired_errors(new, rival).worse:
            return [Objection(code=unfitted_rows.CODE, message=message + unfitted_rows.REMEDY)], []
        return [], [FindingDocument.make(unfitted_rows.COMPARED, message)]

    def _compare_campaigns(self) -> list[Part | None]:
        for message in self.unseen.left_out.values():
            self.warn("campaign_not_compared", message)
        usable = {c: rows for c, rows in self.unseen.rows.items() if self._usable(c, rows)}
        total = sum(core_identify.count_poses(rows) for rows in usable.values())
        share = min(1.0, MOST_POSES / max(total, 1))
        if share < 1.0:
            self.warn("poses_thinned", f"{MOST_POSES} of {total} poses were compared, evenly chosen.")
        out: list[Part | None] = []
        for campaign, rows in usable.items():
            missing = [] if self.rival is None else core_identify.lacking(self.rival, rows)
            if missing:
                self.warn(
                    "active_not_compared",
                    f"Version {self.active} needs {', '.join(missing)}; {self.campaign_label(campaign)} has none.",
                )
            for setup in core_identify.setups(rows):
                chosen = core_identify.thin_poses(
                    setup, max(core_identify.FEWEST_POSES, round(share * core_identify.count_poses(setup)))
                )
                out.append(self._compare_setup(campaign, chosen, None if missing else self.rival))
        return out

    def _usable(self, campaign: str, rows: Observations) -> bool:
        missing = core_identify.lacking(self.new, rows)
        if rows.position is None and rows.markers is None:
            self.warn(
                "campaign_not_compared",
                f"Campaign {self.campaign_label(campaign)} has no measured position: it was not compared.",
            )
        elif missing:
            lacks = f"Campaign {self.campaign_label(campaign)} lacks {', '.join(missing)}"
            message = f"{lacks}, which this version needs: it was not compared."
            self.warn("campaign_not_compared", message)
        else:
            return True
        return False

    def _compare_setup(self, campaign: str, rows: Observations, rival: core_model.Calibration | None) -> Part | None:
        """The errors at one set-up of a campaign; None, and a warning, when it cannot be compared."""
        if core_identify.count_poses(rows) < core_identify.FEWEST_POSES:
            message = (
                f"{core_identify.count_poses(rows)} poses of campaign {self.campaign_label(campaign)} have a set-up "
                "of their own: "
                f"fewer than {core_identify.FEWEST_POSES} tell nothing."
            )
            self.warn("campaign_not_compared", message)
            return None
        plain = self._errors(core_model.Calibration.nominal(self.new.robot), rows)
        if isinstance(plain, str):
            self.warn("campaign_not_compared", f"Campaign {self.campaign_label(campaign)} was not compared: {plain}")
            return None
        new = self._errors(self.new if campaign in self.own else self.new.for_another_campaign(rows), rows)
        if isinstance(new, str):
            name = self.campaign_label(campaign)
            message = (
                f"No base and tool are found in which it predicts campaign {name} ({new}); the nominal robot does."
            )
            self.unpredictable.append(Objection(code="worse_than_registration", message=message))
            return None
        if rival is not None and campaign not in self.rival_own:
            rival = rival.for_another_campaign(rows)
        others = None if rival is None else self._errors(rival, rows)
        if isinstance(others, str):
            self.warn(
                "active_not_compared",
                f"Version {self.active} cannot predict campaign {self.campaign_label(campaign)}: {others}",
            )
            others = None
        if self._fits_nothing(campaign, rows, [e for e in (new, plain, others) if e is not None]):
            return None
        return Part(campaign, len(rows), new, plain, others)

    def _fits_nothing(self, campaign: str, rows: Observations, errors: Sequence[Floats]) -> bool:
        """Whether no model explains the rows, which then say nothing about any; a warning names them."""
        best = min(float(np.mean(found)) for found in errors)
        said = core_identify.said_of_misfit(self.new.robot, rows, best)
        if said is not None:
            name = self.campaign_label(campaign)
            message = (
                f"Campaign {name} was left out: no model fits it, the best leaves {to_mm(best):.4g} mm. {said} Correct or "
                f"retire it (`kilter measure campaigns retire {campaign}`)."
            )
            self.warn("campaign_fits_no_model", message)
        return said is not None

    @staticmethod
    def _errors(calibration: Calibration, rows: Observations) -> Floats | str:
        """Errors by pose, or why there are none: what a fit of nonsense raises is of many kinds."""
        try:
            with np.errstate(all="ignore"):
                found = core_identify.errors_by_pose(calibration, rows)
        except CoreError as error:
            return error.message
        except (ArithmeticError, ValueError):  # also of linear algebra without a solution
            return "no frames fit"
        return found if np.isfinite(found).all() else "no frames fit"

    def campaign_label(self, campaign: str) -> str:
        """What people call a campaign."""
        return self.names.get(campaign) or campaign

    def warn(self, code: str, message: str) -> None:
        """Say what the comparison leaves out."""
        self.warnings.append(FindingDocument.make(code, message))


def _objection(which: str, compared: Comparison, rival: Rival) -> Objection:
    name = "base and tool alone" if which == "registration" else f"version {compared.active_version}, active now,"
    message = (
        f"On {rival.poses} poses it was not fitted to ({', '.join(compared.campaign_names)}) it leaves "
        f"{rival.mean_mm + rival.larger_by_mm:.4g} mm, {name} {rival.mean_mm:.4g} mm: more by {rival.larger_by_mm:.2g} mm, "
        f"where chance explains {rival.margin_mm:.2g} mm."
    )
    return Objection(code=f"worse_than_{which}", message=message)


@dataclass(frozen=True)
class AsItWas:
    """Ids of such ``campaigns``, and ``since`` when the arm is as it is, in words; empty: as long as it is known."""

    campaigns: frozenset[str] = frozenset()
    since: str = ""

    @staticmethod
    def from_repairs_and_reports(session: Session, robot_id: int, *reports: Mapping[str, Any]) -> AsItWas:
        """What was measured before the last repair, or before what the versions of these reports were re-zeroed by."""
        repair, found = robots.last_repair(session, robot_id), AsItWas()
        if repair is not None:
            before = frozenset(campaigns.ids_until(session, robot_id, repair.at))
            found = AsItWas(before, f"the repair of {repair.at:%Y-%m-%d} ({repair.what})")
        for report in reports:
            campaign = (report.get(store.REZEROED) or {}).get("campaign")
            before = frozenset() if campaign is None else frozenset(campaigns.ids_before(session, robot_id, campaign))
            if campaign is not None and (not found.since or len(before) > len(found.campaigns)):
                found = AsItWas(before, f"{campaigns.get(session, campaign).name}, whose rows re-zeroed a version")
        return found

    def left_out(self, unseen: Unseen) -> Unseen:
        """Rows without those of such campaigns, and a sentence that says so."""
        left = [name for name in unseen.rows if name in self.campaigns]
        if not left:
            return unseen
        rows = {name: found for name, found in unseen.rows.items() if name not in self.campaigns}
        said = (
            f"Not compared, for they show the arm as it was: {plural(len(left), 'campaign')} from before {self.since}."
        )
        return replace(unseen, rows=rows, left_out={**unseen.left_out, left[0]: said})
