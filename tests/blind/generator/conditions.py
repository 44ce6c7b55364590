"""The conditions that the sampler draws: no campaign is as its user believes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.blind.generator.options import Options

Rng = np.random.Generator


def conditions(rng: Rng, joints: int) -> Options:
    """Conditions of a case: masses wrong in every one, the rest in some."""
    drawn = Options(
        approach=str(rng.choice(["random", "random", "path"])),
        payload=str(rng.choice(["two", "two", "one"])),
        temperature=str(rng.choice(["constant", "cycling", "cycling"])),
        sessions=int(rng.choice([1, 1, 2])),
        revisited=float(rng.choice([0.0, 0.15, 0.3, 0.5, 0.5])),
        repeats=int(rng.choice([1, 3, 3])),
        spread=float(rng.choice([0.0, 0.5, 1.0])),
        outliers=float(rng.choice([0.0, 0.0, 0.015])),
        angle_urad=float(rng.uniform(2.0, 5.0)),
        approach_um=float(rng.uniform(4.0, 12.0)),
        foot_m=float(rng.uniform(2.0, 4.0) if rng.uniform() < 0.7 else rng.uniform(4.0, 8.0)),
        lean_deg=float(rng.uniform(0.0, 0.3)),
        confirmation=bool(rng.uniform() < 0.5),
    )
    drawn = _believing(drawn, rng)
    if rng.uniform() < 0.35:
        half = rng.permutation(joints)[: (joints + 1) // 2]
        drawn = replace(drawn, restricted=tuple(sorted(int(j) for j in half)))
    if rng.uniform() < 0.08:
        drawn = replace(drawn, clustered=float(rng.uniform(0.05, 0.15)), outliers=0.0)
    return _repeated(drawn, rng)


def _believing(drawn: Options, rng: Rng) -> Options:
    """Masses off in every case: mostly within 10 %, in some within 20 %."""
    worst = float(rng.choice([0.1, 0.1, 0.1, 0.2, rng.uniform(0.0, 0.1)]))
    return replace(
        drawn, mass_error=worst, com_error_mm=float(rng.uniform(0.0, 10.0)),
        payload_error=float(rng.uniform(0.0, 0.05)), payload_offset_mm=float(rng.uniform(0.0, 8.0)),
        stated_priors=bool(rng.uniform() < 0.3),
    )  # fmt: skip


def _repeated(drawn: Options, rng: Rng) -> Options:
    """Some campaigns repeat in ways that say little of the noise."""
    way = rng.uniform()
    if way < 0.15:  # three shots per stop, minutes apart in all, of an arm that stops elsewhere each time
        scatter = {"range_um": 3.0, "angle_urad": 1.5, "approach_um": float(rng.uniform(25.0, 60.0))}
        return replace(drawn, repeats=3, shot_gap_s=float(rng.uniform(20.0, 120.0)), **scatter)
    if way < 0.25:
        return replace(drawn, stays=True, revisited=max(drawn.revisited, 0.3))
    if way < 0.35:
        return replace(drawn, repeats=1, revisited=0.0)
    return drawn


def drifting(drawn: Options, kind: str, overstated: float) -> Options:
    """The same with a slow motion behind it, and repeats far enough apart to be fooled by it."""
    repeated = {"revisited": max(drawn.revisited, 0.4), "spread": max(drawn.spread, 0.7), "stays": False}
    return replace(drawn, background=kind, overstated=overstated, sessions=1, **repeated)
