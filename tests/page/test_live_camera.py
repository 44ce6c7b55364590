"""The page of `kilter measure live` in Chromium: a stream with the corners drawn, a folder that fills, and what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread

import cv2
import pytest
from playwright.sync_api import Browser, Page, expect

from kilter_files.rig.live.feeds import newest, open_feed
from kilter_files.rig.live.server import Session, Taken, follow, serve_live_page
from kilter_files.rig.see.run import Looker
from kilter_files.rig.see.target import read_target
from tests.clients.files.rig.live.cameras import jpeg, mjpeg, picture
from tests.clients.files.rig.see.boards import CHARUCO, board
from tests.page.conftest import Complaints

GREEN = """() => { const i = document.getElementById("picture"), c = document.createElement("canvas");
  c.width = i.naturalWidth; c.height = i.naturalHeight; const x = c.getContext("2d"); x.drawImage(i, 0, 0);
  const d = x.getImageData(0, 0, c.width, c.height).data; let n = 0;
  for (let k = 0; k < d.length; k += 4) if (d[k + 1] > d[k] + 60 && d[k + 1] > d[k + 2] + 60) n++;
  return n; }"""


def session(folder: Path | None, wanted: int) -> Session:
    return Session(Looker([read_target(board(CHARUCO)[0])]), Taken(folder), "camera", wanted=wanted)


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    page = chromium.new_page()
    complaints = Complaints(page)
    yield page
    page.close()
    assert not complaints.found


@pytest.mark.short_path
def test_a_stream_is_shown_with_its_corners_and_takes_views_at_rest(page: Page, tmp_path: Path) -> None:
    live, stop = session(tmp_path / "out", 3), Event()

    def frames() -> Iterator[bytes]:
        for k in range(3):
            still = jpeg(picture(k))
            while len(live.taken) <= k:
                yield still

    with mjpeg(frames) as address, serve_live_page(live) as shown:
        page.goto(shown)
        expect(page.locator("#now")).to_have_text("Waiting for a picture.")
        looking = Thread(target=follow, args=(live, newest(open_feed(address), stop)), daemon=True)
        looking.start()
        expect(page.locator("#taken")).to_have_text("3", timeout=60_000)
        expect(page.locator("#wanted")).to_have_text("of 3 views")
        expect(page.locator("#now")).to_have_text("Done: all views are taken.")
        looking.join(30)
        stop.set()
        page.wait_for_function("document.getElementById('picture').naturalWidth === 480")
        assert page.evaluate(GREEN) > 500  # rings at 24 corners
        missing = page.locator("#cells i.missing").count()
        assert missing == 20 - sum(sum(row) for row in live.state["cells"])
        assert 0 < missing < 20


def test_a_folder_that_fills_says_what_is_missing_and_what_is_wrong(page: Page, tmp_path: Path) -> None:
    live, stop = session(None, 99), Event()
    with serve_live_page(live) as shown:
        page.goto(shown)
        Thread(target=follow, args=(live, newest(open_feed(str(tmp_path)), stop)), daemon=True).start()
        for k in range(6):
            cv2.imwrite(str(tmp_path / f"pose{k}.png"), picture(k))
        expect(page.locator("#taken")).to_have_text("6", timeout=60_000)
        expect(page.locator("#gates li.open").first).to_contain_text("at least 10 pictures")
        cv2.imwrite(str(tmp_path / "wall.png"), picture(0) * 0 + 90)
        expect(page.locator("#refusal.warn")).to_contain_text("Take it", timeout=30_000)
        cv2.imwrite(str(tmp_path / "other.png"), picture(0)[:300])
        expect(page.locator("#refusal.warn")).to_contain_text("has 480 x 300 pixels", timeout=30_000)
        page.get_by_role("button", name="Take a view now").click()
        page.wait_for_timeout(300)
        assert live.asked
        stop.set()
