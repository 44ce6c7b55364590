"""Campaigns fitted under several kinds of processor, and what differs.

``python -m tests.core.processors.compared --n 1000`` is ``python -m tools.lab processors``.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from kilter_core.observations import Observations
from tests.core.processors.made import KINDS, Campaign, campaigns

CORES = ("Haswell", "SkylakeX", "Sandybridge", "Prescott")  # AMD's Zen runs the kernels of Haswell
SAME_VALUE = 1e-3  # standard deviations
SAME_HELD = 1e-2  # of the projector onto what is held: the sine of an angle
TOUCH = 1e-12  # share by which touched data differ: what another processor rounds differently
WORDS = ("names", "said", "codes", "together")
MEASURED = {"q", "position", "markers", "bar_length", "link_q", "tilt"}


def under(core: str, some: Sequence[Campaign], folder: Path) -> dict[str, dict[str, Any]] | None:
    """What is found with the linear algebra of a kind of processor; None where this one cannot run it."""
    source, target = folder / "campaigns", folder / core
    source.write_bytes(pickle.dumps(list(some)))
    environment = os.environ | {"OPENBLAS_CORETYPE": core, "OPENBLAS_NUM_THREADS": "1"}
    try_it = [sys.executable, "-c", "import numpy as np; a = np.ones((64, 64)); assert (a @ a)[0, 0] == 64.0"]
    if subprocess.run(try_it, env=environment, capture_output=True, check=False).returncode != 0:
        return None
    command = [sys.executable, "-m", "tests.core.processors.fitting", str(source), str(target)]
    root = Path(__file__).resolve().parents[3]
    subprocess.run(command, env=environment, cwd=root, check=True)
    found: dict[str, dict[str, Any]] = pickle.loads(target.read_bytes())  # noqa: S301 - our own file
    return found


def touched(campaign: Campaign, seed: int) -> Campaign:
    """The campaign with every measured number a millionth of a millionth off."""
    rng = np.random.default_rng(seed)

    def off(values: Any) -> Any:
        return None if values is None else values * (1.0 + TOUCH * rng.standard_normal(np.shape(values)))

    columns = {f.name: off(getattr(campaign.rows, f.name)) for f in fields(Observations) if f.name in MEASURED}
    return replace(campaign, rows=replace(campaign.rows, **columns), circles=off(campaign.circles))


def differences(one: dict[str, Any], other: dict[str, Any]) -> Iterator[str]:
    """What a person would see differ between two answers."""
    if "refused" in one or "refused" in other:
        if one != other:
            yield f"refused: {one.get('refused')} or {other.get('refused')}"
        return
    yield from (f"{word}: {one[word]} or {other[word]}" for word in WORDS if one[word] != other[word])
    if one["names"] != other["names"]:
        return
    apart = np.abs(one["values"] - other["values"]) / one["sigma"]
    if not np.max(apart) < SAME_VALUE:
        yield f"{one['names'][int(np.argmax(apart))]} by {np.max(apart):.2g} standard deviations"
    if not (held := float(np.linalg.norm(one["held"] - other["held"], 2))) < SAME_HELD:
        yield f"held directions by {held:.2g}"


def main() -> int:
    """Fit campaigns under all kinds of processor and say what differs."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1000)
    asked = parser.parse_args()
    some = list(islice((one for seed in range(asked.seed, asked.seed + asked.n) for one in campaigns(seed)), asked.n))
    kinds, bad = Counter(one.kind for one in some), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        found = {core: under(core, some, Path(folder)) for core in CORES}
        ran = {core: answers for core, answers in found.items() if answers is not None}
    first, *others = ran
    for one in some:
        for core in others:
            for difference in differences(ran[first][one.name], ran[core][one.name]):
                bad[one.kind] += 1
                print(f"{one.name}, {first} and {core}: {difference}")
    refused = Counter(one.kind for one in some if "refused" in ran[first][one.name])
    print(f"{len(some)} campaigns under {', '.join(ran)}; refused alike under all: {dict(refused) or 'none'}")
    for kind in KINDS:
        print(f"{kind:24}{kinds[kind]:5} campaigns, {bad[kind]} differences")
    return 1 if bad or len(ran) < 2 else 0


if __name__ == "__main__":
    sys.exit(main())
