"""The page of a live view, on the loopback interface only."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import SHUT_WR
from threading import Lock, Thread
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.units import column_unit
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.live.feeds import Shot
from kilter_files.rig.see.intrinsics import CELLS, evaluate_gates
from kilter_files.rig.see.optics.intrinsics_fit import fit_intrinsics
from kilter_files.rig.see.pictures import Grey, Refusal
from kilter_files.rig.see.run import Looker
from kilter_files.rig.see.views import View

JOINTS, PICTURE = "joints.csv", "picture"
NUMBERED = re.compile(r"view(\d+)\.png")


@dataclass
class Taken:
    """Where views go: ``folder`` None leaves pictures where they are. ``joints`` is a file that says where the arm is now."""

    folder: Path | None
    joints: Path | None = None
    last: list[View] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    noted: dict[str, str] | None = None

    def __len__(self) -> int:
        return len(self.names)

    def add(self, shot: Shot, views: list[View], elsewhere: bool) -> str:
        """Keep a picture and its joints, and say so; ``elsewhere`` says that the board has moved since the last view.

        Raises:
            FileError: joints that cannot be read or are those of the last view, or a folder that cannot be written to.

        """
        row = None if self.joints is None else read_row(self.joints)
        if elsewhere and row is not None and row == self.noted:
            raise FileError(
                f"{self.joints}: has the joints of {self.names[-1]}, and the board has moved since: the view was not taken. "
                "Let your controller keep the file current."
            )
        name = shot.name
        if self.folder is not None:
            name = self._written(shot)
            if row is not None:
                self._append({PICTURE: name} | row)
        self.names.append(name)
        self.last, self.noted = views, row
        return f"took {name}" + ("" if row is None else " with its joints")

    def _written(self, shot: Shot) -> str:
        assert self.folder is not None
        assert shot.grey is not None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            there = [int(m[1]) for p in self.folder.iterdir() if (m := NUMBERED.fullmatch(p.name))]
            name = f"view{max(there, default=0) + 1:04d}.png"
            with (self.folder / name).open("xb") as file:
                file.write(bytes(opencv().imencode(".png", shot.grey)[1]))
        except OSError as error:
            raise FileError(f"{self.folder}: cannot be written to: {error.strerror or error}.") from error
        return name

    def _append(self, row: dict[str, str]) -> None:
        assert self.folder is not None
        path = self.folder / JOINTS
        new = not path.exists()
        if not new:
            head = path.read_text(encoding="utf-8").partition("\n")[0].strip().split(",")
            if head != list(row):
                raise FileError(f"{path}: has the columns {','.join(head)}, and the joints now {','.join(row)}.")
        with path.open("a", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            if new:
                writer.writerow(row)
            writer.writerow(row.values())


def read_row(path: Path) -> dict[str, str]:
    """The joints in a file with a head of contract columns; its last row counts.

    Raises:
        FileError: not there, no row, a column that is none, or a cell that is not a number.

    """
    try:
        rows = [row for row in csv.reader(path.read_text(encoding="utf-8-sig").splitlines()) if any(row)]
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read: the view was not taken.") from error
    if len(rows) < 2 or len(rows[0]) != len(rows[-1]):
        raise FileError(f"{path}: has no whole row of joints: give a head (q1_deg,q2_deg,...) and a row.")
    found = dict(zip((name.strip() for name in rows[0]), (cell.strip() for cell in rows[-1]), strict=True))
    for name, cell in found.items():
        if column_unit(name) is None:
            raise FileError(f"{path}: column {name!r} is not a contract column such as q1_deg.")
        try:
            float(cell)
        except ValueError:
            raise FileError(f"{path}: {cell!r} in column {name!r} is not a number.") from None
    return found


REST_S = 0.5  # for which no corner may move
REST_PX = 0.3  # beside three standard deviations of a corner
ANOTHER_PX = 15.0  # by which corners differ from those of the last view that was taken
MOST_SHOWN = 1280  # px, width of the picture on the page
FEWEST_FOR_GATES = 6
GREEN, ORANGE = (80, 200, 60), (40, 150, 255)  # BGR


@dataclass
class Session:
    """Looks at one picture after the other; ``state`` and ``picture`` are for whoever watches."""

    looker: Looker
    taken: Taken
    source: str
    lens: str = "brown"
    wanted: int | None = None
    size: tuple[int, int] | None = None
    numbers: int = 0
    refusal: Refusal | None = None
    message: str = ""
    asked: bool = False
    gates: list[dict[str, Any]] = field(default_factory=list)
    cells: set[tuple[int, int]] = field(default_factory=set)
    _before: list[View] = field(default_factory=list)
    _still_since: float | None = None
    _lock: Lock = field(default_factory=Lock)
    _state: dict[str, Any] = field(default_factory=dict)
    _picture: bytes = b""

    @property
    def state(self) -> dict[str, Any]:
        """What the page shows."""
        with self._lock:
            return dict(self._state)

    @property
    def picture(self) -> bytes:
        """The last picture with its corners, JPEG."""
        with self._lock:
            return self._picture

    @property
    def full(self) -> bool:
        """Whether as many views were taken as were wanted."""
        return self.wanted is not None and len(self.taken) >= self.wanted

    def request_next_view(self) -> None:
        """Take the next picture in which the board is seen, whether it moves or not."""
        self.asked = True

    def process_shot(self, shot: Shot) -> None:
        """Look at a picture, and take it where the arm rests at another pose."""
        self.numbers += 1
        views: list[View] = []
        self.refusal = shot.refusal
        if shot.grey is not None and self._fits(shot.name, shot.grey):
            found = self.looker.boards(shot.grey, shot.name)
            views = [one for one in found if isinstance(one, View)]
            self.refusal = next((one for one in found if isinstance(one, Refusal)), None) if not views else None
        rests = self._rests(views, shot)
        if views and shot.grey is not None and ((rests and self._another(views)) or self.asked):
            self._store_views(shot, views)
        self._publish(shot, views, rests)

    def _fits(self, name: str, grey: Grey) -> bool:
        size = (grey.shape[1], grey.shape[0])
        if self.size is not None and size != self.size:
            what = f"has {size[0]} x {size[1]} pixels, and those before it {self.size[0]} x {self.size[1]}"
            self.refusal = Refusal(name, "picture_other_camera", what)
            return False
        self.size = size
        return True

    def _rests(self, views: list[View], shot: Shot) -> bool:
        before, self._before = self._before, views
        if shot.still:
            return bool(views)
        moved = _median_corner_shift(before, views)
        limit = REST_PX + 3.0 * float(np.mean([v.sigmas.mean() for v in views])) if views else 0.0
        if moved is None or moved > limit:
            self._still_since = shot.t_s if views else None
            return False
        if self._still_since is None:
            self._still_since = shot.t_s
        return shot.t_s - self._still_since >= REST_S

    def _another(self, views: list[View]) -> bool:
        moved = _median_corner_shift(self.taken.last, views)
        return moved is None or moved > ANOTHER_PX

    def _store_views(self, shot: Shot, views: list[View]) -> None:
        asked, self.asked = self.asked, False
        assert shot.grey is not None
        try:
            self.message = self.taken.add(shot, views, elsewhere=not asked)
        except FileError as error:
            self.message = str(error)
            return
        for view in views:
            target = next(target for target in self.looker.targets if target.name == view.board)
            self.looker.kept.offer(view, target)
            assert self.size is not None
            cells = np.clip(((view.pixels + 0.5) / self.size * CELLS).astype(int), 0, np.subtract(CELLS, 1))
            self.cells |= {(int(x), int(y)) for x, y in cells}
        self._update_gates()

    def _update_gates(self) -> None:
        """What is missing for intrinsics, by the gates of `kilter measure see`."""
        seen = self.looker.kept.thinned_views()
        if len(seen) < FEWEST_FOR_GATES or self.size is None:
            return
        try:
            fit = fit_intrinsics(seen, self.size, self.lens)
        except FileError:
            return  # views that no camera explains yet: `kilter measure see` says so of all of them
        self.gates = [gate.to_document() | {"remedy": gate.remedy} for gate in evaluate_gates(seen, fit)]

    def _publish(self, shot: Shot, views: list[View], rests: bool) -> None:
        picture = b"" if shot.grey is None else drawn(shot.grey, views, rests)
        state = {
            "source": self.source,
            "number": self.numbers,
            "size": self.size,
            "picture": shot.name,
            "corners": sum(len(view.places) for view in views),
            "rests": rests,
            "taken": len(self.taken),
            "wanted": self.wanted,
            "message": self.message,
            "gates": self.gates,
            "cells": [[(x, y) in self.cells for x in range(CELLS[0])] for y in range(CELLS[1])],
            "refusal": None if self.refusal is None else self.refusal.to_document(),
            "full": self.full,
        }
        with self._lock:
            self._state = state
            self._picture = picture or self._picture


def follow(session: Session, shots: Iterable[Shot | None]) -> None:
    """Look at pictures until enough views were taken, or none comes any more."""
    for shot in shots:
        if shot is not None:
            session.process_shot(shot)
        if session.full:
            return


def drawn(grey: Grey, views: list[View], rests: bool) -> bytes:
    """The picture as JPEG, no wider than the page, with a ring at each corner: green at rest, else orange."""
    cv2 = opencv()
    factor = min(1.0, MOST_SHOWN / grey.shape[1])
    if factor < 1.0:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for view in views:
        for u, v in (view.pixels + 0.5) * factor - 0.5:
            cv2.circle(bgr, (round(float(u)), round(float(v))), 5, GREEN if rests else ORANGE, 2, cv2.LINE_AA)
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])


def _median_corner_shift(before: list[View], now: list[View]) -> float | None:
    """Median (px) by which corners of two pictures differ; None where they share none."""
    old = {(view.board, k): p for view in before for k, p in zip(view.places, view.pixels, strict=True)}
    steps: list[Floats] = [
        p - old[view.board, k]
        for view in now
        for k, p in zip(view.places, view.pixels, strict=True)
        if (view.board, k) in old
    ]
    return float(np.median(np.linalg.norm(np.array(steps), axis=1))) if steps else None


HOST = "127.0.0.1"
PAGE = Path(__file__).with_name("page.html")
POLICY = (
    "default-src 'none'; img-src 'self'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "frame-ancestors 'none'"
)
SILENT_S = 10.0  # after which a connection that sends nothing is closed
MOST_DROPPED = 16  # pieces of a body that nobody reads


@contextmanager
def serve_live_page(session: Session, port: int = 0) -> Iterator[str]:
    """Serve the page of a session while the context lasts; its address.

    Raises:
        UsageError: the port is taken.

    """

    class Handler(_Handler):
        shown = session

    try:
        server = ThreadingHTTPServer((HOST, port), Handler)
    except OSError as error:
        raise UsageError(f"Port {port} of {HOST} is taken: give another --port, or 0 for any.") from error
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers one request of a connection (HTTP/1.0) and closes it: what follows, such as a body, is never a request."""

    shown: Session
    timeout = SILENT_S

    def do_GET(self) -> None:
        """Page, state and picture."""
        path = self.path.partition("?")[0]
        if not self._of_this_page():
            self._answer(403, "text/plain", b"Open the page by its own address.")
        elif path == "/":
            self._answer(200, "text/html; charset=utf-8", PAGE.read_bytes())
        elif path == "/state":
            self._answer(200, "application/json", json.dumps(self.shown.state).encode())
        elif path == "/picture.jpg" and self.shown.picture:
            self._answer(200, "image/jpeg", self.shown.picture)
        else:
            self._answer(404, "text/plain", b"Nothing is here.")

    def do_POST(self) -> None:
        """Take a view: only for the page itself, whose header no other site may send."""
        if not self._of_this_page() or self.headers.get("X-Kilter") != "take":
            self._answer(403, "text/plain", b"Only the page itself takes views.")
        elif self.path != "/take":
            self._answer(404, "text/plain", b"Nothing is here.")
        else:
            self.shown.request_next_view()
            self._answer(202, "text/plain", b"")

    def _of_this_page(self) -> bool:
        """Whether the browser was given this address, not a name that somebody points here, and no other site asks."""
        port = self.connection.getsockname()[1]
        here = {f"{name}:{port}" for name in (HOST, "localhost")} | ({HOST, "localhost"} if port == 80 else set())
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        return len(hosts) == 1 and hosts[0] in here and {f"http://{name}" for name in here}.issuperset(origins)

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for key, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
        ):
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(body)

    def finish(self) -> None:
        """Close the connection, once what the other side still sends was dropped: a reset would take the answer from it."""
        with suppress(OSError):
            super().finish()
            self.connection.shutdown(SHUT_WR)
            for _ in range(MOST_DROPPED):
                if not self.connection.recv(1 << 16):
                    break

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (the name that the library gives)
        """Say nothing: the command shows what matters."""
