"""Rows held out have a clock of their own: what a search places at 2673 s of its rows had happened before their first."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from sqlalchemy.orm import Session

from kilter_service.versions.store import training_campaign_ids

USED = {"cmp_1": "train", "cmp_2": "validation", "cmp_3": "confirmation"}


class Two:
    """A session with two versions, the second of which continues the first."""

    def get(self, _: Any, version: str) -> Any:
        """The row of a version."""
        if version == "ver_1":
            return SimpleNamespace(campaigns=[{"id": "cmp_0", "use": "train"}], parent_id=None)
        return SimpleNamespace(campaigns=[{"id": id_, "use": use} for id_, use in USED.items()], parent_id="ver_1")


def test_campaigns_held_out_are_none_of_those_a_version_was_fitted_to() -> None:
    assert training_campaign_ids(cast(Session, Two()), "ver_2") == {"cmp_0", "cmp_1"}
