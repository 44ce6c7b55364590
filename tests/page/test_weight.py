"""What the browser has to load for the first page, compressed as it is sent."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import httpx
import pytest

from tests.service.conftest import Katana

from .made import made

FIRST_KB, WITH_3D_KB, PICTURE_KB = 400, 700, 700
LINKED = re.compile(r'(?:src|href)="(/assets/[^"]+)"')


def sent(server: httpx.Client, path: str) -> int:
    """Bytes of an answer as they are on the wire, with what it links to."""
    with server.stream("GET", path, headers={"Accept-Encoding": "gzip"}) as answer:
        answer.raise_for_status()
        raw = b"".join(answer.iter_raw())
    return len(raw)


def whole(server: httpx.Client, path: str, seen: set[str]) -> int:
    """Bytes of a view and of every asset that was not loaded before."""
    linked = set(LINKED.findall(server.get(path).text)) - seen
    seen |= linked
    return sent(server, path) + sum(sent(server, asset) for asset in linked)


def on_the_wire(server: httpx.Client, path: str, takes: str) -> tuple[bytes, httpx.Headers]:
    with server.stream("GET", path, headers={"Accept-Encoding": takes}) as answer:
        return b"".join(answer.iter_raw()), answer.headers


@pytest.mark.parametrize("path", ["/", "/new-robot", "/jobs", "/robots/nobody"])
def test_html_is_compressed_for_browsers_that_take_it(server: httpx.Client, path: str) -> None:
    plain, told = on_the_wire(server, path, "identity")
    assert "content-encoding" not in told
    for refusal in ("gzip;q=0", "br"):
        assert on_the_wire(server, path, refusal)[0] == plain
    packed, told = on_the_wire(server, path, "br, gzip")
    assert told["content-encoding"] == "gzip"
    assert "accept-encoding" in told["vary"].lower()
    assert int(told["content-length"]) == len(packed)
    assert gzip.decompress(packed) == plain
    assert len(packed) < 0.7 * len(plain)


def test_the_size_of_a_compressed_page_is_not_that_of_its_text(server: httpx.Client) -> None:
    """Whoever sees sizes on the wire cannot tell what a page repeats."""
    assert len({len(on_the_wire(server, "/", "gzip")[0]) for _ in range(12)}) > 1


def test_the_first_page_is_light(server: httpx.Client) -> None:
    seen: set[str] = set()
    assert whole(server, "/", seen) <= FIRST_KB * 1024
    assert len(seen) >= 4  # style, scripts and icon were found


def test_all_scripts_and_styles_together_are_light(server: httpx.Client) -> None:
    """With 3-D, plots and everything else that any view loads."""
    from kilter_service.page.answers import manifest

    total = sum(sent(server, f"/assets/{name}") for name in manifest().files.values())
    assert sent(server, "/") + total <= WITH_3D_KB * 1024


def test_the_picture_of_very_many_rows_is_light(tmp_path: Path, migrated: Path) -> None:
    """The script that draws, the chain and the rows, as they are sent."""
    from kilter_service.page.answers import hashed_file_name

    rows = 12_000
    with made(tmp_path, migrated, rows) as there:
        address = f"/robots/{there.robot}/places.json?version={there.good}&campaign={there.campaign}"
        found = there.client.get(address).raise_for_status().json()
        measured = Katana().columns(rows, seed=3)
        parts = [address, f"/robots/{there.robot}/arm.json", f"/assets/{hashed_file_name('arm.js')}"]
        sizes = [sent(there.client, path) / 1024 for path in parts]
    assert found["total"] == rows
    assert len(found["row"]) >= 7000
    joints = [name for name in measured if name.startswith("q")]
    assert [round(float(measured[name][found["row"][5] - 1]), 4) for name in joints] == found["q"][5]
    assert sum(sizes) <= PICTURE_KB, sizes
