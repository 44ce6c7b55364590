"""A long table sent in parts, completely or not at all: each part is one upload whose hash the server knows.

The same recording gives the same parts, so a broken sending goes on; nobody sees the campaign before the last part.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_client.errors import ApiError, KilterError, ObservationError, ServerUnreachableError
from kilter_client.resources import is_same_campaign
from kilter_files.ground.later import pa, parquet
from kilter_files.match import Columns
from kilter_files.tables import PARQUET_TYPE, Prepared

if TYPE_CHECKING:
    from kilter_client import Kilter

REFUSED = " Nothing of the recording is stored."
PART_ROWS = 131_072

Progress = Callable[[int, bool], None]
Pieces = Callable[[], Iterable[Prepared]]


def cut_parquet_parts(blocks: Iterable[Columns], rows: int = PART_ROWS) -> Iterator[Prepared]:
    """Cut columns that come in blocks into Parquet parts of ``rows`` rows; one part is in memory at a time."""
    waiting: list[Columns] = []
    held = 0
    for block in blocks:
        waiting.append(block)
        held += len(next(iter(block.values())))
        while held >= rows:
            whole = _concatenate_columns(waiting)
            yield _parquet({name: values[:rows] for name, values in whole.items()})
            waiting = [{name: values[rows:] for name, values in whole.items()}]
            held -= rows
    if held:
        yield _parquet(_concatenate_columns(waiting))


@dataclass(frozen=True)
class Sent:
    """A campaign that is whole: its id, its rows, and how many of them were there already."""

    campaign_id: str
    rows: int
    there: int


def send_whole(
    kilter: Kilter, robot: str, wanted: dict[str, Any], pieces: Pieces, progress: Progress | None = None
) -> Sent:
    """Send a table in parts to a campaign that nobody sees before the last part is there.

    A sending that broke off continues where it stopped. A part that is refused takes the whole campaign with it.
    ``pieces`` gives the parts from the first, as often as asked; ``progress`` is told the rows of each and whether it
    was there already.

    Raises:
        ObservationError: there is nothing to send, or the server refuses a part; nothing is stored.
        ServerUnreachableError: the sending broke off; nothing is visible, and the same call goes on.

    """
    first = next(iter(pieces()), None)
    if first is None:
        raise ObservationError("There is no row to send: nothing is stored.", code="observations_invalid")
    known = _sent_before(kilter, robot, wanted, first, pieces)
    if known is not None:
        return known
    campaign = _begun(kilter, robot, wanted, first)
    try:
        return _send_parts(kilter, campaign, pieces, progress)
    except (ServerUnreachableError, ApiError) as error:
        if isinstance(error, ApiError) and (error.status or 0) < 500:
            kilter.campaigns.discard(campaign)
            error.detail += REFUSED
            raise
        error.detail += " Nothing of it is visible yet: give the same command again, and it continues."
        raise
    except KilterError as error:
        kilter.campaigns.discard(campaign)
        error.detail += REFUSED
        raise


def _send_parts(kilter: Kilter, campaign: str, pieces: Pieces, progress: Progress | None) -> Sent:
    known = {str(done["sha256"]) for done in kilter.campaigns.get(campaign)["uploads"]}
    hashes, rows, there = [], 0, 0
    for part in pieces():
        is_there = part.sha256 in known
        if not is_there:
            kilter.campaigns.upload(campaign, part)
        count = part.rows or 0
        hashes.append(part.sha256)
        rows, there = rows + count, there + count * is_there
        if progress is not None:
            progress(count, is_there)
    kilter.campaigns.commit(campaign, hashes)
    return Sent(campaign, rows, there)


def _sent_before(kilter: Kilter, robot: str, wanted: dict[str, Any], first: Prepared, pieces: Pieces) -> Sent | None:
    """Return the campaign that holds exactly these parts."""
    for known in _matching_campaigns(kilter.campaigns.list(robot), wanted):
        there = {str(done["sha256"]): int(done["rows"]) for done in known["uploads"]}
        if first.sha256 in there and {part.sha256 for part in pieces()} == set(there):
            rows = sum(there.values())
            return Sent(str(known["id"]), rows, rows)
    return None


def _begun(kilter: Kilter, robot: str, wanted: dict[str, Any], first: Prepared) -> str:
    """Return the staged campaign that an earlier sending of these parts began, or a new one."""
    for known in _matching_campaigns(kilter.campaigns.list(robot, staged=True), wanted):
        if not known["uploads"] or any(done["sha256"] == first.sha256 for done in known["uploads"]):
            return str(known["id"])
    return str(kilter.campaigns.add(robot, **wanted, staged=True)["id"])


def _matching_campaigns(campaigns: Iterable[dict[str, Any]], wanted: dict[str, Any]) -> list[dict[str, Any]]:
    return [known for known in campaigns if is_same_campaign(known, wanted)]


def _concatenate_columns(blocks: list[Columns]) -> Columns:
    return blocks[0] if len(blocks) == 1 else {n: np.concatenate([b[n] for b in blocks]) for n in blocks[0]}


def _parquet(columns: Columns) -> Prepared:
    table = pa.table({name: pa.array(values, pa.float64(), from_pandas=True) for name, values in columns.items()})
    out = io.BytesIO()
    parquet.write_table(table, out, compression="zstd", use_dictionary=False)
    return Prepared(out.getvalue(), PARQUET_TYPE, tuple(columns), table.num_rows)
