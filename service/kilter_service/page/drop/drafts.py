"""Files that were dropped and are not stored: each in a folder for a while, for the login that dropped it."""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import Scratch, private_folder

if TYPE_CHECKING:
    from kilter_service.campaigns.facts import Facts

RIG = "rig.json"  # what the reader of a file says of cameras and boards
PICTURES, PART = "pictures.json", "pictures.part"  # what it says of each picture
KEPT_S = 3600.0  # after it was last looked at
MOST_OF_ONE = 4  # drafts of one login; the oldest goes
MOST = 24
LONGEST_NAME = 100
GONE = (
    "This file is no longer here: it is kept for an hour, for the login that dropped it. Drop it again; nothing of it was "
    "stored."
)
_ODD = re.compile(r"[^\w.+() -]", re.ASCII)


@dataclass
class Draft:
    """A dropped file: whose it is, how it is read, what was understood, and the campaign that it became.

    ``job`` is the one that proposed its poses, where the browser said so. Of ``pixels``, ``rig`` has cameras and boards as the
    conditions of a campaign do, from a file called ``rig_name``.
    """

    id: str
    robot: str
    owner: str
    name: str
    folder: Path
    read_as: str = "auto"
    file_sha256: str = ""
    understood: dict[str, Any] = field(default_factory=dict)
    facts: Facts | None = None
    refusal: str = ""
    campaign: str = ""
    job: str = ""
    pixels: bool = False
    rig: dict[str, Any] = field(default_factory=dict)
    rig_name: str = ""
    used: float = field(default_factory=time.monotonic)
    users: int = 0  # requests that read or write it now
    turn: threading.Lock = field(default_factory=threading.Lock)

    @property
    def file(self) -> Path:
        """The file as it was dropped."""
        return self.folder / self.name

    @property
    def rows(self) -> Path:
        """What would be stored."""
        return self.folder / "rows"

    @property
    def pictures(self) -> list[dict[str, Any]]:
        """What was seen in each picture until now."""
        kept = self.folder / PICTURES
        return list(json.loads(kept.read_bytes())) if kept.exists() else []

    @property
    def map(self) -> Path:
        """The column map."""
        return self.folder / "map.toml"


class Drafts:
    """The drafts of this process; they are gone when it ends."""

    def __init__(self, scratch: Scratch) -> None:
        self._folder = scratch.folder / "drafts"
        self._kept: dict[str, Draft] = {}
        self._lock = threading.Lock()

    def new(self, robot: str, owner: str, name: str, job: str = "") -> Draft:
        """Make room for a file.

        Raises:
            ServiceError: there is none, for all others are being read.

        """
        with self._lock:
            self._forget(owner)
            if len(self._kept) >= MOST:
                raise ServiceError(f"{MOST} dropped files are being read: drop yours again in a while.", code="busy")
            identity = secrets.token_hex(12)
            folder = private_folder(private_folder(self._folder) / identity)
            draft = Draft(identity, robot, owner, plain_name(name), folder, job=job)
            self._kept[identity] = draft
        return draft

    def get(self, robot: str, owner: str, identity: str) -> Draft:
        """Return a draft to the login that made it.

        Raises:
            ServiceError: there is none, it is of another login, or its time is over.

        """
        with self._lock:
            self._forget()
            draft = self._kept.get(identity)
            if draft is None or draft.robot != robot or not secrets.compare_digest(draft.owner, owner):
                raise ServiceError(GONE, code="not_found")
            draft.used = time.monotonic()
        return draft

    def get_being_read(self, robot: str, owner: str) -> Draft | None:
        """Return the newest draft of a login that is being read now."""
        with self._lock:
            mine = (one for one in self._kept.values() if one.users and (one.robot, one.owner) == (robot, owner))
            return max(mine, key=lambda one: one.used, default=None)

    @contextmanager
    def in_use(self, draft: Draft) -> Iterator[None]:
        """Keep the folder of a draft while a request reads or writes in it, also where the draft is discarded meanwhile.

        Raises:
            ServiceError: it was discarded before.

        """
        with self._lock:
            if draft.id not in self._kept:
                raise ServiceError(GONE, code="not_found")
            draft.users += 1
        try:
            yield
        finally:
            with self._lock:
                draft.users -= 1
                if draft.id not in self._kept:
                    self._remove(draft)

    def discard(self, draft: Draft) -> None:
        """Delete a draft."""
        with self._lock:
            self._remove(draft)

    def _forget(self, owner: str | None = None) -> None:
        now = time.monotonic()
        for draft in [one for one in self._kept.values() if now - one.used > KEPT_S]:
            self._remove(draft)
        oldest = sorted((one for one in self._kept.values() if not one.users), key=lambda one: one.used)
        mine = [one for one in oldest if one.owner == owner]
        if owner is not None:
            for draft in mine[: max(0, len(mine) - MOST_OF_ONE + 1)]:
                self._remove(draft)
            for draft in oldest[: max(0, len(self._kept) - MOST + 1)]:
                self._remove(draft)

    def _remove(self, draft: Draft) -> None:
        self._kept.pop(draft.id, None)
        if not draft.users:
            shutil.rmtree(draft.folder, ignore_errors=True)


RESERVED = frozenset({"rows", "map.toml", "asked.json", "understood.json", "words", "views.csv", RIG, PICTURES, PART})


def plain_name(name: str) -> str:
    """Return a name that is a file's in its folder, whatever the browser said."""
    last = _ODD.sub("_", name.replace("\\", "/").rpartition("/")[2]).strip(" .-")
    if len(last) > LONGEST_NAME:
        stem, _, ending = last.rpartition(".")
        last = f"{stem[: LONGEST_NAME - 10]}.{ending[:8]}"
    if not last or last.lower() in RESERVED or last.startswith("chunk-"):
        last = f"file-{last or 'dropped'}"
    return last
