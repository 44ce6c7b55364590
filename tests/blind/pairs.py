"""The same campaigns with right and with wrong masses: ``python -m tests.blind.pairs``. The two must come to the same.

Effects whose sign or direction follows a load moment: where it is near zero, wrong masses turn it round.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tests.blind.claims import empirical, found, right, sure
from tests.blind.generator import Case, Hidden, Options
from tests.blind.generator.arms import ARMS
from tests.blind.generator.cases import joints_for
from tests.blind.run import RECORDS, run
from tests.blind.score import Record

EFFECTS = ("clearance_tilt", "backlash_load")
ROUNDS = 3  # pairs of each effect and arm
FIRST = 2  # joints further out are tried first: the load on the inner ones seldom comes near zero
POSES = 118
LAMS = (100_000.0, 20_000.0, 3000.0)  # by round: play of a tenth of a degree, a twentieth, a fiftieth or so
RIGHT, WRONG = "right", "wrong"
HEAD = "| masses | cases | named exactly | closed | extra wrong names | unknown shapes | confirmed but wrong |"


def pairs(seed: int = 0, rounds: int = ROUNDS, mass_error: float = 0.1, com_error_mm: float = 5.0) -> Iterator[Case]:
    """Yield every case twice: masses as they are, and off by up to a share and its centres by up to some mm.

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
                yield replace(case, name=f"{WRONG}-{mass_error:g}-{com_error_mm:g}-{name}", options=off)


def table(records: Sequence[Record]) -> str:
    """Both sides of the pairs, one row each."""
    sides = {side: [r for r in records if r["name"].startswith(side)] for side in (RIGHT, WRONG)}
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
    print(table(run(wanted, path, asked.processes)))


if __name__ == "__main__":
    main()
