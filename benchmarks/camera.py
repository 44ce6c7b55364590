"""How fast boards are found in pictures of 2 megapixels, and whether memory grows with their number.

    python -m benchmarks.camera [--pictures 400]

Pictures are drawn by OpenCV from its own boards, seen at a slant, with noise, and written as PNG; the whole way from the
file to the row is timed. Targets: 10 views/s on two quiet cores; over 10 000 pictures, memory grows by less than 50 MB,
measured between the first tenth and the end.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import resource
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.table import Line, show
from kilter_client.cli import run
from kilter_files.rig.see.run import Looker, Seen
from kilter_files.rig.see.sources import Source
from kilter_files.rig.see.target import Target, read_target

WIDTH, HEIGHT, DIFFERENT = 1600, 1200, 12
SQUARE_PX = 60
LEAST_VIEWS_S, MOST_GROWN_MB, ALL = 10.0, 50.0, 10_000


def drawn(folder: Path) -> list[Path]:
    """Pictures of a board of 9 x 7 squares at different slants."""
    rng = np.random.default_rng(1)
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    flat = cv2.aruco.CharucoBoard((9, 7), 30.0, 22.5, known).generateImage((9 * SQUARE_PX, 7 * SQUARE_PX))
    corners = np.array([[0, 0], [9, 0], [9, 7], [0, 7]], dtype=np.float32) * SQUARE_PX
    paths = []
    for k in range(DIFFERENT):
        there = (corners - corners.mean(axis=0)) * rng.uniform(1.3, 2.0) + rng.uniform(-60, 60, (4, 2))
        homography = cv2.getPerspectiveTransform(corners, np.add(there, [WIDTH / 2, HEIGHT / 2]).astype(np.float32))
        grey = cv2.warpPerspective(flat, homography, (WIDTH, HEIGHT), borderValue=150).astype(np.float64)
        noisy = cv2.GaussianBlur(grey * 0.7 + 30, (0, 0), 0.8) + rng.normal(0, 2, grey.shape)
        paths.append(folder / f"{k}.png")
        cv2.imwrite(str(paths[-1]), np.clip(noisy, 0, 255).astype(np.uint8))
    return paths


def board(folder: Path) -> Target:
    """The same board as kilter measure board describes it."""
    path = folder / "board.svg"
    with contextlib.redirect_stdout(io.StringIO()):
        run(["board", "--columns", "9", "--rows", "7", "--square-mm", "30", "-o", str(path), "--json"])
    return read_target(path.with_suffix(".json"))


def measured(pictures: int) -> list[Line]:
    """Look through the pictures, again and again."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths, target = drawn(folder), board(folder)
        began, early = [0.0], [0]

        def told(seen: Seen) -> None:
            if seen.pictures == max(1, pictures // 10):
                began[0], early[0] = time.perf_counter(), _most_kb()

        source = Source(tuple(paths[k % DIFFERENT] for k in range(pictures)))
        with (folder / "views.csv").open("w", newline="") as stream:
            seen = Looker([target]).write_views(source, stream, None, told)
        later = pictures - max(1, pictures // 10)
        rate = later / (time.perf_counter() - began[0])
        grown = (_most_kb() - early[0]) / 1024 * ALL / later
    whole = len(seen.views) == pictures
    return [
        Line(
            "views per second at 1.9 MP, PNG reading included",
            f"{rate:.1f}",
            f"{LEAST_VIEWS_S:g}",
            rate >= LEAST_VIEWS_S,
        ),
        Line("memory grown in 10 000 pictures, MB", f"{grown:.0f}", f"{MOST_GROWN_MB:g}", grown < MOST_GROWN_MB),
        Line("pictures that became views", f"{len(seen.views)} of {pictures}", "all", whole),
    ]


def _most_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Print the table, and as JSON on the last line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=200)
    lines = measured(parser.parse_args().pictures)
    print(show(lines))
    print(json.dumps({line.what: line.value for line in lines}))


if __name__ == "__main__":
    main()
