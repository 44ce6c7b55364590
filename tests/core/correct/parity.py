"""Random setpoints through the C corrector and through the compiled kernels, millions of them: `tools.lab parity-c`.

Arms of every shape, every effect, three tasks, streams that wander and reverse (both sides of a play), jump and break off,
setpoints with motion and without. Printed are the largest difference of a joint where the search settled, and every setpoint
whose status or flags differ.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram, Track, compile_program
from tests.core.correct.c_corrector import Corrector, blob_of, built
from tests.core.correct.test_c_corrector import CARRIED_ON, HANGING, program_of
from tests.core.correct.twins import ARMS, twin
from tests.corrector.test_runtime_effects import ACTING

CYCLE_S = 0.01
RUN = 2000  # setpoints of one stream
SHOWN = 50  # setpoints that differ


def programs() -> Iterator[tuple[str, CorrectionProgram]]:
    """All programs that are compared, by name."""
    for name in sorted(ARMS):
        yield name, compile_program(twin(name).calibration)
    for task in ("position", "axis", "pose"):
        yield f"ur10 {task}", program_of("ur10", "clearance_tilt", "backlash_load", task=task)
    for k, effect in enumerate(ACTING):
        yield f"ur10 {effect}", program_of("ur10", effect, seed=k)
    for effects in HANGING:
        yield f"ur10 {' '.join(effects)} where it hangs", program_of("ur10", *effects, hanging=True, payload_kg=5.0)


def wandering(rng: np.random.Generator, joints: int) -> np.ndarray:
    """A stream that wanders, reverses and rests; now and then one setpoint is somewhere else (RUN, joints)."""
    steps = rng.normal(0, 0.001, (RUN, joints)) * (rng.random((RUN, 1)) < 0.9)
    velocity, bound = np.zeros(joints), rng.uniform(0.5, 2.9)
    q, out = rng.uniform(-0.5, 0.5, joints), np.empty((RUN, joints))
    for k in range(RUN):
        velocity = 0.95 * velocity + steps[k]
        q = np.clip(q + velocity, -bound, bound)
        out[k] = q if rng.random() > 0.002 else rng.uniform(-3.0, 3.0, joints)
    return out


class Compared:
    """What was seen."""

    def __init__(self) -> None:
        self.count = self.settled = self.differ = self.held_differ = 0
        self.worst_rad = self.worst_unsettled_rad = self.worst_own_rad = 0.0
        self.statuses: dict[int, int] = {}

    def stream(self, ours: Corrector, program: CorrectionProgram, rng: np.random.Generator) -> None:
        """Send one stream through both."""
        track, beside, q = Track(program), Track(program), wandering(rng, program.n_joints)
        rounded = np.nextafter(q, q + np.random.default_rng(0).choice([-1.0, 1.0], q.shape))
        motion = rng.random() < 0.5
        qd = np.gradient(q, CYCLE_S, axis=0)
        qdd, unsettled = np.gradient(qd, CYCLE_S, axis=0), -CARRIED_ON
        for k in range(len(q)):
            more = (qd[k], qdd[k]) if motion else ()
            status = track.step(np.concatenate([q[k], *more]), 1 + len(more), CYCLE_S)
            beside.step(np.concatenate([rounded[k], *more]), 1 + len(more), CYCLE_S)
            found, joints, answer = ours.correct(q[k], CYCLE_S, *map(np.ascontiguousarray, more))
            self.count += 1
            self.statuses[status] = self.statuses.get(status, 0) + 1
            same = (found, answer.flags, answer.limit_mask) == (status, int(track.info[0]), int(track.info[1]))
            self.differ += not same
            if not same and self.differ <= SHOWN:
                theirs = (status, int(track.info[0]), int(track.info[1]))
                mine = (found, answer.flags, answer.limit_mask)
                print(f"setpoint {k}, after {answer.rounds} rounds: {mine} in C, {theirs} in the kernels", flush=True)
            # Where a limit holds the correction, which joints it holds may hang on the last digit: the kernels themselves
            # answer 0.0005 rad apart then for joints one unit of rounding apart.
            held = (answer.flags | int(track.info[0])) & layout.SATURATED
            if held or answer.rounds >= program.array[-1, layout.ITERATIONS]:
                unsettled = k
            self.held_differ += not same and bool(held)
            if status == layout.OK and found == status:
                apart = float(np.abs(joints - track.out).max())
                if k - unsettled >= CARRIED_ON:
                    self.settled, self.worst_rad = self.settled + 1, max(self.worst_rad, apart)
                    self.worst_own_rad = max(self.worst_own_rad, float(np.abs(beside.out - track.out).max()))
                else:
                    self.worst_unsettled_rad = max(self.worst_unsettled_rad, apart)


def main() -> None:
    """Compare, and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=1e9, help="end then at the latest")
    options = parser.parse_args()
    rng, seen, begun = np.random.default_rng(options.seed), Compared(), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        library = built(Path(folder))
        known = list(programs())
        while seen.count < options.count:
            for name, program in known:
                ours = Corrector(library, blob_of(program))
                before, worst = seen.differ, seen.worst_rad
                seen.stream(ours, program, rng)
                if seen.differ > before or seen.worst_rad > max(worst, 1e-12):
                    print(
                        f"{name}: {seen.differ - before} differ in status or flags, worst {seen.worst_rad:.2e} rad",
                        flush=True,
                    )
                if seen.count >= options.count or time.monotonic() - begun > 60 * options.minutes:
                    options.count = 0
                    break
    print(
        f"{seen.count} setpoints of {len(known)} programs in {time.monotonic() - begun:.0f} s, by status {seen.statuses}"
    )
    print(
        f"{seen.settled} settled: at most {seen.worst_rad:.2e} rad apart, the kernels {seen.worst_own_rad:.2e} from "
        f"themselves; the others {seen.worst_unsettled_rad:.2e} rad"
    )
    print(f"{seen.differ} with another status or other flags, {seen.held_differ} of them where a limit held")


if __name__ == "__main__":
    main()
