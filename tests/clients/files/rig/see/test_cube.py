"""A cube: its net folds to where its JSON says, and `kilter measure see` finds its faces as one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client.cli import run
from kilter_files.rig.see.run import Looker
from kilter_files.rig.see.target import read_target
from kilter_files.rig.see.views import View
from tests.clients.files.rig.see.boards import board
from tests.clients.files.rig.see.raycaster import ROOM, Lens, Page, Shot, clean, finished

CHARUCO = ("--columns", "4", "--rows", "4", "--square-mm", "14", "--dictionary", "4x4_100", "--cube")
TAGS = ("--kind", "apriltag", "--columns", "1", "--rows", "1", "--square-mm", "60", "--marker-mm", "42", "--cube")
# Where a place of the net comes to be when it is folded back, from the front's middle: along x, along y, edge.
FOLDED: dict[str, Callable[[float, float, float], tuple[float, float, float]]] = {
    "front": lambda a, b, e: (a, b, 0),
    "right": lambda a, b, e: (e / 2, b, a - e / 2),
    "left": lambda a, b, e: (-e / 2, b, -a - e / 2),
    "top": lambda a, b, e: (a, -e / 2, -b - e / 2),
    "bottom": lambda a, b, e: (a, e / 2, b - e / 2),
    "back": lambda a, b, e: (a, 2 * e - b, e),
}
IN_NET = {"front": (0, 0), "right": (1, 0), "left": (-1, 0), "top": (0, -1), "bottom": (0, 1), "back": (0, 2)}
LENS = Lens(640, 480, (900.0, 900.0), (318.0, 242.0))


@dataclass
class Folded(Shot):
    """A shot of one face of a cube whose middle is at ``centre_mm``."""

    face: str = "front"

    def pose(self, document: dict[str, Any]) -> tuple[Any, Any]:
        edge, size = document["edge_mm"], document["columns"] * document["square_mm"]
        start = np.array(IN_NET[self.face]) * edge - size / 2
        corner, right, down = (
            np.array(FOLDED[self.face](*(start + step), edge)) for step in ([0.0, 0.0], [1.0, 0.0], [0.0, 1.0])
        )
        x, y = right - corner, down - corner
        turn = Rotation.from_euler("xyz", self.rotation_deg, degrees=True).as_matrix()
        own = np.column_stack([x, y, np.cross(x, y)])
        return turn @ own, turn @ (corner - [0, 0, edge / 2]) + self.centre_mm


def taken(options: tuple[str, ...], rotation_deg: tuple[float, float, float]) -> tuple[Any, list[str]]:
    """A picture of a cube, and the faces that it shows."""
    path, document = board(options)
    grey, shown = np.full((LENS.height, LENS.width), ROOM), []
    for face in document["faces"]:
        shot = Folded(rotation_deg, (0.0, 0.0, 350.0), lens=LENS, samples=3, face=face["name"])
        turn, origin = shot.pose(document)
        middle = origin + turn @ [*[document["columns"] * document["square_mm"] / 2] * 2, 0.0]
        if turn[:, 2] @ middle <= 0:
            continue  # it looks away
        around = document["edge_mm"] - document["columns"] * document["square_mm"]
        own = document | {"page": document["page"] | {"left_mm": face["left_mm"], "top_mm": face["top_mm"]}}
        page = Page.read(path.with_suffix(".svg"), own)
        low, high = -around / 2, document["edge_mm"] - around / 2
        x, y = (np.unique([low, high, *edges[(edges > low) & (edges < high)]]) for edges in (page.x, page.y))
        middles = [(a[:-1] + a[1:]) / 2 for a in (x, y)]
        page = Page(x, y, page.at(*np.meshgrid(*middles)))
        grey += clean(page, own, shot) - ROOM
        shown.append(face["name"])
    return finished(grey, Shot()), shown


@pytest.mark.parametrize(
    ("options", "rotation"),
    [(CHARUCO, (-30.0, -35.0, 5.0)), (TAGS, (35.0, 40.0, -80.0)), (CHARUCO, (35.0, 145.0, 20.0))],
    ids=["front-charuco", "tilted-apriltag", "back-charuco"],
)
def test_a_folded_cube_is_seen_where_its_json_says(
    options: tuple[str, ...], rotation: tuple[float, float, float]
) -> None:
    path, document = board(options)
    grey, shown = taken(options, rotation)
    assert len(shown) == 3
    target = read_target(path)
    [view] = Looker([target]).boards(grey, "cube.png")
    assert isinstance(view, View), view
    faces = {document["corners"][place]["face"] for place in view.places}
    assert faces <= set(shown)
    assert len(faces) >= 2
    turn = Rotation.from_euler("xyz", rotation, degrees=True)
    truth = LENS.pixels(np.add(turn.apply(target.corners_mm), [0.0, 0.0, 350.0]))
    off = view.pixels - truth[view.places]
    print(sorted(faces), len(view.places), off.mean(axis=0).round(3), off.std().round(3), np.abs(off).max().round(3))
    assert np.abs(off.mean(axis=0)).max() <= 0.03
    assert np.abs(off).max() < 0.4


def test_the_six_faces_are_apart_and_complete() -> None:
    document = board(CHARUCO)[1]
    assert len({marker["id"] for marker in document["markers"]}) == 48
    assert sorted(corner["id"] for corner in document["corners"]) == list(range(54))
    places = np.array([[corner[f"{axis}_mm"] for axis in "xyz"] for corner in document["corners"]])
    assert np.abs(places).max(axis=1) == pytest.approx(document["edge_mm"] / 2)
    assert np.abs(places.mean(axis=0)).max() < 1e-9


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--columns", "5"], "as many --columns as --rows"),
        (["--edge-mm", "50"], "give 63 mm or more"),
        (["--dictionary", "4x4_50", "--first-id", "10"], "has 50 markers, and the cube needs 58"),
        (["--square-mm", "90"], "fits no page"),
        (["-o", "cube.png"], ".pdf or .svg"),
    ],
)
def test_cubes_that_cannot_be_printed(
    wrong: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["board", *CHARUCO, "-o", str(tmp_path / "cube.svg"), *wrong]) == 2
    assert said in capsys.readouterr().err
    plain = ["board", *CHARUCO[:-1], "-o", str(tmp_path / "b.svg"), "--edge-mm", "80"]
    assert run(plain) == 2
    assert "give --cube too" in capsys.readouterr().err


def test_faces_that_share_a_marker_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads(board(CHARUCO)[0].read_text())
    document["faces"][1]["first_id"] = 4
    path = tmp_path / "cube.json"
    path.write_text(json.dumps(document))
    assert run(["see", str(tmp_path), "--board", str(path), "-o", str(tmp_path / "v.csv")]) == 1
    assert "two of its faces have a marker in common" in capsys.readouterr().err
