"""How wide a figure may be: as wide as the browser has room, so that its letters stay as large as those of the text."""

from __future__ import annotations

from contextvars import ContextVar

COOKIE = "kilter-width"  # of the browser's window, pixels: the page's scripts say it
MARGINS = 52.0  # pixels beside a figure in a narrow window: of the page and of the card
NARROWEST, WIDEST = 260.0, 10_000.0

_ROOM: ContextVar[float] = ContextVar("room", default=WIDEST)


def heard(told: str | None) -> None:
    """Take the width of the window; what is not a width, or is missing, leaves all figures as wide as they are."""
    width = int(told) if told is not None and told.isascii() and told.isdigit() and len(told) < 6 else 0
    _ROOM.set(min(max(width - MARGINS, NARROWEST), WIDEST) if width else WIDEST)


def room_for(width: float) -> float:
    """Return how wide a figure becomes that is so wide where there is room."""
    return min(width, _ROOM.get())
