"""Masses and centres as stated and as identified, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_client.cli.terminal.output import number, print_line, show_rows

HEAD = ("body", "", "stated", "found", "sigma", "stated sigma", "unit")


def show_load_model(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the masses that the data could see, and count the others."""
    seen = [row for row in rows if row["seen"]]
    if seen:
        show_rows(HEAD, [_row(row) for row in seen], title="Masses that the data determine")
    if len(seen) < len(rows):
        print_line(
            f"{len(rows) - len(seen)} of {len(rows)} masses and centres are known no better than stated; see --json"
        )


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    body = "payload" if row["link"] is None else f"link {row['link']}"
    found = (number(row[key]) for key in ("stated", "value"))
    return body, str(row["parameter"]), *found, *(number(row[key], 2) for key in ("sigma", "prior_sigma")), row["unit"]
