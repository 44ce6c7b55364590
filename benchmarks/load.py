"""`python -m tools.lab load`: a whole `kilterd serve` under many clients, on SQLite and on PostgreSQL.

Fifty clients that each wait for their answer write and read, and everything acknowledged is counted again; then a probe of
ten reads a second goes beside thirty mixed requests a second; then two hundred follow a job that waits. The memory of the
API process is read throughout. Last, a million rows are sent at once.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from benchmarks.table import Line, show
from tests.service.postgresql import programs, running_postgresql

CLIENTS, FOLLOWERS, OPEN_PER_S, ROWS = 50, 200, 30, 1_000_000
PROBE_P99_MS, ACKNOWLEDGED_S, SLOWER, GROWTH_MB = 20.0, 3.0, 0.10, 60.0
ARM = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}
NAMES = [*(f"q{j}_deg" for j in range(1, 6)), "x_mm", "y_mm", "z_mm"]


@contextmanager
def server(data: Path, database: str | None) -> Iterator[tuple[str, int]]:
    """Run `kilterd serve`; gives its URL and the process id of the API."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    settings = {"KILTER_DATA": str(data), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    environment = plain | settings | ({"KILTER_DATABASE_URL": database} if database else {})
    command = [sys.executable, "-m", "kilter_service", "serve"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        try:
            found = json.loads(process.stdout.readline())
            yield found["url"], _child_of(process.pid, "api")
        finally:
            process.terminate()
            process.wait(60)


def _child_of(parent: int, name: str) -> int:
    for one in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        if f"\0{name}\0".encode() in Path(f"/proc/{one}/cmdline").read_bytes():
            return int(one)
    raise RuntimeError(f"kilterd serve has no {name} process")


@contextmanager
def stopped_worker(api: int) -> Iterator[None]:
    """Hold the worker that stands beside an API, so that a job waits."""
    status = Path(f"/proc/{api}/status").read_text().splitlines()
    parent = next(int(line.split()[1]) for line in status if line.startswith("PPid"))
    worker = _child_of(parent, "worker")
    os.kill(worker, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(worker, signal.SIGCONT)


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


class Load:
    """Clients of one server, and what they saw."""

    def __init__(self, client: httpx.AsyncClient, pid: int, token: str) -> None:
        self._client, self._pid, self._token = client, pid, token
        self.errors: Counter[str] = Counter()
        self.memory: list[float] = []
        self.acknowledged: dict[str, int] = {}
        self._numbers = itertools.count()
        self._campaign = ""

    async def begin(self) -> None:
        """Add the arm and a campaign to read."""
        (await self._client.post("/v1/robots", json=ARM)).raise_for_status()
        self._campaign = await self._uploaded(20)

    async def _uploaded(self, rows: int) -> str:
        """Send a campaign with rows that no other has; it counts once everything was acknowledged."""
        number = next(self._numbers)
        answer = await self._client.post("/v1/robots/arm/campaigns", json={"name": f"load {number}"})
        campaign = str(answer.raise_for_status().json()["id"])
        random = np.random.default_rng(number)
        table = {name: random.uniform(-20.0, 20.0, rows).tolist() for name in NAMES}
        answer = await self._client.post(f"/v1/campaigns/{campaign}/observations", json=table)
        self.acknowledged[campaign] = answer.raise_for_status().json()["total_rows"]
        return campaign

    async def _mixed(self, number: int) -> None:
        """One request of a mix: mostly reads, one in five a write."""
        reads = ("/v1/robots/arm", f"/v1/campaigns/{self._campaign}", "/v1/jobs", "/v1/robots/arm/campaigns?limit=20")
        try:
            if number % 5 == 0:
                await self._uploaded(50)
            else:
                (await self._client.get(reads[number % len(reads)])).raise_for_status()
        except httpx.HTTPError as error:
            self.errors[str(error)[:120] or type(error).__name__] += 1

    async def closed(self, seconds: float) -> int:
        """Keep fifty clients busy; returns how many requests were sent."""
        end, sent = time.monotonic() + seconds, itertools.count()

        async def one(first: int) -> None:
            number = first
            while time.monotonic() < end:
                await self._mixed(number)
                number, _ = number + 1, next(sent)

        await asyncio.gather(*(one(k) for k in range(CLIENTS)), self._watched(end))
        return next(sent)

    async def _watched(self, end: float) -> None:
        while time.monotonic() < end:
            self.memory.append(memory_mb(self._pid))
            await asyncio.sleep(2.0)

    async def opened(self, seconds: float) -> list[float]:
        """Send thirty a second whatever comes back, and a probe beside; returns the probe's times in ms, sorted."""
        end, running = time.monotonic() + seconds, set()

        async def send() -> None:
            for number in itertools.count():
                if time.monotonic() > end:
                    return
                task = asyncio.create_task(self._mixed(number))
                running.add(task)
                task.add_done_callback(running.discard)
                await asyncio.sleep(1 / OPEN_PER_S)

        _, times, _ = await asyncio.gather(send(), self.probed(seconds), self._watched(end))
        await asyncio.gather(*running)
        return times

    async def probed(self, seconds: float) -> list[float]:
        """Read ten times a second from another process; returns the times in ms, sorted."""
        where = {"KILTER_URL": str(self._client.base_url), "KILTER_TOKEN": self._token}
        probe = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "benchmarks.probe", str(seconds), env=os.environ | where, stdout=subprocess.PIPE
        )
        said, _ = await probe.communicate()
        if probe.returncode != 0:
            raise RuntimeError("The probe failed; what it met stands above.")
        return [float(took) for took in json.loads(said)]

    async def followed(self, seconds: float) -> tuple[float, float]:
        """Read without and with two hundred followers of a job that waits; returns the median of each in ms."""
        wish = {"kind": "identify", "robot": "arm", "campaigns": [self._campaign]}
        with stopped_worker(self._pid):
            return await self._followed(wish, seconds)

    async def _followed(self, wish: dict[str, Any], seconds: float) -> tuple[float, float]:
        before = await self.probed(seconds)
        answer = await self._client.post("/v1/jobs", json=wish)
        job = answer.raise_for_status().json()["id"]
        async with AsyncExitStack() as stack:
            for _ in range(FOLLOWERS):
                stream = self._client.stream("GET", f"/v1/jobs/{job}/events", timeout=None)
                (await stack.enter_async_context(stream)).raise_for_status()
            during = await self.probed(seconds)
            state = (await self._client.get(f"/v1/jobs/{job}")).raise_for_status().json()["state"]
            assert state == "queued", state
        return before[len(before) // 2], during[len(during) // 2]

    async def million(self) -> float:
        """Send a million rows as Parquet; returns the seconds until they are acknowledged."""
        random, buffer = np.random.default_rng(1), io.BytesIO()
        parquet.write_table(pa.table({name: random.uniform(-20.0, 20.0, ROWS) for name in NAMES}), buffer)
        made = await self._client.post("/v1/robots/arm/campaigns", json={"name": "a million"})
        place = f"/v1/campaigns/{made.raise_for_status().json()['id']}/observations"
        headers = {"Content-Type": "application/vnd.apache.parquet"}
        began = time.perf_counter()
        answer = await self._client.post(place, content=buffer.getvalue(), headers=headers)
        took = time.perf_counter() - began
        assert answer.raise_for_status().json()["total_rows"] == ROWS
        return took

    async def lost_or_doubled(self) -> int:
        """Count what was acknowledged and is not there as it was, and what is there and was not."""
        listed = (await self._client.get("/v1/robots/arm/campaigns")).raise_for_status().json()["campaigns"]
        there = {one["id"]: one["rows"] for one in listed}
        lost = [campaign for campaign, rows in self.acknowledged.items() if there.get(campaign) != rows]
        named = Counter(one["name"] for one in listed)
        return len(lost) + sum(count - 1 for count in named.values())


@asynccontextmanager
async def clients(url: str, token: str) -> AsyncIterator[httpx.AsyncClient]:
    """Open a client with as many connections as are needed."""
    limits = httpx.Limits(max_connections=CLIENTS + FOLLOWERS + 50, max_keepalive_connections=CLIENTS)
    headers = {"Authorization": f"Bearer {token}"}
    async with httpx.AsyncClient(base_url=url, headers=headers, limits=limits, timeout=60) as client:
        yield client


async def measured(name: str, url: str, pid: int, token: str, minutes: float) -> list[Line]:
    """Load a server and say how it bore it."""
    async with clients(url, token) as client:
        load = Load(client, pid, token)
        await load.begin()
        sent = await load.closed(24 * minutes)
        times = await load.opened(24 * minutes)
        calm, followed = await load.followed(6 * minutes)
        wrong = await load.lost_or_doubled()
        million = await load.million()
    p99 = times[int(0.99 * len(times))]
    settled, last = load.memory[len(load.memory) // 4], load.memory[-1]
    errors = sum(load.errors.values())
    for text, count in load.errors.most_common(5):
        print(f"{name}: {count} x {text}", file=sys.stderr)
    return [
        Line(f"{name}: errors of {sent} requests by {CLIENTS} clients", f"{errors}", "0", errors == 0),
        Line(f"{name}: lost or doubled of {len(load.acknowledged)} uploads", f"{wrong}", "0", wrong == 0),
        Line(f"{name}: probe beside {OPEN_PER_S}/s, p99", f"{p99:.1f} ms", f"<= {PROBE_P99_MS:g} ms", p99 <= PROBE_P99_MS),
        Line(
            f"{name}: memory of the API, first, settled, last", f"{load.memory[0]:.0f}, {settled:.0f}, {last:.0f} MB",
            f"grows <= {GROWTH_MB:g} MB", last - settled <= GROWTH_MB,
        ),
        Line(
            f"{name}: reads beside {FOLLOWERS} followers, p50", f"{calm:.1f} -> {followed:.1f} ms",
            f"< {SLOWER:.0%} slower", followed <= (1 + SLOWER) * calm,
        ),
        Line(f"{name}: a million rows acknowledged", f"{million:.1f} s", f"<= {ACKNOWLEDGED_S:g} s", million <= ACKNOWLEDGED_S),
    ]  # fmt: skip


def main() -> int:
    """Load both databases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="of load, for each database")
    parser.add_argument("--database", choices=["sqlite", "postgresql", "both"], default="both")
    wanted = parser.parse_args()
    lines: list[Line] = []
    for name in ("sqlite", "postgresql"):
        if wanted.database not in (name, "both") or (name == "postgresql" and programs() is None):
            continue
        database: Any = running_postgresql() if name == "postgresql" else nullcontext(None)
        with ExitStack() as stack:
            data = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="kilter-load-")))
            url, pid = stack.enter_context(server(data, stack.enter_context(database)))
            token = (data / "token").read_text().strip()
            lines += asyncio.run(measured(name, url, pid, token, wanted.minutes))
    print(show(lines))
    return 0 if all(line.met for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
