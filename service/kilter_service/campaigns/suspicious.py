"""Which rows of a campaign look wrong. Every surface shows what is gathered here."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from typing import Any

from kilter_core.errors import CoreError
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns import store
from kilter_service.campaigns.facts import cached_campaign_facts
from kilter_service.campaigns.store import Said
from kilter_service.contract.campaigns import Campaign, SaidBy, SuspiciousRow, SuspiciousRows
from kilter_service.contract.fits import SetAside
from kilter_service.contract.wording import as_written
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError

MOST_SAID = 2000
ORDER: tuple[SaidBy, ...] = ("rows", "identification", "search")


def of_campaign(database: Database, campaign_id: str) -> SuspiciousRows:
    """Return all rows of a campaign that look wrong: to the rows themselves, and to every version made with them.

    Raises:
        ServiceError: no such campaign, or parts of it are missing.

    """
    return _collect_suspicious_rows(database, campaigns.get(database, campaign_id))


def of_campaigns(database: Database, ids: Iterable[str]) -> list[SuspiciousRows]:
    """Return the same of several campaigns, each once; those that are gone say nothing."""
    out = []
    for one in dict.fromkeys(ids):
        try:
            out.append(of_campaign(database, one))
        except ServiceError:
            continue
    return out


def _collect_suspicious_rows(database: Database, campaign: Campaign) -> SuspiciousRows:
    starts = [0, *accumulate(upload.rows for upload in campaign.uploads)]
    found: list[SuspiciousRow] = []
    count = 0
    try:
        facts = cached_campaign_facts(database, campaign)
    except CoreError:
        facts = None  # nothing was uploaded, or rows that cannot be read: the versions' word stays
    if facts is not None:
        own: dict[str, Any] = {"weight": None, "held_out": False}
        found = [
            _row(one.row, starts, "rows", one.why, mm=one.mm, sigma=one.sigma, **own) for one in facts.doubtful.rows
        ]
        count = facts.doubtful.count - len(facts.doubtful.rows)
    with database.reading() as session:
        found += _by_job(session, campaign.id, starts)
    count += len({one.row for one in found})
    found.sort(key=lambda one: (one.row, ORDER.index(one.said_by), one.version_id or ""))
    return SuspiciousRows(
        campaign=campaign.id,
        name=campaign.name,
        rows=campaign.rows,
        count=count,
        found=found[:MOST_SAID],
        sentence=sentence(campaign.rows, count),
    )


def sentence(rows: int, count: int) -> str:
    """Say how many rows look wrong."""
    if not count:
        return f"None of the {rows} rows looks wrong."
    return f"{count} of {rows} rows look{'s' if count == 1 else ''} wrong."


def _by_job(session: Session, campaign: str, starts: Sequence[int]) -> Iterator[SuspiciousRow]:
    """What the jobs that made versions say of rows of a campaign."""
    for said in store.iter_set_aside_rows(session, campaign):
        by: SaidBy = "search" if said.kind == "gap" else "identification"
        for one in as_written(list[SetAside], said.rows):
            values = {"mm": one.residual_mm, "sigma": one.residual_sigma, "weight": one.weight}
            yield _row(
                one.row, starts, by, _set_aside_reason(one, by), held_out=bool(one.held_out), said=said, **values
            )


def _set_aside_reason(one: SetAside, by: SaidBy) -> str:
    if one.held_out:
        return f"no model of this {by} predicts it, and it was left out of the errors on held-out rows"
    if one.weight:
        return "too far from what the model can be, so it counts less than half"
    return "too far from what the model can be, so it was left out of the fit"


def _row(
    row: int, starts: Sequence[int], by: SaidBy, why: str, said: Said | None = None, **values: Any
) -> SuspiciousRow:
    file = max(bisect_right(starts[:-1] or [0], row - 1), 1)
    who = {"version_id": None, "version_name": "", "job_id": None}
    if said is not None:
        who = {"version_id": said.version_id, "version_name": said.name, "job_id": said.job_id}
    return SuspiciousRow(row=row, file=file, file_row=row - starts[file - 1], said_by=by, why=why, **who, **values)
