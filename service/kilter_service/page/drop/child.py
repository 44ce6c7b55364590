"""Reads a dropped file in a process of its own: ``python -m kilter_service.page.drop.child``, in the folder of the draft.

Takes ``asked.json``, the file and perhaps ``map.toml``; writes ``understood.json`` and, where rows came out, ``rows``.
Pictures of a board in a ZIP archive, with the joints and the board's description, become rows of pixels.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kilter_files import prepare, rig
from kilter_files.formats import Columns, Head, all_readers, detect_table_shape, refuse_stranger
from kilter_files.ground import FileError, KilterError, MissingPackageError, member_names
from kilter_files.ground.later import need, parquet
from kilter_files.look import draft, inspect
from kilter_service.ground.child_process import confine
from kilter_service.page.drop.drafts import PART, PICTURES, RIG

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
TABLES = (".csv", ".tsv", ".txt")
CAMERAS = (".yaml", ".yml", ".xml")
MOST_FILES, MOST_BYTES = 2000, 2 << 30
WAYS = {"views-fixed": "fixed", "views-flange": "flange"}  # how the rows are read, and where the camera is
NEEDED = "Put the pictures, the board's JSON (kind, columns, rows, ...) and a table of the joints into one ZIP archive"
LENS = "brown"
VIEWS = "views.csv"
GUESSED = "the camera stands in the room and the board is on the flange; if not, read it with the camera on the flange"


def is_archive_of_pictures(path: Path) -> bool:
    """Whether a file is a ZIP archive of pictures, mostly."""
    try:
        names = [name for name in member_names(path) if not name.endswith("/")]
    except ValueError:
        return False
    return sum(name.lower().endswith(ENDINGS) for name in names) > len(names) / 2


def find_corners(path: Path, way: str) -> tuple[Path, dict[str, Any]]:
    """Find the boards in the pictures of an archive: a table of their corners, and what came of the pictures.

    Raises:
        FileError: something is missing in the archive, or no board is seen in any picture.

    """
    need(f"{path.name}: Pictures of a board need", "opencv-python-headless", "cv2")
    folder = _unpack(path)
    found = sorted(folder.iterdir())
    boards = [one for one in found if one.suffix == ".json"]
    tables = [one for one in found if one.suffix.lower() in TABLES]
    cameras = [one for one in found if one.suffix.lower() in CAMERAS]
    if not boards or len(tables) != 1:
        lacking = "no JSON of a board" if not boards else "no table of joints" if not tables else "several tables"
        raise FileError(f"{path.name} holds {lacking}. {NEEDED}.")
    targets = [rig.read_target(one) for one in boards]
    rig.check_apart(targets)
    source = rig.gather_source([folder])
    camera = rig.read_camera(cameras[0], None) if cameras else None
    looker = rig.Looker(targets, rig.read_poses(tables[0], source.count(), False), camera, None if cameras else LENS)
    with Path(VIEWS).open("w", encoding="utf-8", newline="") as stream:
        seen = looker.write_views(source, stream, None, _write_pictures)
    mount = WAYS.get(way, "fixed")
    Path(RIG).write_text(json.dumps(_rig(looker, mount)), encoding="utf-8")
    told = [f"{len(seen.views)} views of {seen.pictures} pictures, {seen.corners} corners"]
    said = {"kind": "pictures of a board", "notes": told, "warnings": seen.warnings}
    return Path(VIEWS), said | {"guessed": [] if way in WAYS else [GUESSED]}


def _write_pictures(seen: rig.Seen) -> None:
    """Write what each picture shows until now, while others are still looked at: its corners, or why it has none."""
    found = [{"picture": Path(one["picture"]).name, "corners": one["corners"]} for one in seen.views]
    refused = [one.to_document() for one in seen.refused]
    found += [{"picture": Path(one["picture"]).name, "why": f"{one['detail']}. {one['remedy']}"} for one in refused]
    part = Path(PART)
    part.write_text(json.dumps(found), encoding="ascii")
    part.replace(PICTURES)


def _unpack(path: Path) -> Path:
    """Unpack what counts, each file by its last name."""
    folder = Path("pictures")
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(path) as archive:
        members = [one for one in archive.infolist() if _is_wanted(one.filename)]
        if len(members) > MOST_FILES or sum(one.file_size for one in members) > MOST_BYTES:
            raise FileError(f"{path.name} holds more than {MOST_FILES} files or {MOST_BYTES >> 30} GB: split it.")
        names = [_last_name(one.filename) for one in members]
        if double := next((name for name, count in Counter(names).items() if count > 1), None):
            raise FileError(f"{path.name} holds two files called {double}: give each a name of its own.")
        for one, name in zip(members, names, strict=True):
            (folder / name).write_bytes(archive.read(one))
    return folder


def _last_name(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[2]


def _is_wanted(name: str) -> bool:
    last = _last_name(name).lower()
    return not last.startswith(".") and "__MACOSX" not in name and last.endswith((*ENDINGS, *TABLES, *CAMERAS, ".json"))


def _rig(looker: rig.Looker, mount: str) -> dict[str, Sequence[Any]]:
    other = "flange" if mount == "fixed" else "fixed"
    cameras = [] if looker.camera is None else [looker.camera.to_document() | {"mount": mount}]
    return {"cameras": cameras, "boards": [one.to_document() | {"mount": other} for one in looker.targets]}


MOST_ROWS = 2_000_000
MOST_COLUMNS = 400  # of the file, that are described one by one
MOST_TEXT = 300
MOST_LINES = 200_000  # of which the place in the file is told row by row
FIRST = 3
UNKNOWN = "table"  # what a file is that no reader takes
BEGIN = 65536  # bytes that are looked at
# names in the parts of a data set of LeRobot
OF_LEROBOT = ("observation.state", "episode_index", "data/chunk_index", "task_index", "codebase_version")
MOST_REMARKS = 50
Document = dict[str, Any]


def main() -> None:
    """Read the file that is asked for and say what came out, or why nothing did."""
    confine()
    asked = json.loads(Path("asked.json").read_text(encoding="utf-8"))
    try:
        found = understood(Path(asked["file"]), asked["read_as"], asked.get("joints", ()))
    except MemoryError:
        raise
    except Exception as error:
        found = {"refusal": _refusal(error, asked["file"])}
    text = json.dumps(_short(found), ensure_ascii=True, allow_nan=False)
    Path("understood.json").write_text(text, encoding="ascii")


def _refusal(error: Exception, name: str) -> str:
    """Say what is wrong with the file; what no reader foresaw is said so."""
    if isinstance(error, MissingPackageError):
        package = error.context.get("package", "a package")
        return f"{name}: reading it needs {package}, which this server lacks. Install it there: pip install {package}."
    if isinstance(error, KilterError):
        return error.detail
    return (
        f"{name} cannot be read ({type(error).__name__}: {str(error)[:MOST_TEXT]}): it is damaged, or in a layout that no "
        "reader knows. Export it again, as CSV with a line of names above the numbers."
    )


def understood(path: Path, read_as: str, joints: Sequence[str] = ()) -> Document:
    """Read a file through its map, by its device, as it is, or with a map that is drafted now."""
    chosen = Path("map.toml")
    if read_as == "map" and chosen.exists():
        return _describe_source_columns(path) | _apply_map(path, chosen)
    if is_archive_of_pictures(path):
        views, said = find_corners(path, read_as)
        rows = _prepare_rows(views, None)
        return (
            rows
            | {"reader": "pictures"}
            | {key: [*said[key], *rows[key]] if key in rows else said[key] for key in said}
        )
    if path.stat().st_size:
        refuse_stranger(Head(path))
    if read_as not in ("auto", "map"):
        return _prepare_rows(path, read_as)
    seen = _inspect_file(path)
    if seen.get("ready") and read_as == "auto":
        return seen | _describe_kind(seen) | _prepare_rows(path, seen["device"])
    alone = ALONE.get(_kind(path, seen)) if read_as == "auto" else None
    if alone is not None:
        return seen | {"refusal": f"{path.name}: {alone}"}
    try:
        return seen | _describe_source_columns(path) | _draft_map(path, chosen, joints)
    except FileError:
        if seen["kind"] == UNKNOWN and seen["remarks"]:  # a reader that knows the file has said what is wrong with it
            raise FileError(seen["remarks"][0]) from None
        raise


MARKERS_ALONE = (
    "a recording of markers alone says nothing of the joints. Join it with the joint log first "
    "(`kilter measure match`), and drop what comes out."
)
ALONE: Mapping[str, str] = {
    "c3d": MARKERS_ALONE,
    "n3d": MARKERS_ALONE,
    "marker-csv": MARKERS_ALONE,
    "inclinometer": "an inclinometer measures joints, not the tool. Join it with the joint log first "
    "(`kilter measure tilt-join`).",
    "ballbar": "the log of this ball bar has no joint readings. Join it with the joint log first "
    "(`kilter measure ballbar-join`).",
    "bag": "a bag of joint states alone has no measurement. Join it with the recording (`kilter measure match`).",
    "lerobot-calibration": "a calibration of servos has no rows. State it with the views or the joint log on the command line "
    "(`kilter robot kit ROBOT VIEWS --calibration FILE`, `kilter upload` and `kilter measure match` likewise): "
    "rows of another one are refused then.",
    "lerobot": "a part of a LeRobot data set says where the servos were, and not where the tool was. Match the whole folder "
    "with a recording on the command line "
    "(`kilter measure match RECORDING FOLDER --calibration JSON --norm-mode MODE`), and drop what comes out.",
    "mjcf": "a model of MuJoCo has no rows. `kilter version twin compare MODEL CAMPAIGN` scores it on a campaign, "
    "`kilter version twin read MODEL` reads its drives.",
}


def _kind(path: Path, seen: Document) -> str:
    """What a file is, be it one that says nothing alone: a part of a data set of LeRobot, a model of MuJoCo."""
    kind = str(seen["kind"])
    if kind == "parquet":
        return "lerobot" if set(OF_LEROBOT) & set(parquet.read_schema(path).names) else kind
    if kind != UNKNOWN:
        return kind
    with path.open("rb") as file:
        begin = file.read(BEGIN)
    if b"<mujoco" in begin:
        return "mjcf"
    is_part = begin.lstrip().startswith(b"{") and any(f'"{name}"'.encode() in begin for name in OF_LEROBOT)
    return "lerobot" if is_part else kind


def _inspect_file(path: Path) -> Document:
    """What inspection says, as far as it can be had: a table that it does not know may still take a map."""
    try:
        found = inspect(path)
    except FileError as error:
        return {"kind": UNKNOWN, "ready": False, "remarks": [error.detail]}
    kind = "marker-csv" if found["kind"].endswith("csv") and found.get("markers") else found["kind"]
    remarks = [*found["notes"], *found["warnings"], *_problems(found)] if found["ready"] else []
    return {
        "kind": kind,
        "ready": found["ready"],
        "device": found.get("device"),
        "remarks": [text for text in remarks if not text.startswith("ready for")],
    }


def _describe_kind(seen: Document) -> Document:
    """What a file that is read as it is looks like, in words. A reader of a device states units and columns itself."""
    known = all_readers().get(seen["kind"])
    return ({} if known is None else {"kind": known.title}) | ({"remarks": []} if seen["device"] else {})


def _problems(found: Document) -> list[str]:
    places = [({k: v for k, v in one.items() if k != "what"}, one["what"]) for one in found.get("problems", [])]
    return [f"{', '.join(f'{k} {v}' for k, v in place.items())}: {what}".lstrip(": ") for place, what in places]


def _prepare_rows(path: Path, device: str | None) -> Document:
    """Rows as the readers prepare them for an upload, and what they say of them."""
    return _write_prepared_rows(prepare(path, device), "as it is" if device is None else device)


def _apply_map(path: Path, chosen: Path) -> Document:
    return {"map": chosen.read_text(encoding="utf-8")} | _write_prepared_rows(prepare(path, None, chosen), "column map")


def _draft_map(path: Path, chosen: Path, joints: Sequence[str]) -> Document:
    """A drafted map, and what it makes of the file where nothing in it is open."""
    found = draft(path, joints)
    chosen.write_text(found.text, encoding="utf-8")
    said: Document = {"map": found.text, "open": found.open, "guessed": found.guessed, "unused": found.unused}
    if found.open:
        return said
    try:
        return said | _apply_map(path, chosen)
    except KilterError as error:
        return said | {"refusal": error.detail}


def _write_prepared_rows(prepared: Any, reader: str) -> Document:
    """Write the rows beside the file."""
    if prepared.rows is not None and prepared.rows > MOST_ROWS:
        raise FileError(f"The file has {prepared.rows} rows, at most {MOST_ROWS} are read: split it.")
    Path("rows").write_bytes(prepared.content)
    return {
        "media": prepared.content_type,
        "sha256": prepared.sha256,
        "reader": reader,
        "notes": list(prepared.notes)[:MOST_REMARKS],
        "warnings": list(prepared.warnings)[:MOST_REMARKS],
        "lines": list(prepared.lines[:MOST_LINES]),
    }


def _describe_source_columns(path: Path) -> Document:
    """The columns of the file itself, so that a map can be chosen: names, units, first cells, ranges and gaps."""
    columns = Columns(detect_table_shape(path))
    rows = len(columns.shape.source.lines)
    return {
        "kind": all_readers()[columns.shape.form].title,
        "source": [_describe_column(columns, name, rows) for name in columns.names[:MOST_COLUMNS]],
        "more": max(0, len(columns.names) - MOST_COLUMNS),
    }


def _describe_column(columns: Any, name: str, rows: int) -> Document:
    numbers = columns.numbers(name)
    finite = [value for value in numbers or () if math.isfinite(value)]
    return {
        "name": name,
        "key": columns.key(name),
        "unit": columns.unit(name),
        "first": [str(text)[:24] for text in columns.texts(name)[:FIRST]],
        "low": min(finite) if finite else None,
        "high": max(finite) if finite else None,
        "empty": None if numbers is None else max(0, rows - len(numbers)),
    }


def _short(value: Any, depth: int = 0) -> Any:
    """Cut texts and drop numbers that JSON does not have: what a file says about itself is not trusted."""
    if isinstance(value, str):
        return value if depth == 1 else value[:2000]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name)[:200]: _short(part, depth + 1) for name, part in value.items()}
    return [_short(part, depth + 1) for part in value] if isinstance(value, list | tuple) else value


if __name__ == "__main__":
    main()
