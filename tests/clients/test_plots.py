"""Figures drawn by matplotlib: every kind of trace, labels that do not overlap, names that are not mathematics."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from kilter_client.cli.robot.arm_figure import arm_figure, save_arm
from kilter_client.errors import FileError, MissingPackageError
from kilter_client.results import plots

SVG = "{http://www.w3.org/2000/svg}"


def texts(figure: dict[str, Any], tmp_path: Path) -> list[tuple[str, float, float, float]]:
    """Every text of a figure drawn as SVG: what it says, where it stands (x, y), and its size."""
    (file,) = plots.draw(figure, tmp_path / "figure", ("svg",))
    out = []
    for text in ElementTree.parse(file).getroot().iter(f"{SVG}text"):
        size = float((re.findall(r"([\d.]+)px", text.get("style", "")) or ["9"])[0])
        x, y = (
            (float(v) for v in re.findall(r"translate\(([-\d.]+) ([-\d.]+)\)", text.get("transform", ""))[0])
            if ("translate" in text.get("transform", ""))
            else (float(text.get("x", 0)), float(text.get("y", 0)))
        )
        out.append(("".join(text.itertext()), x, y, size))
    return out


def lying(labels: list[str]) -> dict[str, Any]:
    trace = {
        "type": "bar", "orientation": "h", "name": "one", "showlegend": True, "y": labels, "x": [1.0] * len(labels),
        "error_x": {"type": "data", "symmetric": False, "array": [0.1] * len(labels), "arrayminus": [0.2] * len(labels)},
    }  # fmt: skip
    axis = {"title": {"text": ""}}
    layout = {
        "title": {"text": "t"},
        "xaxis": axis,
        "yaxis": axis,
        "barmode": "overlay",
        "height": 190 + 22 * len(labels),
    }
    return {"data": [trace], "layout": layout}


@pytest.mark.parametrize("count", [4, 20, 60])
def test_labels_of_bars_stand_clear_of_each_other(count: int, tmp_path: Path) -> None:
    labels = [f"a rather long name of effect {k} at joint 7" for k in range(count)]
    found = [(y, size) for said, _, y, size in texts(lying(labels), tmp_path) if said in labels]
    assert len(found) == count
    places = sorted(y for y, _ in found)
    assert min(b - a for a, b in itertools.pairwise(places)) > max(size for _, size in found)


def test_names_with_dollars_and_marks_are_told_as_they_are(tmp_path: Path) -> None:
    figure = lying(["Halle &lt;7&gt; &#36;x&#36;"])
    figure["layout"]["title"]["text"] = "title<br><sup>arm &#36;y&#36;, version ver_1<br>measured: a &amp; b</sup>"
    said = [text for text, _, _, _ in texts(figure, tmp_path)]
    assert "Halle <7> $x$" in said
    assert {"arm $y$, version ver_1", "measured: a & b"} <= set(said)


def test_lines_with_gaps_steps_colours_and_panels_are_drawn(tmp_path: Path) -> None:
    axis = {"title": {"text": "mm"}}
    layout = {
        "title": {"text": "t"}, "xaxis": axis | {"type": "log", "domain": [0, 0.4]}, "yaxis": axis,
        "xaxis2": axis | {"domain": [0.6, 1.0]}, "yaxis2": axis | {"scaleanchor": "x2"},
    }  # fmt: skip
    step = {"type": "scatter", "mode": "lines", "name": "counts", "x": [1, 10, 100], "y": [3, 1, 0], "fill": "tozeroy"}
    dots = {
        "type": "scatter", "mode": "markers", "name": "", "x": [1, None], "y": [1, 2], "xaxis": "x2", "yaxis": "y2",
        "marker": {"color": [0.1, 0.2], "colorscale": "Viridis", "cmin": 0.1, "cmax": 0.2,
                   "colorbar": {"title": {"text": "±"}}},
    }  # fmt: skip
    said = [text for text, *_ in texts({"data": [step | {"line": {"shape": "hv"}}, dots], "layout": layout}, tmp_path)]
    assert "±" in said
    scene = {f"{k}axis": {"title": {"text": f"{k} here"}} for k in "xyz"}
    line = {
        "type": "scatter3d",
        "mode": "lines",
        "name": "arrows",
        "x": [0, 1, None],
        "y": [0, 1, None],
        "z": [0, 2, None],
    }
    said = [text for text, *_ in texts({"data": [line], "layout": {"title": {"text": "t"}, "scene": scene}}, tmp_path)]
    assert {"x here", "y here", "z here"} <= set(said)


CHECK: dict[str, Any] = {
    "name": "arm $5$", "reach_mm": 900.0,
    "zero": {"points_mm": [[0, 0, 0], [0, 0, 0], [0, 0, 300], [500, 0, 300], [900, 0, 300], [900, 0, 300]]},
    "axes": [{"direction": [0, 0, 1]}, {"direction": [0, -1, 0]}, {"direction": [0, -1, 0]}],
}  # fmt: skip


def test_an_arm_shows_its_axes_base_and_tool_from_three_sides(tmp_path: Path) -> None:
    figure = arm_figure(CHECK)
    labels = [trace["text"] for trace in figure["data"] if trace["mode"] == "text"]
    side, front, above = labels
    assert side == ["base, 1", "2", "3", "tool"]
    assert front == ["base, 1", "2–3, tool"]
    assert above == ["base, 1–2", "3", "tool"]
    said = {text for text, *_ in texts(figure, tmp_path)}
    assert {"arm $5$ at zero, reach 900 mm", "x, mm (from the side)", "axes of the joints"} <= said
    save_arm(tmp_path / "arm.v2.svg", CHECK)
    assert (tmp_path / "arm.v2.svg").read_text().startswith("<?xml")
    with pytest.raises(FileError):
        save_arm(tmp_path / "nowhere" / "arm.png", CHECK)


def test_labels_of_an_arm_that_would_cover_each_other_become_one() -> None:
    points = [*CHECK["zero"]["points_mm"][:4], [525, 0, 300], [525, 0, 300]]
    side, *_ = [
        trace["text"]
        for trace in arm_figure(CHECK | {"zero": {"points_mm": points}})["data"]
        if trace["mode"] == "text"
    ]
    assert side == ["base, 1", "2", "3, tool"]
    layout = arm_figure(CHECK)["layout"]
    widths = [
        layout[f"{k}axis{n}"]["range"][1] - layout[f"{k}axis{n}"]["range"][0] for k in "xy" for n in ("", "2", "3")
    ]
    assert widths == pytest.approx([widths[0]] * 6)


@pytest.mark.parametrize("file", ["arm.png", "arm.svg"])
def test_without_matplotlib_an_arm_is_not_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match="pip install matplotlib"):
        save_arm(tmp_path / file, CHECK)
    assert not (tmp_path / file).exists()
