"""What the contract says of effects, from the core's: the API process must say what they are without numpy."""

from __future__ import annotations

import json
from dataclasses import Field, fields
from typing import Any

from kilter_core.effects import EFFECTS, Effect

UNITS = {"_nm": "N m", "_c": "degC", "_s": "s", "_m": "m", "_rad": "rad", "_kg": "kg"}
LIMITS = {"low": "ge", "above": "gt", "high": "le"}
FORMS = {"tuple[tuple[float, ...], ...]": "lists", "None": "null"}


def effects_data() -> str:
    """Return the data that the contract makes its models of: JSON, an option a line."""
    return "[\n" + ",\n".join(_lines(kind) for kind in EFFECTS.values()) + "\n]\n"


def _lines(kind: type[Effect]) -> str:
    text = next(f.metadata["text"] for f in fields(Effect) if f.name == "joints")
    said = {
        "id": kind.id,
        "model": f"{kind.__name__}Effect",
        "summary": f"{kind.summary[0].upper()}{kind.summary[1:]}.",
        "at_joints": kind.at_joints,
        "joints": text if kind.at_joints else "Null: the effect does not act at joints.",
    }
    options = ",".join(f"\n  {_json(_option(kind, one))}" for one in fields(kind) if one.name != "joints")
    return f'{_json(said)[:-1]}, "options": [{options}]}}'


def _json(said: dict[str, Any]) -> str:
    return json.dumps(said, ensure_ascii=False)


def _option(kind: type[Effect], one: Field[Any]) -> dict[str, Any]:
    """An option with its type: a joint is counted from 1; other numbers have the unit of its name and the limits it says."""
    said = {"name": one.name, "default": one.default, "text": one.metadata["text"]}
    if "choices" in one.metadata:
        return said | {"choices": one.metadata["choices"]}
    forms = [part.strip() for part in str(one.type).split("|")]
    said["forms"] = [FORMS.get(form, "list" if form.startswith("tuple") else "number") for form in forms]
    if one.name in kind.counted:
        return said | {"number": "joint"}
    said["number"] = next((kind for kind in ("bool", "int") if kind in str(one.type)), "float")
    symbol = next((symbol for ending, symbol in UNITS.items() if one.name.endswith(ending)), None)
    limits = {LIMITS[name]: value for name, value in one.metadata.items() if name in LIMITS}
    return said | ({"unit": symbol} if symbol else {}) | ({"limits": limits} if limits else {})
