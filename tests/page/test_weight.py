"""What the browser has to load for the first page, compressed as it is sent."""

from __future__ import annotations

import re

import httpx

FIRST_KB, WITH_3D_KB = 400, 700
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


def test_the_first_page_is_light(server: httpx.Client) -> None:
    seen: set[str] = set()
    assert whole(server, "/", seen) <= FIRST_KB * 1024
    assert len(seen) >= 4  # style, scripts and icon were found


def test_all_scripts_and_styles_together_are_light(server: httpx.Client) -> None:
    """With 3-D, plots and everything else that any view loads."""
    from kilter_service.page.assets import manifest

    total = sum(sent(server, f"/assets/{name}") for name in manifest().files.values())
    assert sent(server, "/") + total <= WITH_3D_KB * 1024
