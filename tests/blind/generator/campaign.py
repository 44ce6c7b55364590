"""From a case to what Kilter gets (a robot document and columns) and what is kept from it (the truth)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator import tracker
from tests.blind.generator.arm import Arm, Deflection, built
from tests.blind.generator.arms import ARMS
from tests.blind.generator.background import IDS, background_of, pooled, scaled_to
from tests.blind.generator.beliefs import believed, hung, told
from tests.blind.generator.case import Case, Hidden, fitting
from tests.blind.generator.causes import payload_error, random_walk, settling
from tests.blind.generator.columns import columns_of
from tests.blind.generator.library import LIBRARY
from tests.blind.generator.outside import OUTSIDE
from tests.blind.generator.physics import Physics
from tests.blind.generator.rigid import motion
from tests.blind.generator.sizing import Lens, displacement, sized
from tests.blind.generator.truth import DECIDABLE, STRONG, Acting, Background, Truth, TruthEffect, size_mm, sized_up
from tests.blind.generator.twins import TWINS
from tests.blind.generator.visits import Visits, plan

Floats = NDArray[np.float64]
UNSETTLED = 3.0  # lambda (1 - rho) up to which two names stay a toss-up: wrong one time in nine at best
ENOUGH = 1.3  # an effect that must be decidable is made larger by this than it must be
MOST_LAM = 5000.0
SECOND_POSES = 45


@dataclass(frozen=True)
class Campaign:
    """A robot document, observation columns of the contract (name -> array), and the truth about them.

    ``confirmation`` holds the columns of a second campaign of the same arm: other poses, payload, tool and tracker.
    ``case`` is the one that was made: what it hides was chosen among the alternatives of the one asked for.
    """

    case: Case
    document: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    truth: Truth
    confirmation: dict[str, NDArray[Any]] | None = None


@dataclass(frozen=True)
class _Scene:
    case: Case
    arm: Arm
    visits: Visits
    covariance: Floats
    lens: Lens
    rng: np.random.Generator


def generate(case: Case) -> Campaign:
    """Build the arm, measure it, and size what is hidden in it; the same case gives the same numbers.

    Of a case that must be decidable the first alternative is made that can be, its effects as large as that takes.
    """
    for hidden in (case.hidden, *case.alternatives):
        one = replace(case, hidden=hidden, lam=case.lam[: len(hidden)], options=fitting(case.options, hidden))
        scene, acting, effects = _staged(one)
        if case.demanded and not all(e.decidable for e in effects):
            larger = _larger(one, effects)
            if larger is None:
                continue
            one = replace(one, lam=larger)
            scene, acting, effects = _staged(one)
        if not case.demanded or all(e.decidable for e in effects):
            break
    return _measured(replace(scene, case=replace(one, alternatives=(), demanded=False)), acting, effects)


def _staged(case: Case) -> tuple[_Scene, list[Acting], list[TruthEffect]]:
    scene = _scene(case)
    acting = _acting(scene)
    slow = _slow(scene)
    behind = slow if case.options.background != "walk" else random_walk(scene.arm, scene.visits, ())
    return scene, acting, sized_up(scene.arm, scene.visits, scene.lens, acting, behind)


def _larger(case: Case, effects: list[TruthEffect]) -> tuple[float, ...] | None:
    """Sizes that make every effect decidable, None where an effect is too much like another for that."""
    out = []
    for asked, e in zip(case.lam, effects, strict=True):
        needed = max(STRONG, DECIDABLE / max(1.0 - e.rho, 1e-9)) * ENOUGH
        out.append(asked * max(1.0, needed / max(e.lam_partial, 1e-9)))
    return tuple(out) if max(out) < max(MOST_LAM, *case.lam) * 1.01 else None


def _scene(case: Case) -> _Scene:
    rng, options = np.random.default_rng(case.seed), case.options
    arm = built(ARMS[case.robot](), rng, options.foot_m, options.lean_deg)
    arm = replace(arm, hung=hung(options, _apart(case, "hung")))
    visits = plan(arm, case.poses, options, rng)
    covariance = tracker.visit_covariance(arm.positions(visits.q), options)
    return _Scene(case, arm, visits, covariance, Lens.of(arm, visits, covariance), rng)


def _apart(case: Case, what: str) -> np.random.Generator:
    """Chance of its own, so that one draw more or less leaves the others as they were."""
    return np.random.default_rng([case.seed, *what.encode()])


def _acting(scene: _Scene) -> list[Acting]:
    """Every hidden effect with amplitudes of the size asked for."""
    out: list[Acting] = []
    for k, (h, lam) in enumerate(zip(scene.case.hidden, scene.case.lam, strict=True)):
        physics = physics_of(h, scene.arm, scene.visits, _apart(scene.case, f"shape {k}"), out)
        out.append(Acting(h.id, h.joints, physics, _amplitudes(scene, h, physics, lam)))
    return _stiff_enough(scene, out)


def physics_of(
    hidden: Hidden, arm: Arm, visits: Visits, rng: np.random.Generator, beside: list[Acting] | None = None
) -> Physics:
    """The physics of an effect, of the library or outside it; a wrong payload shows by a compliance ``beside`` it."""
    if hidden.id in OUTSIDE or hidden.id in TWINS:
        return (OUTSIDE | TWINS)[hidden.id](arm, visits, hidden.joints, rng)
    if hidden.id == "settling":
        return settling(arm, visits, (), rng.uniform(0.1, 0.5))
    if hidden.id == "random_walk":
        return random_walk(arm, visits, (), rng)
    if hidden.id == "payload_error":
        soft = next(a for a in beside or () if a.id == "axial_compliance")
        return payload_error(arm, visits, soft.joints, float(soft.values[0]))
    return LIBRARY[hidden.id](arm, visits, hidden.joints)


# What geometry swallows whole cannot be sized by what is left of it: amplitudes as real arms and trackers have them.
SWALLOWED = {"measurement_scale": 5e-5, "backlash": np.radians(0.03)}
HEAVIEST = 0.8  # of the payload: no user errs by more


def _amplitudes(scene: _Scene, hidden: Hidden, physics: Physics, lam: float) -> Floats:
    one_sided = hidden.id == "backlash" and scene.case.options.approach == "one_sided"
    if one_sided or hidden.id == "measurement_scale":
        return np.full(len(physics.names), -SWALLOWED[hidden.id])
    values = sized(scene.arm, scene.visits, scene.lens, physics, lam, scene.rng)
    if hidden.id == "payload_error":
        most = HEAVIEST * scene.arm.drawn.payload_kg
        return np.clip(values, -most, most)
    return -np.abs(values) if hidden.id == "backlash" else values


def _stiff_enough(scene: _Scene, acting: list[Acting]) -> list[Acting]:
    """Let no gear that hardens give way backwards: its compliance outweighs the hardening at the largest load."""
    hard = {a.joints: a for a in acting if a.id == "hardening"}
    out = []
    for a in acting:
        if a.id == "axial_compliance" and a.joints in hard:
            most = np.abs(scene.visits.load.moment[:, list(a.joints), 2]).max(axis=0)
            a = replace(a, values=np.maximum(a.values, 2.0 * hard[a.joints].values * most))
        out.append(a)
    return out


def _slow(scene: _Scene) -> Physics | None:
    kind = scene.case.options.background
    return background_of(kind, scene.arm, scene.visits, _apart(scene.case, "background")) if kind else None


def _measured(scene: _Scene, acting: list[Acting], effects: list[TruthEffect]) -> Campaign:
    """Read the moving, deflected arm, and write down what is told and what is true."""
    case, options = scene.case, scene.case.options
    columns, wrong, background = _read(scene, acting)
    undecidable = tuple((h.id, tuple(j + 1 for j in h.joints)) for h in case.undecidable)
    settled = len(undecidable) > 1 and _settled(effects[0], undecidable[1])
    truth = Truth(
        effects=tuple(effects),
        expectation="named" if settled else case.expectation,
        undecidable=() if settled else undecidable,
        background=background,
        mass_error=options.mass_error,
        payload_wrong=bool(options.payload_error or options.payload_offset_mm),
        noise_mm=float(np.sqrt(np.mean(np.trace(scene.covariance, axis1=1, axis2=2)))) * 1e3,
        outlier_rows=wrong,
    )
    second = _read(_second(scene), _again(scene, acting))[0] if options.confirmation else None
    document = believed(scene.arm.drawn, options, _apart(case, "masses"))
    return Campaign(case, document, columns, truth, second)


def _read(scene: _Scene, acting: list[Acting]) -> tuple[dict[str, NDArray[Any]], tuple[int, ...], Background | None]:
    arm, visits, options = scene.arm, scene.visits, scene.case.options
    total = Deflection.none(len(visits), arm.n)
    for a in acting:
        a.physics.act(a.values, total)
    slow, background = _slow(scene), None
    if slow is not None:
        values, background = _moving(scene, slow)
        slow.act(values, total)
    readings, wrong = tracker.read(arm.positions(visits.q, total), options, scene.rng, visits.approach)
    kg = told(visits.payload_kg, options, _apart(scene.case, "told"))
    columns, order = columns_of(visits, readings, kg, options.shot_gap_s)
    return columns, tuple(int(i) for i in np.flatnonzero(wrong.reshape(-1)[order])), background


def _moving(scene: _Scene, slow: Physics) -> tuple[Floats, Background]:
    """Amplitudes with which the background makes repeats scatter as much too much as asked."""
    arm, visits, options = scene.arm, scene.visits, scene.case.options
    rng = _apart(scene.case, "background size")
    values = slow.typical * rng.uniform(0.5, 1.5, len(slow.typical)) * rng.choice([-1.0, 1.0], len(slow.typical))
    variance = float(np.mean(np.trace(scene.covariance, axis1=1, axis2=2)))
    values = values * scaled_to(displacement(arm, visits, slow, values), visits, variance, options.overstated)
    moved = displacement(arm, visits, slow, values)
    overstated = float(np.sqrt(1.0 + pooled(moved, visits) / variance))
    lam = float(np.sum(scene.lens.left(moved) ** 2))
    kind = options.background
    return values, Background(kind, IDS.get(kind), lam, overstated, size_mm(moved))


def _second(scene: _Scene) -> _Scene:
    """The same arm on another day: the tracker elsewhere, the reflector elsewhere on the tool, half the payload."""
    case = replace(scene.case, seed=scene.case.seed ^ 0x5EC0)
    rng = np.random.default_rng(case.seed)
    other = built(scene.arm.drawn, rng, scene.case.options.foot_m)
    put = motion(rng.uniform(-15e-3, 15e-3, 3), np.zeros(3))
    placements = np.concatenate([scene.arm.placements[:-1], (scene.arm.placements[-1] @ put)[None]])
    drawn = replace(scene.arm.drawn, payload_kg=0.5 * scene.arm.drawn.payload_kg)
    arm = replace(scene.arm, drawn=drawn, placements=placements, foot=other.foot)
    visits = plan(arm, SECOND_POSES, case.options, rng)
    covariance = tracker.visit_covariance(arm.positions(visits.q), case.options)
    return _Scene(case, arm, visits, covariance, Lens.of(arm, visits, covariance), rng)


def _again(scene: _Scene, acting: list[Acting]) -> list[Acting]:
    """The same effects, of the same size, in the second campaign."""
    second, out = _second(scene), list[Acting]()
    for k, a in enumerate(acting):
        shape = _apart(scene.case, f"shape {k}")
        physics = physics_of(Hidden(a.id, a.joints), second.arm, second.visits, shape, out)
        out.append(replace(a, physics=physics))
    return out


def _settled(effect: TruthEffect, other: tuple[str, tuple[int, ...]]) -> bool:
    """Whether the data of these poses tell an effect from its alias after all."""
    rho = max((r.rho for r in effect.rivals if (r.id, r.joints) == other), default=0.0)
    return effect.lam_partial * (1.0 - rho) > UNSETTLED
