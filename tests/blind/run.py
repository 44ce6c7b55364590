"""Run the blind benchmark: ``python -m tests.blind.run --n 1000``. Stops and goes on where it was.

Cases are computed in two processes, or on the Dask cluster that ``KILTER_DASK`` names, whose workers find ``tests``.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from kilter_core.arm import Robot
from kilter_core.errors import CoreError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.types import Progress
from kilter_service.jobs.fan_out import fan_out
from tests.blind.generator import Campaign, Case, cases, generate, twin_cases
from tests.blind.page import PAGE, write_page
from tests.blind.score import figures
from tests.blind.to_core import observations_of, robot_of

KEPT = (
    "verdict", "sentence", "effects", "gap", "not_testable", "adequacy", "noise", "predictive", "confirmation",
    "load_model", "warnings",
)  # fmt: skip
PROCESSES = 2
TWIN_SHARE = 25  # cases to one that hides the twin of a member
LIMIT_S = 300.0  # processor time after which a hunt counts as failed
RECORDS = Path(__file__).resolve().parents[2] / "build"
QUIET = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class TooLongError(Exception):
    """A hunt that took longer than it may."""


def run_case(case: Case, limit_s: float = LIMIT_S) -> dict[str, Any]:
    """Generate a case, let the finder at it, and keep what both say."""
    return hunted(generate(case), case.name, limit_s)


def hunted(
    campaign: Campaign, name: str, limit_s: float = LIMIT_S, describe: Callable[[Campaign], Robot] = robot_of
) -> dict[str, Any]:
    """Let the finder at a campaign, and keep what it says beside the truth. Seconds are the processor's."""
    record = {
        "name": name, "case": asdict(campaign.case), "truth": campaign.truth.to_document(), "report": None,
        "error": None,
    }  # fmt: skip
    began = time.process_time()

    def tell(fraction: float, stage: str) -> None:
        if time.process_time() - began > limit_s:
            raise TooLongError(stage)

    try:
        rows = observations_of(campaign.columns)
        report = find_gap(describe(campaign), rows, GapOptions(next_poses=1), progress=tell, **_second(campaign))
    except CoreError as error:
        return {**record, "error": f"{error.code}: {error.message}", "seconds": time.process_time() - began}
    except TooLongError as error:
        return {**record, "error": f"too_long: {error}", "seconds": time.process_time() - began}
    document = {key: value for key, value in report.to_document().items() if key in KEPT}
    seconds = time.process_time() - began
    # Through JSON, so that a run just made and one read back from the file look alike.
    return dict(json.loads(json.dumps({**record, "report": document, "seconds": seconds}, default=float)))


def _second(campaign: Campaign) -> dict[str, Any]:
    """The second campaign, for a finder that can replicate what it found in the first."""
    if campaign.confirmation is None or "confirmation" not in inspect.signature(find_gap).parameters:
        return {}
    return {"confirmation": observations_of(campaign.confirmation)}


def run(
    wanted: Sequence[Case],
    path: Path,
    processes: int = PROCESSES,
    one: Callable[[Case], dict[str, Any]] = run_case,
) -> list[dict[str, Any]]:
    """Run ``one`` on the cases that ``path`` does not hold yet, appending each record to it, and return those of all."""
    done = {record["name"]: record for record in _read(path)}
    left = [case for case in wanted if case.name not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    os.environ.update(QUIET)
    began = time.monotonic()
    spread = fan_out(processes, os.environ.get("KILTER_DASK"))
    with path.open("a") as file:
        for k, (_, record) in enumerate(spread.as_completed(_part, [(one, case) for case in left]), 1):
            file.write(json.dumps(record) + "\n")
            file.flush()
            done[record["name"]] = record
            _tell(k, len(left), time.monotonic() - began, record)
    return [done[case.name] for case in wanted]


def _part(task: tuple[Callable[[Case], dict[str, Any]], Case], progress: Progress) -> dict[str, Any]:
    one, case = task
    return one(case)


def _read(path: Path) -> Iterator[dict[str, Any]]:
    if path.exists():
        for line in path.read_text().splitlines():
            yield json.loads(line)


def _tell(k: int, n: int, elapsed: float, record: dict[str, Any]) -> None:
    verdict = "failed" if record["report"] is None else record["report"]["verdict"]
    minutes = elapsed / k * (n - k) / 60.0
    line = f"{k}/{n}  {minutes:.0f} min left  {record['name']}: {verdict} in {record['seconds']:.1f} s"
    print(line, file=sys.stderr, flush=True)


def main() -> None:
    """Run, print the figures, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=1000, help="number of cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--records", type=Path, default=None, help="file of records; a run goes on from what it holds")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--processes", type=int, default=PROCESSES)
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="processor seconds after which a hunt failed")
    arguments = parser.parse_args()
    path = arguments.records or RECORDS / f"blind-{arguments.seed}.jsonl"
    one = partial(run_case, limit_s=arguments.limit)
    wanted = [*cases(arguments.seed, arguments.n), *twin_cases(arguments.seed, arguments.n // TWIN_SHARE)]
    records = run(wanted, path, arguments.processes, one)
    write_page(records, arguments.seed, arguments.page)
    for figure in figures(records):
        print(figure.row())


if __name__ == "__main__":
    # Under its own name: that of a program means another module in the process of a cluster.
    from tests.blind import run as module

    module.main()
