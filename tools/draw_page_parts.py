"""Draw docs/images/page-parts.png, an example of each part of the page: ``python -m tools.draw_page_parts``.

The parts are those of the page's own style sheet, templates and figures. Needs Chromium and Playwright.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from markupsafe import Markup
from playwright.sync_api import sync_playwright

from kilter_service.page import answers as assets
from kilter_service.page.answers import environment
from kilter_service.page.figures.plot import CORRECTED, ERROR, FITTED, HELD_OUT, SET_ASIDE, Plot, around
from tools.draw_page_picture import ARGUMENTS, small

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "page-parts.png"
STYLE = Path(assets.__file__).parent / assets.FOLDER
ANGLES = tuple(float(angle) for angle in range(-90, 91, 15))
PARTS = """
{% import "parts.html" as parts %}
<main><section class="state good"><strong class="state-word">Good</strong>
<p>A state: one word, its reason, and the next step.</p>
<p class="row"><a class="button" href="#">Report</a></p></section>
<div class="tiles">
<section class="card tile"><h2>A tile: question, number, what it is of</h2><p class="large">17.1 µm</p>
<p class="small">mean error on held-out poses; 95 % interval 14.5 µm to 19.8 µm.</p></section>
<section class="card tile"><h2>Badges</h2><p>{{ parts.state("succeeded") }} {{ parts.state("failed") }}
<span class="badge warn">not evaluated</span> <span class="badge faint">retired</span></p></section>
<section class="card tile"><h2>Buttons</h2><p class="row"><button type="button" class="primary">Run</button>
<button type="button">Check</button> <button type="button" disabled>Not yet</button></p></section>
</div>
<div class="columns"><section class="card"><h2>A figure</h2>{{ figure }}</section>
<section class="card"><h2>Notes and a table</h2><div class="note good">What is well.</div>
<div class="note warn">What to look at.</div>
<div class="note bad">What is wrong, and the way out.</div>
<div class="scroll"><table><thead><tr><th>Parameter</th><th class="number">Value</th><th>Unit</th></tr></thead>
<tbody><tr><th>theta_2</th><td class="number">0.0312 ± 0.0021</td><td>deg</td></tr></tbody></table></div></section></div></main>
"""


def figure() -> Markup:
    """A figure with every meaning of a colour."""
    drawn = Plot("An example", around("angle, degrees", [-90, 90]), around("error, mm", [0, 0.2], zero=True), 560, 300)
    curve = [0.06 + 0.03 * (angle / 90) ** 2 for angle in ANGLES]
    drawn.band(ANGLES, [one - 0.012 for one in curve], [one + 0.012 for one in curve], "95 % interval")
    drawn.line(ANGLES, curve, "corrected", 0, CORRECTED)
    drawn.line(ANGLES, [2 * one for one in curve], "error before", 1, ERROR)
    for label, colour, shift, step in (
        ("fitted", FITTED, 0.02, 2), ("held out", HELD_OUT, -0.02, 3), ("set aside", SET_ASIDE, 0.1, 7)
    ):  # fmt: skip
        there = range(1, len(ANGLES), step)
        drawn.points([ANGLES[k] for k in there], [curve[k] + shift for k in there], label, colour=colour)
    return drawn.svg()


def main() -> None:
    """Draw the picture."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("Chromium is not installed: apt-get install chromium")
    style = (STYLE / assets.hashed_file_name("page.css")).read_text(encoding="utf-8")
    body = environment().from_string(PARTS).render(figure=figure())
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1200, "height": 700})
        page.set_content(f"<style>{style}</style>{body}")
        picture = page.locator("main").screenshot()
        browser.close()
    PICTURE.write_bytes(small(picture))
    print(f"{PICTURE}: {PICTURE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
