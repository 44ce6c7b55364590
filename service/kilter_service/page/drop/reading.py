"""Reading a dropped file: in a limited process, then looked at as an upload is."""

from __future__ import annotations

import json
from typing import Any

from kilter_core.errors import CoreError
from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import facts
from kilter_service.ground.db import Database
from kilter_service.ground.processes import sandbox
from kilter_service.ground.processes.sandbox import Ended, Limits
from kilter_service.ground.tables.columns import has
from kilter_service.page.drop import rig
from kilter_service.page.drop.drafts import Draft
from kilter_service.robots import service as robots

CHILD = "kilter_service.page.drop.child"
LIMITS = Limits(seconds=60, memory_mb=2048, output_mb=512)
MOST_SAID = 32 << 20
MOST_REFUSAL = 2000
WRITTEN = ("understood.json", "rows")
NOTHING: dict[str, Any] = {
    "kind": "", "reader": "", "map": "", "more": 0, "open": [], "guessed": [], "unused": [], "notes": [], "warnings": [],
    "remarks": [], "source": [], "lines": [],
}  # fmt: skip
ELSEWHERE = "`kilter upload` reads it on your own machine, without these limits."


def read(database: Database, draft: Draft) -> None:
    """Read a draft as it says; what is wrong with it is kept as its refusal."""
    with draft.turn:
        draft.facts, draft.refusal, draft.pixels = None, "", False
        draft.understood = NOTHING | _understood(draft, _joints(database, draft.robot))
        draft.refusal = str(draft.understood.get("refusal") or "")[:MOST_REFUSAL]
        if "sha256" in draft.understood and not draft.refusal:
            _assess_rows(database, draft)


def _joints(database: Database, robot: str) -> list[str]:
    """Return the robot's joint names; the prismatic ones end in ``:m``, as the readers of files take them."""
    return [one.name + (":m" if one.kind == "prismatic" else "") for one in robots.get(database, robot).joints]


def _understood(draft: Draft, joints: list[str]) -> dict[str, Any]:
    for name in WRITTEN:
        (draft.folder / name).unlink(missing_ok=True)
    asked = json.dumps({"file": draft.name, "read_as": draft.read_as, "joints": joints})
    (draft.folder / "asked.json").write_text(asked, encoding="utf-8")
    ended = sandbox.run(CHILD, draft.folder, [], LIMITS)
    said = draft.folder / "understood.json"
    if ended.code != 0 or not said.exists() or said.stat().st_size > MOST_SAID:
        return {"refusal": f"{draft.name} {_describe_reader_failure(ended)}", "map": _kept_map(draft)}
    found: dict[str, Any] = json.loads(said.read_bytes())
    return {"map": _kept_map(draft)} | found


def _kept_map(draft: Draft) -> str:
    return draft.map.read_text(encoding="utf-8") if draft.map.exists() else ""


def _describe_reader_failure(ended: Ended) -> str:
    if ended.late:
        return f"took longer than {LIMITS.seconds} s to read: leave out what was not measured, or split it. {ELSEWHERE}"
    if ended.lacked_memory:
        return (
            f"takes more than {LIMITS.memory_mb >> 10} GB of memory to read: leave out what was not measured, or split it. "
            + ELSEWHERE
        )
    return "cannot be read: its reader ended before it was done. The file is damaged; export it again."


def reassess_rows(database: Database, draft: Draft) -> None:
    """Look at the rows of a draft with the cameras and boards that were given since."""
    with draft.turn:
        if "sha256" in draft.understood:
            _assess_rows(database, draft)


def _assess_rows(database: Database, draft: Draft) -> None:
    try:
        rows, refused, belong = looking.of_file(
            database, draft.robot, draft.rows, draft.understood["media"], draft.rig or None
        )
    except CoreError as error:
        draft.refusal = error.message
        return
    draft.pixels = has(rows.columns, "pixel_u")
    draft.refusal = refused or (rig.MISSING if draft.pixels and not draft.rig else "")
    try:
        draft.facts = facts(rows, belong)
    except CoreError as error:
        draft.refusal = error.message
