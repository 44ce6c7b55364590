"""What an exported table says of itself, as tables for people."""

from __future__ import annotations

from typing import Any

from kilter_client.cli.terminal.output import print_line
from kilter_client.cli.terminal.tables import show_rows

STATES = {
    "known": "known",
    "uncertain": "not told apart from 0",
    "held": "not told: shared with base or tool, or not identified",
    "unstated": "nobody says how well it is known",
    "shared": "goes with the table's other numbers: not to be entered alone",
}


def _format_value(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def show(document: dict[str, Any], details: bool) -> None:
    """Print the zero offsets as a table, with ``details`` every number of the export beside its nominal one."""
    if "numbers" not in document:
        return
    if details:
        rows = [
            (one["where"], one["name"], *(_format_value(one[key]) for key in ("nominal", "exported", "difference")))
            for one in document["numbers"]
        ]
        show_rows(("joint or frame", "number", "nominal", "exported", "difference"), rows)
    offsets = []
    for one in document["zero_offsets"]:
        unit = "deg" if "offset_deg" in one else "mm"
        half = one[f"half_width_{unit}"]
        within = "–" if half is None or one["state"] in ("held", "shared") else f"± {half:.2g} {unit}"
        offsets.append((one["joint"], f"{one[f'offset_{unit}']:+.6g} {unit}", within, STATES[one["state"]]))
    show_rows(("joint", "zero offset", "95 %", "how well it is known"), offsets)
    print_line(document["zero_offsets_sign"])
