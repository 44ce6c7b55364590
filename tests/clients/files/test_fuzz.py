"""Whatever bytes come: a FileError or an answer, soon, and never another exception."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kilter_client import FileError
from kilter_files.look.drafts import inspect
from tests.clients.files.formats.test_recordings import c3d_bytes
from tests.clients.files.rig.test_rig import write_tdms
from tests.clients.files.simulated import write_csv, write_n3d

POINTS = np.random.default_rng(3).uniform(-500, 500, (12, 2, 3))
TRACKER = b"Name;X [m];Y [m];Z [m];U95;rx;ry;rz\n" + b"P1;0,1;0,2;0,3;0,01;1;2;3\n" * 5
TILT = b"Time [s],Incl X [deg],Incl Y [deg]\n" + b"".join(b"%d,1.5,2.5\n" % i for i in range(8))
LOG = b"q1_rad,q2_rad,t_s\n" + b"".join(b"0.%d,0.1,%d\n" % (i, i) for i in range(8))

SEEDS: dict[str, Callable[[Path], bytes]] = {
    "a.c3d": lambda path: c3d_bytes(POINTS, 100.0, -1.0, "<", "mm"),
    "a.n3d": lambda path: write_n3d(path, POINTS, 100.0).read_bytes(),
    "a.csv": lambda path: write_csv(path, POINTS, 100.0).read_bytes(),
    "a.tdms": lambda path: write_tdms(path, np.arange(50.0)).read_bytes(),
    "tracker.txt": lambda path: TRACKER,
    "tilt.csv": lambda path: TILT,
    "log.csv": lambda path: LOG,
}
EDITS = st.lists(
    st.tuples(st.sampled_from(["set", "cut", "insert", "double"]), st.integers(0, 1 << 16), st.binary(max_size=8)),
    min_size=1,
    max_size=5,
)


def edited(content: bytes, edits: list[tuple[str, int, bytes]]) -> bytes:
    for kind, place, piece in edits:
        # mostly near the beginning, where headers are
        at = (place % 700 if place % 4 else place) % max(1, len(content))
        if kind == "set":
            content = content[:at] + piece + content[at + len(piece) :]
        elif kind == "cut":
            content = content[:at]
        elif kind == "insert":
            content = content[:at] + piece + content[at:]
        else:
            content = content + content[at:]
    return content[: 1 << 18]


def understood_or_refused(path: Path) -> None:
    said = str(path)
    try:
        inspect(path)
    except FileError as error:
        said = error.detail
    assert str(path) in said


@pytest.mark.parametrize("name", SEEDS)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    seed = SEEDS[name](path)

    @settings(max_examples=40, deadline=5000, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(EDITS)
    def run(edits: list[tuple[str, int, bytes]]) -> None:
        path.write_bytes(edited(seed, edits))
        understood_or_refused(path)

    run()


def test_rubbish(tmp_path: Path) -> None:
    @settings(max_examples=60, deadline=5000, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(st.sampled_from(["a.dat", "a.c3d", "a.n3d"]), st.one_of(st.binary(max_size=600), st.text(max_size=300)))
    def run(name: str, content: bytes | str) -> None:
        path = tmp_path / name
        path.write_bytes(content.encode("utf-8", "replace") if isinstance(content, str) else content)
        understood_or_refused(path)

    run()
