"""The laboratory: long experiments on Kilter, by name. `python -m tools.lab` lists them.

What follows a name goes to the experiment: `python -m tools.lab kills --n 20 --seed 7`; of a value that is given twice the
last counts. First `make` builds what the experiment needs.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
ALL = 'pytest -q -m "slow or not slow"'
SERVER = "tests/service"


class Experiment(NamedTuple):
    """What one learns, how long it takes on two cores, its command, an example of arguments, and its own environment."""

    subject: str
    duration: str
    command: str
    example: str = ""
    environment: str = ""


EXPERIMENTS: dict[str, Experiment] = {
    # The gap finder and the identification
    "blind": Experiment("find hidden physics in simulated campaigns; writes docs/reference/gap-finder-benchmark.md",
        "hours", "-m tests.blind.run", "--n 100"),
    "blind-pairs": Experiment("hunt the same campaigns with right and with wrong masses", "1 h",
        "-m tests.blind.pairs", "--rounds 1"),
    "blind-thresholds": Experiment("score every threshold of the gap finder at half and double", "1 h, --search: hours",
        "-m tests.blind.thresholds --write", "--search"),
    "challenge": Experiment("search cases that somebody else hid, and score them", "minutes for each case",
        "-m benchmarks.challenge", "cases"),
    "mix-ups": Experiment("count mix-ups that are missed and genuine campaigns that are accused", "hours",
        "-m tests.mix_ups.score", "--genuine 50 --rounds 1"),
    "mix-ups-ways": Experiment("send mix-ups through upload, dry run, identify and gap", "30 min",
        "-m tests.mix_ups.ways", "--genuine 10"),
    "silent-rows": Experiment("count wrong rows that pass in silence among 600 recordings", "10 min",
        "pytest -q -m slow tests/clients/files/match/test_silent_rows.py"),
    "processors": Experiment("compare fits of every kind of measurement under four kinds of processor", "30 min",
        "-m tests.core.processors.compared", "--n 20"),
    "thesis": Experiment("do the thesis's experiments again and write their page", "10 min", "-m tools.thesis_reproduction"),
    "tilting": Experiment("measure what tilting influences and write its page", "10 min", "-m tools.influence_and_tilting"),
    # The watch and the fleet
    "drift": Experiment("watch simulated arms day after day: false alarms, steps, causes, ramps, seasons", "hours",
        "-m benchmarks.drift --robots 1000 --days 250", "--robots 20 --days 100"),
    "drift-sums": Experiment("draw a million checks of arms that do not move", "10 min", "-m benchmarks.drift_sums"),
    "fleet": Experiment("identify arms from a few poses with the prior of the others", "30 min",
        "-m benchmarks.fleet", "--types 1 --robots 6"),
    # The server
    "kills": Experiment("kill processes of a server at random while clients work, and look for what is lost", "1 h",
        "-m tests.service.kill_campaign", "--n 20 --seed 7"),
    "load": Experiment("put a whole server under load on SQLite and PostgreSQL", "30 min",
        "-m benchmarks.load", "--minutes 1"),
    "fuzz": Experiment("send requests of every kind to the HTTP interface, some on PostgreSQL too", "30 min",
        "-W ignore::RuntimeWarning -m tests.fuzz.run", "--cases 500"),
    "durability": Experiment("set clocks, make disks read-only and freeze processes under a running server", "10 min",
        f"{ALL} {SERVER}/test_clock_jumps.py {SERVER}/test_read_only_disk.py {SERVER}/test_frozen.py "
        f"{SERVER}/test_failing_disk.py {SERVER}/test_bad_starts.py"),
    "alterations": Experiment("flip bits of backups, alter data folders, and print what is noticed", "5 min",
        f"{ALL} -s {SERVER}/test_seals.py {SERVER}/test_seal_key.py {SERVER}/test_schema.py {SERVER}/test_backup.py "
        '-k "alter or flipped or back or anew or arithmetic"'),
    "many-jobs": Experiment("run 1000 small jobs on four workers and PostgreSQL, and kill two of them", "15 min",
        f"pytest -q -s -m slow {SERVER}/test_many_jobs.py"),
    "machines": Experiment("run two APIs and two workers on PostgreSQL, and kill a worker in a fleet job", "5 min",
        f"{ALL} {SERVER}/test_several_machines.py"),
    # The stream and its bridges
    "kills-stream": Experiment("kill every process under a controller at 1 kHz: how long it is bypassed", "30 min",
        "-m tests.corrector.kill_every", "--n 10"),
    "soak": Experiment("stream and watch the memory", "30 min", "-m benchmarks.stream_load soak", "--minutes 5"),
    "faults": Experiment("kill, stop and cut off everything around the stream", "5 min",
        f"{ALL} tests/corrector/test_faults.py tests/corrector/test_process.py"),
    "fuzz-stream": Experiment("send a million damaged frames through the corrector", "5 min",
        "pytest -q -m slow tests/corrector/test_stream.py"),
    "attack-stream": Experiment("send a million forged, replayed and damaged messages to a stream", "10 min",
        f"{ALL} -s tests/corrector/test_signed.py tests/corrector/test_attacks.py tests/corrector/test_acceptance.py"),
    "bench-stream": Experiment("compare the corrected stream with a bare zenoh echo", "2 min", "-m benchmarks.stream", "--tls"),
    "bench-watched": Experiment("measure the stream with and without an open page", "10 min",
        "-m benchmarks.stream_watched", "--seconds 10"),
    "bench-rsi": Experiment("ask a bridge for offsets as a KUKA controller does, and count late answers", "10 min",
        "-m tests.clients.bridges.long_run", "--cycles 15000"),
    "parity-c": Experiment("compare the C corrector with the compiled kernels on random setpoints", "10 min",
        "-m tests.core.correct.parity", "--count 100000"),
    "fuzz-c": Experiment("have libFuzzer damage programs and setpoints of the C corrector (clang)", "30 min",
        "sh tools/fuzz_c.sh", "5"),
    "bench-c": Experiment("time the C corrector for each setpoint up to the slowest", "1 min",
        "-m benchmarks.c_corrector", "--priority 50"),
    # Other people's simulators, each in an environment of its own
    "franka": Experiment("move a simulated Franka robot through a bridge (SECONDS=16 PRIORITY=40 LATE=drop)", "5 min",
        "pytest -q -s --timeout 1800 tests/clients/bridges/test_fci_bridge.py", environment=".venv-franka"),
    "lerobot": Experiment("run LeRobot's own follower on simulated servos (Python 3.12, 5 GB)", "5 min",
        "pytest -q --timeout 1800 tests/clients/lerobot", environment=".venv-lerobot"),
    "linuxcnc": Experiment("move a calibrated arm in LinuxCNC's simulation (linuxcnc-uspace-dev)", "5 min",
        "pytest -q -rs -m slow tests/clients/linuxcnc"),
    "kit": Experiment("ask kilter kit about simulated SO-101s, worn and clean; goes on where it was", "1 h",
        "-m tests.clients.lerobot.many_arms", "--n 10 --records build/many-arms.jsonl"),
    # Speed and size
    "bench-gap": Experiment("time gap hunts: 118 and 10 000 poses, and a motion at 4600 Hz", "10 min", "-m benchmarks.gap"),
    "bench-page": Experiment("measure the page: first view, memory, a campaign of a million rows", "10 min",
        "-m benchmarks.page", "--loads 50"),
    "bench-beside": Experiment("measure the kernels beside those of another commit, in turns", "10 min",
        "sh tools/bench_beside.sh", "HEAD~5"),
    "peers": Experiment("install the tools that make bench compares with", "2 min",
        "make .venv-peers/.ready .venv-peers-poe/.ready"),
    # The tests
    "slow": Experiment("run the longer tests that no other experiment names", "1 h",
        "pytest --testers 6 -m slow tests/core tests/contract tests/clients"),
    "page": Experiment("run all tests of the page, the long ones too (Chromium)", "20 min", f"{ALL} --testers 6 tests/page"),
    "cpu": Experiment("measure the processor time of each test and write tests/seconds.txt", "40 min",
        'pytest -q --cpu --write-cpu --testers 6 -m "not slow and not bench"', "tests/core/gap"),
    "coverage": Experiment("count the lines that the tests run, those of kernels without the compiler", "1 h",
        "sh tools/coverage.sh"),
    "pythons": Experiment("run the quick tests on every supported Python that is here", "20 min",
        "sh tools/test_pythons.sh", "oldest"),
    "test-wheels": Experiment("run the tests from installed wheels, after make wheels", "30 min",
        "sh tools/test_wheels.sh", "tests/core"),
}  # fmt: skip


def list_experiments() -> str:
    """Return a line for each experiment: its name, its duration, what one learns, and an example."""
    width = max(map(len, EXPERIMENTS))
    lines = [
        f"{name:{width}}  {one.subject} ({one.duration})" + (f", as in: {name} {one.example}" if one.example else "")
        for name, one in EXPERIMENTS.items()
    ]
    return "\n".join(["Run one by `python -m tools.lab NAME`; arguments after the name go to it:", *lines])


def find_command(name: str, arguments: list[str]) -> list[str]:
    """Return the command of an experiment; Python and pytest are those of this environment."""
    words = [*shlex.split(EXPERIMENTS[name].command), *arguments]
    if words[0] == "pytest":
        words.insert(0, "-m")
    return [sys.executable, *words] if words[0].startswith("-") else words


def main(arguments: list[str]) -> int:
    """Run an experiment, or list all of them."""
    if not arguments:
        print(list_experiments())
        return 0
    name, *given = arguments
    if name not in EXPERIMENTS:
        print(f"There is no experiment {name!r}. `python -m tools.lab` lists them.", file=sys.stderr)
        return 2
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"} | os.environ | {"PYTHONDONTWRITEBYTECODE": ""}
    built = [".venv/.made"]
    if place := EXPERIMENTS[name].environment:
        built.append(f"{place}/.ready")
        environment[f"KILTER_{name.upper()}"] = place
    subprocess.run(["make", "--no-print-directory", *built], cwd=REPOSITORY, check=True)  # noqa: S607 - the one in use
    return subprocess.run(find_command(name, given), cwd=REPOSITORY, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
