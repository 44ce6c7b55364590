"""Whether a robot keeps a tolerance, on rows that its version was not fitted to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kilter_core.errors import CoreError, TooFewPosesError
from kilter_core.observations import Observations, evenly
from kilter_core.types import Floats, Ints
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.devices import Instrument
from kilter_service.contract.fits import Errors
from kilter_service.contract.today import Acceptance, Decision, JudgedCampaign
from kilter_service.contract.wording import Remark
from kilter_service.ground.core import core_evaluate, core_identify, core_measurement, core_model, core_watch
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.row import days_since
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.wire import to_metres, to_mm
from kilter_service.robots import store as robots
from kilter_service.robots.store import permissible, remarks
from kilter_service.versions import store as versions
from kilter_service.versions.guard import AsItWas
from kilter_service.versions.predictions.unfitted_rows import Archive
from kilter_service.versions.today import service as today
from kilter_service.versions.today import standing

if TYPE_CHECKING:
    from kilter_core.evaluate import Conformity
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration
    from kilter_service.versions.predictions.unfitted_rows import Unseen


MOST_SHOWN = 500


@dataclass(frozen=True)
class Judged:
    """Rows of a campaign: the conformity of the worst, errors in mm, the budget, and places with errors (N,) m.

    ``before`` are those of the nominal robot with both frames fitted.
    """

    conformity: Conformity
    before: dict[str, float]
    after: dict[str, float]
    budget: dict[str, Any]
    places: Floats
    sizes: Floats
    rows: Ints


def judge_rows(
    calibration: Calibration,
    known: Predictive,
    rows: Observations,
    numbers: Ints,
    instrument: Instrument | None,
    refit: Sequence[str],
    tolerance_m: float,
) -> Judged | None:
    """Judge rows, whose ``numbers`` in their campaign are from 0; None where no place of the tool was measured.

    Raises:
        CoreError: too few rows for the frames to fit.

    """
    if rows.position is None and rows.markers is None:
        return None
    measurement = core_measurement.Measurement.from_observations(rows, calibration.marker_points, held=True)
    fitted = core_identify.refit_frames(calibration, measurement, tuple(refit))
    budget = core_evaluate.Budget.from_measurement(fitted, known, measurement, permissible(instrument), refit)
    if budget is None:
        return None
    error = core_evaluate.errors_by_row(fitted, measurement).error
    seen = ~np.isnan(error).any(axis=1)
    if not seen.any():
        return None
    sizes = np.linalg.norm(error[seen], axis=1)
    conformity = core_evaluate.judge(sizes, core_evaluate.K * budget.along(np.nan_to_num(error))[seen], tolerance_m)
    nominal = core_identify.refit_frames(
        core_model.Calibration.nominal(calibration.robot), measurement, ("base", "tool")
    )
    before, after = (
        core_measurement.Errors.from_calibration(one, measurement).to_document() for one in (nominal, fitted)
    )
    document = {"instrument": instrument and instrument.name, **budget.to_document()}
    return Judged(conformity, before, after, document, _places(rows)[seen], sizes, numbers[seen])


def of_another_arm(calibration: Calibration, known: Predictive, rows: Observations, found: Judged) -> bool:
    """Whether a check of these rows would refuse them as another arm's: they are far off, and no one cause explains it."""
    misfit = float(np.sqrt(np.mean(found.sizes**2)))
    if not core_watch.far_off(calibration, misfit):
        return False
    try:
        core_watch.check(calibration, rows, known)
    except CoreError as error:
        return error.code == core_watch.ANOTHER_ARM
    return False


def sample_places_and_errors(found: Judged) -> tuple[Floats, Floats]:
    """Places (n, 3) m and errors (n,) m of some rows, evenly chosen, the worst among them."""
    some = np.union1d(evenly(len(found.sizes), MOST_SHOWN), found.sizes.argmax())
    return found.places[some], found.sizes[some]


def span(found: Sequence[Judged]) -> tuple[Floats, Floats]:
    """Lowest and highest places (3,) m."""
    places = np.concatenate([one.places for one in found])
    return places.min(axis=0), places.max(axis=0)


def _places(rows: Observations) -> Floats:
    if rows.position is not None:
        return rows.position
    assert rows.markers is not None
    seen = ~np.isnan(rows.markers)
    return np.asarray(np.where(seen, rows.markers, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1))


RULE = (
    "ISO 14253-1: accepted where every measured error and its guard band are within the tolerance, rejected where one is "
    "beyond it by its guard band, else neither is proved. The guard band is the expanded uncertainty of the measured error, "
    "k = 2."
)
WHY = {
    "repeatability": "no pose was visited twice among the rows that were fitted, or, where a camera or a contact measured "
    "those, among these rows, so the scatter of readings is not part of the guard band",
    "temperature": "the temperature was not measured, so growth is not part of the guard band",
}


def sentence(
    decision: Decision, tolerance_mm: float, rows: int, worst: JudgedCampaign, provable_mm: float, lacking: list[Remark]
) -> str:
    """Say what was decided and by which row."""
    row = (
        f"row {worst.row} of {worst.name} has {worst.error_mm:.3g} mm with a guard band of {worst.guard_band_mm:.3g} mm"
    )
    if decision == "accepted":
        return f"Accepted: all {rows} held-out rows prove {tolerance_mm:g} mm; the worst, {row}."
    if decision == "rejected":
        return f"Rejected: {row}, beyond {tolerance_mm:g} mm by more than that."
    if lacking:
        return f"Neither is proved: {lacking[0].message}"
    return f"Neither is proved: {row}; {tolerance_mm:g} mm is within that band. These rows prove {provable_mm:.3g} mm."


def missing_evidence_remarks(campaign: JudgedCampaign, certificate: list[Remark]) -> Iterator[Remark]:
    """Say why rows prove nothing, whatever their numbers."""
    if campaign.instrument is None:
        message = (
            f"campaign {campaign.name} names no instrument, so the guard band lacks its error. Add it "
            "(`kilter measure instrument add`) and name it: `kilter version accept --instrument NAME`."
        )
        yield Remark(code="instrument_not_named", message=message, campaigns=[campaign.id])
    yield from (one.model_copy(update={"campaigns": [campaign.id]}) for one in certificate)


def guard_band_warnings(campaign: JudgedCampaign) -> Iterator[Remark]:
    """Say what the guard band lacks."""
    for source in campaign.budget.not_assessed:
        if source in WHY:
            message = f"Campaign {campaign.name}: {WHY[source]}."
            yield Remark(code=f"{source}_not_assessed", message=message, campaigns=[campaign.id])


def too_few(campaign: str) -> str:
    """Say that a campaign has too few poses to be judged, and what helps."""
    return (
        f"Campaign {campaign} has too few distinct poses to be judged: before and after are compared with base and tool "
        "fitted to it, which takes three, better ten all over the room. Measure more, or name other campaigns (--campaign)."
    )


def another_arm(campaign: str) -> str:
    """Say that rows may be of another arm, and what helps."""
    return (
        f"campaign {campaign} misses the version by more than 2 % of the arm's reach, and no one cause explains it: its rows "
        f"are of another arm or set-up, or the arm is far off. Where they are not of this arm, take it out of use "
        f"(`kilter measure campaigns retire {campaign}`); else name it, and it is judged "
        f"(`kilter version accept --campaign {campaign}`)."
    )


class Wish(NamedTuple):
    """What is to be judged: null version: the active one; no campaigns: those of today's number, else all that there are.

    ``refit`` None: as today's number does, else no frame. ``instrument`` counts for campaigns that name none.
    """

    tolerance_mm: float
    version: str | None = None
    campaigns: Sequence[str] = ()
    refit: Sequence[str] | None = None
    instrument: str | None = None


def of_robot(database: Database, robot: str, wish: Wish) -> Acceptance:
    """Decide whether a robot keeps a tolerance.

    Raises:
        ServiceError: no such robot, version, campaign or instrument, or no row that was not fitted.
        CoreError: too few rows for the frames to fit.

    """
    version_id = wish.version or _active(database, robot)
    wish = _with_todays(database, robot, version_id, wish)
    with database.reading() as session:
        stored = robots.get(session, robot)
        version = versions.get(session, version_id)
        if version.robot != robot:
            raise ServiceError(
                f"Version {version_id} is of robot {version.robot!r}, not of {robot!r}.", code="version_not_found"
            )
        parts, left_out, foreign = _judge_campaigns(session, stored.id, version_id, wish)
        if not parts:
            was = AsItWas() if wish.campaigns else AsItWas.from_repairs_and_reports(session, stored.id, version.report)
            raise _nothing(robot, version_id, wish, was, foreign)
    parts.sort(key=lambda one: -one.campaign.provable_mm)
    decision, worst, lacking = _decision(parts, foreign)
    provable = max(one.campaign.provable_mm for one in parts)
    rows = sum(one.campaign.rows for one in parts)
    low, high = _span(parts)
    return Acceptance(
        robot=robot,
        robot_sha256=stored.sha256,
        version_id=version_id,
        version_name=version.name,
        version_sha256=version.sha256,
        tolerance_mm=wish.tolerance_mm,
        decision=decision,
        rule=RULE,
        sentence=sentence(decision, wish.tolerance_mm, rows, worst, provable, lacking),
        rows=rows,
        provable_mm=provable,
        span_mm={axis: (low[k], high[k]) for k, axis in enumerate("xyz")},
        campaigns=[one.campaign for one in parts],
        lacking=lacking,
        warnings=[*left_out, *(said for one in parts for said in guard_band_warnings(one.campaign))],
    )


class Part(NamedTuple):
    """A campaign that was judged, what its certificate has against it, and its rows."""

    campaign: JudgedCampaign
    certificate: list[Remark]
    judged: Judged


def _active(database: Database, robot: str) -> str:
    with database.reading() as session:
        last = versions.active_entry(session, robots.get(session, robot).id)
    if last is None:
        raise ServiceError(
            f"Robot {robot!r} has no active version: activate one, or name the version to judge.",
            code="no_active_version",
            robot=robot,
        )
    return last.version_id


def _with_todays(database: Database, robot: str, version_id: str, wish: Wish) -> Wish:
    """Take the rows, and the frames fitted to them, of today's number where nobody named any."""
    if wish.campaigns:
        return wish._replace(refit=wish.refit or ())
    found = today.of_robot(database, robot)
    newest = found.newest if found.version_id == version_id else None
    if newest is None or newest.source == "fitted":
        return wish._replace(refit=wish.refit or ())
    with database.reading() as session:
        was = AsItWas.from_repairs_and_reports(session, robots.get(session, robot).id)
    ids = tuple(one.id for one in newest.campaigns if one.id not in was.campaigns)
    return wish._replace(campaigns=ids, refit=newest.refit if wish.refit is None else wish.refit)


def _judge_campaigns(
    session: Session, robot_id: int, version_id: str, wish: Wish
) -> tuple[list[Part], list[Remark], list[Remark]]:
    """The campaigns that are judged; what is said of those that nobody named and that cannot be; and of another arm's."""
    calibration, own = versions.calibration(session, version_id), versions.training_campaign_ids(session, version_id)
    report = versions.get(session, version_id).report
    known = core_identify.Predictive.from_document(versions.covariance(session, version_id), report)
    if known is None:
        raise ServiceError(
            f"Version {version_id} does not say how well it is known: identify again.", code="nothing_held_out"
        )
    for one in wish.campaigns:
        campaigns.get(session, one)
    stated = None if wish.instrument is None else robots.get_instrument(session, wish.instrument)
    unseen: Unseen = Archive(session, robot_id).unseen([version_id])
    if not wish.campaigns:
        unseen = AsItWas.from_repairs_and_reports(session, robot_id, report).left_out(unseen)
    parts, left_out, foreign = [], [], []
    for key, rows in unseen.rows.items():
        if wish.campaigns and key not in wish.campaigns:
            continue
        used = campaigns.instruments(session, [key]).get(key) or stated
        try:
            found = _judge_campaign_rows((calibration, known, key in own), rows, unseen.places[key], used, wish)
        except TooFewPosesError as error:
            if wish.campaigns:
                raise TooFewPosesError(too_few(key), campaign=key) from error
            left_out.append(Remark(code="campaign_not_judged", message=too_few(key), campaigns=[key]))
            continue
        if found is None:
            continue
        if not wish.campaigns and of_another_arm(calibration, known, rows, found):
            foreign.append(Remark(code=core_watch.ANOTHER_ARM, message=another_arm(key), campaigns=[key]))
            continue
        parts.append(_build_part(session, key, found, used, wish.refit or ()))
    return parts, left_out, foreign


def _judge_campaign_rows(
    version: tuple[Calibration, core_identify.Predictive, bool],
    rows: Observations,
    places: Ints,
    used: Instrument | None,
    wish: Wish,
) -> Judged | None:
    """Judge the rows of a campaign; the version with what it knows, and whether it was made from that campaign."""
    calibration, known, own = version
    here = calibration if own else calibration.for_another_campaign(rows)
    return judge_rows(here, known, rows, places, used, wish.refit or (), to_metres(wish.tolerance_mm))


def _build_part(session: Session, key: str, found: Judged, used: Instrument | None, refit: Sequence[str]) -> Part:
    record, uploads = campaigns.get(session, key), campaigns.uploads_of_campaign(session, key)
    at = record.measured_at or max(one.created_at for one in uploads)
    places, sizes = sample_places_and_errors(found)
    worst = found.conformity
    campaign = JudgedCampaign(
        id=key,
        name=record.name,
        when=standing.describe_measurement_time(at, days_since(at), stated=record.measured_at is not None),
        instrument=used and used.name,
        rows=len(found.sizes),
        sha256=[one.sha256 for one in uploads],
        refit=[*refit],
        before=Errors(**found.before),
        after=Errors(**found.after),
        largest_mm=to_mm(float(found.sizes.max())),
        row=int(found.rows[worst.row]) + 1,
        error_mm=to_mm(worst.error),
        guard_band_mm=to_mm(worst.guard),
        provable_mm=to_mm(worst.needed),
        budget=found.budget,
        at_mm=to_mm(places).tolist(),
        error_at_mm=to_mm(sizes).tolist(),
    )
    return Part(campaign, remarks(used, record.measured_at, at), found)


def _decision(parts: Sequence[Part], foreign: Sequence[Remark]) -> tuple[Decision, JudgedCampaign, list[Remark]]:
    """The decision of all campaigns, the one that it rests on, and what lacks for any.

    Nothing is decided beside rows that may be another arm's: they may as well be this one's, and far off.
    """
    lacking = [
        *foreign,
        *(said for one in parts for said in missing_evidence_remarks(one.campaign, one.certificate)),
    ]
    if lacking:
        return "not_proved", parts[0].campaign, lacking
    for decision in ("rejected", "not_proved", "accepted"):
        for one in parts:
            if one.judged.conformity.decision == decision:
                return decision, one.campaign, []
    raise AssertionError("unreachable")


def _span(parts: Sequence[Part]) -> tuple[list[float], list[float]]:
    low, high = span([one.judged for one in parts])
    return to_mm(low).tolist(), to_mm(high).tolist()


def _nothing(robot: str, version_id: str, wish: Wish, was: AsItWas, foreign: Sequence[Remark]) -> ServiceError:
    if foreign:
        return ServiceError(
            f"No row is left to judge: {foreign[0].message}", code="nothing_held_out", version=version_id
        )
    named = f" of {', '.join(wish.campaigns)}" if wish.campaigns else ""
    if was.campaigns:  # rows from before it show the arm as it was
        named = f" since {was.since}"
    return ServiceError(
        f"No row{named} with a measured place is left that version {version_id} was not fitted to, and rows that were fitted "
        f"prove nothing. Measure some poses that are only checked (`kilter upload {robot} FILE --role confirmation`), or "
        "identify with `--validation 0.3`.",
        code="nothing_held_out",
        version=version_id,
    )
