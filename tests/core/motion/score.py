"""How often a hidden effect is named at its joint: simulated logs of two arms, each with one effect or none.

``python -m tests.core.motion.score --seeds 3 --share 1.0``: the effect is as large (rms) as the noise times the share.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from zlib import crc32

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion import find_missing_torque, to_document
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Floats, Logger, State, reversed_softly, seven_like, ur_like

DELAY_S, GAIN = 0.02, 0.08  # of a share of one
Shape = Callable[[State, int], Floats]


def side(state: State, j: int) -> Floats:
    return reversed_softly(state.qd[:, j], 0.004)


SHAPES: dict[str, Shape] = {
    "stribeck": lambda s, j: side(s, j) * np.exp(-np.abs(s.qd[:, j]) / 0.08),
    "root_speed": lambda s, j: side(s, j) * np.sqrt(np.abs(s.qd[:, j])),
    "quadratic_speed": lambda s, j: s.qd[:, j] * np.abs(s.qd[:, j]),
    "one_sided_damping": lambda s, j: np.maximum(s.qd[:, j], 0.0),
    "load_friction": lambda s, j: side(s, j) * np.abs(s.rigid[:, j]),
    "motor_inertia": lambda s, j: s.qdd[:, j],
    "gear_ripple": lambda s, j: np.sin(24.0 * s.q[:, j] + 1.0),
    "spring": lambda s, j: s.q[:, j] - 0.2,
    "counterbalance": lambda s, j: -np.sin(s.q[:, j] + 0.4),
    "cable_curve": lambda s, j: s.q[:, j] ** 3 + 0.5 * s.q[:, j] ** 2,
    "warm_up": lambda s, j: s.qd[:, j] * np.exp(-s.seconds / 200.0),
}
NAMES = (*SHAPES, "drive_gain", "torque_delay")


def hide(logger: Logger, name: str, j: int, share: float) -> None:
    """Hide an effect of this name at a joint of an arm that is about to move."""
    at = np.arange(logger.arm.n) == j
    if name == "torque_delay":
        logger.delay_s = DELAY_S * share * at
    elif name == "drive_gain":
        logger.gain = 1.0 + GAIN * share * at
    elif name:
        scale: list[float] = []

        def extra(state: State) -> Floats:
            torque = SHAPES[name](state, j)
            scale.append(share * logger.noise_share * logger.usual[j] / float(np.std(torque)))
            return np.asarray(scale[0] * torque[:, None] * at)

        logger.extra = [extra]


def hunt(
    name: str, j: int, build: Callable[[np.random.Generator], object], seed: int, share: float
) -> list[dict[str, object]]:
    """What is named in a log with one effect hidden, none for an empty name."""
    arm = build(np.random.default_rng(seed))
    logger = Logger(arm, seed=seed)  # type: ignore[arg-type]
    hide(logger, name, j, share)
    log = logger.log()
    rows = Observations(q=log["q"], t=log["t"], tau=log["tau"])
    found: list[dict[str, object]] = to_document(find_missing_torque(robot_from_document(logger.arm.document()), rows))[
        "effects"
    ]
    return found


def main() -> None:
    """Print how often names are right, by effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--share", type=float, default=1.0, help="size of the effect as a share of the noise")
    asked = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    for name in ("", *NAMES):
        for seed in range(asked.seeds):
            for build, joints in ((ur_like, 6), (seven_like, 7)):
                j = crc32(f"{name} {seed}".encode()) % joints
                found = hunt(name, j, build, seed, asked.share)
                names = [(one["id"], one["joints"]) for one in found]
                counts[name, "logs"] += 1
                counts[name, "right"] += names == ([(name, [j + 1])] if name else [])
                counts[name, "sure and wrong"] += any(
                    (one["id"], one["joints"]) != (name, [j + 1]) and one["verdict"] in ("confirmed", "replicated")
                    for one in found
                )
        print(
            f"{name or 'nothing hidden':20}",
            {key: counts[name, key] for key in ("logs", "right", "sure and wrong")},
            flush=True,
        )


if __name__ == "__main__":
    main()
