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
TABLE = REPOSITORY / "tools" / "experiments.txt"


class Experiment(NamedTuple):
    """How long it takes on two cores, its command, an example of arguments, its own environment, and what one learns."""

    duration: str
    command: str
    example: str
    environment: str
    subject: str


def read_experiments() -> dict[str, Experiment]:
    """Return the experiments by name, in the order of their table."""
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.split("|")] for line in lines if line and not line.startswith("#")]
    return {name: Experiment(*cells) for name, *cells in rows}


EXPERIMENTS = read_experiments()


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
