"""A campaign that is another one without some rows says so first in its notes; without that it is one of its own."""

from __future__ import annotations

import re

WHOLE = re.compile(r"Campaign (cmp_[0-9a-f]{16}) \(")
READ = 32  # characters of the notes that tell


def format_origin_note(campaign: str, name: str, without: str, actor: str) -> str:
    """Return the sentence with which the notes of the rest begin."""
    return f"Campaign {campaign} ({name}) without rows {without}, set aside by {actor} on the page."


def parse_origin_campaign(notes: str) -> str | None:
    """Return the campaign that a campaign is the rest of, by the beginning of its notes; None: it is one of its own."""
    found = WHOLE.match(notes)
    return None if found is None else found[1]
