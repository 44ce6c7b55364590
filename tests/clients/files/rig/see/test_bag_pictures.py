"""Pictures in bags, as the rosbags library writes them: one view of each pose at which the arm rests, with its joints."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from kilter_client.cli import run
from kilter_files.rig.see.bag_pictures import BagPictures, _decode_raw
from kilter_files.rig.see.pictures import RefusedError
from kilter_files.tables.table import JointLog
from tests.clients.files.rig.see.boards import CHARUCO, board, small, taken

STATE, IMAGE, PACKED = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
T0 = 1_700_000_000 * 10**9
POSES = np.radians([[10.0, 20.0], [11.0, 25.0], [14.0, 18.0]])


class Bag:
    """Writes messages of ROS 2 or ROS 1."""

    def __init__(self, path: Path, first: bool) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        self.first, self.path = first, path
        self.writer: Any = Writer1(path) if first else Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self.topics: dict[str, Any] = {}

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def header(self, t: float) -> Any:
        kinds = self.store.types
        stamp = kinds["builtin_interfaces/msg/Time"](*divmod(T0 + round(t * 1e9), 10**9))
        return kinds["std_msgs/msg/Header"](*((0, stamp, "") if self.first else (stamp, "")))

    def write(self, topic: str, kind: str, t: float, *fields: Any) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        message = self.store.types[kind](self.header(t), *fields)
        pack = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        self.writer.write(self.topics[topic], T0 + round((t + 0.02) * 1e9), pack(message, kind))

    def image(self, t: float, grey: Any, encoding: str = "mono8", topic: str = "/camera/image_raw") -> None:
        if encoding == "jpeg":
            self.write(topic, PACKED, t, "jpeg", cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].ravel())
            return
        h, w = grey.shape[:2]
        data = np.ascontiguousarray(grey)
        self.write(topic, IMAGE, t, h, w, encoding, 0, data.nbytes // h, data.view(np.uint8).ravel())


def recorded(path: Path, first: bool, encoding: str = "mono8", gripper: bool = False) -> Path:
    """An arm that rests at three poses for a second and moves for half of one; joints at 100 Hz, pictures at 10 Hz."""
    shots = [taken(CHARUCO, small(rotation_deg=(10.0 * k, -8.0, 4.0), seed=k)) for k in range(3)]
    with Bag(path, first) as bag:
        for n in range(450):
            t = n / 100
            k, within = divmod(t, 1.5)
            last = POSES[int(k)]
            q = last if within < 1.0 else last + 2.0 * (within - 1.0) * (POSES[(int(k) + 1) % 3] - last)
            if gripper and n < 5:  # another publisher, whose messages have none of the arm's joints
                bag.write("/joint_states", STATE, t, ["finger"], np.zeros(1), np.zeros(0), np.zeros(0))
            else:
                bag.write("/joint_states", STATE, t, ["b", "a"], q[::-1].copy(), np.zeros(0), np.zeros(0))
            if n % 10 == 0:
                grey = shots[int(k)]
                bag.image(t + 0.004, np.repeat(grey[..., None], 3, 2) if encoding == "bgr8" else grey, encoding)
    return path


def seen(tmp_path: Path, capsys: pytest.CaptureFixture[str], *given: str, code: int = 0) -> Any:
    capsys.readouterr()
    own = ["--board", str(board(CHARUCO)[0]), "-o", str(tmp_path / "views.csv"), "--json"]
    assert run(["see", *given, *own]) == code
    told = capsys.readouterr()
    return json.loads(told.out) if code == 0 else told.out + told.err


@pytest.mark.parametrize(("first", "encoding"), [(False, "mono8"), (False, "jpeg"), (True, "bgr8")])
def test_one_view_of_each_pose_with_the_joints_of_the_bag(
    first: bool, encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path / ("one.bag" if first else "bag"), first, encoding)
    document = seen(tmp_path, capsys, str(path), "--joint-order", "a,b")
    assert (document["rows"], document["pictures"], document["refused"]) == (3, 3, [])
    table = list(csv.DictReader((tmp_path / "views.csv").read_text().splitlines()))
    found = np.array([[float(row[f"q{j}_rad"]) for j in (1, 2)] for row in table])
    assert found == pytest.approx(POSES, abs=1e-9)
    assert [float(row["t_s"]) for row in table] == pytest.approx([0.0, 1.8, 3.3], abs=0.1)  # once it rests
    assert not [text for text in document["warnings"] if "no picture" in text]


def test_the_times_hold_where_other_messages_come_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "bag", False, gripper=True)
    document = seen(tmp_path, capsys, str(path), "--joint-order", "a,b")
    assert document["rows"] == 3


def test_what_a_bag_lacks_is_said_with_its_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grey = taken(CHARUCO, small())
    with Bag(tmp_path / "two", False) as bag:
        for n in range(40):
            bag.write("/joint_states", STATE, n / 20, ["a", "b"], POSES[0], np.zeros(0), np.zeros(0))
        bag.image(1.0, grey)
        bag.image(1.0, grey, topic="/other/image_raw")
    order = ("--joint-order", "a,b")
    said = seen(tmp_path, capsys, str(tmp_path / "two"), *order, code=1)
    assert "pictures come from /camera/image_raw, /other/image_raw" in said
    assert "--topic" in said
    assert seen(tmp_path, capsys, str(tmp_path / "two"), *order, "--topic", "/other/image_raw")["rows"] == 1
    assert "no topic '/no'" in seen(tmp_path, capsys, str(tmp_path / "two"), *order, "--topic", "/no", code=1)
    with Bag(tmp_path / "none", False) as bag:
        bag.write("/joint_states", STATE, 0.0, ["a", "b"], POSES[0], np.zeros(0), np.zeros(0))
    assert "holds no pictures" in seen(tmp_path, capsys, str(tmp_path / "none"), *order, code=1)
    with Bag(tmp_path / "late", False) as bag:  # a camera whose clock began elsewhere
        for n in range(40):
            bag.write("/joint_states", STATE, n / 20, ["a", "b"], POSES[0], np.zeros(0), np.zeros(0))
        bag.image(5000.0, grey)
    assert "joints_missing" in seen(tmp_path, capsys, str(tmp_path / "late"), *order, code=1)
    assert run(["see", str(tmp_path), "--topic", "/a", "--board", str(board(CHARUCO)[0]), "-o", "v.csv"]) == 2


class Lying:
    """A message whose header says what its data are not."""

    def __init__(self, width: int, height: int, encoding: str, step: int, data: bytes) -> None:
        self.width, self.height, self.encoding, self.step = width, height, encoding, step
        self.data, self.is_bigendian = np.frombuffer(data, dtype=np.uint8), 0


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (Lying(100_000, 100_000, "mono8", 100_000, b""), "picture_too_large"),
        (Lying(640, 480, "mono8", 640, b"\x00" * 100), "picture_unreadable"),
        (Lying(640, 480, "bgr8", 640, b"\x00" * 640 * 480), "picture_unreadable"),
        (Lying(640, 480, "depth32", 640, b"\x00" * 640 * 480), "picture_unreadable"),
    ],
)
def test_lying_headers_are_refused_before_anything_is_unpacked(message: Lying, code: str) -> None:
    with pytest.raises(RefusedError) as refused:
        _decode_raw("bag:/camera:1", message, None)
    assert refused.value.refusal.code == code


def test_every_encoding_gives_the_same_grey() -> None:
    grey = np.random.default_rng(0).integers(0, 255, (64, 96), dtype=np.uint8)
    made = {
        "mono8": grey, "rgb8": np.repeat(grey[..., None], 3, 2), "bgra8": np.repeat(grey[..., None], 4, 2),
        "mono16": grey.astype("<u2") * 16, "yuv422": np.stack([np.full_like(grey, 128), grey], 2),
        "yuyv": np.stack([grey, np.full_like(grey, 128)], 2),
    }  # fmt: skip
    for encoding, array in made.items():
        data = np.ascontiguousarray(array)
        message = Lying(96, 64, encoding, data.nbytes // 64, data.tobytes())
        assert np.abs(_decode_raw("x", message, None).astype(int) - grey).max() <= 1, encoding
    flat = np.full((64, 96), 77, dtype=np.uint8)
    assert (_decode_raw("x", Lying(96, 64, "bayer_rggb8", 96, flat.tobytes()), None) == 77).all()


def test_the_row_nearest_in_time_and_the_first_of_rows_equally_near() -> None:
    times = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 4.0, 4.0])
    log = JointLog(Path("log"), ("q1_rad",), {"t_s": times, "q1_rad": np.arange(7.0)})
    pictures = BagPictures(Path("bag"), None, log, 0)
    asked = {-3.0: 0, 0.0: 0, 0.5: 0, 0.75: 1, 1.0: 1, 1.25: 1, 1.5: 1, 1.75: 4, 3.0: 4, 3.5: 5, 4.0: 5, 9.0: 5}
    assert {t: pictures._nearest(t) for t in asked} == asked
    rng = np.random.default_rng(3)
    times[:] = np.sort(rng.integers(0, 8, 7)) / 2.0  # exact in binary: ties are ties
    for t in rng.integers(-4, 40, 200) / 8.0:
        assert pictures._nearest(float(t)) == min(range(7), key=lambda k: abs(times[k] - t))
