"""A live view takes a view of each pose at which the arm rests, from a stream or a folder, and says what is missing."""

from __future__ import annotations

import csv
import json
import re
import socket
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from threading import Event
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
import pytest

from kilter_client.cli import run
from kilter_files.ground.errors import FileError, UsageError
from kilter_files.rig.live.feeds import Device, Shot, Stream, multipart_boundary, multipart_pictures, newest, open_feed
from kilter_files.rig.live.server import Session, Taken, follow, read_row, serve_live_page
from kilter_files.rig.see.run import Looker
from kilter_files.rig.see.target import read_target
from tests.clients.files.rig.live.cameras import jpeg, mjpeg, picture
from tests.clients.files.rig.see.boards import CHARUCO, board

BOARD = str(board(CHARUCO)[0])


def session(folder: Path | None, joints: Path | None = None, wanted: int | None = None) -> Session:
    return Session(Looker([read_target(Path(BOARD))]), Taken(folder, joints), "test", wanted=wanted)


def test_a_view_is_taken_once_the_board_rests_at_another_place(tmp_path: Path) -> None:
    live = session(tmp_path / "out")

    def show(grey: np.ndarray | None, t: float) -> int:
        live.process_shot(Shot(f"f{t}", t, grey))
        return len(live.taken)

    first = picture(0)
    assert [show(first, t) for t in (0.0, 0.2, 0.4, 0.6, 0.8)] == [0, 0, 0, 1, 1]  # half a second at one place
    assert [show(first, t) for t in (1.0, 2.0, 3.0)] == [1, 1, 1]  # the same pose is not taken again
    assert [show(picture(0, 4.0 * k), 3.0 + 0.3 * k) for k in range(1, 6)] == [1] * 5  # it moves
    assert live.state["rests"] is False
    still = picture(0, 25.0)
    assert [show(still, 5.0 + t) for t in (0.0, 0.3, 0.6, 0.9)] == [1, 1, 2, 2]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["view0001.png", "view0002.png"]
    assert (cv2.imread(str(tmp_path / "out" / "view0002.png"), cv2.IMREAD_GRAYSCALE) == still).all()  # nothing is lost
    assert live.state["taken"] == 2
    missing = [cell for row in live.state["cells"] for cell in row]
    assert 0 < sum(missing) < 20
    show(np.full_like(first, 128), 9.0)
    assert live.state["refusal"]["code"] in ("board_not_found", "picture_blurred")
    assert live.state["corners"] == 0
    live.request_next_view()
    assert [show(picture(1), 10.0), show(picture(1), 10.1)] == [3, 3]  # taken at once when asked for


def test_a_stream_is_followed_and_its_newest_picture_looked_at(tmp_path: Path) -> None:
    live = session(tmp_path / "out", wanted=3)

    def frames() -> Iterator[bytes]:
        for k in range(3):
            still = jpeg(picture(k))
            while len(live.taken) <= k:
                yield still

    with mjpeg(frames) as address:
        stop = Event()
        follow(live, newest(open_feed(address), stop))
        stop.set()
    assert live.full
    assert len(list((tmp_path / "out").glob("view*.png"))) == 3


def test_a_folder_that_fills_takes_every_picture_and_says_what_lacks(tmp_path: Path) -> None:
    folder = tmp_path / "filling"
    folder.mkdir()
    live = session(None, wanted=8)
    shots, stop = open_feed(str(folder)).shots(Event()), Event()
    assert next(shots) is None
    for k in range(8):
        cv2.imwrite(str(folder / f"pose{k}.png"), picture(k))
        shot = next(shots)
        while shot is None:
            shot = next(shots)
        live.process_shot(shot)
        assert len(live.taken) == k + 1
    stop.set()
    gates = {gate["name"]: gate for gate in live.state["gates"]}
    assert gates["views"]["value"] == 8
    assert gates["views"]["met"] is False
    assert "at least 10 pictures" in gates["views"]["remedy"]


def test_the_command_ends_by_itself_and_what_it_wrote_is_read_by_see(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    now, out = tmp_path / "now.csv", tmp_path / "out"
    now.write_text("q1_deg,q2_deg\n10,20\n11,21.5\n")

    def frames() -> Iterator[bytes]:
        k, sent = 0, 0
        while True:
            there = len(list(out.glob("view*.png"))) if out.exists() else 0
            if there > k:
                now.write_text("q1_deg,q2_deg\n12,23.5\n")
            k, sent = (there, 0) if there > k else (k, sent + 1)
            yield jpeg(picture(k))

    with mjpeg(frames) as address:
        given = [address, "--board", BOARD, "--joints", str(now), "-o", str(out), "--views", "2", "--json"]
        assert run(["live", *given]) == 0
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert document["address"].startswith("http://127.0.0.1:")
    assert json.loads(told.err.splitlines()[0]) == {"address": document["address"]}
    assert document["views"] == ["view0001.png", "view0002.png"]
    rows = list(csv.DictReader((out / "joints.csv").read_text().splitlines()))
    assert [(row["picture"], row["q2_deg"]) for row in rows] == [("view0001.png", "21.5"), ("view0002.png", "23.5")]
    views = tmp_path / "views.csv"
    assert run(["see", str(out), "--board", BOARD, "--joints", str(out / "joints.csv"), "-o", str(views)]) == 0
    assert len(views.read_text().splitlines()) == 3


def test_joints_that_cannot_be_read_take_no_view(tmp_path: Path) -> None:
    now = tmp_path / "now.csv"
    live = session(tmp_path / "out", now)
    for k in range(4):
        live.process_shot(Shot("a", 0.4 * k, picture(0)))
    assert "cannot be read: the view was not taken" in live.state["message"]
    now.write_text("q1_deg\n12\n")
    live.process_shot(Shot("a", 2.0, picture(0)))
    assert (live.state["taken"], live.state["message"]) == (1, "took view0001.png with its joints")
    for text, said in (
        ("q1_deg\n", "no whole row"),
        ("q1\n3\n", "not a contract column"),
        ("q1_deg\nx\n", "not a number"),
    ):
        now.write_text(text)
        with pytest.raises(FileError, match=said):
            read_row(now)


def test_joints_that_stay_while_the_board_moves_take_no_view(tmp_path: Path) -> None:
    """A file that nobody keeps current gave every picture the joints of the first."""
    now = tmp_path / "now.csv"
    now.write_text("q1_deg\n12\n")
    live = session(tmp_path / "out", now)
    for k in range(6):
        live.process_shot(Shot("a", 0.4 * k, picture(0, 25.0 * (k > 2))))
    assert "has the joints of view0001.png, and the board has moved since" in live.state["message"]
    assert live.state["taken"] == 1
    now.write_text("q1_deg\n13\n")
    live.process_shot(Shot("a", 2.4, picture(0, 25.0)))
    assert live.state["message"] == "took view0002.png with its joints"
    live.request_next_view()
    live.process_shot(Shot("a", 2.5, picture(0, 25.0)))  # the same pose once more, as asked for
    assert live.state["taken"] == 3


def test_what_is_no_source_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UsageError, match="give a folder, the address"):
        open_feed(str(tmp_path / "nowhere"))
    with pytest.raises(FileError, match="is not there"):
        next(Device(Path("/dev/video987")).shots(Event()))
    with pytest.raises(FileError, match="sends no pictures"):
        next(Stream("http://127.0.0.1:9/").shots(Event()))
    with (
        mjpeg(lambda: iter([b"x"]), "text/html") as address,
        pytest.raises(FileError, match="is text/html, not an MJPEG"),
    ):
        next(Stream(address).shots(Event()))
    assert multipart_boundary("a", 'multipart/x-mixed-replace; boundary="--x"') == b"--x"
    assert run(["live", "http://127.0.0.1:9/", "--board", BOARD]) == 2
    assert "-o DIR" in capsys.readouterr().err
    assert run(["live", "http://127.0.0.1:9/", "--board", BOARD, "-o", str(tmp_path)]) == 1
    assert "sends no pictures" in capsys.readouterr().err


@pytest.mark.parametrize(
    "head", [b"Content-Length: 99999999999\r\n", b"Content-Type: image/jpeg\r\n", b"Content-Length: 50\r\n"]
)
def test_lying_parts_end_the_stream_with_bounded_memory(head: bytes) -> None:
    with pytest.raises(OSError, match=r"length|ended within"):
        next(multipart_pictures(BytesIO(b"--frame\r\n" + head + b"\r\nshort"), b"--frame"))


def test_the_page_answers_itself_only(tmp_path: Path) -> None:
    live = session(tmp_path)
    with serve_live_page(live) as address, httpx.Client() as client:
        assert "default-src 'none'" in client.get(address).headers["content-security-policy"]
        assert client.get(address + "state").json() == {}
        assert client.get(address + "picture.jpg").status_code == 404
        live.process_shot(Shot("a", 0.0, picture(0)))
        assert client.get(address + "state").json()["corners"] == 24
        assert client.get(address + "picture.jpg").headers["content-type"] == "image/jpeg"
        assert client.get(address, headers={"Host": "evil.example"}).status_code == 403
        assert client.post(address + "take").status_code == 403
        assert live.asked is False
        assert client.post(address + "take", headers={"X-Kilter": "take"}).status_code == 202
        assert live.asked is True
        assert client.get(address + "../etc/passwd").status_code == 404


HIDDEN = "POST /take HTTP/1.1\r\nHost: {host}\r\nX-Kilter: take\r\n\r\n"


def statuses(host: str, request: str) -> list[str]:
    """Send bytes over one connection; the statuses of all answers until the page closes it."""
    name, _, port = host.partition(":")
    with socket.create_connection((name, int(port)), 10.0) as connection:
        connection.sendall(request.format(host=host, length=len(HIDDEN.format(host=host))).encode())
        answers = b"".join(iter(lambda: connection.recv(1 << 16), b""))
    return re.findall(r"HTTP/1\.\d (\d+)", answers.decode())


@pytest.mark.parametrize(
    ("head", "status"),
    [
        ("POST /take HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n", "403"),
        ("POST /nothing HTTP/1.1\r\nHost: {host}\r\nX-Kilter: take\r\nContent-Length: {length}\r\n\r\n", "404"),
        ("POST /take HTTP/1.1\r\nHost: evil.example\r\nX-Kilter: take\r\nContent-Length: {length}\r\n\r\n", "403"),
        ("POST /take HTTP/1.1\r\nHost: {host}\r\nTransfer-Encoding: chunked\r\n\r\n", "403"),
        ("GET /state HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n", "200"),
        ("GET /state HTTP/1.1\r\nHost: {host}\r\nConnection: keep-alive\r\n\r\n", "200"),
        ("GET /nothing HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n", "404"),
        ("PUT /take HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n", "501"),
        ("OPTIONS /take HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n", "501"),
    ],
)
def test_no_request_in_the_body_of_another_is_run(tmp_path: Path, head: str, status: str) -> None:
    live = session(tmp_path)
    with serve_live_page(live) as address:
        assert statuses(urlsplit(address).netloc, head + HIDDEN) == [status]
    assert live.asked is False


def test_a_view_that_the_page_asks_for_is_taken_once(tmp_path: Path) -> None:
    live = session(tmp_path)
    with serve_live_page(live) as address:
        assert statuses(urlsplit(address).netloc, HIDDEN + HIDDEN) == ["202"]


@pytest.mark.parametrize(
    ("header", "status"),
    [
        ("Host: localhost:{port}", 200),
        ("Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}", 200),
        ("Host: 127.0.0.1:{port}\r\nOrigin: http://localhost:{port}", 200),
        ("Host: 127.0.0.1", 403),
        ("Host: 127.0.0.1:1{port}", 403),
        ("Host: 127.0.0.1:{port}.evil.example", 403),
        ("Host: evil.example:{port}", 403),
        ("Host: evil.example@127.0.0.1:{port}", 403),
        ("Host: 127.0.0.1:{port}\r\nHost: evil.example", 403),
        ("X-Nothing: 1", 403),
        ("Host: 127.0.0.1:{port}\r\nOrigin: http://evil.example", 403),
        ("Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:1", 403),
        ("Host: 127.0.0.1:{port}\r\nOrigin: https://127.0.0.1:{port}", 403),
        ("Host: 127.0.0.1:{port}\r\nOrigin: null", 403),
        ("Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nOrigin: http://evil.example", 403),
    ],
)
def test_only_a_browser_at_the_pages_own_address_is_answered(tmp_path: Path, header: str, status: int) -> None:
    live = session(tmp_path)
    with serve_live_page(live) as address:
        host = urlsplit(address).netloc
        said = header.format(port=host.partition(":")[2])
        assert statuses(host, f"GET /state HTTP/1.1\r\n{said}\r\n\r\n") == [str(status)]
        taken = statuses(host, f"POST /take HTTP/1.1\r\n{said}\r\nX-Kilter: take\r\n\r\n")
    assert taken == ["202" if status == 200 else "403"]
    assert live.asked is (status == 200)
