"""The time column of a tracker's export where it holds time stamps instead of seconds."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import numbered_lines
from kilter_files.ground.text_layout import TextLayout
from kilter_files.ground.time_stamps import continuous_seconds, parse_stamp, parse_stamp_column


def stamped_times(path: Path, layout: TextLayout, means: Mapping[str, int], rows: int) -> Floats | None:
    """Return the seconds of a column of time stamps, NaN where a cell is empty; None where the column holds numbers.

    Raises:
        FileError: a cell that is not a time stamp among others that are.

    """
    column = means.get("t")
    if column is None:
        return None
    cells = [(line, layout.split(text)) for line, text in itertools.islice(numbered_lines(path, layout), rows)]
    texts = [(line, row[column] if column < len(row) else "") for line, row in cells]
    first = next((text for _, text in texts if text), "")
    if parse_number(first, layout.decimal) is not None or parse_stamp(first) is None:
        return None
    told = [(line, text) for line, text in texts if text]
    lines = [line for line, _ in told]
    stamps = parse_stamp_column([text for _, text in told], lines, path, layout.names[column])
    seconds = iter(continuous_seconds(stamps))
    return np.array([next(seconds) if text else np.nan for _, text in texts])
