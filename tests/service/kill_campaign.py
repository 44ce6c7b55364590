"""Kills the processes of a server at random moments while clients work, and compares what is stored with what was promised.

``tools.lab kills`` runs many. Each client has a robot of its own and sends every request until it is answered, so what the
server holds at the end is known exactly: nothing lost, nothing half, nothing doubled.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from kilter_service.ground.settings import Settings
from kilter_service.run.backup.service import verify_stored
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana

REPOSITORY = Path(__file__).resolve().parents[2]
VICTIMS = ("api", "worker", "corrector")
SUPERVISOR = 0.1  # of the moments hit the supervisor
PATIENCE_S = 280.0
CLIENTS, ROWS = 3, 40
HEAVY = 3  # one job in so many operations


class Server:
    """`kilterd serve` at one port, started again when it was killed."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self.settings = Settings(data=folder, database_url=None, port=port, zenoh_listen="tcp/127.0.0.1:0", token=None)
        self.url = f"http://127.0.0.1:{port}"
        self.log = (folder.parent / "server.log").open("ab")
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; again while the processes of the killed one still hold the port."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "kilter_service", "serve"],
                env={**os.environ, **self.settings.environment()},
                cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=self.log, stderr=self.log,
            )  # fmt: skip
            while self.process.poll() is None and time.monotonic() < deadline:
                if self.settings.server_file.exists() and self._says_its_pid():
                    return
                time.sleep(0.05)
            assert time.monotonic() < deadline, "the server did not start: see server.log"

    def _says_its_pid(self) -> bool:
        try:
            said = json.loads(self.settings.server_file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return self.process is not None and bool(said["pid"] == self.process.pid)

    def children(self) -> dict[str, int]:
        """Process ids by command."""
        assert self.process is not None
        found = {}
        with suppress(OSError):
            pids = (
                Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text(encoding="ascii").split()
            )
            for pid in pids:
                with suppress(OSError):
                    command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
                    if b"kilter_service" in command[:-1]:
                        found[command[command.index(b"kilter_service") + 1].decode()] = int(pid)
        return found

    def kill_supervisor(self) -> float:
        """Kill the supervisor, start it again; returns the seconds until all is as before."""
        assert self.process is not None
        begin = time.monotonic()
        self.process.kill()
        self.process.wait()
        self.start()
        return time.monotonic() - begin

    def kill(self, victims: list[str]) -> dict[str, float]:
        """Kill processes at one moment, as the system does; returns the seconds until each was noticed to be back."""
        there = self.children()
        killed = {victim: there[victim] for victim in victims if victim in there}
        begin, took = time.monotonic(), {}
        for pid in killed.values():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        while len(took) < len(killed):
            for victim, pid in killed.items():
                if victim not in took and self._is_back(victim, pid):
                    took[victim] = time.monotonic() - begin
            assert time.monotonic() - begin < PATIENCE_S, f"{killed} did not come back: see server.log"
            assert self.process is not None
            assert self.process.poll() is None, "the server ended: see server.log"
            time.sleep(0.02)
        return took

    def _is_back(self, victim: str, killed: int) -> bool:
        pid = self.children().get(victim, killed)
        if pid == killed:
            return False
        if victim == "api":
            return self._answers()
        if victim == "worker":
            return pid in self._beating()
        try:
            return bool(json.loads(self.settings.corrector_file.read_text(encoding="utf-8"))["pid"] == pid)
        except (OSError, ValueError, KeyError):
            return False

    def _answers(self) -> bool:
        try:
            return httpx.get(f"{self.url}/v1/health/live", timeout=5).status_code == 200
        except httpx.TransportError:
            return False

    def _beating(self) -> list[int]:
        with closing(sqlite3.connect(self.settings.data / "kilter.sqlite", timeout=30)) as file:
            return [pid for (pid,) in file.execute("SELECT pid FROM heartbeats WHERE process = 'worker'")]

    def stop(self) -> None:
        """End it."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(30)
            self.process.kill()
            self.process.wait()
        self.log.close()


@dataclass
class Promised:
    """What the server has acknowledged to one client."""

    robot: str
    campaigns: dict[str, dict[str, int]] = field(default_factory=dict)
    jobs: list[str] = field(default_factory=list)
    versions: list[str] = field(default_factory=list)
    log: list[str] = field(default_factory=list)


class Client(threading.Thread):
    """Works at random on a robot of its own, and sends each request until it is answered."""

    def __init__(self, server: Server, token: str, number: int, seed: int) -> None:
        super().__init__(name=f"client {number}")
        self.promised = Promised(f"arm{number}")
        self.stopping = threading.Event()
        self.error: BaseException | None = None
        self.sent = 0
        self._random = random.Random(seed)
        self._http = httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {token}"}, timeout=30)

    def run(self) -> None:
        """Work until told to stop; what goes wrong is kept for the thread that asks."""
        try:
            self._ask("POST", "/v1/robots", json=Katana.document | {"name": self.promised.robot})
            while not self.stopping.is_set():
                self._random.choice((self._measure, self._measure, self._identify, self._activate, self._look))()
        except BaseException as error:
            self.error = error
        finally:
            self._http.close()

    def _ask(self, method: str, path: str, headers: dict[str, str] | None = None, **given: Any) -> httpx.Response:
        """Send a request under one key until there is an answer below 500."""
        key = {"Idempotency-Key": f"{self._random.getrandbits(128):032x}"}
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                answer = self._http.request(method, path, headers=key | (headers or {}), **given)
                if answer.status_code < 500:
                    self.sent += 1
                    return answer
            except httpx.TransportError:
                pass
            assert time.monotonic() < deadline, f"{method} {path} is not answered"
            time.sleep(0.02)

    def _measure(self) -> None:
        robot, promised = self.promised.robot, self.promised
        name = f"c{len(promised.campaigns)}"
        staged = self._random.random() < 0.5
        campaign = self._ask("POST", f"/v1/robots/{robot}/campaigns", json={"name": name, "staged": staged})
        assert campaign.status_code == 201, campaign.text
        identity = campaign.json()["id"]
        uploads = promised.campaigns.setdefault(identity, {})
        for _ in range(self._random.randint(1, 3)):
            columns = Katana().columns(ROWS, seed=self._random.getrandbits(30))
            done = self._ask("POST", f"/v1/campaigns/{identity}/observations", json=columns)
            assert done.status_code == 201, done.text
            uploads[done.json()["sha256"]] = done.json()["rows"]
        if staged:
            done = self._ask("POST", f"/v1/campaigns/{identity}/commit", json={"sha256": [*uploads]})
            assert done.status_code == 200, done.text

    def _identify(self) -> None:
        if not self.promised.campaigns or len(self.promised.jobs) > self.sent / HEAVY / 2:
            return
        body = {
            "kind": "identify", "robot": self.promised.robot, "campaigns": [self._random.choice([*self.promised.campaigns])],
            "options": {"level": 1},
        }  # fmt: skip
        done = self._ask("POST", "/v1/jobs", json=body)
        assert done.status_code == 202, done.text
        self.promised.jobs.append(done.json()["id"])

    def _activate(self) -> None:
        robot, log = self.promised.robot, self.promised.log
        versions = self._ask("GET", f"/v1/robots/{robot}/versions").json()["versions"]
        if not versions:
            return
        if len(set(log)) > 1 and self._random.random() < 0.3:
            state = self._ask("GET", f"/v1/robots/{robot}/activations")
            assert len(state.json()["activations"]) == len(log), (state.text, log)
            back = self._ask("POST", f"/v1/robots/{robot}/rollback", {"If-Match": state.headers["etag"]})
            if back.status_code == 409:  # nothing before it
                return
            # 412: it was done, and the answer was lost
            assert back.status_code in (200, 412), back.text
            after = self._ask("GET", f"/v1/robots/{robot}/activations").json()["activations"]
            assert len(after) == len(log) + 1, (after, log)
            log.append(after[0]["version_id"])
            return
        version = self._random.choice(versions)["id"]
        done = self._ask("POST", f"/v1/versions/{version}/activate", json={"force": True, "reason": "kills"})
        assert done.status_code == 200, done.text
        if log[-1:] != [version]:
            log.append(version)

    def _look(self) -> None:
        """All that was promised is there at every moment."""
        if self.promised.campaigns:
            identity = self._random.choice([*self.promised.campaigns])
            shown = self._ask("GET", f"/v1/campaigns/{identity}").json()
            assert {one["sha256"]: one["rows"] for one in shown["uploads"]} == self.promised.campaigns[identity], shown


def campaign(folder: Path, kills: int, seed: int, told: Any = lambda line: None) -> dict[str, Any]:
    """Kill so many times and check; returns the figures. What is wrong is an AssertionError with the seed."""
    told(f"seed {seed}, {kills} kills")
    server = Server(folder / "data")
    rng = random.Random(seed)
    clients: list[Client] = []
    try:
        server.start()
        token = admin_token(server.settings)
        clients = [Client(server, token, number, rng.getrandbits(64)) for number in range(CLIENTS)]
        for client in clients:
            client.start()
        recovered = _kill(server, clients, kills, rng, told)
        for client in clients:
            client.stopping.set()
        for client in clients:
            client.join(PATIENCE_S)
            assert not client.is_alive()
            if client.error is not None:
                raise client.error
        checked = check(server, token, [client.promised for client in clients])
        left = [path for path in (server.settings.data / "tmp").iterdir() if path.is_dir()]
        assert len(left) <= 2, left  # of the API and the corrector that run
    except BaseException:
        told(f"it went wrong with seed {seed}; the log is {folder / 'server.log'}")
        raise
    finally:
        for client in clients:
            client.stopping.set()
        server.stop()
    found = verify_stored(server.settings)
    assert found.damaged == [], found.damaged
    return checked | {"kills": kills, "requests": sum(client.sent for client in clients), "recovered_s": recovered}


def _kill(server: Server, clients: list[Client], kills: int, rng: random.Random, told: Any) -> dict[str, list[float]]:
    recovered: dict[str, list[float]] = {}
    done = 0
    while done < kills:
        time.sleep(rng.uniform(0.0, 0.6))
        for client in clients:
            if client.error is not None:
                raise client.error
        if rng.random() < SUPERVISOR:
            took = {"supervisor": server.kill_supervisor()}
        else:
            took = server.kill(rng.sample(VICTIMS, min(rng.randint(1, len(VICTIMS)), kills - done)))
        done += len(took)
        for victim, seconds in took.items():
            recovered.setdefault(victim, []).append(seconds)
        told(f"{done} kills: {', '.join(f'{victim} back after {seconds:.1f} s' for victim, seconds in took.items())}")
    return recovered


def check(server: Server, token: str, promised: list[Promised]) -> dict[str, int]:
    """Compare what is stored with what was promised, once all jobs are over."""
    counts = {"campaigns": 0, "uploads": 0, "jobs": 0, "activations": 0}
    with httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {token}"}, timeout=60) as http:
        for one in promised:
            for job in one.jobs:
                _over(http, job)

            def listed(what: str, robot: str = one.robot) -> list[dict[str, Any]]:
                answer = http.get(f"/v1/robots/{robot}/{what}", params={"limit": 1000}).raise_for_status().json()
                assert not answer.get("next")
                return list(answer[what])

            campaigns = {c["id"]: {u["sha256"]: u["rows"] for u in c["uploads"]} for c in listed("campaigns")}
            assert campaigns == one.campaigns
            staged = http.get(f"/v1/robots/{one.robot}/campaigns", params={"staged": True}).json()["campaigns"]
            assert staged == []
            jobs = http.get("/v1/jobs", params={"robot": one.robot, "limit": 1000}).json()["jobs"]
            assert sorted(job["id"] for job in jobs) == sorted(one.jobs)
            versions = sorted(version["job_id"] for version in listed("versions"))
            assert versions == sorted(job["id"] for job in jobs if job["state"] == "succeeded")
            assert [entry["version_id"] for entry in reversed(listed("activations"))] == one.log
            counts["campaigns"] += len(campaigns)
            counts["uploads"] += sum(map(len, campaigns.values()))
            counts["jobs"] += len(jobs)
            counts["activations"] += len(one.log)
    return counts


def _over(http: httpx.Client, job: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        found = http.get(f"/v1/jobs/{job}").raise_for_status().json()
        if found["state"] in ("succeeded", "failed", "cancelled"):
            assert found["state"] == "succeeded", found
            return
        assert time.monotonic() < deadline, found
        time.sleep(0.1)


def main() -> None:
    """Run a campaign and print its figures."""
    parser = argparse.ArgumentParser(description="Kill the processes of a server while clients work.")
    parser.add_argument("--n", type=int, default=500)
    parser.add_argument("--seed", type=int, default=None)
    given = parser.parse_args()
    seed = random.SystemRandom().getrandbits(32) if given.seed is None else given.seed
    folder = Path(tempfile.mkdtemp(prefix="kilter-kills-"))
    done = campaign(folder, given.n, seed, lambda line: print(line, flush=True))
    times = done.pop("recovered_s")
    every = [took for one in times.values() for took in one]
    print(f"0 lost, 0 half, 0 doubled: {done}")
    for victim, one in sorted(times.items()):
        print(f"  {victim}: {len(one)} kills, recovered in {statistics.median(one):.2f} s (longest {max(one):.2f} s)")
    print(f"  recovery p95 {statistics.quantiles(every, n=20)[18]:.2f} s" if len(every) > 1 else "")


if __name__ == "__main__":
    main()
