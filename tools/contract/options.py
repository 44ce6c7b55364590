"""What the contract says of options that the core declares: the API process must say what they are without numpy."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import Field, fields
from typing import Any

from kilter_core.gap import GapOptions
from kilter_core.identify import IdentifyOptions

UNITS = {
    "_nm": "N m", "_c": "degC", "_s": "s", "_m": "m", "_rad": "rad", "_kg": "kg", "_mm": "mm", "_um": "um", "_deg": "deg",
    "_percent": "%",
}  # fmt: skip
LIMITS = {"low": "ge", "above": "gt", "high": "le", "below": "lt"}
FORMS = {"tuple[tuple[float, ...], ...]": "lists", "None": "null"}


def options_data() -> str:
    """Return the options of jobs that the core declares, by kind: JSON, an option a line."""
    kinds = {"identify": IdentifyOptions, "gap": GapOptions}
    made = (f"{json.dumps(kind)}: [\n" + ",\n".join(_lines(options)) + "\n]" for kind, options in kinds.items())
    return "{\n" + ",\n".join(made) + "\n}\n"


def _lines(options: type) -> Iterator[str]:
    for one in fields(options):
        if "text" in one.metadata:
            yield json.dumps(describe_option(one), ensure_ascii=False)


def describe_option(one: Field[Any], counted: bool = False) -> dict[str, Any]:
    """Return an option with its type: numbers have the unit of their name and the limits declared, or count joints from 1."""
    said = {"name": one.name, "default": one.default, "text": one.metadata["text"]}
    forms = [part.strip() for part in str(one.type).split("|")]
    if "choices" in one.metadata:
        return said | {"choices": one.metadata["choices"]} | ({"null": True} if "None" in forms else {})
    said["forms"] = [FORMS.get(form, "list" if form.startswith("tuple") else "number") for form in forms]
    if counted:
        return said | {"number": "joint"}
    said["number"] = next((kind for kind in ("bool", "int") if kind in str(one.type)), "float")
    symbol = next((symbol for ending, symbol in UNITS.items() if one.name.endswith(ending)), None)
    limits = {LIMITS[name]: value for name, value in one.metadata.items() if name in LIMITS}
    return said | ({"unit": symbol} if symbol else {}) | ({"limits": limits} if limits else {})
