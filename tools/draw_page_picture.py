"""Draw docs/images/page.png, the README's picture, from the page of a real server: ``python -m tools.draw_page_picture``.

``--view`` is what comes after the robot's address, for example ``/stream``; without it the overview is drawn. Needs Chromium
and Playwright.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from tools.page_lab import Lab, lab, moving

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
