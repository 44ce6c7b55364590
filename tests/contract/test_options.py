"""The options of jobs: what the contract says is what core does, and what cannot be is refused in one sentence."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

import kilter_core.gap
import kilter_core.identify
from kilter_core.effects import EFFECTS, effect_from_document
from kilter_core.gap.search.candidates import joints_by_effect
from kilter_service.contract.effects import AnyEffect
from kilter_service.contract.jobs.gap import GapOptions
from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.jobs.refusals import refusal, without_kind
from kilter_service.jobs.registry import KINDS

NEW_JOB: TypeAdapter[Any] = TypeAdapter(NewJob)
EFFECT: TypeAdapter[Any] = TypeAdapter(AnyEffect)
NOT_OF_THE_CORE = {"start", "limits", "sheet_order", "masses_from"}
OF_THE_START = {"prior"}  # of a search: `kilter_core.gap.of_type` makes the start that has it


def test_the_contract_of_effects_is_up_to_date() -> None:
    repository = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-m", "tools.contract", "--check"], cwd=repository, check=False)
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("contract", "options"),
    [(IdentifyOptions, kilter_core.identify.IdentifyOptions), (GapOptions, kilter_core.gap.GapOptions)],
)
def test_names_and_defaults_are_those_of_the_core(contract: Any, options: Any) -> None:
    own = dataclasses.asdict(options())
    others = NOT_OF_THE_CORE | (OF_THE_START if contract is GapOptions else set())
    said = {name: field.default for name, field in contract.model_fields.items() if name not in others}
    assert said == {name: list(value) if isinstance(value, tuple) else value for name, value in own.items()}


@pytest.mark.parametrize("effect", EFFECTS)
def test_core_makes_what_the_contract_lets_through(effect: str) -> None:
    assert EFFECT.validate_python(effect) == effect
    made = effect_from_document(EFFECT.validate_python({"id": effect}).model_dump(mode="json"))
    stored = made.to_document()
    assert EFFECT.validate_python(stored).model_dump(mode="json") == stored
    if EFFECTS[effect].at_joints:
        joints = {"id": effect, "joints": [2]}
        assert effect_from_document(EFFECT.validate_python(joints).model_dump(mode="json")).joints == (1,)
    else:
        with pytest.raises(ValidationError):
            EFFECT.validate_python({"id": effect, "joints": [2]})


def test_one_grammar_of_effects_for_every_kind() -> None:
    effects = ["backlash", {"id": "eccentricity", "joints": [2, 3]}]
    for kind, more in (("identify", {}), ("gap", {}), ("plan", {"purpose": "separate"})):
        job = NEW_JOB.validate_python({"kind": kind, "robot": "a", "options": {"effects": effects, **more}})
        KINDS[kind].check(job.options)
        assert job.options.model_dump(mode="json") == {"effects": effects, **more}


def test_a_hunt_looks_at_the_joints_that_are_named() -> None:
    assert joints_by_effect(["drift", {"id": "backlash", "joints": [2]}, {"id": "backlash", "joints": [3]}]) == {
        "drift": None,
        "backlash": frozenset({1, 2}),
    }
    assert joints_by_effect([{"id": "backlash", "joints": [2]}, "backlash"]) == {"backlash": None}


def refused(kind: str, options: Any) -> str:
    body = {"kind": kind, "robot": "a", "options": options}
    with pytest.raises(ValidationError) as error:
        NEW_JOB.validate_python(body)
    found = refusal([{**one, "loc": ("body", *one["loc"])} for one in error.value.errors()], body)
    assert found is not None
    assert found.code == "option_invalid"
    return found.message


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("identify", {"alpha": 0.01}, ["options.alpha:", "identify has no option 'alpha'", "(gap has it)", "search_mm"]),
        ("identify", {"levl": 2}, ["options.levl:", "Do you mean 'level'?"]),
        ("identify", {"level": 7}, ["options.level is 7: give 1, 2 or 3", "identify"]),
        ("identify", {"level": "2"}, ["options.level is '2': give 1, 2 or 3"]),
        ("identify", {"noise_mm": 0}, ["options.noise_mm is 0: give a number above 0 mm"]),
        ("identify", {"tilt_first": 1}, ["options.tilt_first is 1: give true or false"]),
        ("identify", {"free": "theta_1"}, ["options.free is 'theta_1': give a list of text"]),
        ("identify", {"limits": {"max_joint_deg": -1}}, ["options.limits.max_joint_deg is -1"]),
        ("identify", {"limits": {"max_deg": 1}}, ["options.limits.max_deg: limits of identify has no 'max_deg'"]),
        ("identify", {"effects": ["ghost"]}, ["options.effects.0: there is no effect 'ghost'", "backlash_load"]),
        ("gap", {"effects": [{"id": "ghost"}]}, ["options.effects.0: there is no effect 'ghost'", "backlash_load"]),
        ("gap", {"effects": [{"joints": [1]}]}, ["options.effects.0 is", "give an id, or an object with its id"]),
        ("gap", {"effects": [3]}, ["options.effects.0 is 3"]),
        ("plan", {"purpose": "identify", "effects": [{"id": "backlash", "joints": [0]}]}, ["options.effects.0.joints.0 is 0"]),
        ("gap", {"effects": [{"id": "backlash", "axis": 1}]}, ["backlash has no option 'axis'. It has: joints."]),
        ("gap", {"effects": "backlash"}, ["options.effects is 'backlash': give a list"]),
        ("gap", {"alpha": 0.9}, ["options.alpha is 0.9: give a number between 0 and 0.5", "gap"]),
        ("gap", {"alpha": "0.01"}, ["options.alpha is '0.01': give a number"]),
        ("gap", {"bootstraps": 10**9}, ["options.bootstraps is 1000000000: give a whole number from 1 to 20000"]),
        ("gap", {"matters_um": -1}, ["options.matters_um is -1: give a number of 0 or more micrometres"]),
        ("evaluate", {"criteria": ["XY"]}, ["options.criteria.0 is 'XY'"]),
        ("plan", {}, ["options.purpose is missing: plan needs it. Give iso9283, identify, separate or check."]),
        ("plan", {"purpose": "fun"}, ["options.purpose is 'fun': give iso9283, identify, separate or check"]),
        ("plan", {"purpose": "identify", "box_mm": [[0, 0], [1, 1]]}, ["options.box_mm"]),
        ("joint_parameters", {"propose": "j3", "count": 1}, ["options.count is 1: give a whole number from 4 to 200"]),
        ("gap", 3, ["options"]),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_sentence(kind: str, options: Any, words: list[str]) -> None:
    said = refused(kind, options)
    for word in words:
        assert word in said
    assert "\n" not in said


def test_a_plan_without_options_says_what_is_needed() -> None:
    body = {"kind": "plan", "robot": "a"}
    with pytest.raises(ValidationError) as error:
        NEW_JOB.validate_python(body)
    found = refusal([{**one, "loc": ("body", *one["loc"])} for one in error.value.errors()], body)
    assert found is not None
    assert "purpose" in found.message


def test_what_else_is_wrong_keeps_its_place_in_the_body() -> None:
    body = {"kind": "gap", "robot": "a", "priority": 1}
    with pytest.raises(ValidationError) as error:
        NEW_JOB.validate_python(body)
    errors = [{**one, "loc": ("body", *one["loc"])} for one in error.value.errors()]
    assert refusal(errors, body) is None
    assert [one["loc"] for one in without_kind(errors, body)] == [("body", "priority")]


def test_an_unknown_kind_is_refused_with_the_kinds_there_are() -> None:
    found = refusal([], {"kind": "paint"})
    assert found is not None
    assert (found.code, "joint_parameters" in found.message) == ("kind_unavailable", True)


def test_an_effect_with_its_options_is_copied_to_other_processes() -> None:
    told = EFFECT.validate_python({"id": "gear_error", "joints": [2], "orders": [1.0]})
    assert pickle.loads(pickle.dumps(told)) == told  # noqa: S301 (our own)
