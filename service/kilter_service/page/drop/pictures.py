"""Pictures of a board in a ZIP archive, with the joints and the board's description: they become rows of pixels.

Runs in the process that reads a dropped file, in the folder of the draft.
"""

from __future__ import annotations

import json
import zipfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kilter_files import rig
from kilter_files.ground import FileError, member_names
from kilter_files.ground.later import need
from kilter_service.page.drop.drafts import RIG

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
        seen = looker.write_views(source, stream, None)
    mount = WAYS.get(way, "fixed")
    Path(RIG).write_text(json.dumps(_rig(looker, mount)), encoding="utf-8")
    told = [f"{len(seen.views)} views of {seen.pictures} pictures, {seen.corners} corners"]
    documents = [one.to_document() for one in seen.refused]
    refused = [f"{Path(one['picture']).name}: {one['detail']}. {one['remedy']}" for one in documents]
    said = {"kind": "pictures of a board", "notes": told, "warnings": [*seen.warnings, *refused]}
    return Path(VIEWS), said | {"guessed": [] if way in WAYS else [GUESSED]}


def _unpack(path: Path) -> Path:
    """Unpack what counts, each file by its last name.

    Raises:
        FileError: there is more than anybody takes pictures of, or two files have one name.

    """
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
