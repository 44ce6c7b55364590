"""The page's figures: the first view, memory over many of them, and a campaign of a million rows.

    python -m benchmarks.page [--loads 1000] [--rows 1000000]

Seconds are those of Chromium on this machine, from the request to the painted page; memory is that of the API process.
"""

from __future__ import annotations

import argparse
import io
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from playwright.sync_api import Browser, Page, sync_playwright

from kilter_client.requests.connection import LocalServer, local_server
from kilter_service.web.auth.policy import PAGE_RULES

ROBOT = {"name": "bench", "convention": "preset", "preset": "katana450-chapter5"}
FIRST, BYTES, INTERACTION = "first page <= 1 s", "first page <= 400 kB", "interaction <= 100 ms"
PAINT = """() => new Promise((done) => {
    const seen = performance.getEntriesByName("first-contentful-paint");
    if (seen.length) return done(seen[0].startTime);
    new PerformanceObserver((list) => done(list.getEntries()[0].startTime)).observe({ type: "paint", buffered: true });
})"""


def resident_mb(url: str, data: Path) -> float:
    """Memory of the API process, MB; it is the child of the server that says `api`."""
    import json

    parent = json.loads((data / "server.json").read_text())["pid"]
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        if b"api" in Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0"):
            lines = Path(f"/proc/{child}/status").read_text().splitlines()
            return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024
    raise SystemExit(f"{url} has no API process")


@contextmanager
def browser_of(server: LocalServer) -> Iterator[Browser]:
    """Chromium."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("Chromium is not installed: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def logged_in(browser: Browser, server: LocalServer) -> Page:
    """A page of a browser with nothing in its cache, behind the login."""
    page = browser.new_context(base_url=server.url).new_page()
    page.goto("/login")
    page.get_by_label("Token").fill((server.data / "token").read_text(encoding="ascii").strip())
    page.get_by_role("button", name="Log in").click()
    page.wait_for_url("**/")
    return page


def first_page(browser: Browser, server: LocalServer, times: int = 10) -> None:
    """Time to the first paint and to the end of loading, with an empty cache."""
    paints, loads, sizes = [], [], []
    for _ in range(times):
        page = logged_in(browser, server)
        session = page.context.new_cdp_session(page)
        session.send("Network.enable")
        session.send("Network.setCacheDisabled", {"cacheDisabled": True})
        size = [0.0]
        session.on("Network.loadingFinished", lambda event, size=size: size.append(event["encodedDataLength"]))
        begin = time.perf_counter()
        page.goto("/", wait_until="load")
        loads.append(time.perf_counter() - begin)
        paints.append(float(page.evaluate(PAINT)) / 1000)
        sizes.append(sum(size))
        page.context.close()
    print(f"first paint {statistics.median(paints):.3f} s, loaded {statistics.median(loads):.3f} s ({FIRST})")
    print(f"bytes on the wire {max(sizes) / 1024:.0f} kB ({BYTES})")


def memory(client: httpx.Client, server: LocalServer, loads: int) -> None:
    """Memory of the API process before and after many views."""
    paths = ["/", f"/robots/{ROBOT['name']}/stream", f"/robots/{ROBOT['name']}"]
    paths = [path for path in paths if client.get(path).status_code == 200]
    for _ in range(50):
        client.get(paths[0])
    before = resident_mb(server.url, server.data)
    for k in range(loads):
        client.get(paths[k % len(paths)]).raise_for_status()
    after = resident_mb(server.url, server.data)
    print(f"memory {before:.0f} MB, after {loads} loads of {len(paths)} views {after:.0f} MB")


def campaign(client: httpx.Client, rows: int) -> str:
    """Upload a campaign of so many rows; returns its id."""
    rng = np.random.default_rng(0)
    columns = {f"q{j + 1}_deg": rng.uniform(-5, 5, rows) for j in range(5)}
    columns |= {f"{axis}_mm": rng.normal(0, 1, rows) for axis in "xyz"}
    out = io.BytesIO()
    pq.write_table(pa.table(columns), out)  # type: ignore[no-untyped-call]
    made = client.post(f"/v1/robots/{ROBOT['name']}/campaigns", json={"name": "many"}).raise_for_status().json()
    headers = {"Content-Type": "application/vnd.apache.parquet"}
    address = f"/v1/campaigns/{made['id']}/observations"
    client.post(address, content=out.getvalue(), headers=headers, timeout=300).raise_for_status()
    return str(made["id"])


def interaction(browser: Browser, server: LocalServer, client: httpx.Client, rows: int) -> None:
    """Time from a key or click to the next paint in the view of a large campaign."""
    if "GET /campaigns/{campaign}" not in PAGE_RULES:
        print("the view of a campaign is not there: not measured")
        return
    page = logged_in(browser, server)
    begin = time.perf_counter()
    page.goto(f"/campaigns/{campaign(client, rows)}", wait_until="load", timeout=300_000)
    print(f"a campaign of {rows} rows is loaded in {time.perf_counter() - begin:.2f} s (with its upload)")
    script = """() => new Promise((done) => {
        const begin = performance.now();
        const summary = document.querySelector("main details > summary") || document.querySelector("[data-theme-switch]");
        summary.click();
        requestAnimationFrame(() => setTimeout(() => done(performance.now() - begin)));
    })"""
    found = [float(page.evaluate(script)) for _ in range(20)]
    print(f"click to next paint: median {statistics.median(found):.0f} ms, largest {max(found):.0f} ms ({INTERACTION})")


def main() -> None:
    """Run everything once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loads", type=int, default=1000, help="views for the memory")
    parser.add_argument("--rows", type=int, default=1_000_000, help="rows of the large campaign")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, local_server(Path(folder)) as server:
        token = (server.data / "token").read_text(encoding="ascii").strip()
        with httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {token}"}, timeout=60) as client:
            client.post("/v1/robots", json=ROBOT).raise_for_status()
            memory(client, server, given.loads)
            with browser_of(server) as browser:
                first_page(browser, server)
                interaction(browser, server, client, given.rows)


if __name__ == "__main__":
    main()
