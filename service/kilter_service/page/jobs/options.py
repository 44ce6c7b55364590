"""The options of a kind as fields of a form: what they are called, what they take, and what was typed into them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from kilter_service.contract.jobs.registry import KINDS
from kilter_service.ground.errors import ServiceError

PREFIX = "option."
EFFECT = "effect."  # an effect that was ticked in the list
NUMBERS = {"number", "integer"}


@dataclass(frozen=True)
class Field:
    """A field of the form; ``form`` is `choice`, `number`, `text`, `names` or `json`."""

    name: str
    form: str
    hint: str
    default: str
    choices: tuple[str, ...] = ()
    required: bool = False


@cache
def fields(kind: str) -> tuple[list[Field], list[Field]]:
    """Return the usual options of a kind, and the others."""
    schema, first = KINDS[kind].options.model_json_schema(), KINDS[kind].usual
    made = {name: _field(name, part, schema) for name, part in schema["properties"].items()}
    return [made[name] for name in first], [field for name, field in made.items() if name not in first]


def parse_typed_values(kind: str, typed: Mapping[str, str]) -> dict[str, Any]:
    """Return the options that were typed; what was left empty has its default.

    Raises:
        ServiceError: what was typed is not what the option takes.

    """
    usual, others = fields(kind)
    texts = {field.name: typed.get(PREFIX + field.name, "").strip() for field in [*usual, *others]}
    found = {field.name: _read(field, texts[field.name]) for field in [*usual, *others] if texts[field.name]}
    ticked = [name.removeprefix(EFFECT) for name in typed if name.startswith(EFFECT)]
    if ticked and "effects" in texts:
        found["effects"] = [*found.get("effects", []), *(one for one in ticked if one not in found.get("effects", []))]
    return found


def _field(name: str, part: Mapping[str, Any], schema: Mapping[str, Any]) -> Field:
    hint, required = (
        part.get("description", "").replace("null:", "empty:").replace("`", ""),
        name in schema.get("required", []),
    )
    default = part.get("default")
    shown = "" if default in (None, [], {}, "") else json.dumps(default).strip('"')
    parts = [_resolve_reference(one, schema) for one in part.get("anyOf", [part])]
    kinds = {str(one.get("type", "")) for one in parts} - {"null"}
    choices = tuple(json.dumps(value).strip('"') for one in parts for value in _values(one))
    if "boolean" in kinds:
        return Field(name, "choice", hint, shown, ("true", "false"), required)
    if choices:
        return Field(name, "choice", hint, shown, choices, required)
    form = "json"
    if kinds <= NUMBERS:
        form = "number"
    elif kinds == {"string"}:
        form = "text"
    elif kinds == {"array"}:
        form = "names"
    return Field(name, form, hint, shown, (), required)


def _resolve_reference(part: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    target = part.get("$ref", "").rpartition("/")[2]
    found: Mapping[str, Any] = schema["$defs"][target] if target else part
    return found


def _values(part: Mapping[str, Any]) -> list[Any]:
    return list(part.get("enum", [part["const"]] if "const" in part else []))


def _read(field: Field, text: str) -> Any:
    if field.form == "text":
        return text
    if field.form == "choice":
        return _number_or_text(text)
    if field.form == "names" and not text.startswith("["):
        return [_number_or_text(one.strip()) for one in text.split(",") if one.strip()]
    try:
        return json.loads(text)
    except ValueError as error:
        wanted = "a number" if field.form == "number" else "JSON"
        raise ServiceError(
            f"{field.name}: {text!r} cannot be read. Write {wanted}, or leave it empty.",
            code="option_invalid",
            option=field.name,
        ) from error


def _number_or_text(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
