"""Campaigns that show an arm as it was before a repair or a re-zeroing: they say nothing of the arm as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from kilter_service.campaigns import store as campaigns
from kilter_service.ground.db import Session
from kilter_service.ground.texts import plural
from kilter_service.robots.repairs import store as repairs
from kilter_service.versions import store
from kilter_service.versions.predictions.unfitted_rows import Unseen


@dataclass(frozen=True)
class AsItWas:
    """Ids of such ``campaigns``, and ``since`` when the arm is as it is, in words; empty: as long as it is known."""

    campaigns: frozenset[str] = frozenset()
    since: str = ""

    @staticmethod
    def from_repairs_and_reports(session: Session, robot_id: int, *reports: Mapping[str, Any]) -> AsItWas:
        """What was measured before the last repair, or before what the versions of these reports were re-zeroed by."""
        repair, found = repairs.last_repair(session, robot_id), AsItWas()
        if repair is not None:
            before = frozenset(campaigns.ids_until(session, robot_id, repair.at))
            found = AsItWas(before, f"the repair of {repair.at:%Y-%m-%d} ({repair.what})")
        for report in reports:
            campaign = (report.get(store.REZEROED) or {}).get("campaign")
            before = frozenset() if campaign is None else frozenset(campaigns.ids_before(session, robot_id, campaign))
            if campaign is not None and (not found.since or len(before) > len(found.campaigns)):
                found = AsItWas(before, f"{campaigns.get(session, campaign).name}, whose rows re-zeroed a version")
        return found

    def left_out(self, unseen: Unseen) -> Unseen:
        """Rows without those of such campaigns, and a sentence that says so."""
        left = [name for name in unseen.rows if name in self.campaigns]
        if not left:
            return unseen
        rows = {name: found for name, found in unseen.rows.items() if name not in self.campaigns}
        said = (
            f"Not compared, for they show the arm as it was: {plural(len(left), 'campaign')} from before {self.since}."
        )
        return replace(unseen, rows=rows, left_out={**unseen.left_out, left[0]: said})
