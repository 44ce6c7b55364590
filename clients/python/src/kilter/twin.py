"""``kilter.twin.apply``: the step that an exported model of MuJoCo takes beside its elements."""

from __future__ import annotations

from kilter_client.twin.step import apply as apply

__all__ = ["apply"]
