"""Send mix-ups through every way in, to a server of its own: ``python -m tests.mix_ups.ways``.

The ways: the upload, its dry run by the command, and jobs of `identify` and `gap` on rows that came in pieces.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np

from kilter_service.contract.jobs.kind import FINAL
from tests.mix_ups.arms import BUILDS
from tests.mix_ups.campaigns import MIXED, Genuine, genuine
from tests.mix_ups.columns import Columns, columns_of
from tests.mix_ups.score import bounds, is_worn, of_few_joints

PIECE = 11  # rows of a piece that is too small to be judged alone
REFUSED = ("foreign_observations", "markers_swapped", "markers_not_rigid", "markers_mirrored", "observations_invalid")
WAYS = ("upload", "dry run", "identify", "gap")


class Server:
    """A server of our own, and the command that speaks to it."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.folder, self.environment = folder, environment
        token = (folder / "token").read_text().strip()
        self.http = httpx.Client(
            base_url=environment["KILTER_URL"], headers={"Authorization": f"Bearer {token}"}, timeout=300
        )

    def said(self, way: str, robot: str, columns: Columns) -> str:
        """What the rows are refused with on one way in, empty where they are taken."""
        if way == "dry run":
            return self._dry_run(robot, columns)
        if way == "upload":
            return _problem(self._sent(robot, columns, len(columns["q1_deg" if "q1_deg" in columns else "q1_mm"])))
        answer = self._sent(robot, columns, PIECE)
        return _problem(answer) or self._of_job(way, robot, str(answer.json()["campaign_id"]))

    def _sent(self, robot: str, columns: Columns, piece: int) -> httpx.Response:
        made = self.http.post(f"/v1/robots/{robot}/campaigns", json={"name": "rows", "numbered": True})
        address = f"/v1/campaigns/{made.raise_for_status().json()['id']}/observations"
        count = len(next(iter(columns.values())))
        for first in range(0, count, piece):
            part = {name: values[first : first + piece] for name, values in columns.items()}
            answer = self.http.post(address, json=part)
            if answer.is_error:
                break
        return answer

    def _dry_run(self, robot: str, columns: Columns) -> str:
        path = self.folder / "rows.csv"
        out = io.StringIO(newline="")
        csv.writer(out).writerows([list(columns), *zip(*columns.values(), strict=True)])
        path.write_text(out.getvalue())
        done = subprocess.run(
            ["kilter", "upload", robot, str(path), "--dry-run", "--json"],
            env=self.environment,
            capture_output=True,
            text=True,
        )
        found = json.loads(done.stdout)
        if found.get("not_checked"):
            raise RuntimeError(found["not_checked"])
        return "; ".join(found["refused"]) if "refused" in found else str(found["detail"])

    def _of_job(self, kind: str, robot: str, campaign: str) -> str:
        asked = self.http.post("/v1/jobs", json={"kind": kind, "robot": robot, "campaigns": [campaign]})
        if asked.is_error:
            return _problem(asked)
        address = asked.headers["location"]
        while (job := self.http.get(address).json())["state"] not in FINAL:
            time.sleep(0.1)
        error = job["error"] or {}
        return str(error["message"]) if error.get("code") in REFUSED else ""


def _problem(answer: httpx.Response) -> str:
    """What was refused about the rows; another error is no judgement of them."""
    if not answer.is_error:
        return ""
    found = answer.json()
    if found["code"] not in REFUSED:
        raise RuntimeError(str(found))
    return str(found["detail"])


@contextmanager
def served() -> Iterator[Server]:
    """Start a server on a folder for a while."""
    with tempfile.TemporaryDirectory(prefix="kilter-mix-ups-") as name:
        folder = Path(name)
        environment = {key: value for key, value in os.environ.items() if not key.startswith("KILTER_")}
        environment |= {"KILTER_DATA": name, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        with (folder / "said.txt").open("w") as log:
            process = subprocess.Popen(["kilterd", "serve", "--port", "0"], env=environment, stdout=log, stderr=log)
            try:
                told = folder / "server.json"
                while not told.exists():
                    if process.poll() is not None:
                        raise RuntimeError((folder / "said.txt").read_text())
                    time.sleep(0.2)
                environment["KILTER_URL"] = json.loads(told.read_text())["url"]
                yield Server(folder, environment)
            finally:
                process.terminate()
                process.wait(60)


def registered(server: Server, g: Genuine, name: str) -> str:
    """Add the arm of a campaign."""
    server.http.post("/v1/robots", json=g.pair.drawn.document() | {"name": name}).raise_for_status()
    return name


def main() -> None:
    """Send and count."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--genuine", type=int, default=50, help="genuine campaigns that are uploaded, and run dry")
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    found, accused = Counter[str](), 0
    with served() as server:
        for build in BUILDS:
            g = genuine(given.seed + 50 + list(BUILDS).index(build), build)
            robot = registered(server, g, f"mixed-{build.lower()}")
            for name, mix in MIXED.items():
                columns = columns_of(g, mix(g, np.random.default_rng(given.seed)))
                for way in WAYS:
                    text = server.said(way, robot, columns)
                    found[way] += bool(text)
                    if not text:
                        print(f"missed: {way}, {name} ({g.kind}, {len(g.rows)} rows)", flush=True)
            print(f"{build}: {dict(found)}", flush=True)
        for seed in range(given.seed, given.seed + given.genuine):
            g = genuine(seed, moving=of_few_joints(seed), worn=is_worn(seed))
            robot = registered(server, g, f"genuine-{seed}")
            for way in WAYS[:2]:
                text = server.said(way, robot, columns_of(g))
                accused += bool(text)
                if text:
                    print(f"accused: {way}, {seed} ({g.kind}): {text}", flush=True)
    count = len(BUILDS) * len(MIXED)
    for way in WAYS:
        print(f"{way}: {found[way]} of {count} mix-ups named or refused, 95 % bounds {bounds(found[way], count)}")
    print(f"genuine campaigns accused by upload or dry run: {accused} of {2 * given.genuine}")


if __name__ == "__main__":
    main()
