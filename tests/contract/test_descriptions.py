"""Every field of the HTTP interface says what it is, in which unit; next to nothing is left to guess."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tools.contract.interface import promised_interface

SCHEMAS: dict[str, Any] = promised_interface()["components"]["schemas"]
# What a name ends in, and what its description must say; the longest ending counts.
UNITS = {
    "_mm": "mm", "_deg": "degrees", "_kg": "kg", "_s": " s", "_c": "Celsius", "_m": " m", "_nm": "N m", "_um": "um",
    "_nm_deg": "N m/deg", "_m_s2": "m/s2", "_kg_m2": "kg m2", "_n": " N", "_rad": "rad", "_hz": "Hz",
}  # fmt: skip
MOST_FREE = 1  # the context of a problem


def fields() -> Iterator[tuple[str, str, dict[str, Any]]]:
    for name, schema in SCHEMAS.items():
        for field, said in schema.get("properties", {}).items():
            yield name, field, said


def free(place: str, schema: Any) -> Iterator[str]:
    """Places where anything goes: an object without fields, or a value without a type."""
    if isinstance(schema, list):
        for number, part in enumerate(schema):
            yield from free(f"{place}.{number}", part)
    if not isinstance(schema, dict):
        return
    more = schema.get("additionalProperties", schema.get("patternProperties"))
    if more is True or (schema.get("type") == "object" and "properties" not in schema and more is None):
        yield place
    for key in ("items", "anyOf", "oneOf", "allOf", "prefixItems", "additionalProperties"):
        yield from free(f"{place}.{key}", schema.get(key))
    for field, part in schema.get("properties", {}).items():
        if not set(part) & {"type", "$ref", "anyOf", "oneOf", "allOf", "const", "enum"}:
            yield f"{place}.{field}"
        yield from free(f"{place}.{field}", part)


def test_every_field_is_described() -> None:
    silent = [f"{name}.{field}" for name, field, said in fields() if not str(said.get("description", "")).endswith(".")]
    assert not silent


def test_every_model_is_described() -> None:
    assert not [name for name, schema in SCHEMAS.items() if not schema.get("description") and "properties" in schema]


def test_a_field_with_a_unit_in_its_name_says_the_unit() -> None:
    wrong = []
    for name, field, said in fields():
        ending = max((e for e in UNITS if field.endswith(e)), key=len, default=None)
        if ending is not None and UNITS[ending] not in said["description"]:
            wrong.append(f"{name}.{field}: {said['description']!r} does not say {UNITS[ending]!r}")
    assert not wrong


def test_next_to_nothing_is_free_form() -> None:
    found = [place for name, schema in SCHEMAS.items() for place in free(name, schema)]
    assert len(found) <= MOST_FREE, found
