"""What a JSON schema allows, in words that a sentence or a table can hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SYMBOLS = {"um": "micrometres", "degC": "°C"}
PLAIN = {"boolean": "true or false", "string": "text", "object": "an object"}


def describe_schema(schema: Mapping[str, Any] | None) -> str:
    """Say what a schema allows besides null; empty when there is nothing short to say."""
    if schema is None:
        return ""
    parts = [part for part in schema.get("anyOf", [schema]) if part.get("type") != "null"]
    said = [_describe_schema_part(part) for part in parts]
    return " or ".join(one for one in said if one)


def _describe_schema_part(part: Mapping[str, Any]) -> str:
    if "enum" in part or "const" in part:
        values = [str(value) for value in part.get("enum", [part.get("const")])]
        return values[0] if len(values) == 1 else f"{', '.join(values[:-1])} or {values[-1]}"
    sort = part.get("type")
    if sort in ("integer", "number"):
        return f"a {'whole number' if sort == 'integer' else 'number'}{_range(part)}"
    if sort == "array":
        inner = describe_schema(part.get("items"))
        return f"a list of {inner}" if inner else "a list"
    return PLAIN.get(str(sort), "")


def _range(part: Mapping[str, Any]) -> str:
    low, above = part.get("minimum"), part.get("exclusiveMinimum")
    high, below = part.get("maximum"), part.get("exclusiveMaximum")
    symbol = part.get("x-unit", "")
    unit = f" {SYMBOLS.get(symbol, symbol)}" if symbol else ""
    if low is not None and high is not None:
        return f" from {low:.10g} to {high:.10g}{unit}"
    if above is not None and below is not None:
        return f" between {above:.10g} and {below:.10g}{unit}"
    if above is not None:
        return f" above {above:.10g}{unit}"
    if low is not None:
        return f" of 0 or more{unit}" if low == 0 else f" of at least {low:.10g}{unit}"
    return f" in {unit.strip()}" if unit else ""
