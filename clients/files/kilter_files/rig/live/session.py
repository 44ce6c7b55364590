"""What is seen now, what is still missing, and the views that were taken."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError
from kilter_files.rig.board.opencv import opencv
from kilter_files.rig.live.feeds import Shot
from kilter_files.rig.live.taken import Taken
from kilter_files.rig.see.optics.coverage import CELLS, evaluate_gates
from kilter_files.rig.see.optics.intrinsics_fit import fit_intrinsics
from kilter_files.rig.see.pictures import Grey
from kilter_files.rig.see.refusals import Refusal
from kilter_files.rig.see.run import Looker
from kilter_files.rig.see.views import View

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
