"""`kilter kit` over many simulated SO-101: what it finds of play and stiffness, and that it names nothing on clean arms.

`make test-kit ARMS=200`: each arm takes about ten processor seconds, so `make test` leaves it out. `FIRST=1000` takes
other arms than those of numbers from 0.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from kilter_client import Kilter
from tests.clients.files.formats.test_lerobot import calibration
from tests.clients.lerobot.so101_twin import Twin
from tests.clients.lerobot.webcam import View, advised, views, views_near, written
from tests.clients.test_cli import Command

ARMS, FIRST = int(os.environ.get("ARMS", "20")), int(os.environ.get("FIRST", "0"))
POSES, PAYLOADS, CORNER_PX, PLAY_DEG = 20, (0.0, 0.2), 0.5, 1.0
LOADED = (2, 3, 4)  # joints that gravity loads
STIFF = 3000.0
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(24 * 3600),
    pytest.mark.skipif("ARMS" not in os.environ, reason="make test-kit"),
]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    return Command(capsys)


def two_of_four(seen: list[View]) -> list[View]:
    """Two of the four views of each pose: both payloads, each from another side."""
    return [one for k in range(0, len(seen), 4) for one in (seen[k], seen[k + 2 + int(same(seen[k], seen[k + 2]))])]


def same(one: View, other: View) -> bool:
    return bool(one.side[2] == other.side[2])


def asked(kilter: Kilter, command: Command, folder: Path, name: str, twin: Twin, rng: np.random.Generator) -> Any:
    """What the kit says of 40 views and those it asked for besides, with the parameters of its version."""
    so101 = {"name": name, "convention": "preset", "preset": "so101", "controller_compensation": "none"}
    kilter.robots.add({**so101, "payload_sigma": {"mass_percent": 1.0, "com_mm": 10.0}})  # as the kit adds one

    def ask(seen: list[View], *more: str) -> dict[str, Any]:
        rows, rig = written(folder, name, seen)
        options = ("--cameras", rig, "--calibration", calibration(folder), *more)
        return command.json("kit", name, rows, *options, code=(0, 4))

    def take(examples_deg: Sequence[Sequence[float]]) -> list[View]:
        return two_of_four(views_near(twin, examples_deg, rng, PAYLOADS, CORNER_PX))

    document, seen = advised(ask, two_of_four(views(twin, POSES, rng, PAYLOADS, CORNER_PX)), take)
    document = document if "version_id" in document else ask(seen, "--anyway")
    found = {one["name"]: one["value"] for one in kilter.versions.get(document["version_id"])["parameters"]}
    return document, found


def named(lines: list[str]) -> list[int]:
    return [int(hit[1]) for line in lines if (hit := re.match(r"joint (\d) .* deg of backlash", line))]


def share(hits: int, of: int) -> str:
    low, high = binomtest(hits, of).proportion_ci(0.95, method="exact")
    return f"{hits} of {of} ({100 * low:.0f} to {100 * high:.0f} %)"


def test_play_stiffness_and_the_right_joint(
    kilter: Kilter, command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, play_off, stiffness_off, after = 0, [], [], []
    for k in range(ARMS):
        rng = np.random.default_rng([34, FIRST + k])
        joint, soft, zeros = int(rng.choice(LOADED)), rng.uniform(23.0, 47.0, 3), rng.uniform(-2.0, 2.0, 3)
        play = [PLAY_DEG if j == joint else 0.0 for j in range(1, 6)]
        twin = Twin([0.0, *zeros, 0.0], [300.0, *soft, 300.0], play)
        document, found = asked(kilter, command, tmp_path, f"worn-{k}", twin, rng)
        right += named(document["lines"]) == [joint]
        play_off.append(2.0 * found[f"backlash_load_{joint}"] / PLAY_DEG - 1.0)
        stiffness_off += [np.degrees(1.0) / found[f"compliance_{j}"] / soft[j - 2] - 1.0 for j in LOADED]
        after.append(document["after_mm"])
        with capsys.disabled():
            print(
                f"\nworn {FIRST + k}: {document['views']} views, joint {joint}, named {named(document['lines'])}, "
                f"play {play_off[-1]:+.0%}, "
                f"stiffness {', '.join(f'{one:+.0%}' for one in stiffness_off[-3:])}, "
                f"{document['before_mm']:.1f} to {document['after_mm']:.2f} mm; right {share(right, k + 1)}, "
                f"play within 20 % {share(int(np.sum(np.abs(play_off) <= 0.2)), k + 1)}, stiffness within 15 % "
                f"{share(int(np.sum(np.abs(stiffness_off) <= 0.15)), 3 * (k + 1))}",
                flush=True,
            )
    assert right >= 0.95 * ARMS
    assert np.quantile(np.abs(play_off), 0.95) <= 0.2
    assert np.quantile(np.abs(stiffness_off), 0.95) <= 0.15
    assert np.median(after) <= 2.0


def test_nothing_is_named_on_clean_arms(
    kilter: Kilter, command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = unsure = 0
    for k in range(ARMS):
        rng = np.random.default_rng([35, FIRST + k])
        twin = Twin([0.0] * 5, [STIFF] * 5, [0.0] * 5)
        document, _ = asked(kilter, command, tmp_path, f"clean-{k}", twin, rng)
        said = [line for line in document["lines"] if re.search(r"deg of backlash|sags by|is off by", line)]
        names += bool(said)
        unsure += sum("whether it has backlash" in line for line in document["lines"])
        with capsys.disabled():
            print(f"\nclean {FIRST + k}: {said}; named {share(names, k + 1)}, unsure of {unsure} joints", flush=True)
    assert names == 0
