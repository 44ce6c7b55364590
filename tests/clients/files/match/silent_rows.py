"""Whether a wrong row goes in silence: simulated recordings through the client's checks, counted against the truth."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from kilter_client import FileError
from kilter_files.match.clock_checks import Checks
from kilter_files.match.matching import frame_rows, match_dwells, match_frames
from kilter_files.match.rigid_body import Arm, arm_from_check
from kilter_files.tables.recording import Block, Recording
from kilter_files.tables.table import JointLog
from tests.clients.files.match.campaign_generator import Jump, Knock, Made, Plan, document, make, schedule, turn_of

SIZES_S = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.1, 4.0, 5.0, 6.2, 9.3, 10.0)
KNOCKS_MM = (0.5, 0.6, 0.8, 1.0, 2.0, 3.0, 5.0, 10.0)
WRONG_DEG = {"time": 0.1, "order": 0.1, "frames": 1.0}
TIME_S, SIZE_S, SIZE_MM = 1.0, 0.03, 0.3  # how well time and size must be named


@dataclass(frozen=True)
class Verdict:
    """What came of a recording; ``said`` is the refusal, or the warnings."""

    plan: Plan
    by: str
    refused: bool
    said: str
    wrong_rows: int
    rows: int
    named: bool
    exact: bool

    @property
    def silent(self) -> bool:
        """Wrong rows and not a word of why."""
        return self.wrong_rows > 0 and not self.named


@cache
def model(arm: str) -> Arm:
    """The nominal arm as the service resolves it."""
    from kilter_service.robots.check import check
    from kilter_service.robots.wire import DOCUMENT

    return arm_from_check(check(DOCUMENT.validate_python(document(arm, arm))).model_dump(mode="json"))


def planned(seed: int, what: str) -> tuple[Plan, str]:
    """A recording of a kind ("clean", "jump", "knock"), and how it is matched."""
    rng = np.random.default_rng([seed, 77])
    rests = bool(rng.random() < 0.8)
    plan = Plan(
        seed=seed,
        arm=str(rng.choice(["cobot", "industrial"])),
        poses=int(rng.integers(20, 44)),
        cadence=str(rng.choice(["regular", "irregular"])),
        order=str(rng.choice(["random", "random", "sorted"])) if rests else "random",
        rests=rests,
        markers=int(rng.integers(1 if what == "jump" else 3, 6)),
        noise_mm=float(rng.choice([0.01, 0.03, 0.1])),
        rate_hz=float(rng.choice([50.0, 60.0, 100.0])),
        log_hz=float(rng.choice([50.0, 100.0, 125.0])),
        error=float(rng.choice([0.5, 1.0, 2.0])),
    )
    by = str(rng.choice(["time", "frames"])) if rests else "frames"
    if what != "jump" and rests:
        by = str(rng.choice(["time", "order", "frames"]))
    end = float(schedule(plan)[0][-1, 1])
    at = float(rng.uniform(0.04, 0.96)) * end
    if what == "jump":
        size = float(rng.choice(SIZES_S) * rng.choice([-1, 1]))
        plan = replace(plan, jumps=(Jump(at, size, str(rng.choice(["log", "recording"]))),))
    if what == "knock":
        shift = rng.normal(size=3)
        shift *= float(rng.choice(KNOCKS_MM)) / np.linalg.norm(shift)
        body = rng.random() < 0.3
        knock = Knock(at, -1 if body else int(rng.integers(0, plan.markers)), shift, turn_of(rng, 0.2 if body else 0.0))
        plan = replace(plan, knock=knock)
    return plan, by


def files(made: Made) -> tuple[Recording, JointLog]:
    """The recording and the log as the readers give them."""
    block = Block(made.t_s, made.points, np.arange(1, len(made.t_s) + 1))
    names = tuple(f"M{k + 1}" for k in range(made.plan.markers))
    recording = Recording(Path("r.n3d"), "n3d", names, made.plan.rate_hz, len(made.t_s), lambda: iter([block]))
    columns = {f"q{i + 1}_deg": made.log_q[:, i] for i in range(6)}
    return recording, JointLog(Path("log.csv"), tuple(columns), columns | {"t_s": made.log_t})


def listed(made: Made) -> JointLog:
    """The poses in order, as a table without time."""
    columns = {f"q{i + 1}_deg": made.poses[:, i] for i in range(6)}
    return JointLog(Path("poses.csv"), tuple(columns), columns)


def matched(made: Made, by: str, checks: Checks) -> tuple[dict[str, np.ndarray], list[str]]:
    """The rows that would be sent, and the warnings."""
    recording, log = files(made)
    if by == "frames":
        pieces, warnings = match_frames(recording, log, checks)
        blocks = list(frame_rows(recording, log, pieces))
        return {n: np.concatenate([b[n] for b in blocks]) for n in blocks[0]}, warnings
    found = match_dwells(recording, listed(made) if by == "order" else log, by, checks=checks)
    return found.columns, found.report["warnings"]


def judged(plan: Plan, by: str, checks: Checks | None = None) -> Verdict:
    """Match a simulated recording and count what is wrong."""
    made = make(plan)
    try:
        columns, warnings = matched(made, by, checks or Checks(model(plan.arm)))
    except FileError as error:
        return Verdict(plan, by, True, error.detail, 0, 0, *names_it(made, error.detail))
    wrong = wrong_rows(made, by, columns)
    said = "; ".join(warnings)
    return Verdict(plan, by, False, said, int(wrong.sum()), len(wrong), *names_it(made, said))


def wrong_rows(made: Made, by: str, columns: dict[str, np.ndarray]) -> np.ndarray:
    """Rows whose joints are not the arm's then, or that were measured after a knock and go with others from before."""
    k = np.clip(np.searchsorted(made.t_s, columns["t_s"]), 0, len(made.t_s) - 1)
    q = np.stack([columns[f"q{i}_deg"] for i in range(1, 7)], axis=1)
    wrong = np.abs(q - made.arm_q[k]).max(axis=1) > WRONG_DEG[by]
    if made.plan.knock is not None:
        after = made.arm_t[k] >= made.plan.knock.at_s
        wrong |= after & (not after.all())
    return wrong


def names_it(made: Made, said: str) -> tuple[bool, bool]:
    """Whether words name the time of what was done with some size, and the right size (and marker) too."""
    plan = made.plan
    times = [
        (float(a) - TIME_S, float(b) + TIME_S) for a, b in re.findall(r"between (-?[\d.]+) and (-?[\d.]+) s", said)
    ]
    if plan.knock is not None:
        at = float(made.t_s[np.argmax(made.arm_t >= plan.knock.at_s)])
        sizes = [float(s) for s in re.findall(r"moved (?:at least )?([\d.]+) mm", said)]
        named = bool(sizes) and any(low <= at <= high for low, high in times)
        return named, named and _is_knock(plan.knock, plan.markers, said, sizes)
    sizes = [float(s) for s in re.findall(r"by ([+-][\d.]+) s", said)]
    for jump in plan.jumps:
        at = float(made.t_s[np.argmax(made.arm_t > jump.at_s)])
        if sizes and any(low <= at <= high for low, high in times):
            return True, any(abs(size - jump.size_s) <= SIZE_S for size in sizes)
    return False, False


def _is_knock(knock: Knock, markers: int, said: str, sizes: list[float]) -> bool:
    """Three markers show what lies in their plane only, and which one moved not always."""
    true = float(np.linalg.norm(knock.shift_mm))
    near = any(abs(size - true) <= max(SIZE_MM, 0.15 * true) for size in sizes)
    if knock.marker < 0:
        return near and "as a whole" in said
    if "as a whole" in said:
        return markers < 4
    right = f"'M{knock.marker + 1}'" in said
    return right and (near or (markers < 4 and any(size <= true + SIZE_MM for size in sizes)))
