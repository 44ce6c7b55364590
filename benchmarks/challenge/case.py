"""A hidden case on disk: what is given to the search, the seal published before, and the truth opened afterwards."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kilter_core.effects import EFFECTS
from kilter_core.effects.physical import JOINT_SCALE

SEALS = "seals.txt"  # as sha256sum writes it
TRUTH = "truth.json"
Part = TypeVar("Part", bound=BaseModel)
# A prismatic joint has a class of its own.
CLASSES = frozenset({JOINT_SCALE.id, *(effect.physical.id for effect in EFFECTS.values())})


class CaseError(Exception):
    """A folder that is no case, or a truth that is not the sealed one; the message names the place and the remedy."""


class Strict(BaseModel):
    """Nothing unknown: a field misspelt would be a truth left out."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Size(Strict):
    """A true amplitude by the name of its parameter in results, in the unit of results."""

    name: str
    value: float


class Hidden(Strict):
    """One hidden effect.

    ``physical_class`` is where and how it acts, ``effects`` are all ids of the library that would be its right name
    (none where the library does not hold it), ``joints`` are counted from 1 (none for the whole arm). ``demanded`` says
    whether whoever hid it believes that the rows show it well enough to be found.
    """

    physical_class: str
    effects: list[str] = []
    joints: list[int] = []
    demanded: bool = True
    sizes: list[Size] = []
    says: str = Field("", description="What was done to the arm, in words.")


class Truth(Strict):
    """What was hidden. ``salt`` keeps the seal from being guessed; ``family`` groups cases in the score."""

    format: Literal[1]
    salt: str = Field(min_length=16)
    family: str
    hidden: list[Hidden]


class Given(Strict):
    """What the search is told beside the files (``given.json``, which may be missing): of the robot, rows and search."""

    robot: dict[str, Any] = {}
    device: str | None = None
    payload_kg: float | None = None
    payload_com_mm: list[float] | None = None
    temperature_c: float | None = None
    options: dict[str, Any] = {}


@dataclass(frozen=True)
class Case:
    """A folder with ``robot.json`` (or ``robot.urdf``), ``campaign.csv`` and perhaps more."""

    folder: Path

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    @property
    def robot(self) -> Path:
        """File of the robot."""
        return self._one("robot", (".json", ".urdf", ".xacro", ".csv", ".toml"))

    @property
    def campaign(self) -> Path:
        """Rows to search in."""
        return self._one("campaign", (".csv", ".xlsx", ".txt", ".parquet"))

    def perhaps(self, name: str) -> Path | None:
        """Rows of another kind (``confirmation``, ``validation``), where the case has them."""
        found = [path for path in sorted(self.folder.glob(f"{name}.*")) if path.is_file()]
        return found[0] if found else None

    def given(self) -> Given:
        """What the search is told beside the files."""
        path = self.folder / "given.json"
        return _read(Given, path) if path.is_file() else Given()

    def truth(self) -> Truth | None:
        """What was hidden, None while it is sealed.

        Raises:
            CaseError: it is not the truth of the published seal, or cannot be read.

        """
        path = self.folder / TRUTH
        if not path.is_file():
            return None
        self._check_seal(path)
        truth = _read(Truth, path)
        for hidden in truth.hidden:
            if hidden.physical_class not in CLASSES:
                known = ", ".join(sorted(CLASSES))
                raise CaseError(f"{path}: there is no physical class {hidden.physical_class!r}. There are {known}.")
            if unknown := [name for name in hidden.effects if name not in EFFECTS]:
                raise CaseError(f"{path}: the library has no effect {unknown[0]!r}: leave it out, and give the class.")
        return truth

    def _check_seal(self, path: Path) -> None:
        published = seals(self.folder.parent)
        name = f"{self.name}/{TRUTH}"
        if name not in published:
            raise CaseError(
                f"{self.folder.parent / SEALS} has no seal of {name}. A truth without a seal proves nothing: publish "
                f"`sha256sum */{TRUTH} > {SEALS}` before anybody runs the cases."
            )
        if hashlib.sha256(path.read_bytes()).hexdigest() != published[name]:
            raise CaseError(f"{path} is not the truth that was sealed: its SHA-256 is another than {SEALS} has.")

    def _one(self, name: str, endings: tuple[str, ...]) -> Path:
        found = [self.folder / f"{name}{end}" for end in endings if (self.folder / f"{name}{end}").is_file()]
        if len(found) != 1:
            said = " and ".join(path.name for path in found) or "none"
            raise CaseError(f"{self.folder}: a case has one file {name} ({', '.join(endings)}); found {said}.")
        return found[0]


def cases(folder: Path) -> list[Case]:
    """All cases of a folder, by name.

    Raises:
        CaseError: there are none.

    """
    found = [Case(path) for path in sorted(folder.iterdir()) if path.is_dir() and any(path.glob("robot.*"))]
    if not found:
        raise CaseError(f"{folder} has no folders with a robot and a campaign: see docs/how-to/hide-a-case.md.")
    return found


def seals(folder: Path) -> dict[str, str]:
    """Published seals: the SHA-256 of each truth by its path."""
    path = folder / SEALS
    return dict(_seals(path)) if path.is_file() else {}


def _seals(path: Path) -> Iterator[tuple[str, str]]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.split()
        if len(words) != 2 or len(words[0]) != 64:
            raise CaseError(f"{path}, line {number}: not as sha256sum writes it (64 digits and a path).")
        yield words[1].removeprefix("*").removeprefix("./"), words[0].lower()


def _read(kind: type[Part], path: Path) -> Part:
    try:
        return kind.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise CaseError(f"{path}: {place or 'the document'}: {first['msg']}.") from error
