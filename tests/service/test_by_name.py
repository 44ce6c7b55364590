"""What is copied by names, and what must not be forgotten."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from pydantic import BaseModel, ValidationError

from kilter_service.ground.naming import copy_fields

STORED = SimpleNamespace(id="a", rows=3, secret="s")


@dataclass(frozen=True)
class Record:
    id: str
    rows: int
    robot: str


class Pair(NamedTuple):
    id: str
    robot: str


class Answer(BaseModel):
    id: str
    rows: int
    robot: str
    note: str = ""


@pytest.mark.parametrize("kind", [Record, Pair, Answer])
def test_fields_are_copied_by_name_and_what_is_given_wins(kind: type[Record | Pair | Answer]) -> None:
    made = copy_fields(kind, STORED, robot="ur10", id="b")
    assert (made.id, made.robot) == ("b", "ur10")
    assert getattr(made, "rows", 3) == 3
    assert not hasattr(made, "secret")


def test_a_field_that_is_nowhere_is_refused() -> None:
    for kind in (Record, Pair):
        with pytest.raises(TypeError, match="robot"):
            copy_fields(kind, STORED)
    with pytest.raises(ValidationError, match="robot"):
        copy_fields(Answer, STORED)
    with pytest.raises(TypeError, match="colour"):
        copy_fields(Record, STORED, robot="ur10", colour="red")
