"""Options that the core declares, made from `options.json`: `make contract` writes it from the core's dataclasses.

So the API process knows what they are without numpy, and an option has here what it says of itself there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

from pydantic import Field, create_model

from kilter_service.contract.units import Asked, JointNumber, unit

NUMBERS = {"float": float, "int": int, "bool": bool, "joint": JointNumber}
Declared = Mapping[str, Any]
OPTIONS: Mapping[str, Sequence[Declared]] = json.loads(
    Path(__file__).with_name("options.json").read_text(encoding="utf-8")
)
ModelT = TypeVar("ModelT", bound=type[Asked])


class WithCoreOptions(Asked):
    """Options of a job some of which the core declares."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def with_core_options(kind: str) -> Callable[[ModelT], ModelT]:
    """Add to the options of a kind of job those that the core declares."""

    def add(model: ModelT) -> ModelT:
        made: Any = create_model(
            model.__name__,
            __base__=model,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **option_fields(OPTIONS[kind]),
        )
        return cast("ModelT", made)

    return add


def option_fields(declared: Sequence[Declared]) -> dict[str, Any]:
    """Return the fields of a model for options."""
    return {one["name"]: (_type(one), Field(one["default"], description=one["text"])) for one in declared}


def _type(said: Declared) -> Any:
    """Type of an option: one of its choices, or a number, a list of numbers or of lists, or nothing."""
    if "choices" in said:
        choices: Any = Literal[tuple(said["choices"])]
        return choices | None if said.get("null") else choices
    number: Any = NUMBERS[said["number"]]
    limits = said.get("limits", {})
    if "unit" in said:
        number = Annotated[number, unit(said["unit"], **limits)]
    elif limits:
        number = Annotated[number, Field(**limits)]
    forms = {"number": number, "list": list[number], "lists": list[list[number]], "null": None}
    return reduce(or_, (forms[form] for form in said["forms"]))
