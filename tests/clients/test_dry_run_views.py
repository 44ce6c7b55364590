"""`kilter upload --dry-run` promises what the upload does: cameras and boards, the campaign's name, the one it adds to."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.answered import document
from tests.service.test_pixels import SCENE, columns, csv, described, seen

Capture = pytest.CaptureFixture[str]
Change = Callable[[dict[str, Any]], None]
CELL = described(SCENE)["cameras"][0]


@pytest.fixture
def watched(kilter: Kilter, request: pytest.FixtureRequest) -> str:
    """A robot of this test's own that a camera watches."""
    name = "".join(c if c.isalnum() else "-" for c in request.node.name)[:60].strip("-")
    kilter.robots.add(SCENE.drawn.document() | {"name": name})
    return name


def written(folder: Path, rows: dict[str, list[Any]], rig: Change | None = None) -> tuple[Path, Path]:
    """Views in which some corners were not seen, and the JSON of their cameras and boards."""
    table = columns(seen(12)) | {"camera": ["cell"] * 12, "board": ["board"] * 12}
    table |= {name: [None, *table[name][1:]] for name in ("u3_px", "v3_px")} | rows
    described_by = deepcopy(described(SCENE))
    if rig is not None:
        rig(described_by)
    (folder / "views.csv").write_text(csv({name: cells for name, cells in table.items() if cells}))
    (folder / "views.json").write_text(json.dumps(described_by))
    return folder / "views.csv", folder / "views.json"


def promised(capsys: Capture, *arguments: object) -> tuple[list[str], dict[str, Any] | None]:
    """What a dry run says would be refused, and the refusal of the upload; None where it stored the rows."""
    capsys.readouterr()
    code = run([*map(str, arguments), "--dry-run", "--json"])
    dry = json.loads(capsys.readouterr().out)
    assert dry["not_checked"] == ""
    assert code == bool(dry["refused"])
    code = run([*map(str, arguments), "--json"])
    done = json.loads(capsys.readouterr().out)
    return dry["refused"], done if code else None


def test_views_that_upload_takes_are_not_refused(watched: str, tmp_path: Path, capsys: Capture) -> None:
    """Corners out of sight and names of cameras are cells that are no numbers; the same file again changes nothing."""
    rows, rig = written(tmp_path, {})
    named = ("upload", watched, rows, "--cameras", rig, "--name", "views")
    for _ in range(2):
        assert promised(capsys, *named) == ([], None)
    (one,) = document(capsys, "campaigns", "list", watched)["campaigns"]
    assert (one["rows"], one["name"]) == (12, "views")


def _set(what: str, **changes: Any) -> Change:
    return lambda rig: rig[what][0].update(changes)


@pytest.mark.parametrize(
    ("rows", "rig", "code"),
    [
        ({"camera": ["cell"] * 11 + ["door"]}, None, "camera_unknown"),
        ({"board": ["sheet"] * 12}, None, "board_unknown"),
        ({"u49_px": [5.0] * 12, "v49_px": [5.0] * 12}, None, "corner_unknown"),
        ({}, _set("cameras", width_px=640, height_px=480), "outside_picture"),
        ({"camera": []}, lambda rig: rig["cameras"].append(CELL | {"name": "door"}), "cameras_missing"),
        ({}, _set("cameras", distortion=[0.1]), "camera_invalid"),
        ({}, lambda rig: rig["boards"].append(rig["boards"][0]), "board_invalid"),
        ({}, lambda rig: rig["cameras"][0].pop("fx_px"), "payload_invalid"),
    ],
)  # fmt: skip
def test_what_these_cameras_cannot_have_seen_is_refused_by_both(
    watched: str, tmp_path: Path, capsys: Capture, rows: dict[str, list[Any]], rig: Change | None, code: str
) -> None:
    table, described_by = written(tmp_path, rows, rig)
    (said,), refused = promised(capsys, "upload", watched, table, "--cameras", described_by)
    assert refused is not None
    assert refused["code"] == code
    assert refused["detail"] == said


def test_pixels_without_cameras_are_refused_by_both(watched: str, tmp_path: Path, capsys: Capture) -> None:
    (said,), refused = promised(capsys, "upload", watched, written(tmp_path, {})[0])
    assert refused is not None
    assert (refused["code"], refused["detail"]) == ("cameras_missing", said)


def test_names_and_instruments_and_the_campaign_that_is_added_to(
    watched: str, kilter: Kilter, tmp_path: Path, capsys: Capture
) -> None:
    rows, rig = written(tmp_path, {})
    document(capsys, "upload", watched, rows, "--cameras", rig, "--name", "views")
    rows.write_text(rows.read_text() + rows.read_text().splitlines()[-1] + "\n")  # other bytes
    arguments = ("upload", watched, rows, "--cameras", rig)
    for option, code in (
        (("--name", "views"), "name_taken"),
        (("--instrument", "theodolite"), "instrument_not_found"),
        (("--measured-at", "2999-01-01"), "payload_invalid"),
    ):
        (said,), refused = promised(capsys, *arguments, *option)
        assert refused is not None, option
        assert (refused["code"], refused["detail"]) == (code, said)
    into = ("upload", watched, rows, "--campaign", "views")
    assert promised(capsys, *into) == ([], None)
    rows, _ = written(tmp_path, {"camera": ["door"] * 12})
    (said,), refused = promised(capsys, *into)
    assert refused is not None
    assert (refused["code"], refused["detail"]) == ("camera_unknown", said)
    rows, _ = written(tmp_path, {"camera": []})
    (said,), refused = promised(capsys, *into)
    assert refused is not None
    assert "Column 'camera' is not in both" in said
    assert refused["detail"].startswith(said)
