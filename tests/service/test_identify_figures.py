"""Figures of an identification: plain JSON, bounded, and true to the rows; on arms that share no code with Kilter."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.fit.robust import RowErrors
from kilter_core.observations import Observations
from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.jobs.kind import JobInput
from kilter_service.jobs.kinds.identify import run
from kilter_service.jobs.plotly_figures.identify import MOST_PARAMETERS, WORST, changes
from kilter_service.jobs.plotly_figures.layout import LONGEST as LONGEST_LABEL
from kilter_service.jobs.plotly_figures.layout import LONGEST_ARROWS as LONGEST
from kilter_service.jobs.plotly_figures.layout import (
    MOST_ARROWS,
    add_captions,
    arrows,
    bar_layout,
    distinct_labels,
    magnification,
    shorten_label,
)
from tests.core.campaigns import joints, measured
from tests.core.truth import Arm, some_arm, some_pose, ur10, with_hidden_errors

Figures = Mapping[str, Any]
EVERY = {"residual_arrows_3d", "residual_arrows", "worst_rows", "parameter_changes", "predicted_error"}
MOST_BYTES = 250_000


@cache
def rows(arm: Arm, count: int, seed: int, see: str = "position") -> Observations:
    rng = np.random.default_rng(1)
    true = replace(with_hidden_errors(arm, rng), base=some_pose(rng, 2.0))
    rng = np.random.default_rng(seed)
    return measured(true, joints(true, count, rng), rng, 5e-5, see)


def drawn(arm: Arm, campaigns: dict[str, Observations], validation: Any = None, **options: Any) -> Figures:
    """Figures of a job whose campaigns are named after their ids."""
    every = [*campaigns, *(validation if isinstance(validation, dict) else ())]
    names = {campaign: f"name of {campaign}" for campaign in every}
    robot = robot_from_document(arm.document())
    result = run(
        JobInput(robot, campaigns, validation, IdentifyOptions(**options), names=names), lambda fraction, stage: None
    ).result
    figures: Figures = json.loads(json.dumps(result["figures"], allow_nan=False))
    assert all(set(figure) == {"data", "layout"} for figure in figures.values())
    return figures


def wrong(observations: Observations, row: int, metres: float = 0.02) -> Observations:
    assert observations.position is not None
    position = observations.position.copy()
    position[row] += metres / np.sqrt(3.0)
    return replace(observations, position=position)


def counted(figure: Figures) -> list[int]:
    return [sum(trace["y"]) for trace in figure["data"]]


@pytest.mark.parametrize("poses", [8, 500])
@pytest.mark.parametrize("joints_", [6, 7])
def test_every_figure_for_six_and_seven_axes_few_and_many_poses(joints_: int, poses: int) -> None:
    arm = ur10() if joints_ == 6 else some_arm(np.random.default_rng(7), 7)
    figures = drawn(arm, {"a": rows(arm, poses, 2, "pose")}, 0.25, level=1)
    assert set(figures) == EVERY | {"held_out_errors"}
    held = round(0.25 * poses)
    assert counted(figures["held_out_errors"]) == [held] * 3
    assert f" {held} held-out rows" in figures["held_out_errors"]["layout"]["title"]["text"]
    assert len(json.dumps(figures)) < MOST_BYTES


def test_without_rows_held_out_nothing_says_so() -> None:
    figures = drawn(ur10(), {"a": rows(ur10(), 60, 2)})
    assert set(figures) == EVERY | {"fitted_errors"}
    assert "held" not in json.dumps(figures)
    assert counted(figures["fitted_errors"]) == [60] * 3


def test_the_worst_rows_are_named_by_campaign_and_number() -> None:
    campaigns = {"a": rows(ur10(), 60, 2), "b": wrong(rows(ur10(), 60, 3), 6)}
    other = {"v": rows(ur10(), 20, 4), "w": wrong(rows(ur10(), 20, 5), 12, 0.03)}
    figure = drawn(ur10(), campaigns, other, loss="tukey")["worst_rows"]
    labels = figure["data"][0]["y"]
    assert labels[:2] == ["name of w row 13", "name of b row 7"]
    assert len(labels) == WORST == len(set(labels))
    used = {trace["name"]: trace["x"] for trace in figure["data"]}
    assert used["held out"][0] == pytest.approx(30.0, abs=0.5)
    assert used["held out"][1] is None
    assert used["fitted, but counts less than half"][1] == pytest.approx(20.0, abs=0.5)


def test_folds_count_the_error_of_the_model_that_never_saw_the_row() -> None:
    figure = drawn(ur10(), {"a": wrong(rows(ur10(), 60, 2), 0)}, 4, loss="huber")["worst_rows"]
    assert [trace["name"] for trace in figure["data"]] == ["held out"]
    assert figure["data"][0]["y"][0] == "name of a row 1"


def test_rows_are_few_enough_to_look_at_however_many_there_are() -> None:
    rng = np.random.default_rng(0)
    at, left = rng.uniform(-1, 1, (10_000, 3)), rng.normal(0, 1e-4, (10_000, 3))
    left[4321] = 0.5
    figures = arrows(RowErrors({"identified": left}, np.arange(10_000), at), "held-out")
    assert len(json.dumps(figures)) < MOST_BYTES
    dots = figures["residual_arrows"]["data"][0]
    assert MOST_ARROWS <= len(dots["x"]) <= MOST_ARROWS + 10
    assert "of 10000 held-out rows" in figures["residual_arrows"]["layout"]["title"]["text"]
    worst = figures["residual_arrows_3d"]["data"][2]
    lengths = [np.linalg.norm([worst[k][n + 1] - worst[k][n] for k in "xyz"]) for n in range(0, len(worst["x"]), 3)]
    assert max(lengths) == pytest.approx(1e3 * LONGEST * float(np.ptp(at, axis=0).max()), rel=1e-3)


@pytest.mark.parametrize("size", [1e-7, 3e-5, 2e-3, 0.4])
def test_arrows_are_as_many_times_as_long_as_a_person_can_reckon_with(size: float) -> None:
    times = magnification(np.full(10, size), 1.0)
    assert 0.02 < times * size <= 0.12 + 1e-9
    assert f"{times:e}"[0] in "125"
    assert float(f"{times:e}".split("e")[0]) in (1.0, 2.0, 5.0)


def parameter(name: str, unit: str = "mm", **more: Any) -> dict[str, Any]:
    row = {
        "name": name,
        "unit": unit,
        "value": 2.0,
        "nominal": 1.5,
        "sigma": 0.1,
        "identifiable": True,
        "plausible": True,
    }
    return {**row, **more}


def test_changes_have_a_panel_for_each_unit_and_the_interval_that_was_found() -> None:
    given = [
        parameter("a_1"),
        parameter("a_2", lower=1.0, upper=2.5),
        parameter("alpha_1", "deg", identifiable=False, sigma=40.0),
        parameter("base_x", value=900.0),
        parameter("residual_1", "", value=3.0),
    ]
    figure = changes(given)
    assert figure is not None
    lengths, angles = figure["data"]
    assert (lengths["y"], lengths["x"]) == (["a_1", "a_2"], [0.5, 0.5])
    assert lengths["error_x"]["array"] == pytest.approx([0.196, 0.5])
    assert lengths["error_x"]["arrayminus"] == pytest.approx([0.196, 1.0])
    assert (angles["y"], angles["xaxis"], angles["error_x"]["array"]) == (["alpha_1"], "x2", [0.0])
    assert figure["layout"]["xaxis2"]["title"]["text"] == "change, deg"
    many = changes([parameter(f"p_{k}", value=1.5 + 0.01 * k) for k in range(300)])
    assert many is not None
    assert many["data"][0]["y"] == [f"p_{k}" for k in range(300 - MOST_PARAMETERS, 300)]
    frames = changes([parameter("base_x"), parameter("tool_z")])
    assert frames is not None
    assert frames["data"][0]["y"] == ["base_x", "tool_z"]
    assert changes([]) is None


def test_names_stay_names() -> None:
    """No marks and no mathematics: Plotly would read both, and a title between two dollars is gone."""
    layout = bar_layout("title", "x", ["a"])
    used = ["a < b $x$", "b", "c", "d"]
    title = add_captions({"f": {"data": [], "layout": layout}}, "<b>$y$", used, "ver_1")["f"]["layout"]["title"]["text"]
    assert "<b>" not in title
    assert "$" not in title
    assert "and 1 more" in title
    assert "ver_1" in title
    long = "x" * 100
    assert len(shorten_label(long)) == LONGEST_LABEL
    assert distinct_labels([long, long, "a"])[1:] == [shorten_label(long) + " (2)", "a"]
