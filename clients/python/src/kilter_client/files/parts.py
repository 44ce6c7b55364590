"""A long table sent in parts: each part is one upload whose hash the server knows, so that a broken sending goes on.

The same recording gives the same parts; parts the campaign already has are not sent again.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_client.files.matching import Columns
from kilter_client.files.table import PARQUET_TYPE, Prepared

if TYPE_CHECKING:
    from kilter_client import Kilter

PART_ROWS = 131_072

Progress = Callable[[int, bool], None]


def parts(blocks: Iterable[Columns], rows: int = PART_ROWS) -> Iterator[Prepared]:
    """Cut columns that come in blocks into Parquet parts of ``rows`` rows; one part is in memory at a time."""
    waiting: list[Columns] = []
    held = 0
    for block in blocks:
        waiting.append(block)
        held += len(next(iter(block.values())))
        while held >= rows:
            whole = _joined(waiting)
            yield _parquet({name: values[:rows] for name, values in whole.items()})
            waiting = [{name: values[rows:] for name, values in whole.items()}]
            held -= rows
    if held:
        yield _parquet(_joined(waiting))


def send_parts(kilter: Kilter, campaign: str, pieces: Iterable[Prepared], progress: Progress | None = None) -> int:
    """Send the parts a campaign does not have yet; return the rows it then has of them.

    ``progress`` is told the rows of each part and whether it was there already.
    """
    known = {str(done["sha256"]) for done in kilter.campaigns.get(campaign)["uploads"]}
    total = 0
    for part in pieces:
        there = part.sha256 in known
        if not there:
            kilter.campaigns.upload(campaign, part)
        total += part.rows or 0
        if progress is not None:
            progress(part.rows or 0, there)
    return total


def find_campaign(kilter: Kilter, robot: str, wanted: dict[str, Any], first: Prepared) -> str:
    """Return the campaign that an earlier sending of these parts began, or a new one."""
    for known in kilter.campaigns.list(robot):
        same = all(known[key] == wanted[key] for key in ("name", "device", "role"))
        if same and (not known["uploads"] or any(done["sha256"] == first.sha256 for done in known["uploads"])):
            return str(known["id"])
    return str(kilter.campaigns.add(robot, **wanted)["id"])


def _joined(blocks: list[Columns]) -> Columns:
    return blocks[0] if len(blocks) == 1 else {n: np.concatenate([b[n] for b in blocks]) for n in blocks[0]}


def _parquet(columns: Columns) -> Prepared:
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table({name: pa.array(values, pa.float64(), from_pandas=True) for name, values in columns.items()})
    out = io.BytesIO()
    parquet.write_table(table, out, compression="zstd", use_dictionary=False)
    return Prepared(out.getvalue(), PARQUET_TYPE, tuple(columns), table.num_rows)
