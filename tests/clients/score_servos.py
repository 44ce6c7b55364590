"""How often what a simulator hides is named: logs of servo arms in MuJoCo, each with one effect or none.

``python -m tests.clients.score_servos --seeds 3``: three-joint arms whose model states other servos than they have;
with ``--single`` a servo with 0.3 kg on a lever.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kilter_client.twin.servo_gap import find_servo_gap
from tests.clients.servo_arm import NOMINAL, TICK_RAD, Hidden, Servos, arm_xml, record

DEG = np.pi / 180.0
NOISE_DEG = TICK_RAD / DEG / np.sqrt(12.0)
LOGS, SECONDS = 6, 15.0


def draw_servos(rng: np.random.Generator) -> Servos:
    """Servos of an arm of its own."""
    return Servos(*(tuple(np.array(own) * rng.uniform(0.6, 1.6, 3)) for own in (
        Servos.armature, Servos.friction, Servos.damping, Servos.gain
    )))  # fmt: skip


def draw_hidden(rng: np.random.Generator, name: str, single: bool) -> Hidden | None:
    """An effect of a size that servos have, at a joint that weight loads."""
    j = 0 if single else int(rng.integers(1, 3))
    read = ("motor", "body")[int(rng.integers(2))]
    sizes = {
        "command_delay": rng.uniform(0.005, 0.06),
        "backlash": rng.uniform(0.3, 1.5) * DEG,
        "load_friction": rng.uniform(0.05, 0.15),
        "torque_limit": rng.uniform(0.6, 1.2),
        "flexible_gear": rng.uniform(0.02, 0.08),
    }
    if name == "none":
        return None
    return Hidden(name, j, sizes[name], read if name in ("backlash", "flexible_gear") else "motor")


def judge(hidden: Hidden | None, found: dict[str, Any]) -> str:
    """Right, its class, probable, missed, or something wrong named; nothing named counts as right where nothing is hidden."""
    sure = [(one["id"], one["joint"], one["alias_set"], one["sure"]) for one in found["effects"]]
    if hidden is None:
        return "wrong" if sure else "right"
    wrong = [one for one in sure if one[1] != f"j{hidden.joint + 1}" or hidden.effect not in (one[0], *one[2])]
    own = [one for one in sure if one not in wrong]
    if any(one[3] == "certain" for one in wrong):
        return "wrong"
    if not own:
        return "missed"
    if own[0][3] != "certain":
        return "probable"
    return "right" if own[0][0] == hidden.effect and not wrong else "class"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--single", action="store_true")
    asked = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    names = ("none", "command_delay", "backlash", "load_friction", "torque_limit", "flexible_gear")
    for name in (asked.only,) if asked.only else names:
        for seed in range(asked.first, asked.first + asked.seeds):
            rng = np.random.default_rng([seed, names.index(name)])
            hidden, servos = draw_hidden(rng, name, asked.single), draw_servos(rng)
            stated = NOMINAL
            if asked.single:
                servos, stated = replace(servos.of_joint(1), payload_kg=0.3), NOMINAL.of_joint(1)
            with tempfile.TemporaryDirectory() as folder:
                logs = [Path(folder) / f"log{k}.csv" for k in range(LOGS)]
                for k, path in enumerate(logs):
                    record(1000 * seed + 10 * names.index(name) + k, hidden, servos, SECONDS).write(path)
                model = Path(folder) / "arm.xml"
                model.write_text(arm_xml(stated))
                found, _ = find_servo_gap(model, logs)
            verdict = judge(hidden, found)
            counts.setdefault(name, Counter())[verdict] += 1
            sizes = [
                (one["id"], one["joint"], one["verdict"], round(one["parameters"][0]["value"], 3))
                for one in found["effects"]
            ]
            error = (found["whole_arm"]["found"] or {"rms_deg": np.nan})["rms_deg"] / NOISE_DEG
            print(f"{verdict:9} {hidden} {sizes} {error:.2f} x noise", flush=True)
    for name, own in counts.items():
        print(f"{name:16}", dict(own))


if __name__ == "__main__":
    main()
