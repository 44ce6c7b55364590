"""Draw the pictures of the documentation as SVG: ``python tools/draw_pictures.py [PATH.json]``.

Without an argument the data flow alone; with the file that ``kilter demo --json`` prints also the error
along the demo's circle.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
INK, PALE, GRID = "#1f2933", "#eef2f6", "#d5dce3"
TITLE = "Data flow: measurements become observations, a fit makes a version, the corrector applies it"
BLUE, ORANGE, GREEN = "#0b63a5", "#c2410c", "#15803d"


def text(
    x: float, y: float, words: str, *, size: int = 14, fill: str = INK, anchor: str = "middle", weight: int = 400
) -> str:
    """One line of text with its baseline at (x, y)."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{fill}" text-anchor="{anchor}" font-weight="{weight}">'
        f"{escape(words)}</text>"
    )


def box(x: float, y: float, w: float, h: float, title: str, lines: Sequence[str], colour: str = INK) -> str:
    """A rounded box with a title and small lines below it."""
    top = y + h / 2 - 9 * len(lines) + 5
    out = [
        f'<rect x="{x}" y="{y}" width="{w}" height="{h}" rx="8" fill="{PALE}" stroke="{colour}" stroke-width="1.5"/>'
    ]
    out.append(text(x + w / 2, top, title, weight=600, fill=colour))
    out += [text(x + w / 2, top + 18 * (i + 1), line, size=12) for i, line in enumerate(lines)]
    return "".join(out)


def arrow(path: str, colour: str = INK, ends: str = "end") -> str:
    """A line along an SVG path with a tip at its end, or at both ends."""
    tips = " ".join(f'marker-{end}="url(#tip)"' for end in ends.split())
    return f'<path d="{path}" stroke="{colour}" stroke-width="1.5" fill="none" {tips}/>'


def picture(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    """A whole SVG document on a white ground."""
    tip = (
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
        f'orient="auto-start-reverse"><path d="M0 0L10 5L0 10z" fill="{INK}"/></marker></defs>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'font-family="system-ui, sans-serif"><title>{escape(title)}</title>{tip}'
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>{"".join(parts)}</svg>\n'
    )


def data_flow() -> str:
    """From a measurement file to corrected setpoints."""
    parts = [
        box(16, 30, 150, 84, "measurements", ["tracker, camera,", "encoder files"]),
        box(214, 30, 150, 84, "observations", ["joints, poses, loads;", "units in every name"], BLUE),
        box(412, 30, 150, 84, "identify", ["weighted fit, null", "directions by name"], BLUE),
        box(610, 30, 150, 84, "version", ["immutable, one", "active per robot"], BLUE),
        box(412, 176, 150, 84, "model", ["chain + tilt, play,", "compliance, ..."], BLUE),
        box(610, 176, 150, 84, "corrector", ["inverse of the model,", "a stream of its own"], GREEN),
        box(16, 176, 150, 84, "robot.json", ["preset, DH, MDH,", "URDF or chain"]),
        box(214, 176, 150, 84, "controller", ["setpoints out,", "corrected ones in"]),
        arrow("M166 72H212"), arrow("M364 72H410"), arrow("M562 72H608"), arrow("M685 114V174"),
        arrow("M487 176V116"), arrow("M562 218H608"), arrow("M91 260V300H460V262"),
        arrow("M660 260V330H270V262", GREEN, "start end"),
        text(470, 347, "zenoh, 500 Hz and more", size=12, fill=GREEN),
    ]  # fmt: skip
    return picture(776, 360, TITLE, parts)


def path_error(record: dict[str, list[float]]) -> str:
    """Error along the circle before and after correction; ``record`` has ``t_s``, ``before_mm`` and ``after_mm``."""
    left, right, top, bottom = 64.0, 756.0, 40.0, 270.0
    t, before, after = record["t_s"], record["before_mm"], record["after_mm"]
    highest = 1.1 * max(before + after)
    step = next(s for s in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if highest / s <= 7)

    def curve(values: Sequence[float], colour: str) -> str:
        points = " ".join(
            f"{left + (right - left) * (at - t[0]) / (t[-1] - t[0]):.1f},{bottom - (bottom - top) * v / highest:.1f}"
            for at, v in list(zip(t, values, strict=True))[:: max(1, len(t) // 800)]
        )
        return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>'

    parts = []
    for k in range(int(highest / step) + 1):
        y = bottom - (bottom - top) * k * step / highest
        parts.append(f'<path d="M{left} {y:.1f}H{right}" stroke="{GRID}"/>')
        parts.append(text(left - 8, y + 4, f"{k * step:g}", size=12, anchor="end"))
    parts += [curve(before, ORANGE), curve(after, GREEN)]
    parts.append(text(left, 24, "distance from the wanted path, mm", size=13, anchor="start"))
    for x, name, values, colour in ((490, "before", before, ORANGE), (670, "after", after, GREEN)):
        parts.append(text(x, 24, f"{name}: mean {sum(values) / len(values):.3f}", size=13, fill=colour, weight=600))
    parts.append(text((left + right) / 2, 300, f"once round the circle, {t[-1] - t[0]:.0f} s", size=13))
    return picture(776, 316, "Error along the circle of the demo, before and after correction", parts)


def main(arguments: Sequence[str]) -> None:
    """Write the pictures into docs/images."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    (IMAGES / "data-flow.svg").write_text(data_flow(), encoding="utf-8")
    if arguments:
        record = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
        (IMAGES / "path-error.svg").write_text(path_error(record), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
