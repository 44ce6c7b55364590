"""One table of a TOML column map, read key by key so that nothing in it goes unnoticed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError
from kilter_files.ground.names import did_you_mean


class Section:
    """A table of the map: typed reading, and the refusal of every key nobody asked for."""

    def __init__(self, path: Path, place: str, content: Any) -> None:
        self.path = path
        self.place = place
        if not isinstance(content, Mapping):
            raise self.error(f"must be a table, not {content!r}")
        self._content = content
        self._known: list[str] = []

    def error(self, why: str, key: str = "") -> FileError:
        """Build the error that names the map, the place in it and what is wrong."""
        place = ".".join(part for part in (self.place, key) if part)
        return FileError(f"{self.path}, {place or 'top level'}: {why}.", file=str(self.path), key=place)

    def raw(self, key: str) -> Any:
        """Return a key's value as it stands, None when absent."""
        self._known.append(key)
        return self._content.get(key)

    def text(self, key: str, default: str | None = None) -> str | None:
        """Return a text."""
        value = self.raw(key)
        if value is not None and not isinstance(value, str):
            raise self.error(f"must be text, not {value!r}", key)
        return default if value is None else value

    def number(self, key: str) -> float | None:
        """Return a number."""
        value = self.raw(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise self.error(f"must be a number, not {value!r}", key)
        return None if value is None else float(value)

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return one number or a list of them, empty when absent."""
        value = self.raw(key)
        values = value if isinstance(value, list) else [] if value is None else [value]
        if any(isinstance(item, bool) or not isinstance(item, int | float) for item in values):
            raise self.error(f"must be a number or a list of numbers, not {value!r}", key)
        return tuple(float(item) for item in values)

    def count(self, key: str, default: int) -> int:
        """Return a whole number, zero or more."""
        value = self.raw(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self.error(f"must be a whole number from 0, not {value!r}", key)
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self.raw(key)
        if value is not None and not isinstance(value, bool):
            raise self.error(f"must be true or false, not {value!r}", key)
        return default if value is None else value

    def column(self, key: str) -> str | int | None:
        """Return the name or the index of a column."""
        value = self.raw(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, str | int)):
            raise self.error(f"must be a column's name or its index from 0, not {value!r}", key)
        return value

    def items(self, key: str) -> list[Any]:
        """Return a list, empty when absent."""
        value = self.raw(key)
        if value is not None and not isinstance(value, list):
            raise self.error(f"must be a list, not {value!r}", key)
        return list(value or ())

    def child_section(self, key: str) -> Section | None:
        """Return the table under ``key``, None when absent."""
        value = self.raw(key)
        return None if value is None else Section(self.path, ".".join(filter(None, (self.place, key))), value)

    def child_sections(self, key: str) -> list[Section]:
        """Return the table under ``key`` or, where it stands several times as ``[[key]]``, each of them, numbered from 1."""
        value, place = self.raw(key), ".".join(filter(None, (self.place, key)))
        if not isinstance(value, list):
            return [] if value is None else [Section(self.path, place, value)]
        return [Section(self.path, f"{place} {number}", one) for number, one in enumerate(value, 1)]

    def names(self) -> list[str]:
        """Return every key of the table."""
        return list(self._content)

    def finish(self) -> None:
        """Refuse the keys that were never asked for.

        Raises:
            FileError: an unknown key, with the nearest known one.

        """
        for key in self._content:
            if key not in self._known:
                known = sorted(set(self._known))
                raise self.error(f"unknown key{did_you_mean(key, known)}; known are {', '.join(known)}", key)
