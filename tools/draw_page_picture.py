"""Draw docs/images/page.png, the README's picture, from the page of a real server: ``python -m tools.draw_page_picture``.

``--view`` is what comes after the robot's address, for example ``/stream``; without it the overview is drawn. Needs Chromium
and Playwright.

A server with a robot, its campaigns, a version in use and a moving stream: for pictures and measurements of the page.
"""

from __future__ import annotations

import argparse
import io
import math
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from kilter_client import Kilter
from kilter_client.cli.demo import PRESET, ROBOT, STAGES, identify, measure
from kilter_client.requests.connection import LocalServer, local_server
from kilter_client.stream import CorrectedStream
from kilter_core.twin import thesis_katana

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "page.png"
MOST_BYTES = 200_000
# Chromium draws WebGL without a graphics card only when it is told to; as root it has no sandbox.
ARGUMENTS = ("--no-sandbox", "--enable-unsafe-swiftshader")
SIZE = {"width": 1440, "height": 900}
SETTLE_MS = 20_000  # plots fill, the arm is drawn


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--view", default="", help="what comes after the robot's address (default: its overview)")
    given = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="kilter-picture-") as folder,
        lab(Path(folder)) as shown,
        moving(shown.server.data, shown.robot),
    ):
        picture = screenshot(shown, given.view)
    PICTURE.write_bytes(small(picture))
    print(f"{PICTURE}: {PICTURE.stat().st_size} bytes")


def screenshot(shown: Lab, view: str) -> bytes:
    """Log in and look."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("Chromium is not installed: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        page: Page = browser.new_page(base_url=shown.server.url, viewport=SIZE)  # type: ignore[arg-type]
        page.goto("/login")
        page.get_by_label("Token").fill(shown.token)
        page.get_by_role("button", name="Log in").click()
        page.wait_for_url("**/")
        answer = page.goto(f"/robots/{shown.robot}{view}")
        if answer is None or not answer.ok:
            raise SystemExit(f"There is no view {view!r} of a robot.")
        page.wait_for_timeout(SETTLE_MS)
        picture = page.screenshot()
        browser.close()
    return picture


def small(picture: bytes) -> bytes:
    """Fewer colours, until the file is small enough for a README."""
    from PIL import Image

    with Image.open(io.BytesIO(picture)) as image:
        for colours in (256, 128, 64, 32):
            out = io.BytesIO()
            image.convert("RGB").quantize(colours).save(out, "PNG", optimize=True)
            if out.tell() <= MOST_BYTES:
                return out.getvalue()
    raise SystemExit(f"The picture is larger than {MOST_BYTES} bytes: draw a smaller part.")


if __name__ == "__main__":
    main()


HOME = (0.1, 0.6, 0.4, 0.3, 0.2)  # rad


@dataclass(frozen=True)
class Lab:
    """What there is to look at."""

    server: LocalServer
    robot: str
    train: str
    held_out: str
    version: str

    @property
    def token(self) -> str:
        """The admin token."""
        return (self.server.data / "token").read_text(encoding="ascii").strip()


@contextmanager
def lab(folder: Path) -> Iterator[Lab]:
    """Measure, identify and activate as the demo does, on a server of its own."""
    twin = thesis_katana(PRESET)
    with local_server(folder / "data") as server:
        os.environ["KILTER_DATA"] = str(server.data)
        with Kilter(server.url) as kilter:
            train, held_out = measure(kilter, twin, folder)
            found = [identify(kilter, name, train, held_out) for name in STAGES]
            version = min(found, key=lambda one: one.held_out_mm).version
            kilter.versions.activate(version)
        yield Lab(server, ROBOT, train, held_out, version)


@contextmanager
def moving(data: Path, robot: str, rate_hz: float = 250.0) -> Iterator[None]:
    """Swing the joints of a robot by a stream."""
    ended = threading.Event()

    def run() -> None:
        began = time.monotonic()
        with CorrectedStream(robot, data=data, deadline_s=0.2, connect_timeout_s=30.0) as stream:
            while not ended.wait(1.0 / rate_hz):
                swing = 0.2 * math.sin(0.7 * (time.monotonic() - began))
                stream.correct((HOME[0] + swing, HOME[1] + 0.5 * swing, HOME[2] - 0.3 * swing, *HOME[3:]))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
