"""What colours mean, in figures, on the page and in the 3-D picture: the same in all of them."""

from __future__ import annotations

from kilter_service.page.figures.plot import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY

ERROR, CORRECTED, INTERVAL = RED, BLUE, BLUE  # an interval is a band of a quarter of its colour, or a bar
BESIDE = SKY  # the second of two: the other side, the other version, the largest beside the mean
FITTED, HELD_OUT, SET_ASIDE, CHOSEN = GREY, GREEN, ORANGE, PURPLE  # what was done with a row
MEANINGS = {
    "error": ERROR,
    "corrected": CORRECTED,
    "interval": INTERVAL,
    "fitted": FITTED,
    "held-out": HELD_OUT,
    "set-aside": SET_ASIDE,
    "chosen": CHOSEN,
    "beside": BESIDE,
}
