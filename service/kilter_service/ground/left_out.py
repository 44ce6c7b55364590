"""Which effects of a version a correction leaves out, and where it makes up for them all the same, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

COLUMNS = {"temperature_c": "temperature_c", "base_tilt_x": "base_tilt_x_deg", "base_tilt_y": "base_tilt_y_deg"}


def where_sentences(where_stated: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Say where effects are corrected that are left out of rows which do not state what they follow."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, asked in where_stated.items():
        names.setdefault(tuple(asked), []).append(name)
    return tuple(_describe_correction_scope(asked, who) for asked, who in names.items())


def sentence(unsupported: Sequence[str], where_stated: Mapping[str, Sequence[str]], by: str = "at run time") -> str:
    """Say what is left out ``by`` a correction and where it is not; empty: nothing is left out."""
    never = [name for name in unsupported if name not in where_stated]
    said = [f"Not corrected {by}: {', '.join(never)}."] if never else []
    return " ".join((*said, *where_sentences(where_stated)))


def fields(unsupported: Sequence[str], where_stated: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """What an answer says of it: ``unsupported_effects``, ``corrected_where_stated``, ``not_corrected``."""
    return {
        "unsupported_effects": list(unsupported),
        "corrected_where_stated": {name: [COLUMNS[one] for one in asked] for name, asked in where_stated.items()},
        "not_corrected": sentence(unsupported, where_stated),
    }


def _describe_correction_scope(asked: Sequence[str], names: Sequence[str]) -> str:
    columns = " and ".join(COLUMNS[one] for one in asked)
    where = f"in files and paths, whose rows must state {columns}"
    if tuple(asked) == ("temperature_c",):
        where = f"in rows that state {columns}, in all others and in a stream with KILTER_TEMPERATURE_C"
    return f"Corrected only {where}: {', '.join(names)}."
