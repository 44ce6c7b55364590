"""The sampler: what is hidden in which arm, how it is measured, and what an honest finder would say."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tests.blind.generator.arms import ARMS
from tests.blind.generator.physics import PER_JOINT
from tests.blind.generator.visits import Options

Rng = np.random.Generator


@dataclass(frozen=True)
class Hidden:
    """An effect by id; ``joints`` from 0, empty for the whole arm (for a coupling: driven joint, driver)."""

    id: str
    joints: tuple[int, ...] = ()


@dataclass(frozen=True)
class Case:
    """One blind run. ``lam`` is the non-centrality of each hidden effect after geometry.

    ``expectation``: "no_gap" (nothing to name), "named", "outside" (nothing may be confirmed), "undecidable" (the
    effects ``undecidable`` are there, or could be, and no honest finder can tell).
    """

    name: str
    robot: str
    hidden: tuple[Hidden, ...]
    lam: tuple[float, ...]
    poses: int
    options: Options
    expectation: str
    seed: int
    undecidable: tuple[Hidden, ...] = field(default=())


# Twenty-five cases in the proportions of the benchmark: two fifths hide nothing.
PATTERN = (
    "none", "one", "none", "outside", "two", "none", "all", "undecidable", "none", "one", "decoy", "three", "none",
    "outside", "one", "none", "two", "undecidable", "none", "all", "decoy", "outside", "one", "none", "two",
)  # fmt: skip

UPRIGHT_BLIND = {"axial_compliance", "backlash_load"}  # gravity has no moment about joint 1
LOCAL = (
    *PER_JOINT, "joint_coupling", "gravity_spring", "base_compliance", "thermal_growth", "drift", "session_shift",
)  # fmt: skip
FAMILIES = tuple(PER_JOINT)


def cases(seed: int, n: int, poses: tuple[int, ...] = (30, 60, 118)) -> Iterator[Case]:
    """Yield ``n`` cases; case k is the same for every ``n``. ``poses`` are the counts to choose from."""
    for k in range(n):
        rng = np.random.default_rng([seed, k])
        kind = PATTERN[k % len(PATTERN)]
        robot = str(rng.choice(list(ARMS)))
        case = Case(
            "", robot, (), (), int(rng.choice([30, 60, 118])), _conditions(rng), "no_gap", int(rng.integers(2**31))
        )
        made = KINDS[kind](case, rng)
        yield replace(made, name=f"{k:04d}-{kind}-{robot}-{made.poses}")


def _conditions(rng: Rng) -> Options:
    return Options(
        approach=str(rng.choice(["random", "random", "path"])),
        payload=str(rng.choice(["two", "two", "one"])),
        temperature=str(rng.choice(["constant", "cycling"])),
        sessions=int(rng.choice([1, 2])),
        revisited=float(rng.choice([0.3, 0.5])),
        wrong_masses=bool(rng.uniform() < 0.4),
        outliers=float(rng.choice([0.0, 0.0, 0.015])),
        angle_urad=float(rng.uniform(2.0, 5.0)),
        approach_um=float(rng.uniform(4.0, 12.0)),
    )


def _none(case: Case, rng: Rng) -> Case:
    return case


def _some(count: int) -> Callable[[Case, Rng], Case]:
    def make(case: Case, rng: Rng) -> Case:
        ids = [str(i) for i in rng.choice(LOCAL, count, replace=False)]
        if {"backlash", "friction_windup"} <= set(ids):
            ids = [i for i in ids if i != "friction_windup"] + ["eccentricity"]
        ids = list(dict.fromkeys(ids))
        return _hiding(case, tuple(_placed(i, case.robot, rng) for i in ids), rng)

    return make


def _all(case: Case, rng: Rng) -> Case:
    effect = str(rng.choice(FAMILIES))
    return _hiding(case, (Hidden(effect, tuple(joints_for(effect, case.robot))),), rng)


def _hiding(case: Case, hidden: tuple[Hidden, ...], rng: Rng) -> Case:
    lam = tuple(float(np.exp(rng.uniform(np.log(15.0), np.log(1000.0)))) for _ in hidden)
    options = case.options
    if any(h.id == "thermal_growth" for h in hidden):
        options = replace(options, temperature="cycling")
    if any(h.id == "session_shift" for h in hidden):
        options = replace(options, sessions=2)
    return replace(case, hidden=hidden, lam=lam, options=options, expectation="named")


def joints_for(effect: str, robot: str) -> list[int]:
    """Joints at which an effect can show at all."""
    if effect == "link_bending":
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


def _outside(case: Case, rng: Rng) -> Case:
    shape = str(rng.choice(["third_harmonic", "local_bump", "sine_product", "workspace_field", "stick_slip"]))
    n = ARMS[case.robot]().n
    joint = int(rng.integers(0, n - 1))
    joints = {"workspace_field": (), "sine_product": (joint, joint + 1)}.get(shape, (joint,))
    hidden = (Hidden(shape, joints),)
    return replace(_hiding(case, hidden, rng), expectation="outside")


def _undecidable(case: Case, rng: Rng) -> Case:
    kind = str(rng.choice(["one_sided", "scale", "bending", "spring"]))
    lam = float(np.exp(rng.uniform(np.log(40.0), np.log(300.0))))
    options = case.options
    if kind == "one_sided":
        joint = int(rng.integers(0, ARMS[case.robot]().n))
        pair, options = [Hidden("backlash", (joint,))], replace(options, approach="one_sided")
    elif kind == "scale":
        pair = [Hidden("measurement_scale")]
    elif kind == "bending":
        # The elbow arm's first link is short: its bending turns the arm as its second joint does.
        pair = [Hidden("axial_compliance", (1,)), Hidden("link_bending", (0,))]
        case, options = replace(case, robot="elbow"), replace(options, payload="one")
    else:
        pair = [Hidden("gravity_spring", (1,)), Hidden("eccentricity", (1,))]
    case = replace(case, hidden=(pair[0],), lam=(lam,), options=options)
    return replace(case, expectation="undecidable", undecidable=tuple(pair))


def _decoy(case: Case, rng: Rng) -> Case:
    """Conditions that go along with pose or time although nothing depends on them."""
    options = replace(case.options, payload="correlated", temperature="warming", sessions=2)
    return replace(case, options=options)


KINDS: dict[str, Callable[[Case, Rng], Case]] = {
    "none": _none, "decoy": _decoy, "one": _some(1), "two": _some(2), "three": _some(3), "all": _all,
    "outside": _outside, "undecidable": _undecidable,
}  # fmt: skip
