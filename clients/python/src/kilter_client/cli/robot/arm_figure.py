"""A checked robot at zero as a figure: links, numbered axes, base, flange and tool, from three sides, in mm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from kilter_client.errors import FileError
from kilter_client.results.plots import draw

Point = Sequence[float]
Figure = dict[str, Any]

VIEWS = ((0, 2, "from the side"), (1, 2, "from the front"), (0, 1, "from above"))
LETTERS = "xyz"
AXIS_SHARE = 0.07  # of the arm's size that half an axis is drawn as
LETTER_SHARE, HIGH_SHARE = 0.026, 0.055  # of the arm's size: width and height of a letter of a label
ROOM = 0.68  # of the arm's size that is shown to either side of its middle, alike in all views
END_ON = 0.2  # share of an axis seen from the side below which it points at the reader
LINK, AXIS, END, MARK = "#3c5aa0", "#d2782a", "#2e8b57", "#1e1e1e"
LONGEST_NAME = 60


def save_arm(file: Path, check: Mapping[str, Any]) -> None:
    """Draw the arm into a .png or .svg file.

    Raises:
        FileError: the file cannot be written. MissingPackageError: matplotlib is not installed.

    """
    try:
        draw(arm_figure(check), file.with_suffix(""), (file.suffix[1:].lower(),))
    except OSError as error:
        raise FileError(f"{file}: cannot be written: {error.strerror or error}.", file=str(file)) from error


def arm_figure(check: Mapping[str, Any]) -> Figure:
    """Draw the arm at zero, as Plotly's JSON."""
    points, axes = check["zero"]["points_mm"], check["axes"]
    size = max(max(p[k] for p in points) - min(p[k] for p in points) for k in range(3)) or 1.0
    data = [trace for n, view in enumerate(VIEWS) for trace in _view(points, axes, view[:2], size, n)]
    name = str(check["name"])
    name = name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}…"
    title = f"{escape(name).replace('$', '&#36;')} at zero, reach {check['reach_mm']:.0f} mm"
    middle = [(max(p[k] for p in points) + min(p[k] for p in points)) / 2 for k in range(3)]
    return {"data": data, "layout": _layout(title, [[m - ROOM * size, m + ROOM * size] for m in middle])}


def _view(
    points: Sequence[Point], axes: Sequence[Mapping[str, Any]], plane: Point, size: float, n: int
) -> list[Figure]:
    i, j = (int(k) for k in plane)
    own = {} if n == 0 else {"xaxis": f"x{n + 1}", "yaxis": f"y{n + 1}"}

    def trace(name: str, mode: str, places: Sequence[Point | None], **look: Any) -> Figure:
        x, y = ([None if p is None else p[k] for p in places] for k in (0, 1))
        return {"type": "scatter", "mode": mode, "name": name, "showlegend": n == 0, "x": x, "y": y, **own, **look}

    flat = [(p[i], p[j]) for p in points]
    joints = flat[1 : 1 + len(axes)]
    lines: list[Point | None] = []
    for (x, y), axis in zip(joints, axes, strict=False):
        dx, dy = (AXIS_SHARE * size * axis["direction"][k] for k in (i, j))
        lines += [(x - dx, y - dy), (x + dx, y + dy), None]
    towards = [
        p for p, axis in zip(joints, axes, strict=False) if math.hypot(*(axis["direction"][k] for k in (i, j))) < END_ON
    ]
    ends = [flat[0], *flat[1 + len(axes) :]]
    made = [
        trace("links", "lines", flat, line={"color": LINK, "width": 5}),
        trace("axes of the joints", "lines", lines, line={"color": AXIS, "width": 3}),
        trace("axis seen end on", "markers", towards, marker={"color": AXIS, "size": 13, "symbol": "circle-open"}),
        trace("points on the axes", "markers", joints, marker={"color": MARK, "size": 5}),
        trace("base, flange and tool", "markers", ends, marker={"color": END, "size": 8, "symbol": "diamond"}),
    ]
    linked = _linkages(joints, axes)
    if linked:
        made.append(trace("linkages", "lines", linked, line={"color": END, "width": 2, "dash": "dash"}))
    places, labels = _labels(flat, len(axes), size)
    made.append(trace("", "text", places, text=labels, textposition="top right") | {"showlegend": False})
    return made


def _linkages(joints: Sequence[Point], axes: Sequence[Mapping[str, Any]]) -> list[Point | None]:
    """Lines from the axis of a joint to each axis that follows it by a linkage."""
    drawn = list(zip(joints, axes, strict=False))
    follows = [(place, axis["joint"]) for place, axis in drawn if axis.get("drive") == "linkage"]
    out: list[Point | None] = []
    for place, joint in follows:
        own = [p for p, axis in drawn if axis["joint"] == joint and axis.get("drive") is None]
        out += [own[0], place, None] if own else []
    return out


def _labels(flat: Sequence[Point], count: int, size: float) -> tuple[list[Point], list[str]]:
    """Where to write what: numbers of joints, base and tool; labels that would cover each other become one."""
    named = [("base", flat[0]), *((str(k), flat[k]) for k in range(1, count + 1)), ("tool", flat[-1])]
    groups: list[tuple[Point, list[str]]] = [(place, [label]) for label, place in named]
    while (pair := _covering(groups, size)) is not None:
        first, second = pair
        groups[first][1].extend(groups.pop(second)[1])
    return [place for place, _ in groups], [_run(members) for _, members in groups]


def _covering(groups: Sequence[tuple[Point, list[str]]], size: float) -> tuple[int, int] | None:
    """The first two labels, right above their places, that would cover each other."""
    for i, (p, first) in enumerate(groups):
        for j, (q, second) in enumerate(groups[i + 1 :], i + 1):
            left, right = (first, q[0] - p[0]) if p[0] <= q[0] else (second, p[0] - q[0])
            if abs(p[1] - q[1]) < HIGH_SHARE * size and right < LETTER_SHARE * size * (len(_run(left)) + 1):
                return i, j
    return None


def _run(members: Sequence[str]) -> str:
    """Join labels, consecutive numbers as 2–4."""
    out: list[list[str]] = []
    for label in members:
        follows = out and label.isdigit() and out[-1][-1].isdigit() and int(label) == int(out[-1][-1]) + 1
        out[-1].append(label) if follows else out.append([label])
    return ", ".join(part[0] if len(part) == 1 else f"{part[0]}–{part[-1]}" for part in out)


def _layout(title: str, shown: Sequence[Sequence[float]]) -> Figure:
    made: Figure = {
        "title": {"text": title},
        "width": 1500,
        "height": 620,
        "legend": {"orientation": "h", "yanchor": "top", "y": -0.18, "itemsizing": "constant"},
    }
    for n, (i, j, side) in enumerate(VIEWS):
        own, low = "" if n == 0 else str(n + 1), 0.355 * n
        made[f"xaxis{own}"] = {
            "title": {"text": f"{LETTERS[i]}, mm ({side})"},
            "domain": [low, low + 0.29],
            "range": list(shown[i]),
            "anchor": f"y{own}",
        }
        made[f"yaxis{own}"] = {
            "title": {"text": f"{LETTERS[j]}, mm"},
            "range": list(shown[j]),
            "anchor": f"x{own}",
            "scaleanchor": f"x{own}",
            "scaleratio": 1,
        }
    return made
