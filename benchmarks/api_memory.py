"""`python -m tools.lab api-memory`: what the API process keeps after thousands of requests over 28 routes."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx

from benchmarks.load import memory_mb, server
from benchmarks.table import Line, show

ASKED_MB, SETTLED_MB = 300.0, 15.0
REPOSITORY = Path(__file__).resolve().parents[1]
TUTORIAL = REPOSITORY / "docs" / "tutorial"
CSV = {"Content-Type": "text/csv"}
Request = tuple[str, str, dict[str, object]]


def calibrate(client: httpx.Client) -> dict[str, str]:
    """Identify and activate a version of the tutorial's arm; returns the ids that routes name."""
    arm = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}
    client.post("/v1/robots", json=arm).raise_for_status()
    campaign, other = (_upload(client, name) for name in ("measured", "held-out"))
    wish = {"kind": "identify", "robot": "arm", "campaigns": [campaign]}
    job = str(client.post("/v1/jobs", json=wish).raise_for_status().json()["id"])
    end = time.monotonic() + 120
    while (answer := client.get(f"/v1/jobs/{job}").json())["state"] not in {"succeeded", "failed", "cancelled"}:
        if time.monotonic() > end:
            raise TimeoutError(f"job {job} is {answer['state']} after two minutes")
        time.sleep(0.2)
    version = str(client.get("/v1/robots/arm/versions").raise_for_status().json()["versions"][0]["id"])
    client.post(f"/v1/versions/{version}/activate", json={"force": True}).raise_for_status()
    return {"campaign": campaign, "other": other, "job": job, "version": version}


def _upload(client: httpx.Client, name: str) -> str:
    answer = client.post("/v1/robots/arm/campaigns", json={"name": name}).raise_for_status()
    campaign = str(answer.json()["id"])
    rows = (TUTORIAL / f"{name}.csv").read_bytes()
    client.post(f"/v1/campaigns/{campaign}/observations", content=rows, headers=CSV).raise_for_status()
    return campaign


def requests_of(ids: dict[str, str]) -> list[Request]:
    """Return one request of each route: of the interface, of the page, and of what computes."""
    campaign, job, version = (
        f"/v1/campaigns/{ids['campaign']}",
        f"/v1/jobs/{ids['job']}",
        f"/v1/versions/{ids['version']}",
    )
    rows = (TUTORIAL / "held-out.csv").read_bytes()
    path = b"q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n" + b"".join(
        b",".join(line.split(b",")[:5]) + b"\n" for line in rows.splitlines()[1:]
    )
    wish = {"kind": "identify", "robot": "arm", "campaigns": [ids["campaign"]]}
    read = [
        "/v1/robots", "/v1/robots/arm", "/v1/robots/arm/today", "/v1/robots/arm/drift", "/v1/robots/arm/activations",
        "/v1/robots/arm/campaigns", campaign, f"{campaign}/observations", f"{campaign}/suspicious", "/v1/jobs", job,
        "/v1/robots/arm/versions", version, f"{version}/preview", f"{version}/residuals?format=csv",
        f"{version}/export?format=json", f"{version}/diff/nominal",
        f"/v1/robots/arm/acceptance?tolerance_mm=1&campaign={ids['other']}", "/v1/audit", "/v1/health", "/metrics",
        "/", "/robots/arm", f"/campaigns/{ids['campaign']}", f"/versions/{ids['version']}",
    ]  # fmt: skip
    computed: list[Request] = [
        ("POST", "/v1/robots/arm/correct", {"content": path, "headers": CSV}),
        ("POST", "/v1/robots/arm/observations/check", {"content": rows, "headers": CSV}),
        ("POST", "/v1/jobs/check", {"json": wish}),
    ]
    return [*(("GET", where, {}) for where in read), *computed]


def ask(client: httpx.Client, wanted: list[Request], count: int, threads: int) -> Counter[str]:
    """Send requests in turn from several threads; returns how many were refused, by route and status."""
    refused: Counter[str] = Counter()

    def send(number: int) -> None:
        method, where, body = wanted[number % len(wanted)]
        status = client.request(method, where, **body).status_code  # type: ignore[arg-type]
        if status != 200:
            refused[f"{method} {where}: {status}"] += 1

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(send, range(count)):
            pass
    return refused


def print_growth(client: httpx.Client, wanted: list[Request], pid: int) -> None:
    """Print what the first five requests of each route add, in their order."""
    before = memory_mb(pid)
    for one in wanted:
        ask(client, [one], 5, 1)
        now = memory_mb(pid)
        print(f"{now - before:+7.1f} MB  {now:6.1f} MB  {one[0]} {one[1]}", flush=True)
        before = now


def main() -> int:
    """Start a server, ask it, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--requests", type=int, default=4000)
    parser.add_argument("--threads", type=int, default=8)
    parser.add_argument("--by-route", action="store_true", help="print what each route adds first")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kilter-memory-") as folder, server(Path(folder), None) as (url, pid):
        started = memory_mb(pid)
        bearer = {"Authorization": f"Bearer {(Path(folder) / 'token').read_text().strip()}"}
        with httpx.Client(base_url=url, headers=bearer, timeout=120) as client:
            wanted = requests_of(calibrate(client))
            if given.by_route:
                print_growth(client, wanted, pid)
            refused = ask(client, wanted, given.requests // 2, given.threads)
            half = memory_mb(pid)
            refused += ask(client, wanted, given.requests - given.requests // 2, given.threads)
            kept = memory_mb(pid)
    for what, count in refused.most_common():
        print(f"refused {count} x {what}", file=sys.stderr)
    lines = [
        Line("memory of the API when it starts", f"{started:.0f} MB"),
        Line(f"memory after {given.requests} requests over {len(wanted)} routes", f"{kept:.0f} MB",
             f"<= {ASKED_MB:g} MB", kept <= ASKED_MB),
        Line("grown in the second half", f"{kept - half:.0f} MB", f"<= {SETTLED_MB:g} MB", kept - half <= SETTLED_MB),
        Line("requests refused", f"{sum(refused.values())}", "0", not refused),
    ]  # fmt: skip
    print(show(lines))
    return 0 if all(line.met is not False for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
