"""Patterns that a long text is searched for fast: ones that begin with known words, and ones of brackets in brackets."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache


class Keyed:
    """A pattern whose matches begin at one of some words, in capitals or small letters; it finds what the pattern finds.

    The pattern begins with a condition that a word begins there, as ``\\b`` is. Python tries such a pattern, or one for
    capitals and small letters alike, at each place of a text, which takes up to a second for 16 MB.
    """

    def __init__(self, words: str, pattern: str, flags: int = re.I) -> None:
        """Take the words, in small letters and parted by blanks, and the pattern."""
        self._words, self._pattern = words.split(), re.compile(pattern, flags)

    def finditer(self, text: str) -> Iterator[re.Match[str]]:
        """Yield the matches that do not overlap, from left to right."""
        folded = _lower_text(text)
        words = "|".join(word for word in self._words if word in folded)
        end = 0
        for place in re.finditer(words, folded) if words else ():
            match = self._pattern.match(text, place.start()) if place.start() >= end else None
            if match is not None:
                yield match
                end = match.end()

    def search(self, text: str) -> re.Match[str] | None:
        """Return the first match."""
        return next(self.finditer(text), None)

    def match(self, text: str, at: int = 0) -> re.Match[str] | None:
        """Return the match at a place."""
        return self._pattern.match(text, at)


class Tailed:
    """A pattern of a head that may begin nearly anywhere, and a tail that does not; it finds what both together find.

    The tail begins with a sign, which Python finds fast. Only in front of a tail the head is looked for, which is no longer
    than ``REACH``; what follows the head does not depend on it.
    """

    REACH = 200  # characters

    def __init__(self, head: str, tail: str) -> None:
        """Take both; capitals count as small letters."""
        self._tail, self._whole = re.compile(tail, re.I), re.compile(head + tail, re.I)

    def finditer(self, text: str) -> Iterator[re.Match[str]]:
        """Yield the matches that do not overlap, from left to right."""
        end = 0
        for tail in self._tail.finditer(text):
            match = self._whole.search(text, max(end, tail.start() - self.REACH), tail.end())
            if match is not None:
                yield match
                end = match.end()


def has_word(text: str, *words: str) -> bool:
    """Say whether one of these words, in small letters, is anywhere in a text, in capitals or small letters."""
    folded = _lower_text(text)
    return any(word in folded for word in words)


@lru_cache(maxsize=2)
def _lower_text(text: str) -> str:
    """Small letters at the same places: programs are text of 8 bits, of which no letter becomes two."""
    return text.lower()


def nested(brackets: str, levels: int) -> str:
    """Return a pattern of text in which brackets close, at most so many in another."""
    opening, closing = (rf"[{re.escape(brackets[k::2])}]" for k in (0, 1))
    plain = rf"[^{re.escape(brackets)}]*+"
    inner = plain
    for _ in range(levels):
        inner = rf"{plain}(?:{opening}{inner}{closing}{plain})*+"
    return inner


ARGUMENT = re.compile(
    rf"\s*+([^\[\](){{}},]*+(?:[\[({{]{nested('()[]{}', 5)}[\])}}][^\[\](){{}},]*+)*+)(,|\Z)"
)  # as all that a person writes


def arguments(said: str) -> Iterator[tuple[int, str]]:
    """Yield the arguments of an instruction with their places: they part at the commas outside brackets.

    From where brackets do not close, or too many stand in another, the rest is one argument.
    """
    start = 0
    while (found := ARGUMENT.match(said, start)) is not None:
        yield found.start(1), found[1].rstrip()
        start = found.end()
        if not found[2]:
            return
    rest = said[start:]
    yield start + len(rest) - len(rest.lstrip()), rest.strip()
