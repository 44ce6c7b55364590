"""What data cannot tell apart, as text, with the sums that they know all the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.cli.terminal.output import print_line


def show_unobservable(directions: list[Any]) -> None:
    """Print each combination of parameters that changes nothing that was measured."""
    if not directions:
        return
    print_line("What these data cannot distinguish:")
    for direction in directions:
        sentence = direction.get("sentence") if isinstance(direction, Mapping) else direction
        print_line(f"  - {sentence or _combination(direction)}")


def _combination(direction: Mapping[str, Any]) -> str:
    parts = direction.get("parameters") or ()
    return " ".join(f"{part['weight']:+.2f} {part['name']}" for part in parts) + " changes nothing that was measured."
