"""Answers of the server as typed values, which keep the document that they were read from.

What a command must know of a kind of job.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import (
    Any,
    ClassVar,
    Generic,
    NamedTuple,
    Self,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

from kilter_client.errors import UsageError
from kilter_client.requests.steps import Steps
from kilter_client.results.rows import Tabular
from kilter_files.ground import did_you_mean

T = TypeVar("T", bound="Record")
R = TypeVar("R")
Convert = Callable[[Any], Any]
Ask = Callable[[Steps[Any]], Any]

SCALARS = (str, int, float, bool)
MOST_SHOWN, WIDEST = 8, 60  # fields of a repr, and letters of one


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
class _OfFields:
    """Whatever derives from it is a frozen dataclass of the fields that it names."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)


class Record(_OfFields):
    """A part of an answer: its fields by name, and ``document``, as the server sent it.

    ``record["name"]`` looks into the document, and so finds what this release of the library does not know yet. A field
    that the document lacks is None, or empty where it holds several things.
    """

    RENAMED: ClassVar[Mapping[str, str]] = {}

    document: Mapping[str, Any]
    """What it was read from."""

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Self:
        """Read a document; what nobody knows of it stays in ``document``."""
        values = {name: convert(document.get(key)) for name, key, convert in _fields(cls)}
        return cls(document=document, **values)

    def bound(self, ask: Ask) -> Self:
        """Let the record ask the server for more."""
        object.__setattr__(self, "_ask", ask)
        return self

    def __getitem__(self, name: str) -> Any:
        return self.document[name]

    def __contains__(self, name: object) -> bool:
        return name in self.document

    def __iter__(self) -> Iterator[str]:
        return iter(self.document)

    def keys(self) -> Sequence[str]:
        """Return the names in the document."""
        return list(self.document)

    def get(self, name: str, default: Any = None) -> Any:
        """Return what the document has under a name."""
        return self.document.get(name, default)

    def __repr__(self) -> str:
        told = [(name, getattr(self, name)) for name in scalar_names(type(self))]
        shown = [f"{name}={_short(value)}" for name, value in told if value not in (None, "")]
        more = ", ..." if len(shown) > MOST_SHOWN else ""
        return f"{type(self).__name__}({', '.join(shown[:MOST_SHOWN])}{more})"

    def _ask_server(self, call: Steps[R], instead: str) -> R:
        ask: Ask | None = getattr(self, "_ask", None)
        if ask is None:
            raise UsageError(f"This result is not connected to a server: use {instead}.")
        found: R = ask(call)
        return found


class Records(Sequence[T], Tabular, Generic[T]):
    """Records of one kind, in order: by number, or by name (``parameters["alpha_2"]``); a table as a whole."""

    def __init__(self, kind: type[T], records: Sequence[T]) -> None:
        self._kind, self._records = kind, tuple(records)

    @overload
    def __getitem__(self, place: int | str) -> T: ...
    @overload
    def __getitem__(self, place: slice) -> Records[T]: ...
    def __getitem__(self, place: int | str | slice) -> T | Records[T]:
        if isinstance(place, slice):
            return Records(self._kind, self._records[place])
        if isinstance(place, int):
            return self._records[place]
        called = {_display_name(record): record for record in self._records}
        if place not in called:
            raise KeyError(f"there is no {place!r}{did_you_mean(place, called)} in {', '.join(called)}")
        return called[place]

    def __len__(self) -> int:
        return len(self._records)

    def __contains__(self, one: object) -> bool:
        return any(one is record or one == _display_name(record) for record in self._records)

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns by name: fields that are numbers or words, units in their names or in ``unit``."""
        return {name: [getattr(record, name) for record in self._records] for name in scalar_names(self._kind)}

    def __repr__(self) -> str:
        lines = [f"{len(self)} {self._kind.__name__}", *(f"  {record!r}" for record in self._records[:MOST_SHOWN])]
        return "\n".join([*lines, "  ..."] if len(self) > MOST_SHOWN else lines)


def _display_name(record: Record) -> str:
    return str(record.get("name") or record.get("id"))


def _short(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= WIDEST else f"{text[:WIDEST]}..."


def scalar_names(kind: type[Record]) -> tuple[str, ...]:
    """Return the names of fields that hold a number or a word, names of things first, then by the alphabet."""
    hints = get_type_hints(kind)
    found = sorted(one.name for one in fields(kind) if _inner(hints[one.name])[0] in SCALARS)
    first = [name for name in ("id", "name", "unit") if name in found]
    return (*first, *(name for name in found if name not in first))


_READ: dict[type[Record], tuple[tuple[str, str, Convert], ...]] = {}  # by kind, found at its first document


def _fields(kind: type[Record]) -> tuple[tuple[str, str, Convert], ...]:
    """Name, name in the document and reading of each field."""
    if kind not in _READ:
        hints = get_type_hints(kind)
        names = [one.name for one in fields(kind) if one.name != "document"]
        _READ[kind] = tuple((name, kind.RENAMED.get(name, name), _reading(hints[name])) for name in names)
    return _READ[kind]


def _inner(hint: Any) -> tuple[Any, ...]:
    """What a hint allows besides None."""
    variants = get_args(hint) if get_origin(hint) is UnionType else ()
    return tuple(one for one in variants if one is not NoneType) or (hint,)


def _reading(hint: Any) -> Convert:
    """How a value is read: records as such, lists as tuples, None as nothing of them."""
    variants = _inner(hint)
    if len(variants) > 1:
        return lambda value: value
    (hint,) = variants
    origin = get_origin(hint)
    if origin is None and isinstance(hint, type) and issubclass(hint, Record):
        return lambda value: hint.read(value) if isinstance(value, Mapping) else None
    if origin is Records:
        (kind,) = get_args(hint)
        return lambda value: Records(kind, [kind.read(one) for one in value or () if isinstance(one, Mapping)])
    if origin is tuple:
        each = _reading(get_args(hint)[0])
        return lambda value: tuple(map(each, value or ()))
    if origin is not None and issubclass(origin, Mapping):
        each = _reading(get_args(hint)[1])
        return lambda value: {key: each(one) for key, one in (value or {}).items() if one is not None}
    return lambda value: value


Z95 = 1.959964  # half width of a 95 % interval of a normal distribution, in standard deviations
MOST_DECIMALS = 6  # beyond that many zeros a power of ten is easier to read ...
PLAIN_FROM = 0.01  # ... of a number that begins with them: 90.0000049 stays plain
UNKNOWN_DIGITS = 4  # of a value whose uncertainty nobody knows


def decimals(sigma: Any) -> int | None:
    """Return the decimals that two significant digits of ``sigma`` reach; below 0 are tens; None without a sigma."""
    if not isinstance(sigma, int | float) or not math.isfinite(sigma) or sigma <= 0:
        return None
    two = float(f"{sigma:.1e}")  # 0.0996 is 0.10: one decimal less
    return 1 - math.floor(math.log10(two) + 1e-9)


def estimate(value: Any, places: int | None) -> str:
    """Write a number with this many decimals, nothing for None."""
    if value is None:
        return ""
    if places is None:
        return f"{value:.{UNKNOWN_DIGITS}g}"
    rounded = round(float(value), places) + 0.0  # no -0
    if places <= MOST_DECIMALS or abs(rounded) >= PLAIN_FROM:
        return f"{rounded:.{max(places, 0)}f}"
    if rounded == 0.0:
        return "0"
    return f"{rounded:.{max(0, math.floor(math.log10(abs(rounded))) + places)}e}"


def ends(value: float | None, sigma: float | None, lower: float | None, upper: float | None) -> str:
    """Write the 95 % interval as ``from to``: as it was computed, else 1.96 sigma to either side."""
    places = decimals(sigma)
    if lower is None or upper is None:
        if value is None or sigma is None:
            return ""
        lower, upper = value - Z95 * sigma, value + Z95 * sigma
    return f"{estimate(lower, places)} to {estimate(upper, places)}"


class Kind(NamedTuple):
    """A kind of job: what it does, whether it needs campaigns, and of each option its help and what it takes.

    Forms are `flag`, `integer`, `number`, `text`, `names`, `json`, or choices with bars between.
    """

    summary: str
    needs_campaigns: bool
    help: Mapping[str, str]
    forms: Mapping[str, str]
