"""The time column of a tracker's export where it holds time stamps instead of seconds."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import lines_of
from kilter_files.ground.text_layout import TextLayout
from kilter_files.ground.time_stamps import seconds_of, stamp_of, stamps_of


def stamped_times(path: Path, layout: TextLayout, means: Mapping[str, int], rows: int) -> Floats | None:
    """Return the seconds of a column of time stamps, NaN where a cell is empty; None where the column holds numbers.

    Raises:
        FileError: a cell that is not a time stamp among others that are.

    """
    column = means.get("t")
    if column is None:
        return None
    cells = [(line, layout.split(text)) for line, text in itertools.islice(lines_of(path, layout), rows)]
    texts = [(line, row[column] if column < len(row) else "") for line, row in cells]
    first = next((text for _, text in texts if text), "")
    if parse_number(first, layout.decimal) is not None or stamp_of(first) is None:
        return None
    told = [(line, text) for line, text in texts if text]
    lines = [line for line, _ in told]
    stamps = stamps_of([text for _, text in told], lines, path, layout.names[column])
    seconds = iter(seconds_of(stamps))
    return np.array([next(seconds) if text else np.nan for _, text in texts])
