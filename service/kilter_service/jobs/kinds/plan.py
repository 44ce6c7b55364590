"""Job kind ``plan``: poses to measure, for ISO 9283, to identify well, or to tell two effects apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import FindingDocument, OptionError
from kilter_core.observations import Observations
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.contract.jobs.plan import PLAN, PlanOptions
from kilter_service.ground.core import core_effects, core_gap, core_identify, core_model, core_plan, core_watch
from kilter_service.ground.wire import to_metres, to_metres_if_known
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Lack, Progress
from kilter_service.jobs.setups import to_json_types
from kilter_service.jobs.torque_inputs import Pose, poses_document, poses_from_rows
from kilter_service.versions.drift import wire

if TYPE_CHECKING:
    from kilter_core.effects import Effect
    from kilter_core.gap import Proposal
    from kilter_core.model import Calibration, Region
    from kilter_core.types import Floats


UNCHECKED = FindingDocument.make(
    "collisions_not_checked",
    "Collisions are not checked: drive the poses slowly once, or simulate them, before you measure.",
)
CYCLES = {"five_poses": (5, 4, 3, 2, 1), "two_poses": (2, 4)}  # P5 to P1 for AP, RP and vAP; P2 and P4 for AD and RD
CYCLES_DEMANDED = 30
COUNTS = {"iso9283": 118, "identify": 60, "separate": 12, "check": 5}
FEWEST_CHECKED = 3
IMAGINED = Lack(
    "measurements",
    "No campaign is named: a first one of random poses is imagined, and what it would see may not be what you measured.",
    "Name the campaigns that were measured so far.",
)
NO_PAYLOADS = (
    "They follow the load, and no payloads are named: all poses are planned without a load to change.",
    "Name the loads at hand in `payloads_kg`, 0 among them.",
)
NOISE_MM = 0.05  # of a coordinate, where neither repeats nor the request say it


def check(options: PlanOptions) -> None:
    """Refuse options that do not go together.

    Raises:
        OptionError: a box without room, a cycle of the standard for another purpose, or effects that cannot be told apart.

    """
    _box(options)
    _keep_out(options)
    if options.without_joints and options.purpose != "check":
        raise OptionError(
            "options.without_joints goes with purpose check: give both, or none.", option="without_joints"
        )
    if options.purpose == "check" and options.count is not None and options.count < FEWEST_CHECKED:
        raise OptionError(
            f"options.count is {options.count}: a check needs {FEWEST_CHECKED} poses, better five.", option="count"
        )
    if options.prior is not None and (options.purpose, options.method) != ("identify", "d_optimal"):
        raise OptionError(
            "options.prior is 'fleet': it goes with purpose identify and method d_optimal, leave it out.",
            option="prior",
        )
    if options.method in CYCLES and options.purpose != "iso9283":
        raise OptionError(
            f"options.method is {options.method!r}: it is a cycle of ISO 9283, give purpose iso9283.", option="method"
        )
    if options.method == "views" and options.purpose != "identify":
        raise OptionError("options.method is 'views': it goes with purpose identify.", option="method")
    if options.purpose == "separate":
        named_effects(options)
        if len(options.effects) > 2:
            raise OptionError(
                'separate tells two effects apart, as ["axial_compliance", "link_bending"], or one from geometry.',
                option="effects",
            )


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Plan with the version named, else the nominal robot."""
    progress(0.0, "choosing poses")
    plans: dict[str, Callable[[JobInput, Progress], dict[str, Any]]]
    plans = {"iso9283": _iso, "identify": _identify, "separate": _separate, "check": _check}
    purpose = job.options.purpose
    made = {"purpose": purpose, "start": job.version_id, **plans[purpose](job, progress)}
    warnings = [UNCHECKED, *made.pop("warned", ())]
    return JobOutput(to_json_types({**made, "within": _pose_region_name(job), "warnings": warnings}))


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Plan a single pose, which is refused as the whole plan would be, and say what the plan has to do without."""
    options: PlanOptions = job.options
    found.count_fitted_rows(*job.campaigns.values())
    with found.noting_refusals():
        few = FEWEST_CHECKED if options.purpose == "check" else 1
        run(replace(job, options=options.model_copy(update={"count": few})), lambda fraction, stage: None)
        planned = "Three poses were" if options.purpose == "check" else "A single pose was"
        found.limited.append(f"{planned} planned, to see whether there is room for poses.")
        if options.purpose == "separate" and not job.campaigns:
            found.missing.append(IMAGINED)
        loaded = (
            [effect.id for effect in _effects_from_options(job) if "moments" in effect.needs] if options.effects else []
        )
        if loaded and not options.payloads_kg:
            found.missing.append(Lack(f"second payload for {', '.join(loaded)}", *NO_PAYLOADS))


def _check(job: JobInput, progress: Progress) -> dict[str, Any]:
    """The few poses of a check, with what they will show."""
    options: PlanOptions = job.options
    beyond = [joint for joint in options.without_joints if joint > job.robot.n_joints]
    if beyond:
        raise OptionError(
            f"options.without_joints has joint {beyond[0]}: the robot has {job.robot.n_joints}.",
            option="without_joints",
        )
    known = core_identify.Predictive.from_document(job.covariance or {}, job.report)
    if known is None:
        known = core_identify.Predictive((), np.zeros((0, 0)), 0.0, to_metres(NOISE_MM))
    noise = to_metres_if_known(options.noise_mm)
    if noise is None and known.noise == 0.0 and known.inadequacy == 0.0:
        noise = to_metres(NOISE_MM)
    plan = core_watch.check_poses(
        _starting_calibration(job),
        known,
        _count(job),
        _region(job),
        noise=noise,
        without=options.without_joints,
        seed=options.seed,
        progress=progress,
    )
    shown = {
        "false_alarm": core_watch.FALSE_ALARM,
        "smallest": wire.smallest_documents(plan.found),
        "unseen": [wire.cause_words(one) for one in plan.found.unseen],
        "faint": [wire.faint_sentence(one) for one in plan.faint],
    }
    return {**poses_document(job.robot, [Pose(row) for row in plan.q]), **shown}


def named_effects(options: PlanOptions) -> list[tuple[str, tuple[int, ...] | None]]:
    """Ids and joints (from 0) of the effects to tell apart.

    Raises:
        OptionError: an option besides the joints, which a separation has no use for.

    """
    out: list[tuple[str, tuple[int, ...] | None]] = []
    for number, one in enumerate(options.effects):
        named: dict[str, Any] = {"id": one} if isinstance(one, str) else one.model_dump(mode="json")
        more = sorted(set(named) - {"id", "joints"})
        if more:
            raise OptionError(
                f"options.effects.{number}.{more[0]}: separate tells effects apart as the library has them. Name the "
                "effect and its joints alone.",
                option="effects",
            )
        joints = named.get("joints")
        out.append((str(named["id"]), None if joints is None else tuple(j - 1 for j in joints)))
    return out


def _iso(job: JobInput, progress: Progress) -> dict[str, Any]:
    if job.options.method in CYCLES:
        return _cycles(job, CYCLES[job.options.method])
    q = core_plan.iso_poses(job.robot, _count(job), job.options.seed, _room(job))
    return poses_document(job.robot, [Pose(row) for row in q])


def _cycles(job: JobInput, order: tuple[int, ...]) -> dict[str, Any]:
    """The same poses again and again; ``count`` cycles, pose_id the standard's number, session the cycle."""
    q = core_plan.five_poses(job.robot, seed=job.options.seed, region=_room(job))
    cycles = range(1, (job.options.count or CYCLES_DEMANDED) + 1)
    poses = [Pose(q[number - 1], pose_id=number, session=cycle) for cycle in cycles for number in order]
    return {**poses_document(job.robot, poses), "cycles": len(cycles), "cycles_demanded": CYCLES_DEMANDED}


def _identify(job: JobInput, progress: Progress) -> dict[str, Any]:
    if job.options.method == "iso9283":
        return _iso(job, progress)
    given: dict[str, Any] = {
        "count": _count(job),
        "effects": _effects_from_options(job),
        "noise": to_metres(job.options.noise_mm or NOISE_MM),
        "seed": job.options.seed,
        "progress": lambda fraction: progress(fraction, "choosing poses"),
        "region": _region(job),
        "payloads_kg": job.options.payloads_kg,
        "payload_com": [to_metres(value) for value in job.options.payload_com_mm or ()],
    }
    if job.options.method == "views":
        rows = core_plan.view_poses(_with_cameras(job), driven=job.driven, **given)
    else:
        rows = core_plan.d_optimal_poses(
            _starting_calibration(job), fleet=None if job.options.prior is None else job.fleet, **given
        )
    return poses_document(job.robot, poses_from_rows(rows))


def _with_cameras(job: JobInput) -> Calibration:
    """What is planned with, and where its cameras and boards stand."""
    seen = [rows for rows in renumber_poses_and_sessions(job.campaigns.values()) if rows.pixels is not None]
    return core_plan.placed_by_views(_starting_calibration(job), Observations.concatenate(seen) if seen else None)


def _starting_calibration(job: JobInput) -> core_model.Calibration:
    return job.calibration or core_model.Calibration.nominal(job.robot)


def _pose_region_name(job: JobInput) -> str:
    """Where the poses are: within "campaigns", the robot's, or only within its "limits"."""
    options: PlanOptions = job.options
    standard = options.purpose == "iso9283" or options.method == "iso9283"
    return "limits" if standard or job.driven is None else options.within


def _region(job: JobInput) -> core_model.Region:
    """Where poses may be: as far as the arm was driven before unless ``within`` says limits, above floor, in the box."""
    region = core_model.Region.from_calibration(
        _starting_calibration(job), job.driven if _pose_region_name(job) == "campaigns" else None
    )
    region = region.above(to_metres_if_known(job.options.floor_mm)).restrict_to_box(_box(job.options))
    return region.outside(_keep_out(job.options))


def _room(job: JobInput) -> Region | None:
    """The floor, the box and the zones to keep out of alone, for the poses of the standard; None without any."""
    options: PlanOptions = job.options
    bounded = options.floor_mm is not None or options.box_mm is not None or options.keep_out_mm
    return _region(job) if bounded else None


def _box(options: PlanOptions) -> Floats | None:
    """Lowest and highest corner (2, 3) m of the option ``box_mm``."""
    if options.box_mm is None:
        return None
    return _corners(np.array(options.box_mm, dtype=np.float64), "box_mm")


def _keep_out(options: PlanOptions) -> Floats | None:
    """Lowest and highest corners (k, 2, 3) m of the option ``keep_out_mm``; None without any."""
    if not options.keep_out_mm:
        return None
    boxes = [np.array(box, dtype=np.float64) for box in options.keep_out_mm]
    return np.stack([_corners(box, f"keep_out_mm.{k}") for k, box in enumerate(boxes)])


def _corners(box_mm: Floats, option: str) -> Floats:
    if not (box_mm[0] < box_mm[1]).all():
        raise OptionError(
            f"options.{option} holds the lowest and the highest corner, as [[-200, 100, 0], [200, 400, 300]].",
            option=option,
        )
    return to_metres(box_mm)


def _effects_from_options(job: JobInput) -> list[Effect]:
    named = [{"id": one} if isinstance(one, str) else one.model_dump(mode="json") for one in job.options.effects]
    return [core_effects.effect_from_document(one).configure_for_robot(job.robot) for one in named]


def _separate(job: JobInput, progress: Progress) -> dict[str, Any]:
    """Poses that tell the two effects named apart, or what the gap search that made the version left undecided."""
    wanted: list[Any] = list(named_effects(job.options))
    if not wanted:
        open_ = core_gap.undecided_effect_pair(job.origin or {})
        if open_ is None:
            raise OptionError(
                "There is nothing to tell apart: name two effects, or a version of a gap search that left something undecided.",
                option="effects",
            )
        wanted = [named for named in open_ if named is not None]
    progress(0.1, "what was measured")
    plan = core_gap.plan_separation(
        job.robot,
        Observations.concatenate(renumber_poses_and_sessions(job.campaigns.values())) if job.campaigns else None,
        wanted[0],
        wanted[1] if len(wanted) > 1 else None,
        _count(job),
        core_gap.GapOptions(noise_mm=job.options.noise_mm, seed=job.options.seed),
        job.calibration,
        _region(job),
    )
    about = {
        "separates": list(plan.labels),
        "correlation": round(plan.alike, 4),
        "proposals": [_about(p) for p in plan.proposals],
        "told_apart": None if plan.told is None else plan.told.to_document(),
        "warned": [] if plan.told is None else list(plan.told.warnings()),
    }
    poses = [
        pose
        for p in plan.proposals
        for pose in poses_from_rows(
            p.rows, p.kind, p.change or None, [after / max(p.before, 1e-12) for after in p.after]
        )
    ]
    return {**poses_document(job.robot, poses), **about}


def _about(p: Proposal) -> dict[str, Any]:
    return {
        "kind": p.kind,
        "change": p.change or None,
        "poses": len(p.rows),
        "information_factor": round(float(p.after[-1] / max(p.before, 1e-12)), 3),
    }


def _count(job: JobInput) -> int:
    return int(job.options.count or COUNTS[job.options.purpose])


KIND = JobKind(PLAN, run, check, preview_job=preview_job)
