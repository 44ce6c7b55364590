"""A hunt judged again under the noise that its own names leave: a drift that is named is no noise any more.

A name that follows the clock or the temperature explains a part of what repeats differ by. Judged by the noise from before
it, everything seems too good to be true, or too small to be seen.
"""

from __future__ import annotations

from dataclasses import replace

from kilter_core.gap.search.hunt import Hunt, selector_at
from kilter_core.gap.search.renewal import renewed
from kilter_core.gap.search.settle import settled
from kilter_core.types import Floats

ROUNDS = 3  # of names judged by the noise and noise judged by the names


def rejudged(found: Hunt, alpha: float, limits: Floats) -> Hunt:
    """Settle the names and renew noise and outliers in turn, until neither changes. ``limits (Q,)`` as of a hunt."""
    for _ in range(ROUNDS):
        found = settled(found, alpha)
        world = renewed(found.world, found.columns)
        if world is found.world:
            return found
        selector = selector_at(world, found.selector, limits)
        found = replace(found, world=world, selector=selector, steps=found.stepped(world, found.chosen))
    return settled(found, alpha)
