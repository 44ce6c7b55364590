"""Dropping a file, looking at what was understood, editing the column map, storing."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Form, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, JSONResponse
from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_core.observations import format_part_name
from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import facts
from kilter_service.contract.campaigns import Board, Camera, Conditions
from kilter_service.ground import child_process
from kilter_service.ground.child_process import Ended, Limits
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.ground.tables.assemble import rig_from_conditions
from kilter_service.ground.tables.columns import has
from kilter_service.page.answers import get_root_path, redirect, render, router
from kilter_service.page.drop import service
from kilter_service.page.drop.drafts import PICTURES, RIG, Draft, Drafts, plain_name
from kilter_service.page.shared import asking
from kilter_service.page.shared.asking import take_step
from kilter_service.page.shared.measured import describe_facts
from kilter_service.page.words import validation_words
from kilter_service.robots import service as robots
from kilter_service.versions.today import service as today
from kilter_service.web import logins
from kilter_service.web.auth.access import get_caller
from kilter_service.web.bodies import compute, parse_json, read_document, spool_upload
from kilter_service.web.logins import hash_secret
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp, get_scratch

PARTS: Mapping[str, type[Camera] | type[Board]] = {"cameras": Camera, "boards": Board}
MISSING = (
    "These rows have corners in pixels, and nothing says of which cameras and boards: give the JSON that `kilter "
    "measure see` wrote "
    "beside them (Cameras and boards, below)."
)
REMEDY = "Give the JSON that `kilter measure see` writes beside its views."

BOARD, REFUSED = "board.zip", "refused"
DRAWING = child_process.Limits(seconds=30, memory_mb=2048, output_mb=50)


def draw_board(folder: Path, columns: int, rows: int, square_mm: float) -> None:
    """Write the page of a board and its description into an archive in ``folder``.

    Raises:
        ServiceError: there is no such board, or this server has no OpenCV.

    """
    ended = child_process.run(f"{__package__}.board", folder, [str(columns), str(rows), str(square_mm)], DRAWING)
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
    rig = {
        what: [_known_fields(one, kind) for one in parts] if isinstance(parts := given.get(what), list) else []
        for what, kind in PARTS.items()
    }
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
        raise ServiceError(f"{name}: {validation_words(error)}. {REMEDY}", code="payload_invalid") from error
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


def _known_fields(one: Any, kind: type[Camera] | type[Board]) -> Any:
    """The fields that a campaign has of it; anything but an object is left for the check to refuse."""
    if not isinstance(one, dict):
        return one
    return {name: one[name] for name in kind.model_fields if one.get(name) is not None}


CHILD = "kilter_service.page.drop.child"
LIMITS = Limits(seconds=60, memory_mb=2048, output_mb=512)
OF_PICTURES = Limits(seconds=240, memory_mb=4096, output_mb=512)
MOST_SAID = 32 << 20
MOST_REFUSAL = 2000
WRITTEN = ("understood.json", "rows", RIG, PICTURES)
LISTS = ("open", "guessed", "unused", "notes", "warnings", "remarks", "source", "lines")
NOTHING: dict[str, Any] = {"kind": "", "reader": "", "map": "", "more": 0, **{name: [] for name in LISTS}}
ELSEWHERE = "`kilter upload` reads it on your own machine, without these limits."


def read(database: Database, draft: Draft) -> None:
    """Read a draft as it says; what is wrong with it is kept as its refusal."""
    with draft.turn:
        draft.facts, draft.refusal, draft.pixels = None, "", False
        draft.understood = NOTHING | _understood(draft, _joints(database, draft.robot))
        draft.refusal = str(draft.understood.get("refusal") or "")[:MOST_REFUSAL]
        seen_by = draft.folder / RIG
    if seen_by.exists() and not draft.refusal:  # pictures say themselves which camera saw which board
        add_to_draft(draft, draft.name, json.loads(seen_by.read_bytes()))
    with draft.turn:
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
    limits = OF_PICTURES if draft.name.lower().endswith(".zip") else LIMITS
    ended = child_process.run(CHILD, draft.folder, [], limits)
    said = draft.folder / "understood.json"
    if ended.code != 0 or not said.exists() or said.stat().st_size > MOST_SAID:
        return {"refusal": f"{draft.name} {_describe_reader_failure(ended, limits)}", "map": _kept_map(draft)}
    found: dict[str, Any] = json.loads(said.read_bytes())
    return {"map": _kept_map(draft)} | found


def _kept_map(draft: Draft) -> str:
    return draft.map.read_text(encoding="utf-8") if draft.map.exists() else ""


def _describe_reader_failure(ended: Ended, limits: Limits) -> str:
    if ended.late:
        return f"took longer than {limits.seconds} s to read: leave out what was not measured, or split it. {ELSEWHERE}"
    if ended.lacked_memory:
        return (
            f"takes more than {limits.memory_mb >> 10} GB of memory to read: leave out what was not measured, or split it. "
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
    draft.refusal = refused or (MISSING if draft.pixels and not draft.rig else "")
    try:
        draft.facts = facts(rows, belong)
    except CoreError as error:
        draft.refusal = error.message


BODY = {"requestBody": {"required": True}}  # the endpoint receives the file itself
Text = Annotated[str, Form(max_length=20_000)]
UNDERSTOOD = "drop/understood.html"
Short = Annotated[str, Form(max_length=200)]
JobId = Annotated[str, Query(max_length=100)]
Squares = Annotated[int, Query(ge=3, le=60)]
Side = Annotated[float, Query(ge=1.0, le=500.0)]
Texts = Annotated[list[str], Form(max_length=1000)]


@router.get("/robots/{robot}/campaigns/new")
def empty(robot: str, request: Request, database: DatabaseOfApp, job: JobId = "") -> HTMLResponse:
    """Show where to drop a file: any, or what was measured at the poses that a job proposes."""
    name = robots.get(database, robot).name
    return render(request, "drop/new.html", robot=name, job=asking.get_proposing_job(database, name, job))


@router.post("/robots/{robot}/campaigns/new/file", openapi_extra=BODY)
async def drop_file(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    name: str = "",
    job: JobId = "",
) -> Response:
    """Take a file and read it; nothing is stored."""
    await run_in_threadpool(robots.get, database, robot)
    await run_in_threadpool(asking.get_proposing_job, database, robot, job)
    drafts = _drafts(request)
    draft = drafts.new(robot, _owner(request), name[:500], job)
    with drafts.in_use(draft):
        try:
            draft.file_sha256 = await spool_upload(request, draft.file, settings.max_upload_mb)
            await compute(request, read, database, draft)
        except BaseException:
            drafts.discard(draft)
            raise
    return JSONResponse({"address": _place(request, draft)}, 201)


@router.get("/robots/{robot}/campaigns/new/board.zip")
async def board(request: Request, columns: Squares = 8, rows: Squares = 6, square_mm: Side = 25.0) -> Response:
    """Send a board to print for a camera, with its description."""
    with get_scratch(request).folder_for("board") as folder:
        await run_in_threadpool(draw_board, folder, columns, rows, square_mm)
        content = (folder / BOARD).read_bytes()
    named = {"Content-Disposition": f'attachment; filename="{BOARD}"'}
    return Response(content, media_type="application/zip", headers=named)


@router.get("/robots/{robot}/campaigns/new/reading")
def reading(robot: str, request: Request) -> HTMLResponse:
    """Show what was seen in the pictures that are being read."""
    draft = _drafts(request).get_being_read(robot, _owner(request))
    return render(request, "drop/pictures.html", pictures=[] if draft is None else draft.pictures)


@router.get("/robots/{robot}/campaigns/new/{draft}")
def understood(robot: str, draft: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show what was understood of a file."""
    return _render_draft(request, database, _draft(request, robot, draft), "drop/draft.html")


@router.post("/robots/{robot}/campaigns/new/{draft}/columns")
async def columns(
    robot: str,
    draft: str,
    request: Request,
    database: DatabaseOfApp,
    column: Texts,
    target: Texts,
    unit: Texts,
) -> HTMLResponse:
    """Read the file with another column map, as the form has it."""
    found = _draft(request, robot, draft)
    kinds = await run_in_threadpool(service.joint_kinds, database, robot)
    return await _reread_and_render(
        request, database, found, lambda: service.choose(found, kinds, column, target, unit)
    )


@router.post("/robots/{robot}/campaigns/new/{draft}/map")
async def written(
    robot: str,
    draft: str,
    request: Request,
    database: DatabaseOfApp,
    text: Annotated[str, Form(max_length=service.LONGEST_MAP)],
) -> HTMLResponse:
    """Read the file with another column map, as it was written."""
    found = _draft(request, robot, draft)
    return await _reread_and_render(request, database, found, lambda: service.write(found, text))


@router.post("/robots/{robot}/campaigns/new/{draft}/rig", openapi_extra=BODY)
async def cameras(
    robot: str,
    draft: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    name: str = "",
    job: JobId = "",
) -> Response:
    """Take the description of the cameras and boards of a file's pixels, and look at its rows with it."""
    found = _draft(request, robot, draft)
    body = await parse_json(await read_document(request, settings.max_document_mb))
    with _drafts(request).in_use(found):
        await run_in_threadpool(add_to_draft, found, plain_name(name[:500]), body)
        await compute(request, reassess_rows, database, found)
    return JSONResponse({"address": f"{_place(request, found)}{_job_query(found)}"})


@router.post("/robots/{robot}/campaigns/new/{draft}/read")
async def otherwise(robot: str, draft: str, request: Request, database: DatabaseOfApp, way: Short) -> HTMLResponse:
    """Read the file in another way."""
    found = _draft(request, robot, draft)
    return await _reread_and_render(request, database, found, lambda: service.read_as(found, way))


@router.post("/robots/{robot}/campaigns/new/{draft}/store")
async def store(
    robot: str,
    draft: str,
    request: Request,
    database: DatabaseOfApp,
    sha256: Short,
    name: Short,
    role: Short = "train",
    device: Short = "",
    payload_kg: Short = "",
    temperature_c: Short = "",
    notes: Text = "",
    measured_at: Short = "",
    instrument: Short = "",
    payload_com_mm: Short = "",
    then: Short = "",
) -> Response:
    """Store the rows as a campaign; ``then`` search in them, or identify from them, where that comes next."""
    found = _draft(request, robot, draft)
    conditions: dict[str, object] = {
        **found.rig,
        **service.conditions(payload_kg=payload_kg, temperature_c=temperature_c),
    }
    if payload_com_mm.strip():
        conditions["payload_com_mm"] = service.point(payload_com_mm)
    campaign: dict[str, object] = {
        "name": name,
        "role": role,
        "device": device,
        "notes": notes,
        "conditions": conditions,
        "measured_at": service.parse_measured_day(measured_at),
        "instrument": instrument or None,
    }
    with _drafts(request).in_use(found):
        stored = await compute(request, service.store, database, found, campaign, sha256)
    if then in ("search", "identify"):
        try:
            queued = await compute(request, take_step, database, robot, then, stored.id)
        except ServiceError:  # it is stored; the robot's view says what comes next, and its button why not
            return redirect(request, f"/robots/{robot}")
        return redirect(request, f"/jobs/{queued}")
    return redirect(request, f"/campaigns/{stored.id}{_job_query(found)}")


@router.post("/robots/{robot}/campaigns/new/{draft}/discard")
def discard(robot: str, draft: str, request: Request) -> Response:
    """Forget a file."""
    found = _draft(request, robot, draft)
    _drafts(request).discard(found)
    return redirect(request, f"/robots/{robot}/campaigns/new{_job_query(found)}")


async def _reread_and_render(
    request: Request, database: DatabaseOfApp, draft: Draft, choose: Callable[[], None]
) -> HTMLResponse:
    """Read the file in the way that was chosen, or say why it cannot be read so."""
    with _drafts(request).in_use(draft):
        try:
            choose()
        except ServiceError as error:
            return await run_in_threadpool(_render_draft, request, database, draft, UNDERSTOOD, error.message)
        await compute(request, read, database, draft)
    return await run_in_threadpool(_render_draft, request, database, draft, UNDERSTOOD)


def _render_draft(
    request: Request, database: DatabaseOfApp, draft: Draft, template: str, problem: str = ""
) -> HTMLResponse:
    kinds = service.joint_kinds(database, draft.robot)
    shown = None if draft.facts is None else describe_facts(draft.facts, draft.understood.get("lines") or ())
    return render(
        request,
        template,
        robot=draft.robot,
        draft=draft,
        pictures=draft.pictures,
        found=draft.understood,
        seen=shown,
        ways=service.ways(),
        instruments=robots.list_instruments(database, Page()).instruments,
        problem=problem,
        here=_place(request, draft),
        meant=service.meant_for(database, draft),
        rig=describe_parts(draft.rig),
        first=bool((standing := today.of_robot(database, draft.robot).standing) and standing.first),
        **service.column_map_form(draft, kinds),
    )


def _job_query(draft: Draft) -> str:
    return f"?{urlencode({'job': draft.job})}" if draft.job else ""


def _place(request: Request, draft: Draft) -> str:
    return f"{get_root_path(request)}/robots/{draft.robot}/campaigns/new/{draft.id}"


def _draft(request: Request, robot: str, identity: str) -> Draft:
    return _drafts(request).get(robot, _owner(request), identity)


def _drafts(request: Request) -> Drafts:
    drafts: Drafts = request.app.state.drafts
    return drafts


def _owner(request: Request) -> str:
    """Return whose drafts these are: a login's, else a token's."""
    kept = request.cookies.get(logins.COOKIE, "")
    caller = get_caller(request)
    return hash_secret(kept) if kept else f"{caller.actor} {caller.token_id}"
