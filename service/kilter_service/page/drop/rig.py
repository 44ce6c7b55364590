"""Cameras and boards of a dropped file of views: the JSON that is dropped as well; and a board to print."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_core.observations import format_part_name
from kilter_service.contract.campaigns import Board, Camera, Conditions
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.processes import sandbox
from kilter_service.ground.tables.assemble import rig_from_conditions
from kilter_service.page.drop.drafts import Draft

PARTS: Mapping[str, type[Camera] | type[Board]] = {"cameras": Camera, "boards": Board}
MISSING = (
    "These rows have corners in pixels, and nothing says of which cameras and boards: give the JSON that `kilter "
    "measure see` wrote "
    "beside them (Cameras and boards, below)."
)
REMEDY = "Give the JSON that `kilter measure see` writes beside its views."
MOST_TOLD = 5
BOARD, REFUSED = "board.zip", "refused"
DRAWING = sandbox.Limits(seconds=30, memory_mb=2048, output_mb=50)


def draw_board(folder: Path, columns: int, rows: int, square_mm: float) -> None:
    """Write the page of a board and its description into an archive in ``folder``.

    Raises:
        ServiceError: there is no such board, or this server has no OpenCV.

    """
    ended = sandbox.run(f"{__package__}.board", folder, [str(columns), str(rows), str(square_mm)], DRAWING)
    if not (folder / BOARD).exists():
        why = folder / REFUSED
        said = why.read_text(encoding="utf-8") if why.exists() else f"The board was not drawn: {ended.words[-200:]}"
        raise ServiceError(said, code="payload_invalid")


def add_to_draft(draft: Draft, name: str, document: Any) -> None:
    """Take what a document says of cameras and boards; what else it holds is of whoever saw them.

    Raises:
        ServiceError: it describes none, or a field of one cannot be.
        CoreError: what it describes cannot be a camera or a board.

    """
    given = document if isinstance(document, dict) else {}
    rig = {what: [_known_fields(one, kind) for one in _as_list(given.get(what))] for what, kind in PARTS.items()}
    lacking = [what for what, parts in rig.items() if not parts]
    if len(lacking) == len(rig):
        raise ServiceError(f"{name} describes no cameras and boards. {REMEDY}", code="cameras_missing")
    if lacking:
        remedy = "State the intrinsics when you run `kilter measure see` (--camera, or --intrinsics brown)."
        raise ServiceError(
            f"{name} names no {lacking[0]}. {remedy if lacking == ['cameras'] else REMEDY}", code="cameras_missing"
        )
    try:
        rig_from_conditions(Conditions.model_validate(rig).model_dump(mode="json", exclude_none=True))
    except ValidationError as error:
        told = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors()[:MOST_TOLD])
        raise ServiceError(f"{name}: {told}. {REMEDY}", code="payload_invalid") from error
    except CoreError as error:
        raise ServiceError(f"{name}: {error.message}", code=error.code) from error
    with draft.turn:
        draft.rig, draft.rig_name = rig, name


def describe_parts(rig: Mapping[str, Any]) -> list[str]:
    """Return each camera and board in words."""
    where = {"fixed": "in the room", "flange": "on the flange"}
    cameras = [
        f"{format_part_name('camera', one['name'])}, {where[one['mount']]}, {one['width_px']} × {one['height_px']} px"
        for one in rig.get("cameras", ())
    ]
    boards = [
        f"{format_part_name('board', one['name'])}, {where[one['mount']]}, {len(one['corners_mm'])} corners"
        for one in rig.get("boards", ())
    ]
    return cameras + boards


def _as_list(parts: Any) -> list[Any]:
    return parts if isinstance(parts, list) else []


def _known_fields(one: Any, kind: type[Camera] | type[Board]) -> Any:
    """The fields that a campaign has of it; anything but an object is left for the check to refuse."""
    if not isinstance(one, dict):
        return one
    return {name: one[name] for name in kind.model_fields if one.get(name) is not None}
