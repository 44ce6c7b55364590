"""The newest picture of a feed that does not wait: what comes while one is looked at is passed over."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Condition, Event, Thread

from kilter_files.rig.live.feeds import Feed, Shot

WAIT_S = 0.5


class _Slot:
    """Room for one picture, and for what ended the feed."""

    def __init__(self) -> None:
        self.changed = Condition()
        self.shot: Shot | None = None
        self.error: BaseException | None = None
        self.ended = False

    def fill(self, feed: Feed, stop: Event) -> None:
        """Read the feed to its end."""
        error: BaseException | None = None
        try:
            for shot in feed.shots(stop):
                if shot is not None:
                    with self.changed:
                        self.shot = shot
                        self.changed.notify()
        except BaseException as raised:  # told where pictures are looked at
            error = raised
        with self.changed:
            self.error, self.ended = error, True
            self.changed.notify()


def newest(feed: Feed, stop: Event) -> Iterator[Shot | None]:
    """Pictures of a feed, each the newest there is; None while none comes. A folder's are all looked at."""
    if not feed.passes:
        yield from feed.shots(stop)
        return
    slot = _Slot()
    Thread(target=slot.fill, args=(feed, stop), daemon=True).start()
    while not stop.is_set():
        with slot.changed:
            if slot.shot is None and not slot.ended:
                slot.changed.wait(WAIT_S)
            shot, slot.shot = slot.shot, None
            if shot is None and slot.ended:
                if slot.error is not None:
                    raise slot.error
                return
        yield shot
