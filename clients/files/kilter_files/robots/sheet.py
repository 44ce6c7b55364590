"""A table of text cells, wherever it was read from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Sheet:
    """Cells of a table with the line each row stood on, and its comments."""

    path: Path
    names: list[str]
    rows: list[tuple[int, list[str]]]
    comments: list[str] = field(default_factory=list)
    decimal: str = "."
