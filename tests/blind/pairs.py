"""The same campaigns with right masses, wrong ones, and wrong ones that a log of torques tells: ``python -m
tests.blind.pairs``. The first and the last must come to the same.

Effects whose sign or direction follows a load moment: where it is near zero, wrong masses turn it round.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from kilter_core.arm import Robot
from kilter_core.motion import find_missing_torque
from kilter_core.observations import Observations
from tests.blind.claims import empirical, found, right, sure
from tests.blind.generator import Campaign, Case, Hidden, Options, generate
from tests.blind.generator.arms import ARMS, Drawn
from tests.blind.generator.cases import joints_for
from tests.blind.run import RECORDS, hunted, run
from tests.blind.score import Record
from tests.blind.to_core import robot_of
from tests.core.motion.moving_arm import Logger
from tests.core.truth import Arm, Body, Step

EFFECTS = ("clearance_tilt", "backlash_load")
ROUNDS = 3  # pairs of each effect and arm
FIRST = 2  # joints further out are tried first: the load on the inner ones seldom comes near zero
POSES = 118
LAMS = (100_000.0, 20_000.0, 3000.0)  # by round: play of a tenth of a degree, a twentieth, a fiftieth or so
RIGHT, WRONG, TOLD = "right", "wrong", "told"
HEAD = "| masses | cases | named exactly | closed | extra wrong names | unknown shapes | confirmed but wrong |"


def pairs(seed: int = 0, rounds: int = ROUNDS, mass_error: float = 0.1, com_error_mm: float = 5.0) -> Iterator[Case]:
    """Yield every case thrice: masses as they are, and off by up to a share and its centres by up to some mm, untold and told.

    Nothing else differs: what the user believes of the masses changes no reading.
    """
    for n in range(rounds):
        for effect in EFFECTS:
            for a, robot in enumerate(ARMS):
                joints = joints_for(effect, robot)
                first = (n + FIRST) % len(joints)
                turned = joints[first:] + joints[:first]
                sets = tuple((Hidden(effect, (j,)),) for j in turned)
                number = 1000 * seed + 100 * n + 10 * EFFECTS.index(effect) + a
                case = Case(
                    "", robot, sets[0], (LAMS[n % len(LAMS)],), POSES, Options(), "named", number, (), True, sets[1:]
                )
                off = Options(mass_error=mass_error, com_error_mm=com_error_mm)
                name = f"{n}-{effect}-{robot}"
                yield replace(case, name=f"{RIGHT}-{name}")
                for side in (WRONG, TOLD):
                    yield replace(case, name=f"{side}-{mass_error:g}-{com_error_mm:g}-{name}", options=off)


def run_side(case: Case) -> dict[str, Any]:
    """Let the finder at a case; where masses are told, with what a log of its moving arm says of them."""
    return hunted(generate(case), case.name, describe=robot_told if case.name.startswith(TOLD) else robot_of)


def robot_told(campaign: Campaign) -> Robot:
    """Kilter's robot with the masses of its user, and what torques say of them: those of the true arm, by Pinocchio."""
    robot, drawn = robot_of(campaign), ARMS[campaign.case.robot]()
    log = Logger(moving(drawn), seed=campaign.case.seed).log()
    report = find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"]))
    return replace(robot, told_loads=report.model.loads)


def moving(drawn: Drawn) -> Arm:
    """The arm as drawn, with masses that move: thin boxes about their centres."""
    number = iter(range(drawn.n))
    steps = tuple(
        Step("rz", 0.0, next(number))
        if axis == "joint"
        else Step(axis.lower(), np.radians(amount) if axis[0] == "R" else amount * 1e-3)
        for axis, amount in drawn.steps
    )
    bodies = tuple(
        Body(j, float(m), c, pin.Inertia.FromBox(float(m), 0.1, 0.08, 0.05).inertia)
        for j, (m, c) in enumerate(zip(drawn.mass, drawn.com, strict=True))
    )
    return Arm(steps, drawn.n, bodies=bodies)


def table(records: Sequence[Record]) -> str:
    """Both sides of the pairs, one row each."""
    sides = {side: [r for r in records if r["name"].startswith(side)] for side in (RIGHT, WRONG, TOLD)}
    rows = [_row(side, [r for r in found if r["report"] is not None]) for side, found in sides.items()]
    return "\n".join([HEAD, "|---" * 7 + "|", *rows])


def _row(side: str, records: Sequence[Record]) -> str:
    named = sum(all(found(r["report"], h) for h in r["truth"]["effects"]) for r in records)
    closed = sum(r["report"]["verdict"] == "closed" for r in records)
    effects = [(e, r["truth"]) for r in records for e in r["report"]["effects"]]
    extra = sum(not empirical(e) and not right(e, t) for e, t in effects)
    shapes = sum(empirical(e) for e, _ in effects)
    lies = sum(not right(e, r["truth"]) for r in records for e in sure(r["report"]["effects"]))
    return f"| {side} | {len(records)} | {named} | {closed} | {extra} | {shapes} | {lies} |"


def main() -> None:
    """Run both sides and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="pairs of each effect and arm")
    parser.add_argument("--mass-error", type=float, default=0.1, help="share by which masses are off")
    parser.add_argument("--com-error-mm", type=float, default=5.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--records", type=Path, default=None, help="file of records; a run goes on from what it holds")
    asked = parser.parse_args()
    wanted = list(pairs(asked.seed, asked.rounds, asked.mass_error, asked.com_error_mm))
    path = asked.records or RECORDS / f"blind-pairs-{asked.seed}.jsonl"
    print(table(run(wanted, path, asked.processes, run_side)))


if __name__ == "__main__":
    main()
