"""The facts of campaigns that somebody looked at lately: a million rows take seconds to look at."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import facts
from kilter_service.contract.campaigns import Campaign
from kilter_service.ground.db import Database
from kilter_service.ground.recent import Recent

if TYPE_CHECKING:
    from kilter_service.campaigns.facts import Facts
    from kilter_service.campaigns.looking import Rows

MOST_FACTS = 24
_facts = Recent["Facts"](MOST_FACTS)


def campaign_cache_key(campaign: Campaign) -> tuple[str, ...]:
    """Return what tells the rows of a campaign from all others, and from its own with other files."""
    return campaign.id, str(campaign.conditions), *(upload.sha256 for upload in campaign.uploads)


def cached_campaign_facts(
    database: Database, campaign: Campaign, reading: Callable[[Rows], None] | None = None
) -> Facts:
    """Return the facts of a campaign; ``reading`` gets its rows where they had to be read.

    Raises:
        ObservationError: nothing was uploaded yet. ServiceError: no such campaign, or parts of it are missing.

    """

    def read() -> Facts:
        rows = looking.load_campaign_rows(database, campaign.id)
        found = facts(rows)
        if reading is not None:
            reading(rows)
        return found

    return _facts.get(campaign_cache_key(campaign), read)
