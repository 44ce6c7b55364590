"""Cells that hold a name: the camera and the board of a view, stored as their numbers in the campaign's conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_core.errors import ObservationError
from kilter_files.ground.later import pa
from kilter_service.contract.columns import NAMED


class Names:
    """The names that cells of each column may hold; their numbers count from 1. A column may hold the numbers as well."""

    def __init__(self, of: Mapping[str, Sequence[str] | None]) -> None:
        self._of: dict[str, list[str] | None] = {k: None if v is None else list(v) for k, v in of.items()}
        self._met: dict[str, list[str]] = {column: [] for column in self._of}

    @staticmethod
    def from_conditions(conditions: Mapping[str, Any] | None) -> Names:
        """Those that a campaign's conditions name; with None whatever comes."""
        if conditions is None:
            return Names(dict.fromkeys(NAMED))
        return Names({c: [str(one["name"]) for one in conditions.get(k) or ()] for c, k in NAMED.items()})

    def __contains__(self, column: str) -> bool:
        return column in self._of

    def replace_names_by_numbers(self, table: pa.Table, first: int) -> pa.Table:
        """The table with numbers for names; ``first`` is the number of its first row.

        Raises:
            ObservationError: a name that the campaign does not have.

        """
        for place, column in enumerate(table.column_names):
            if column in self._of and pa.types.is_string(table.schema.field(column).type):
                cells = table.column(column).to_pylist()
                numbers = [None if c is None else self._number(column, c, first + k) for k, c in enumerate(cells)]
                table = table.set_column(place, column, pa.array(numbers, pa.float64()))
        return table

    def _number(self, column: str, cell: str, row: int) -> float:
        known = self._of[column]
        text = cell.removesuffix(".0")
        if known is not None and cell in known:
            return float(known.index(cell) + 1)
        if text.isascii() and text.isdigit() and (known is None or 1 <= int(text) <= len(known)):
            return float(text)
        if known is None:
            met = self._met[column]
            if cell not in met:
                met.append(cell)
            return float(met.index(cell) + 1)
        named = ", ".join(known) or "none"
        raise ObservationError(
            f"Row {row}, column {column!r} is {cell[:64]!r}, and the campaign names {named}: correct the cell, or name it in "
            f"the campaign's conditions ({NAMED[column]}).",
            code=f"{column}_unknown",
            row=row,
            column=column,
        )
