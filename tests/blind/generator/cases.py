"""The sampler: what is hidden in which arm, how it is measured, and what an honest finder would say."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from tests.blind.generator.arms import ARMS
from tests.blind.generator.background import KINDS as BACKGROUNDS
from tests.blind.generator.case import Case, Hidden
from tests.blind.generator.conditions import conditions, drifting
from tests.blind.generator.library import PER_JOINT
from tests.blind.generator.outside import OUTSIDE, SMOOTH
from tests.blind.generator.twins import TWINS

Rng = np.random.Generator

# Fifty cases in the proportions of the benchmark. Two fifths hide nothing in the arm; a third of those drift.
PATTERN = (
    "none", "one", "two", "three", "drifting", "one", "none", "two", "three", "outside",
    "none", "one", "decoy", "two", "three", "drifting", "none", "one", "two", "three",
    "smooth", "none", "drifting", "one", "two", "three", "none", "free", "decoy", "one",
    "drifting", "two", "three", "none", "smooth", "one", "two", "drifting", "none", "three",
    "one", "undecidable", "none", "two", "drifting", "three", "decoy", "smooth", "none", "drifting",
)  # fmt: skip

UPRIGHT_BLIND = {"axial_compliance", "backlash_load", "hardening", "direction_compliance"}  # gravity turns no joint 1
PARTNERED = {"hardening", "payload_error"}  # seen beside a compliance only
LOCAL = (
    *(e for e in PER_JOINT if e not in PARTNERED), "joint_coupling", "base_compliance", "thermal_growth", "drift",
    "session_shift", "settling", "random_walk", "column_bending", "tool_sag",
)  # fmt: skip
FAMILIES = ("clearance_tilt", "backlash", "backlash_load", "axial_compliance", "radial_compliance", "eccentricity",
            "second_harmonic", "gear_error", "encoder_scale", "link_bending", "friction_windup")  # fmt: skip
ALTERNATIVES = 5
FAMILY_SHARE, PARTNER_SHARE, SLOW_SHARE = 0.15, 0.15, 0.1
SLOW = ("linear", "settling", "walk", "column")
OF_TIME = {"drift", "settling", "random_walk", "column_bending", "zero_drift"}


def cases(seed: int, n: int, poses: tuple[int, ...] = (30, 60, 118)) -> Iterator[Case]:
    """Yield ``n`` cases; case k is the same for every ``n``. ``poses`` are the counts to choose from."""
    for k in range(n):
        yield _case(PATTERN[k % len(PATTERN)], k, np.random.default_rng([seed, k]), poses)


def twin_cases(seed: int, n: int, poses: tuple[int, ...] = (30, 60, 118)) -> Iterator[Case]:
    """Yield ``n`` cases that hide the twin of a member of the library; they stand beside those of ``cases``."""
    for k in range(n):
        yield _case("twin", k, np.random.default_rng([seed, k, *b"twin"]), poses)


def _case(kind: str, k: int, rng: Rng, poses: tuple[int, ...]) -> Case:
    """Case k of a kind, with its name."""
    robot, count = str(rng.choice(list(ARMS))), int(rng.choice(poses))
    options = conditions(rng, ARMS[robot]().n)
    made = KINDS[kind](Case("", robot, (), (), count, options, "no_gap", int(rng.integers(2**31))), rng)
    return replace(made, name=f"{k:04d}-{kind}-{made.robot}-{made.poses}")


def _none(case: Case, rng: Rng) -> Case:
    return case


def _decoy(case: Case, rng: Rng) -> Case:
    """Conditions that go along with pose or time although nothing depends on them."""
    return replace(case, options=replace(case.options, payload="correlated", temperature="warming", sessions=2))


def _drifting(case: Case, rng: Rng) -> Case:
    """Base or instrument move slowly, so that repeats pooled over the campaign overstate the noise."""
    return replace(case, options=drifting(case.options, str(rng.choice(BACKGROUNDS)), rng.uniform(1.4, 5.0)))


def _set(count: int) -> Callable[[Case, Rng], Case]:
    """So many effects, each of which can be seen and told from its rivals."""

    def make(case: Case, rng: Rng) -> Case:
        sets = tuple(_hidden(count, case.robot, rng) for _ in range(ALTERNATIVES))
        if rng.uniform() < SLOW_SHARE and not any(h.id in OF_TIME for hidden in sets for h in hidden):
            options = drifting(case.options, str(rng.choice(SLOW)), rng.uniform(1.4, 3.0))
            case = replace(case, options=options)
        lam = _sizes(rng, 3, 40.0)
        return replace(
            case, hidden=sets[0], alternatives=sets[1:], lam=lam, expectation="named", demanded=True
        )  # fmt: skip

    return make


def _sizes(rng: Rng, count: int, least: float) -> tuple[float, ...]:
    return tuple(float(np.exp(rng.uniform(np.log(least), np.log(1000.0)))) for _ in range(count))


def _hidden(count: int, robot: str, rng: Rng) -> tuple[Hidden, ...]:
    if count == 1 and rng.uniform() < FAMILY_SHARE:
        effect = str(rng.choice(FAMILIES))
        return (Hidden(effect, tuple(joints_for(effect, robot))),)
    found: list[Hidden] = []
    if count > 1 and rng.uniform() < PARTNER_SHARE:
        soft = _placed("axial_compliance", robot, rng)
        second = str(rng.choice(sorted(PARTNERED)))
        found = [soft, Hidden(second, soft.joints if second == "hardening" else ())]
    taken = {h.id for h in found} | ({"axial_compliance"} if found else set())
    for effect in rng.permutation(LOCAL):
        if len(found) == count:
            break
        twin = {"backlash": "friction_windup", "friction_windup": "backlash"}.get(str(effect), "")
        if effect not in taken and twin not in taken:
            found.append(_placed(str(effect), robot, rng))
            taken.add(str(effect))
    return tuple(found)


def joints_for(effect: str, robot: str) -> list[int]:
    """Joints at which an effect can show at all."""
    if effect in ("link_bending", "link_growth"):
        return list(ARMS[robot]().links)
    n = ARMS[robot]().n
    return list(range(1 if effect in UPRIGHT_BLIND else 0, n))


def _placed(effect: str, robot: str, rng: Rng) -> Hidden:
    if effect == "joint_coupling":
        n = ARMS[robot]().n
        driver = int(rng.integers(n - 3, n - 1))
        return Hidden(effect, (driver + 1, driver))
    if effect == "gravity_spring":
        return Hidden(effect, (1,))
    if effect not in PER_JOINT:
        return Hidden(effect)
    return Hidden(effect, (int(rng.choice(joints_for(effect, robot))),))


def _free(case: Case, rng: Rng) -> Case:
    """Any effects of any size: many that cannot be seen or told."""
    ids = rng.choice([*LOCAL, "gravity_spring"], int(rng.integers(1, 4)), replace=False)
    hidden = tuple(_placed(str(i), case.robot, rng) for i in ids if i != "friction_windup" or "backlash" not in ids)
    return replace(case, hidden=hidden, lam=_sizes(rng, len(hidden), 15.0), expectation="named")


def _beyond(shapes: tuple[str, ...]) -> Callable[[Case, Rng], Case]:
    def make(case: Case, rng: Rng) -> Case:
        shape = str(rng.choice(shapes))
        joint = int(rng.integers(0, ARMS[case.robot]().n - 1))
        whole = ("workspace_field", "azimuth_error")
        joints = () if shape in whole else (joint, joint + 1) if shape == "sine_product" else (joint,)
        return replace(case, hidden=(Hidden(shape, joints),), lam=_sizes(rng, 1, 15.0), expectation="outside")

    return make


def _twin(case: Case, rng: Rng) -> Case:
    """What follows a clock as a member of the library does, and is none: that it did so may be said, and not where."""
    cause = str(rng.choice(list(TWINS)))
    links = list(ARMS[case.robot]().links)
    joints = {"air_scale": (), "zero_settling": (int(rng.integers(1, ARMS[case.robot]().n - 1)),)}
    where = joints.get(cause, (int(rng.choice(links)),))
    return replace(case, hidden=(Hidden(cause, where),), lam=_sizes(rng, 1, 100.0), expectation="outside")


def _undecidable(case: Case, rng: Rng) -> Case:
    kind = str(rng.choice(["one_sided", "scale", "bending", "spring", "vertical"]))
    options = case.options
    if kind == "one_sided":
        joint = int(rng.integers(0, ARMS[case.robot]().n))
        pair, options = [Hidden("backlash", (joint,))], replace(options, approach="one_sided")
    elif kind == "scale":
        pair = [Hidden("measurement_scale")]
    elif kind == "bending":
        # The elbow arm's first link is short: its bending turns the arm as its second joint does.
        pair = [Hidden("axial_compliance", (1,)), Hidden("link_bending", (0,))]
        case, options = replace(case, robot="elbow"), replace(options, payload="one", restricted=())
    elif kind == "vertical":
        # A zero of the first joint that drifts turns the arm as a foot does that turns.
        pair = [Hidden("zero_drift", (0,)), Hidden("drift")]
    else:
        pair = [Hidden("gravity_spring", (1,)), Hidden("eccentricity", (1,))]
    lam = (float(np.exp(rng.uniform(np.log(40.0), np.log(300.0)))),)
    case = replace(case, hidden=(pair[0],), lam=lam, options=options)
    return replace(case, expectation="undecidable", undecidable=tuple(pair))


KINDS: dict[str, Callable[[Case, Rng], Case]] = {
    "none": _none, "decoy": _decoy, "drifting": _drifting, "one": _set(1), "two": _set(2), "three": _set(3),
    "free": _free, "outside": _beyond(tuple(e for e in OUTSIDE if e not in SMOOTH)), "smooth": _beyond(tuple(SMOOTH)),
    "twin": _twin, "undecidable": _undecidable,
}  # fmt: skip
