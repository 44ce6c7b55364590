"""Options: which parameters they free, and how a wrong one is refused."""

from __future__ import annotations

from typing import Any

import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions
from kilter_core.model import RobotModel
from tests.core.truth import ur10

MODEL = RobotModel(robot_from_document(ur10().document()))
FRAME = ("x", "y", "z", "rx", "ry", "rz")


def freed(observes_orientation: bool = True, **options: Any) -> set[str]:
    chosen = IdentifyOptions(**options)
    model = RobotModel(MODEL.robot, chosen.make_effects())
    return {model.names[k] for k in chosen.free_parameters(model, observes_orientation=observes_orientation)}


def test_level_1_frees_joint_offsets_only() -> None:
    assert freed(level=1, base="fixed", tool="fixed") == {f"theta_offset_{j}" for j in range(1, 7)}


@pytest.mark.parametrize("level", [None, 2])
def test_level_2_frees_the_geometry(level: int | None) -> None:
    assert freed(level=level, base="fixed", tool="fixed") == set(MODEL.names[6:-6])


def test_level_3_adds_full_tilting_and_naming_effects_means_level_3() -> None:
    extra = freed(level=3, base="fixed", tool="fixed") - set(MODEL.names)
    stems = {"clearance", "backlash_load", "compliance"}
    assert extra == {f"{stem}_{j}" for stem in stems for j in range(1, 7)}
    only = freed(effects=("axial_compliance",), base="fixed", tool="fixed") - set(MODEL.names)
    assert only == {f"compliance_{j}" for j in range(1, 7)}


def test_base_and_tool_come_as_the_measurement_sees_them() -> None:
    chain = set(MODEL.names[6:-6])
    assert freed() - chain == {f"{which}_{k}" for which in ("base", "tool") for k in FRAME}
    assert freed(observes_orientation=False) - chain == {*(f"base_{k}" for k in FRAME), "tool_x", "tool_y", "tool_z"}
    assert freed(tool="fixed") - chain == {f"base_{k}" for k in FRAME}


def test_patterns_free_and_fix() -> None:
    held: dict[str, Any] = {"base": "fixed", "tool": "fixed"}
    assert freed(free=("theta_offset_[23]", "a_2"), **held) == {"theta_offset_2", "theta_offset_3", "a_2"}
    assert not any(name.startswith("alpha") for name in freed(fix=("alpha_*",), **held))
    assert freed(free=("d_*",), fix=("d_1",), **held) == {f"d_{j}" for j in range(2, 7)}


def test_tilt_first_holds_the_effects() -> None:
    assert not any(name.startswith("compliance") for name in freed(effects=("axial_compliance",), tilt_first=True))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"level": 4}, "level is 4"),
        ({"method": "guess"}, "method is 'guess'"),
        ({"base": "loose"}, "give free, fixed"),
        ({"tool": "loose"}, "give free, fixed"),
        ({"loss": "cauchy"}, "give linear, huber"),
        ({"reference": "moon"}, "reference"),
        ({"noise_mm": 0.0}, "above 0"),
        ({"level": 2, "effects": ("axial_compliance",)}, "Level 2 has no effects"),
        ({"method": "influence", "intervals": "bootstrap"}, "does not end at"),
    ],
)
def test_impossible_options_are_refused_in_words(options: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        IdentifyOptions(**options)


def test_patterns_that_match_nothing_list_the_names() -> None:
    with pytest.raises(OptionError, match=r"gamma_\*.*theta_offset_1"):
        freed(fix=("gamma_*",))
    with pytest.raises(OptionError, match="Nothing is left"):
        freed(fix=("*",))


def test_a_document_becomes_options_and_unknown_ones_are_named() -> None:
    assert IdentifyOptions.from_document({"fix": ["alpha_*"], "level": 2}).fix == ("alpha_*",)
    with pytest.raises(OptionError, match="no option 'levels'"):
        IdentifyOptions.from_document({"levels": 2})
    with pytest.raises(OptionError, match="no effect 'rust'"):
        IdentifyOptions(effects=("rust",)).make_effects()
