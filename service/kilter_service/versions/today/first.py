"""The first calibration of an arm, stage by stage: what is done, what is missing, and how to do it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kilter_service.contract.standing import FirstStage, FirstStep, NextStep

WORDS: dict[FirstStage, str] = {
    "describe": "Describe",
    "measure": "Measure",
    "check": "Check the file",
    "search": "Identify and search",
    "activate": "Activate",
    "correct": "Correct",
}
MISSING: dict[FirstStage, str] = {
    "describe": "",
    "measure": "Nothing was measured yet.",
    "check": "No campaign is meant for identification.",
    "search": "No version was made of the measurements yet.",
    "activate": "No version is active.",
    "correct": "No path and no stream was corrected yet.",
}


@dataclass(frozen=True)
class Reached:
    """What is stored of the first calibration of a robot; ``checked``: some rows are meant to be fitted."""

    measured: bool = False
    checked: bool = False
    searched: bool = False
    active: bool = False
    corrected: bool = False


def first_calibration(reached: Reached, steps: Mapping[FirstStage, Sequence[NextStep]]) -> list[FirstStep]:
    """Return the stages, of which the first that is not done has its ``steps``; none once all are done."""
    searched = reached.active or reached.searched
    done: dict[FirstStage, bool] = {
        "describe": True,
        "measure": searched or reached.measured,
        "check": searched or reached.checked,
        "search": searched,
        "activate": reached.active,
        "correct": reached.active and reached.corrected,
    }
    if all(done.values()):
        return []
    following = next(stage for stage in WORDS if not done[stage])
    return [
        FirstStep(
            stage=stage,
            words=words,
            done=done[stage],
            missing=MISSING[stage] if stage == following else "",
            steps=[*steps.get(stage, ())] if stage == following else [],
        )
        for stage, words in WORDS.items()
    ]
