"""What `kilter robot kit` says of many simulated SO-101, worn and clean: ``python -m tests.clients.lerobot.many_arms --n 200``.

Worn and clean arms are asked in turns, through a server of its own, as a person asks: with the views that the kit wants
besides. Stops and goes on where it was.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from kilter_client import Kilter
from kilter_client.cli import run as kilter_command
from kilter_client.requests.connection import local_server
from tests.blind.bounds import Figure, share
from tests.clients.files.formats.test_lerobot import calibration
from tests.clients.lerobot.so101_twin import Twin
from tests.clients.lerobot.webcam import View, advised, views, views_near, written

POSES, PAYLOADS, CORNER_PX, PLAY_DEG = 20, (0.0, 0.2), 0.5, 1.0
LOADED = (2, 3, 4)  # joints that gravity loads
STIFF = 3000.0
RECORDS = Path(__file__).resolve().parents[3] / "build"
NAMES = re.compile(r"deg of backlash|sags by|is off by")
Record = dict[str, Any]  # {"name", "truth": {...}, "report": {...} | None, "error", "seconds"}


def run(n: int, seed: int, path: Path, one: Callable[[str, int, int], Record]) -> list[Record]:
    """Ask ``one`` (kind, seed, number) of the arms that ``path`` does not hold yet, append each, return those of all."""
    wanted = [(kind, k) for k in range(n) for kind in ("worn", "clean")]
    done = {record["name"]: record for record in read(path)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        for kind, k in wanted:
            if f"{kind}-{seed}-{k}" not in done:
                record = one(kind, seed, k)
                done[record["name"]] = record
                file.write(json.dumps(record) + "\n")
                file.flush()
                print(f"{record['name']} in {record['seconds']:.0f} s: {record['error'] or record['report']['names']}",
                      file=sys.stderr, flush=True)  # fmt: skip
    return [done[f"{kind}-{seed}-{k}"] for kind, k in wanted]


def read(path: Path) -> Iterator[Record]:
    """Records of a file; a line that a kill cut short is left out, and its arm is asked anew."""
    if path.exists():
        for line in path.read_text().splitlines(keepends=True):
            if line.endswith("\n"):
                yield json.loads(line)
            else:
                path.write_text(path.read_text()[: -len(line)])


def worn(rng: np.random.Generator) -> tuple[Twin, dict[str, Any]]:
    """An arm with soft drives, zeros off, and backlash in one joint; and its truth."""
    joint, soft, zeros = int(rng.choice(LOADED)), rng.uniform(23.0, 47.0, 3), rng.uniform(-2.0, 2.0, 3)
    play = [PLAY_DEG if j == joint else 0.0 for j in range(1, 6)]
    truth = {"joint": joint, "stiffness": soft.tolist(), "zeros_deg": zeros.tolist()}
    return Twin([0.0, *zeros, 0.0], [300.0, *soft, 300.0], play), truth


def clean(rng: np.random.Generator) -> tuple[Twin, dict[str, Any]]:
    """An arm that is as drawn, but for the ticks of its readings."""
    return Twin([0.0] * 5, [STIFF] * 5, [0.0] * 5), {}


def ask(kilter: Kilter, folder: Path, kind: str, seed: int, number: int) -> Record:
    """Measure an arm and keep what the kit says of it beside the truth. Seconds are the clock's."""
    began = time.monotonic()
    rng = np.random.default_rng([34 if kind == "worn" else 35, seed, number])
    twin, truth = (worn if kind == "worn" else clean)(rng)
    name = f"{kind}-{seed}-{number}"
    record: Record = {"name": name, "kind": kind, "truth": truth, "report": None, "error": None}
    try:
        record["report"] = report(kilter, folder, name, twin, rng)
    except AssertionError as error:  # the kit refused, or it advised a pose at which the board is not seen
        record["error"] = str(error)
    return record | {"seconds": time.monotonic() - began}


def report(kilter: Kilter, folder: Path, name: str, twin: Twin, rng: np.random.Generator) -> dict[str, Any]:
    """What the kit says of 40 views and those it asked for besides, with backlash and stiffness of its version."""
    so101 = {"name": name, "convention": "preset", "preset": "so101", "controller_compensation": "none"}
    kilter.robots.add({**so101, "payload_sigma": {"mass_percent": 1.0, "com_mm": 10.0}})  # as the kit adds one

    def kit(seen: list[View], *more: str) -> dict[str, Any]:
        rows, rig = written(folder, name, seen)
        options = ("--cameras", str(rig), "--calibration", str(calibration(folder)), *more)
        return told("kit", name, str(rows), *options)

    def take(examples_deg: Sequence[Sequence[float]]) -> list[View]:
        return two_of_four(views_near(twin, examples_deg, rng, PAYLOADS, CORNER_PX))

    document, seen = advised(kit, two_of_four(views(twin, POSES, rng, PAYLOADS, CORNER_PX)), take)
    document = document if "version_id" in document else kit(seen, "--anyway")
    found = {one["name"]: one["value"] for one in kilter.versions.get(document["version_id"])["parameters"]}
    return {
        "names": [line for line in document["lines"] if NAMES.search(line)],
        "lines": document["lines"],
        "views": document["views"],
        "before_mm": document["before_mm"],
        "after_mm": document["after_mm"],
        "play_deg": {str(j): 2.0 * found[f"backlash_load_{j}"] for j in LOADED if f"backlash_load_{j}" in found},
        "stiffness": {
            str(j): np.degrees(1.0) / found[f"compliance_{j}"] for j in LOADED if found.get(f"compliance_{j}")
        },
    }


def told(*arguments: str) -> dict[str, Any]:
    """The document that a command prints. A command that fails is an AssertionError; 4 says that views are missing."""
    printed = io.StringIO()
    with redirect_stdout(printed):
        code = kilter_command([*arguments, "--json"])
    assert code in (0, 4), printed.getvalue()
    document: dict[str, Any] = json.loads(printed.getvalue())
    return document


def two_of_four(seen: list[View]) -> list[View]:
    """Two of the four views of each pose: both payloads, each from another side."""
    return [one for k in range(0, len(seen), 4) for one in (seen[k], seen[k + 2 + int(same(seen[k], seen[k + 2]))])]


def same(one: View, other: View) -> bool:
    return bool(one.side[2] == other.side[2])


def figures(records: Sequence[Record]) -> list[Figure]:
    """The figures of the tutorial; an arm that gave no answer counts as missed."""
    some, bare = ([one for one in records if one["kind"] == kind] for kind in ("worn", "clean"))
    answered = [one for one in bare if one["report"]]
    after = [one["report"]["after_mm"] for one in some if one["report"]]
    return [
        share("the right joint named, and no other", "≥ 95 %", [backlash_at(one) == [one["truth"]["joint"]] for one in some]),
        share("backlash within 20 %", "≥ 95 %", [abs(play_off(one)) <= 0.2 for one in some]),
        share("stiffness within 15 %, joints", "≥ 95 %", [abs(off) <= 0.15 for one in some for off in stiffness_off(one)]),
        share("clean arms on which anything is named", "0", [bool(one["report"]["names"]) for one in answered]),
        share("arms without an answer", "0", [one["report"] is None for one in records]),
        Figure("held-out error of worn arms, median", "≤ 2 mm", n=len(after), value=float(np.median(after)), unit=" mm"),
        Figure("– the same, largest", "", n=len(after), value=float(np.max(after)), unit=" mm"),
    ]  # fmt: skip


def backlash_at(record: Record) -> list[int]:
    """Joints of which the kit says that they have backlash."""
    lines = record["report"]["names"] if record["report"] else []
    return [int(hit[1]) for line in lines if (hit := re.match(r"joint (\d) .* deg of backlash", line))]


def play_off(record: Record) -> float:
    """Backlash found over that hidden, less 1; of an arm without an answer infinite."""
    found = record["report"]["play_deg"] if record["report"] else {}
    return float(found.get(str(record["truth"]["joint"]), np.inf)) / PLAY_DEG - 1.0


def stiffness_off(record: Record) -> list[float]:
    """Stiffness found over that hidden, less 1, of each loaded joint; without an answer infinite."""
    found = record["report"]["stiffness"] if record["report"] else {}
    return [
        found.get(str(j), np.inf) / true - 1.0 for j, true in zip(LOADED, record["truth"]["stiffness"], strict=True)
    ]


@contextmanager
def served(data: Path) -> Iterator[Kilter]:
    """A server of its own, found as a person's own: by the environment."""
    with local_server(data) as server:
        os.environ |= server.environment()
        with Kilter() as kilter:
            yield kilter


def main() -> None:
    """Run, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=200, help="number of arms of either kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--records", type=Path, default=None, help="file of records; a run goes on from what it holds")
    parser.add_argument("--read", action="store_true", help="only print the figures of the records that are there")
    arguments = parser.parse_args()
    path = arguments.records or RECORDS / f"many-arms-{arguments.seed}.jsonl"
    if arguments.read:
        records = list(read(path))
    else:
        with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "data") as kilter:
            records = run(arguments.n, arguments.seed, path, lambda *arm: ask(kilter, Path(folder), *arm))
    for figure in figures(records):
        print(figure.row())


if __name__ == "__main__":
    main()
