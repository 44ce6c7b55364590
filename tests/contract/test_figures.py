"""What Kilter draws is typed whole: nothing of a figure is left out of an answer, and each has the kind it is said to have."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel

from kilter_client.results.plots import save_figures
from kilter_service.contract.figures import Figure, GapFigures, IdentifyFigures
from kilter_service.jobs.plotly_figures.gap import gap_figures
from kilter_service.jobs.plotly_figures.identify import changes
from kilter_service.jobs.plotly_figures.layout import _from_three_sides, _in_space, _sides, _space, add_captions

REPOSITORY = Path(__file__).resolve().parents[2]


def gap_report() -> dict[str, Any]:
    labelled = [
        {"joint": 1, "value": 1.0, "n": 3, "before_mean": 0.1, "before_sd": 0.2, "after_mean": 0.0, "after_sd": 0.1}
    ]
    return {
        "gap": {"before_mm": 1.0},
        "alias_matrix": {"labels": ["backlash j1", "eccentricity j1"], "values": [[1.0, 0.2], [0.2, 1.0]]},
        "figures": {
            "gap_bar": [
                {"label": name, "value": size, "held_out": size, "held_out_interval": ends}
                for name, size, ends in (
                    ("before", 1.0, [0.9, 1.2]),
                    ("+ backlash j1", 0.2, [0.15, 0.3]),
                    ("noise", 0.1, None),
                )
            ],
            "residual_by_angle": [
                {"joint": 1, "q_deg": [1.0, 2.0], "before": [0.1, 0.2], "after": [0.0, 0.1], "curve": [0.1, 0.1]}
            ],
            "residual_by_direction": labelled,
            "residual_by_load": [{**labelled[0], "joint": None}],
            "contribution": [{"label": "backlash j1", "rms": 0.1, "largest": 0.2}],
        },
        "effect_curves": [effect_curve()],
    }


def effect_curve() -> dict[str, Any]:
    sides = [
        {"direction": sign, "x": [0.0, 10.0], "y": [sign, sign], "low": [sign - 0.5] * 2, "high": [sign + 0.5] * 2}
        for sign in (1.0, -1.0)
    ]
    rival = {"id": "eccentricity", "joints": [1], "times": 4.0, "sides": sides}
    visits = {
        "x": [1.0, 2.0, 3.0], "y": [1.1, -0.9, 0.8], "half": [0.2] * 3, "curve": [1.0, -1.0, 1.0],
        "direction": [1.0, -1.0, 1.0], "faint": 0, "of": 3,
    }  # fmt: skip
    return {
        "id": "backlash", "joints": [1], "joint": 1, "follows": "q", "x_unit": "deg", "unit": "deg", "sides": sides,
        "visits": visits, "distance": {"value": 2.0, "low": 1.9, "high": 2.1}, "rival": rival,
    }  # fmt: skip


def identify_figures() -> dict[str, Any]:
    tails, heads = np.zeros((30, 3)), np.random.default_rng(1).normal(size=(30, 3))
    red = np.arange(30) < 10
    parameters = [
        {
            "name": f"p{k}",
            "unit": unit,
            "value": 1.0,
            "nominal": 0.0,
            "sigma": 0.1,
            "identifiable": k != 1,
            "plausible": True,
        }
        for k, unit in enumerate(("mm", "deg", "deg/(N m)"))
    ]
    drawn = {
        "residual_arrows_3d": {"data": _in_space(tails, heads, red), "layout": _space("space")},
        "residual_arrows": {"data": _from_three_sides(tails, heads, red), "layout": _sides("sides")},
        "parameter_changes": changes(parameters),
    }
    return dict(add_captions(drawn, "arm", ["rows"], "ver_1"))


@pytest.mark.parametrize(
    ("model", "drawn"), [(GapFigures, gap_figures(gap_report())), (IdentifyFigures, identify_figures())]
)
def test_an_answer_holds_all_that_was_drawn(model: type[BaseModel], drawn: dict[str, Any]) -> None:
    assert model.model_validate(drawn).model_dump(mode="json") == drawn


def test_an_effect_over_its_own_quantity_has_band_visits_rival_and_model() -> None:
    figure = gap_figures(gap_report())["effect_curve_backlash_joint_1"]
    layout, traces = figure["layout"], figure["data"]
    assert layout["title"]["text"].startswith("Backlash of joint 1 over angle of joint 1")
    assert "2 deg (1.9 to 2.1) apart" in layout["title"]["text"]
    assert (layout["xaxis"]["title"]["text"], layout["yaxis"]["title"]["text"]) == (
        "angle of joint 1, deg",
        "what joint 1 rotates by, deg",
    )
    bands = [trace for trace in traces if trace.get("fill") == "toself"]
    assert [(band["x"], band["y"]) for band in bands] == [
        ([0.0, 10.0, 10.0, 0.0], [sign + 0.5] * 2 + [sign - 0.5] * 2) for sign in (1.0, -1.0)
    ]
    dots = [trace for trace in traces if trace["mode"] == "markers"]
    assert [(dot["x"], dot["y"]) for dot in dots] == [([1.0, 3.0], [1.1, 0.8]), ([2.0], [-0.9])]
    named = [trace["name"] for trace in traces if trace["showlegend"]]
    assert named == [
        "visit, after motion +, 95 % interval", "visit, after motion −, 95 % interval", "refused: eccentricity of joint 1",
        "model, after motion +, 95 % band", "model, after motion −, 95 % band",
    ]  # fmt: skip


def test_the_curve_of_an_effect_is_drawn_as_a_picture(tmp_path: Path) -> None:
    name = "effect_curve_backlash_joint_1"
    pytest.importorskip("matplotlib")
    files = save_figures({name: gap_figures(gap_report())[name]}, tmp_path, ("svg",))
    text = files[-1].read_text(encoding="utf-8")
    for word in ("angle of joint 1, deg", "refused: eccentricity of joint 1", "model, after motion +, 95 % band"):
        assert word in text, word


def test_a_figure_of_another_kind_is_refused() -> None:
    arrows = identify_figures()["residual_arrows_3d"]
    with pytest.raises(ValueError, match="bar"):
        IdentifyFigures.model_validate({"worst_rows": arrows})


def test_every_figure_that_an_identification_draws_has_its_field() -> None:
    text = "".join(
        (REPOSITORY / f"service/kilter_service/jobs/plotly_figures/{name}.py").read_text(encoding="utf-8")
        for name in ("identify", "layout")
    )
    for name in IdentifyFigures.model_fields:
        assert f'"{name}"' in text, name


def test_traces_are_told_apart_by_their_type() -> None:
    kinds = get_args(get_args(Figure.model_fields["data"].annotation)[0])[0]
    union = get_args(get_args(kinds)[0])
    assert {get_args(kind.model_fields["type"].annotation)[0] for kind in union} == {
        "bar", "scatter", "scatter3d", "heatmap",
    }  # fmt: skip
