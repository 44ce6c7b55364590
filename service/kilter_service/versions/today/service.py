"""How good robots are today. Every surface shows what is computed here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from kilter_service.contract.fits import Metrics, StageErrors
from kilter_service.contract.gap_details import AtJoints, NamedEffect
from kilter_service.contract.headlines import name_effects
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.today import (
    ErrorAt,
    ErrorsToday,
    MeasuredCampaign,
    NamedMissing,
    Repair,
    SearchToday,
    Today,
)
from kilter_service.contract.units import ControllerCompensation
from kilter_service.contract.wording import as_written, interval
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.row import days_since
from kilter_service.ground.naming import copy_fields
from kilter_service.robots import store as arms
from kilter_service.robots.compensation import parse_compensation, sentence
from kilter_service.versions.drift import service as drift
from kilter_service.versions.predictions.unfitted_rows import larger
from kilter_service.versions.today import standing, store
from kilter_service.versions.today.standing import Known, Reached, assess
from kilter_service.versions.today.store import Active, Evaluated, Made, Measured, Searched
from kilter_service.web.store import streams


def against(found: Searched, active: Active | None) -> SearchToday:
    """Say what a search named, which of it the active version corrects, and what is missing now."""
    result = as_written(GapResult, {key: value for key, value in found.result.items() if key != "figures"})
    named = [_missing_from_effect(one, () if active is None else active.effects) for one in result.effects or []]
    return SearchToday(
        job_id=found.job_id,
        at=found.at,
        campaigns=found.campaigns,
        start=result.start,
        verdict=result.verdict,
        named=named,
        open=_open(result),
        next_poses=len(result.next_poses or []),
        sentence=_sentence(found, result, named, active),
    )


def format_claim(effect: NamedEffect) -> str:
    """Name an effect; where these data cannot tell it from others of its class, the class or all of them."""
    if effect.claim is not None and effect.claim.said != "member":
        return effect.claim.words.replace("_", " ")
    rivals = (
        [_format_effect_at_joints(one.id, one.joints or []) for one in effect.alias_set or []]
        if _is_undecided(effect)
        else []
    )
    names = list(dict.fromkeys([_format_effect_at_joints(effect.id, effect.joints or []), *rivals]))
    return names[0] if len(names) == 1 else f"{' or '.join(names)} (these data cannot tell)"


def _is_undecided(effect: NamedEffect) -> bool:
    return effect.verdict in ("class_confirmed", "provisional", "contradicted") or effect.class_ is not None


def _format_effect_at_joints(name: str, joints: Sequence[int]) -> str:
    words = name.replace("_", " ")
    return words if not joints else f"{words} of joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"


def _missing_from_effect(effect: NamedEffect, corrected: Iterable[dict[str, Any]]) -> NamedMissing:
    joints = set(effect.joints or [])
    alike: list[AtJoints] = [effect, *((effect.alias_set or []) if _is_undecided(effect) else [])]
    there = any(
        one.get("id") == like.id and set(like.joints or []) <= _joints(one, set(like.joints or []))
        for one in corrected
        for like in alike
    )
    return NamedMissing(id=effect.id, joints=sorted(joints), words=format_claim(effect), corrected=there)


def _joints(effect: dict[str, Any], wanted: set[int]) -> set[int]:
    """Joints of an effect of a version; one that states none is of all."""
    stated = effect.get("joints")
    return wanted if stated is None else set(stated)


def _open(result: GapResult) -> str:
    """What a search leaves unsettled."""
    unsure = [format_claim(one) for one in result.effects or [] if one.verdict == "provisional"]
    said = ["something is left that no known effect explains"] if result.verdict == "unexplained" else []
    said += [f"not yet confirmed: {', '.join(unsure)}"] if unsure else []
    return "; ".join(said) or "nothing that these data show"


def _sentence(found: Searched, result: GapResult, named: Sequence[NamedMissing], active: Active | None) -> str:
    when = f"the search of {found.at:%Y-%m-%d}"
    effects = list(zip(result.effects or [], named, strict=True))
    lacking = name_effects(effect for effect, one in effects if not one.corrected)
    there = name_effects(effect for effect, one in effects if one.corrected)
    beyond = " Something is left that no known effect explains." if result.verdict == "unexplained" else ""
    if not named:
        said = (result.headline or result.sentence or "Nothing was named.").splitlines()[0]
        return f"{said} So said {when}."
    if active is None:
        return f"Nothing corrects yet what {when} named: {', '.join(lacking)}.{beyond}"
    has = f"The active version corrects {', '.join(there)}, which {when} named." if there else ""
    if not lacking:
        return f"{has} Nothing else is known to be missing.{beyond}" if not beyond else f"{has}{beyond}"
    lack = f"Missing in the active version: {', '.join(lacking)}, which {when} named."
    return f"{lack} {has}".strip() + beyond


Campaigns = Mapping[str, Measured]
MOST, LAST = 200, 12  # errors over time of one robot, and of each of all


def of_robot(database: Database, robot: str) -> Today:
    """Say how good a robot is today, and what is missing in its active version."""
    with database.reading() as session:
        robots = arms.names_by_key(session, robot)
        (key,) = robots
        active = store.active(session, robots).get(key)
        found = store.newest_search(session, key)
        searched = None if found is None else against(found, active)
        compensation = parse_compensation(arms.get_compensation(session, key))
        known = _with_repair(
            _today_by_robot(session, robots, searched, MOST)[robots[key]], arms.last_repair(session, key)
        )
        return _with_controller(known, compensation)


def _with_repair(today: Today, repair: Repair | None) -> Today:
    """What is said of a robot; rows from before its last repair say how it was."""
    measured = [] if today.newest is None else [one.measured_at for one in today.newest.campaigns]
    if repair is None or not measured or max(measured) >= repair.at:
        return today
    said = (
        f"These rows are from before the repair of {repair.at:%Y-%m-%d} ({repair.what}): check the arm as it is (`kilter check "
        f"{today.robot} FILE`)."
    )
    return today.model_copy(update={"sentences": [*today.sentences, said]})


def _with_controller(today: Today, compensation: ControllerCompensation) -> Today:
    """What is said of a robot, with what its controller corrects by itself."""
    said = sentence(today.robot, compensation)
    sentences = [*today.sentences, said] if said else today.sentences
    return today.model_copy(update={"controller_compensation": compensation, "sentences": sentences})


def of_robots(database: Database) -> dict[str, Today]:
    """Say the same of all robots in use, by name, without their searches; however many, it takes a few queries."""
    with database.reading() as session:
        return _today_by_robot(session, arms.names_by_key(session, None), None, LAST)


def _today_by_robot(
    session: Session, robots: Mapping[int, str], searched: SearchToday | None, most: int
) -> dict[str, Today]:
    active, measured = store.active(session, robots), store.measured_campaigns(session, robots)
    made = store.versions(session, robots)
    evaluated = store.evaluations(session, [one.id for found in made.values() for one in found])
    checked, goals = drift.summaries(session, robots), arms.goals(session, robots)
    alarms = [
        one.last.job_id for one in checked.values() if one.last is not None and one.state in ("moved", "cannot_tell")
    ]
    causes, planned = store.causes(session, alarms), store.planned(session, robots)
    proposed, searching = store.proposed(session, robots), store.searching(session, robots)
    streamed = {one["version_id"] for one in streams(session)}
    out = {}
    for key, name in robots.items():
        version, campaigns, own, last = active.get(key), measured.get(key, {}), made.get(key, []), checked[key].last
        if version is None:
            found = _today_without_version(name, searched)
        else:
            found = _today(name, version, campaigns, evaluated.get(version.id, []), searched)
        tolerance, days = goals[key]
        history = sorted(_history(campaigns, [one for v in own for one in evaluated.get(v.id, [])]), key=lambda e: e.at)
        known = Known(
            tolerance_mm=tolerance,
            check_interval_days=days,
            rezeroed={one.rows: (one.id, one.name) for one in own if one.rows and version and one.parent == version.id},
            causes=causes.get(last.job_id, []) if last is not None else [],
            newest=(own[-1].id, own[-1].name) if own and not own[-1].was_active else None,
            fresh=_fresh(found, campaigns, [] if own else list(campaigns.values())),
            planned=planned.get(key),
            proposed=proposed.get(key),
            searching=searching.get(key),
            reached=Reached(
                measured=bool(campaigns),
                checked=any(one.role == "train" for one in campaigns.values()),
                searched=bool(own),
                active=version is not None,
                # who checks how good it is, or activated another one before, is past the first calibration
                corrected=version is not None
                and (version.id in streamed or bool(history) or _was_corrected(own, version)),
            ),
        )
        shown = history[-most:]
        out[name] = found.model_copy(update={"standing": assess(found, checked[key], known), "history": shown})
    return out


def _was_corrected(made: Iterable[Made], version: Active) -> bool:
    """Whether another version was active before."""
    return any(one.was_active and one.id != version.id for one in made)


def _fresh(today: Today, campaigns: Campaigns, unused: Sequence[Measured]) -> Measured | None:
    """The newest campaign that is to be fitted, and that no version knows."""
    after = [campaigns[one.id] for one in today.not_evaluated if one.id in campaigns] if today.version_id else unused
    wanted = [one for one in after if one.role == "train"]
    return max(wanted, key=lambda one: one.measured_at, default=None)


def _history(campaigns: Campaigns, evaluated: Iterable[Evaluated]) -> Iterable[ErrorAt]:
    """Errors of versions on campaigns in use, each when its rows were measured."""
    for one in evaluated:
        for campaign, metrics in one.metrics.items():
            known, errors = campaigns.get(campaign), as_written(StageErrors, metrics)
            if known is None or errors.identified is None:
                continue
            low, high = interval(errors.identified, errors.n) or (None, None)
            yield ErrorAt(
                at=known.measured_at,
                mean_mm=errors.identified.mean_mm,
                low_mm=low,
                high_mm=high,
                source="check" if one.kind == "drift" else "evaluation",
                job_id=one.job_id,
                version_id=one.version_id,
                campaign_id=campaign,
                alarm=one.said is not None,
            )


def _today_without_version(robot: str, searched: SearchToday | None) -> Today:
    found = Today(
        robot=robot,
        version_id=None,
        newest=None,
        own=None,
        changed=False,
        larger_by_mm=None,
        compared="",
        not_evaluated=[],
        missing=searched,
        sentences=[],
    )
    return found.model_copy(update={"sentences": standing.describe_today(found)})


def _today(
    robot: str, version: Active, campaigns: Campaigns, evaluated: Sequence[Evaluated], searched: SearchToday | None
) -> Today:
    own = _errors_of_own_job(version, campaigns)
    candidates = [one for one in _evaluations(version, campaigns, evaluated) if one.errors.identified is not None]
    if own is not None and own.source == "held_out":
        candidates.append(own)
    newest = max(candidates, key=_age, default=own)
    agreeing = {one.job_id for one in evaluated if one.agrees}  # a few poses are judged by their check
    alike = own is None or newest is None or newest is own or newest.job_id in agreeing
    more = None if alike or newest is None or own is None else _larger(newest, own)
    found = Today(
        robot=robot,
        version_id=version.id,
        newest=newest,
        own=own,
        changed=more is not None,
        larger_by_mm=more,
        compared=standing.describe_change(robot, newest, own, more),
        not_evaluated=_not_evaluated(version, campaigns, newest, candidates),
        missing=searched,
        sentences=[],
    )
    return found.model_copy(update={"sentences": standing.describe_today(found)})


def _age(found: ErrorsToday) -> tuple[bool, Any, Any]:
    """What is of the newest rows is of today; of the same rows, what was computed last."""
    measured = max((one.measured_at for one in found.campaigns), default=None)
    return measured is not None, measured or found.at, found.at


def _errors_of_own_job(version: Active, campaigns: Campaigns) -> ErrorsToday | None:
    """What the job of a version said of it: of rows it held out, else of those its line was fitted to."""
    metrics = as_written(Metrics, version.metrics)
    held = metrics.validation is not None and metrics.validation.identified is not None
    errors = metrics.validation if held else metrics.train
    if errors is None or errors.identified is None:
        return None
    named = [one for use in ("validation", "train") for one in version.campaigns if one["use"] == use]
    uses = {one["use"] for one in named}
    wanted = "validation" if held and "validation" in uses else "train"
    used = [one["id"] for one in named if one["use"] == wanted]
    fitted = wanted == "validation" and any(c in campaigns and campaigns[c].hashes & version.fitted for c in used)
    return _errors(
        version,
        "held_out" if held and not fitted else "fitted",
        version.job_id,
        version.created_at,
        used,
        campaigns,
        errors,
    )


def _evaluations(version: Active, campaigns: Campaigns, evaluated: Iterable[Evaluated]) -> Iterable[ErrorsToday]:
    """The errors of each campaign of each evaluation or check of which the version's line was fitted to no file."""
    for one in evaluated:
        for campaign, metrics in one.metrics.items():
            known = campaigns.get(campaign)
            if known is None or known.hashes & version.fitted:
                continue
            errors = as_written(StageErrors, metrics)
            if errors.fitted:  # the same rows in another file
                continue
            source = "check" if one.kind == "drift" else "evaluation"
            found = _errors(version, source, one.job_id, one.at, [campaign], campaigns, errors, one.refit)
            yield found.model_copy(update={"alarm": one.said})


def _errors(
    version: Active,
    source: Any,
    job: str,
    at: Any,
    used: list[str],
    campaigns: Campaigns,
    errors: StageErrors,
    refit: list[str] | None = None,
) -> ErrorsToday:
    found = [campaigns[one] for one in used if one in campaigns]
    return ErrorsToday(
        source=source,
        job_id=job,
        at=at,
        campaigns=[_campaign(one) for one in found],
        refit=refit or [],
        rows=standing.rows(source, refit or []),
        errors=errors,
    )


def _campaign(found: Measured) -> MeasuredCampaign:
    days = days_since(found.measured_at)
    return copy_fields(
        MeasuredCampaign,
        found,
        age_days=days,
        when=standing.describe_measurement_time(found.measured_at, days, stated=found.stated),
    )


def _larger(newest: ErrorsToday, own: ErrorsToday) -> float | None:
    """By how much today's mean error, mm, is larger than at the fit; None: by no more than chance explains."""
    blocks = (one.errors.model_dump(mode="json") for one in (newest, own))
    return larger(*blocks)


def _not_evaluated(
    version: Active, campaigns: Campaigns, newest: ErrorsToday | None, candidates: Iterable[ErrorsToday]
) -> list[MeasuredCampaign]:
    """Campaigns newer than the rows of today's number that say nothing yet; not what is left of one in use."""
    since = max((one.measured_at for one in newest.campaigns), default=version.created_at) if newest else None
    known = {one.id for found in candidates for one in found.campaigns} | {one["id"] for one in version.campaigns}
    found = [
        one
        for one in campaigns.values()
        if one.id not in known
        and one.whole is None
        and not one.hashes & version.fitted
        and (since is None or one.measured_at > since)
    ]
    return [_campaign(one) for one in sorted(found, key=lambda one: one.measured_at)]
