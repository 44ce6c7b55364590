"""Data of earlier releases: what `upgrade --check` prints, and how far the joints that today's server answers are from theirs.

Each release runs from its own commit, stores an arm with an active version, and corrects a path; today's server takes its
data over and corrects the same path.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
from numpy.typing import NDArray

from benchmarks.api_memory import CSV, REPOSITORY, TUTORIAL, calibrate

PARTS = ("core", "service", "clients/files", "clients/python/src", ".")
RELEASES = ("546da9f5", "98bdbf205", "f65592892")  # the one before seals, 0.1.0, 0.2.0
PLAIN = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
COMMAND = [sys.executable, "-m", "kilter_service"]


@contextmanager
def running(data: Path, code: Path | None) -> Iterator[httpx.Client]:
    """Run `kilterd serve` of a commit's files, or of today's, on a data folder."""
    own = {"KILTER_DATA": str(data), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    own |= {} if code is None else {"PYTHONPATH": os.pathsep.join(str(code / part) for part in PARTS)}
    with subprocess.Popen(
        [*COMMAND, "serve"], env=PLAIN | own, cwd=data, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as server:
        try:
            assert server.stdout is not None
            url = json.loads(server.stdout.readline())["url"]
            bearer = {"Authorization": f"Bearer {(data / 'token').read_text().strip()}"}
            with httpx.Client(base_url=url, headers=bearer, timeout=300) as client:
                yield client
        finally:
            server.terminate()
            server.wait(60)


def corrected_deg(client: httpx.Client) -> NDArray[np.float64]:
    """Joints (N, 5) to which the tutorial's poses are corrected."""
    rows = [line.split(",")[:5] for line in (TUTORIAL / "measured.csv").read_text().splitlines()]
    content = "\n".join(",".join(row) for row in rows)
    answer = client.post("/v1/robots/arm/correct", content=content, headers=CSV).raise_for_status().text
    read = csv.DictReader(line for line in answer.splitlines() if not line.startswith("#"))
    return np.array([[float(row[name]) for name in rows[0]] for row in read])


def main() -> None:
    """Take over data of each release and print what changes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--releases", default=",".join(RELEASES), help="commits")
    for commit in parser.parse_args().releases.split(","):
        with tempfile.TemporaryDirectory() as folder:
            code, data = Path(folder) / "code", Path(folder) / "data"
            data.mkdir(mode=0o700)
            code.mkdir()
            archive = subprocess.run(["git", "archive", commit], cwd=REPOSITORY, check=True, capture_output=True)
            subprocess.run(["tar", "-x"], cwd=code, check=True, input=archive.stdout)
            with running(data, code) as client:
                calibrate(client)
                before = corrected_deg(client)
            plan = subprocess.run(
                [*COMMAND, "upgrade", "--check"], env=PLAIN | {"KILTER_DATA": str(data)}, cwd=data,
                check=True, capture_output=True, text=True,
            )  # fmt: skip
            print(f"{commit}: {plan.stdout.splitlines()[0]}")
            with running(data, None) as client:
                apart = np.abs(corrected_deg(client) - before)
            print(f"{commit}: joints of {len(apart)} setpoints change by at most {apart.max():.2g} deg", flush=True)


if __name__ == "__main__":
    main()
