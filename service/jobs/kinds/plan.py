"""Job kind ``plan``: poses to measure, for ISO 9283, to identify well, or to tell two effects apart."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from core.errors import OptionError
from service.jobs.kind import JobInput, JobKind, JobOutput, Progress
from service.jobs.poses import Pose, document_of, poses_of
from service.jobs.wire import plain

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from core.design.region import Region
    from core.effects import Effect
    from core.gap.next_poses import Proposal
    from core.model import Calibration

    Floats = NDArray[np.float64]

UNCHECKED = {
    "code": "collisions_not_checked",
    "message": "Collisions are not checked: drive the poses slowly once, or simulate them, before you measure.",
}
PURPOSES = ("iso9283", "identify", "separate")
METHODS = ("d_optimal", "iso9283", "five_poses", "two_poses")
CYCLES = {"five_poses": (5, 4, 3, 2, 1), "two_poses": (2, 4)}  # P5 to P1 for AP, RP and vAP; P2 and P4 for AD and RD
CYCLES_DEMANDED = 30
COUNTS = {"iso9283": 118, "identify": 60, "separate": 12}
MOST_POSES = 2000
OPTIONS = {
    "purpose", "method", "count", "effects", "seed", "noise_mm", "version", "box_mm", "floor_mm", "within", "payloads_kg",
}  # fmt: skip
WITHIN = ("campaigns", "limits")
HEAVIEST_KG = 1000.0
NOISE_MM = 0.05  # of a coordinate, where neither repeats nor the request say it


def check(options: dict[str, Any]) -> None:
    """Refuse options that plan does not have.

    Raises:
        OptionError: one that does not exist or cannot be.

    """
    unknown = sorted(set(options) - OPTIONS)
    if unknown:
        raise OptionError(
            f"plan has no option {unknown[0]!r}. It has: {', '.join(sorted(OPTIONS))}.", option=unknown[0]
        )
    _one_of("purpose", options.get("purpose"), PURPOSES)
    _one_of("method", options.get("method", METHODS[0]), METHODS)
    _whole("count", options.get("count", 1), 1, MOST_POSES)
    _whole("seed", options.get("seed", 0), 0, 2**31)
    noise = options.get("noise_mm", NOISE_MM)
    if not isinstance(noise, int | float) or not noise > 0:
        raise OptionError("noise_mm must be above 0: it is a standard deviation.", option="noise_mm")
    _box(options)
    _one_of("within", options.get("within", WITHIN[0]), WITHIN)
    _number("floor_mm", options.get("floor_mm"))
    _payloads(options)
    method, purpose = options.get("method"), options["purpose"]
    if method in CYCLES and purpose != "iso9283":
        raise OptionError(f"{method} is a cycle of ISO 9283: give purpose iso9283.", option="method")
    wanted = named_effects(options)
    if options["purpose"] == "separate" and len(wanted) > 2:
        raise OptionError(
            'separate tells two effects apart, as ["axial_compliance", "link_bending"], or one from geometry.',
            option="effects",
        )


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Plan with the version named, else the robot as drawn."""
    progress(0.0, "choosing poses")
    plans: dict[str, Callable[[JobInput, Progress], dict[str, Any]]]
    plans = {"iso9283": _iso, "identify": _identify, "separate": _separate}
    purpose = job.options["purpose"]
    made = {"purpose": purpose, "start": job.version_id, **plans[purpose](job, progress)}
    return JobOutput(plain({**made, "within": _within(job), "warnings": [UNCHECKED]}))


def named_effects(options: dict[str, Any]) -> list[tuple[str, tuple[int, ...] | None]]:
    """Ids and joints (from 0) of the option ``effects``: ids, or objects {"id", "joints"} with joints from 1.

    Raises:
        OptionError: no such effect, or another form.

    """
    from core.effects import EFFECTS

    out = []
    given = options.get("effects", [])
    for one in given if isinstance(given, list) else [given]:
        named = {"id": one} if isinstance(one, str) else one
        if not isinstance(named, dict) or set(named) - {"id", "joints"} or not isinstance(named.get("id"), str):
            raise OptionError(f'effects holds {one!r}: give ids, or {{"id": ..., "joints": [2]}}.', option="effects")
        if named["id"] not in EFFECTS:
            raise OptionError(f"There is no effect {named['id']!r}. There are: {', '.join(EFFECTS)}.", option="effects")
        out.append((named["id"], _joints(named.get("joints"))))
    return out


def _joints(joints: Any) -> tuple[int, ...] | None:
    if joints is None:
        return None
    if not isinstance(joints, list) or not all(type(j) is int and j >= 1 for j in joints):
        raise OptionError(f"joints is {joints!r}: give joint numbers from 1, as [2].", option="effects")
    return tuple(j - 1 for j in joints)


def _iso(job: JobInput, progress: Progress) -> dict[str, Any]:
    from core.design.iso9283 import iso_poses

    if job.options.get("method") in CYCLES:
        return _cycles(job, CYCLES[job.options["method"]])
    q = iso_poses(job.robot, _count(job), int(job.options.get("seed", 0)), _room(job))
    return document_of(job.robot, [Pose(row) for row in q])


def _cycles(job: JobInput, order: tuple[int, ...]) -> dict[str, Any]:
    """The same poses again and again; ``count`` cycles, pose_id the standard's number, session the cycle."""
    from core.design.iso9283 import five_poses

    q = five_poses(job.robot, seed=int(job.options.get("seed", 0)), region=_room(job))
    cycles = range(1, int(job.options.get("count", CYCLES_DEMANDED)) + 1)
    poses = [Pose(q[number - 1], pose_id=number, session=cycle) for cycle in cycles for number in order]
    return {**document_of(job.robot, poses), "cycles": len(cycles), "cycles_demanded": CYCLES_DEMANDED}


def _identify(job: JobInput, progress: Progress) -> dict[str, Any]:
    if job.options.get("method") == "iso9283":
        return _iso(job, progress)
    from core.design.d_optimal import d_optimal_poses

    rows = d_optimal_poses(
        _begin(job),
        _count(job),
        _made(job),
        float(job.options.get("noise_mm", NOISE_MM)) * 1e-3,
        int(job.options.get("seed", 0)),
        lambda fraction: progress(fraction, "choosing poses"),
        _region(job),
        _payloads(job.options),
    )
    return document_of(job.robot, poses_of(rows))


def _begin(job: JobInput) -> Calibration:
    from core.model import Calibration

    return job.calibration or Calibration.nominal(job.robot)


def _within(job: JobInput) -> str:
    """Where the poses are: within "campaigns", the robot's, or only within its "limits"."""
    chosen = job.options.get("within", WITHIN[0]) if job.driven is not None else WITHIN[1]
    return WITHIN[1] if job.options["purpose"] == "iso9283" or job.options.get("method") == "iso9283" else str(chosen)


def _region(job: JobInput) -> Region:
    """Where poses may be: as far as the arm was driven before unless ``within`` says limits, above floor, in the box."""
    from core.design.region import Region

    region = Region.of(_begin(job), job.driven if _within(job) == WITHIN[0] else None)
    floor = job.options.get("floor_mm")
    return region.above(None if floor is None else float(floor) * 1e-3).within(_box(job.options))


def _room(job: JobInput) -> Region | None:
    """The floor and the box alone, for the poses of the standard; None without either."""
    return _region(job) if {"floor_mm", "box_mm"} & set(job.options) else None


def _payloads(options: dict[str, Any]) -> list[float]:
    given = options.get("payloads_kg", [])
    if not isinstance(given, list) or not all(_is_number(v) and 0.0 <= v <= HEAVIEST_KG for v in given):
        raise OptionError(f"payloads_kg is {given!r}: give the loads at hand in kg, as [0, 5].", option="payloads_kg")
    return [float(v) for v in given]


def _number(name: str, value: Any) -> None:
    if value is not None and not _is_number(value):
        raise OptionError(f"{name} is {value!r}: give a number.", option=name)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _box(options: dict[str, Any]) -> Floats | None:
    """Lowest and highest corner (2, 3) m of the option ``box_mm``."""
    import numpy as np

    given = options.get("box_mm")
    if given is None:
        return None
    try:
        box = np.array(given, dtype=np.float64) * 1e-3
    except (TypeError, ValueError):
        box = np.empty(0)
    if box.shape != (2, 3) or not np.isfinite(box).all() or not (box[0] < box[1]).all():
        raise OptionError(
            "box_mm holds the lowest and the highest corner, as [[-200, 100, 0], [200, 400, 300]].", option="box_mm"
        )
    return box


def _made(job: JobInput) -> list[Effect]:
    from core.effects import make_effect

    return [make_effect(i, joints).on(job.robot) for i, joints in named_effects(job.options)]


def _separate(job: JobInput, progress: Progress) -> dict[str, Any]:
    """Poses that tell the two effects named apart, or what the hunt that made the version left undecided."""
    from core.gap import GapOptions, plan_separation
    from core.gap.plan import undecided
    from core.observations import Observations
    from service.campaigns.store import numbered

    wanted: list[Any] = list(named_effects(job.options))
    if not wanted:
        open_ = undecided(job.origin or {})
        if open_ is None:
            raise OptionError(
                "There is nothing to tell apart: name two effects, or a version of a hunt that left something undecided.",
                option="effects",
            )
        wanted = [named for named in open_ if named is not None]
    progress(0.1, "what was measured")
    noise = job.options.get("noise_mm")
    plan = plan_separation(
        job.robot,
        Observations.concatenate(numbered(job.campaigns.values())) if job.campaigns else None,
        wanted[0],
        wanted[1] if len(wanted) > 1 else None,
        _count(job),
        GapOptions(noise_mm=noise, seed=int(job.options.get("seed", 0))),
        job.calibration,
        _region(job),
    )
    about = {
        "separates": list(plan.labels),
        "correlation": round(plan.alike, 4),
        "proposals": [_about(p) for p in plan.proposals],
    }
    poses = [
        pose
        for p in plan.proposals
        for pose in poses_of(p.rows, p.kind, p.change or None, [after / max(p.before, 1e-12) for after in p.after])
    ]
    return {**document_of(job.robot, poses), **about}


def _about(p: Proposal) -> dict[str, Any]:
    return {
        "kind": p.kind, "change": p.change or None, "poses": len(p.rows),
        "information_factor": round(float(p.after[-1] / max(p.before, 1e-12)), 3),
    }  # fmt: skip


def _count(job: JobInput) -> int:
    return int(job.options.get("count", COUNTS[job.options["purpose"]]))


def _one_of(name: str, value: Any, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise OptionError(f"{name} is {value!r}: give one of {', '.join(allowed)}.", option=name)


def _whole(name: str, value: Any, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise OptionError(f"{name} is {value!r}: give a whole number from {low} to {high}.", option=name)


PLAN = JobKind("plan", check, run, version_option="version", needs_campaigns=False, history=True)
