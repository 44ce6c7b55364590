"""The zenoh side of a stream: checks what arrives and hands it over; follows versions and sessions apart from the cycles."""

from __future__ import annotations

import atexit
import contextlib
import itertools
import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from kilter_client.client import Kilter
from kilter_client.errors import ConflictError, KilterError
from kilter_client.signing import LIFETIME_S, SESSION_EXPIRED, Session, Signer, from_document, on_this_machine
from kilter_client.streaming.accepted_versions import MOST_REPLIES, Acceptance, InUse
from kilter_client.streaming.certificates import StreamError, robot_key_prefix, session_config, why_not
from kilter_client.streaming.frames import Statistics

GONE = b""  # put into the queue when the corrector is gone, to end a wait
AGAIN = b"again"  # put there when the setpoint was not corrected, but the corrector has given its nonce
LOOK_S = 0.25  # so often the address of a corrector that is gone is read again
MOST_WAITING = 64  # answers to one setpoint; more of them are somebody else's


@dataclass(frozen=True)
class Place:
    """Names of a stream, and the endpoints of its corrector."""

    site: str
    robot: str
    stream: str
    endpoints: Sequence[str]

    @property
    def root(self) -> str:
        """Keys of the robot begin so."""
        return robot_key_prefix(self.site, self.robot, self.stream)


class Link:
    """A stream's session with the corrector."""

    _acceptance: Acceptance

    def __init__(
        self,
        place: Place,
        statistics: Statistics,
        in_use: InUse,
        sessions: Sessions,
        first: Session | None,
        zenoh_config: Path | None = None,
        elsewhere: Callable[[], Place | None] = lambda: None,
    ) -> None:
        _ = place.root  # refuses names that nobody would ever answer
        self._elsewhere = elsewhere
        self.joints = 0  # known when the stream is open
        self._place = place
        self._statistics = statistics
        self._in_use = in_use
        self._sessions = sessions
        self._signer = Signer(first) if first is not None else None
        self._ask_again = threading.Event()
        self._alive: set[str] = set()
        self._told = False  # whether anybody ever answered which version is active
        self._answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._follower: threading.Thread | None = None
        self._opening = threading.Lock()
        self._session: Any = None
        self._zenoh_config = zenoh_config

    def close(self) -> None:
        """Close the session; safe to call twice."""
        atexit.unregister(self.close)
        with self._opening:
            session, self._session = self._session, None
        if session is not None:
            session.close()
            self._ask_again.set()  # the thread sees that there is no session any more
            if self._follower is not None:
                self._follower.join(1.0)

    @property
    def active(self) -> dict[str, Any] | None:
        """The announcement of the version in use, as the corrector confirmed it; None when there is none."""
        return self._in_use.active

    @property
    def alive(self) -> bool:
        """Whether a corrector that serves the robot is known to be there."""
        return bool(self._alive)

    def _open(self, zenoh: Any, endpoints: Sequence[str]) -> Any:
        return zenoh.open(session_config(zenoh, endpoints, self._zenoh_config))

    def _declare(self, zenoh: Any) -> None:
        session = self._session
        self._deleted = zenoh.SampleKind.DELETE
        # Of everybody who answers, not of one whom the network thinks best.
        self._question = {
            "target": zenoh.QueryTarget.ALL,
            "consolidation": zenoh.ConsolidationMode.NONE,
            "timeout": 0.5,
        }
        # Direct callbacks only hand bytes over: no zenoh call, no thread of their own that could hang at exit.
        direct = {"indirect": False}
        session.declare_subscriber(
            f"{self._place.root}/stream/{self._place.stream}/out",
            zenoh.handlers.Callback(self._on_answer, **direct),
        )
        session.declare_subscriber(f"{self._place.root}/active", zenoh.handlers.Callback(self._on_active, **direct))
        session.liveliness().declare_subscriber(
            f"{self._place.root}/@alive/*", zenoh.handlers.Callback(self._on_liveliness, **direct), history=True
        )
        self._publisher = session.declare_publisher(
            f"{self._place.root}/stream/{self._place.stream}/in",
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,
        )

    def _on_answer(self, sample: Any) -> None:
        data = sample.payload.to_bytes()
        if self._signer is not None:
            data = self._unwrap_signed_answer(self._signer, data)
        # What is not an echo goes no further: it would wait in the queue before the answer.
        if data and self._acceptance.echoes(data) and self._answers.qsize() < MOST_WAITING:
            self._answers.put(data)

    def _unwrap_signed_answer(self, signer: Signer, data: bytes) -> bytes:
        """The plain answer in a signed one; nothing when it is forged, or was not meant for the cycle."""
        echo = self._acceptance.echo
        status = signer.accept_challenge(data, echo)
        if status is None:
            plain = signer.verify_answer(data)
            self._statistics.forged += int(plain is None)
            return plain or b""
        if status == SESSION_EXPIRED:
            self._sessions.mark_expired()
            self._ask_again.set()
        elif data[8:32] == echo:
            self._answers.put(AGAIN)
        return b""

    def _on_active(self, sample: Any) -> None:
        payload = sample.payload.to_bytes()
        if self._signer is not None:
            payload = self._signer.verify_announcement(f"{self._place.root}/active", payload)
        if payload is None:
            self._statistics.forged += 1
            return
        self._in_use.announce(payload)
        self._ask_again.set()

    def _ask_for_version(self, session: Any) -> None:
        key, signer = f"{self._place.root}/active", self._signer
        if signer is None:
            asked = session.get(key, **self._question)
        else:
            question = signer.question()
            asked = session.get(f"{key}?stream={self._place.stream}", payload=question, **self._question)
        found = [reply.ok.payload.to_bytes() for reply in itertools.islice(asked, MOST_REPLIES) if reply.ok is not None]
        if signer is not None:
            found = [body for reply in found if (body := signer.verify_reply(question, key, reply)) is not None]
        self._told = self._told or bool(found)
        self._in_use.confirm(found)

    def _follow(self) -> None:
        """Ask which version is active whenever somebody says that it has changed; apart from the cycles."""
        while True:
            self._ask_again.wait(30.0 if self._alive else LOOK_S)
            self._ask_again.clear()
            if not self._alive:
                self._look_elsewhere()
            session = self._session
            if session is None:
                return
            if self._signer is not None and self._sessions.due():
                self._renew(self._signer)
            with contextlib.suppress(Exception):  # the session is being closed
                self._ask_for_version(session)
            time.sleep(0.02)  # however often somebody says so

    def _look_elsewhere(self) -> None:
        """Connect to where the corrector is now, if the file that told its address names another."""
        place = self._elsewhere()
        if place is None or place == self._place:
            return
        import zenoh

        with self._opening:
            if self._session is None:
                return
            before, self._session, self._place = self._session, self._open(zenoh, place.endpoints), place
            self._declare(zenoh)
        before.close()

    def _renew(self, signer: Signer) -> None:
        """Get another session; the stream changes to it when the corrector has answered its greeting."""
        with contextlib.suppress(StreamError):
            session = self._sessions.next_session()
            if session is not None:
                signer.renew(session)
                self._publisher.put(signer.greeting())

    def _on_liveliness(self, sample: Any) -> None:
        if sample.kind == self._deleted:
            self._alive.discard(str(sample.key_expr))
            if not self._alive:
                self._answers.put(GONE)
        else:
            self._alive.add(str(sample.key_expr))
            self._ask_again.set()

    @property
    def _silent(self) -> str:
        """What is said of a corrector that cannot be reached for no reason that shows."""
        return f"{self._corrector_label} does not answer: is `kilterd serve` up, and its site {self._place.site!r}?"

    @property
    def _corrector_label(self) -> str:
        return f"The corrector at {', '.join(dict.fromkeys(self._place.endpoints))}"

    def _wait_for_version(self, zenoh: Any, timeout_s: float, config: Path | None) -> None:
        """Ask for the active version until somebody knows it and the way to the corrector is open."""
        end = time.monotonic() + timeout_s
        while True:
            if self._signer is not None and not self._signer.ready:
                self._publisher.put(self._signer.greeting())
            self._ask_for_version(self._session)
            ready = self._signer is None or self._signer.ready
            if ready and self.active is not None and self.alive and self._publisher.matching_status.matching:
                self.joints = self.active["joints"]
                return
            if time.monotonic() > end:
                break
            time.sleep(0.02)
        robot = self._place.robot
        if why := why_not(zenoh, self._place.endpoints, config):
            raise StreamError(why)
        if config is not None and self._publisher.matching_status.matching and not self._told:
            raise StreamError(
                f"{self._corrector_label} takes this controller's certificate, and its access list has no right to "
                f"robot {robot!r} for "
                "it: name the robot for this controller (`kilterd zenoh-config --controller NAME=ROBOT,...`) and start the "
                "corrector with its new folder."
            )
        if self._publisher.matching_status.matching:
            raise StreamError(
                f"{self._corrector_label} knows no active version of a robot {robot!r}: activate one with `kilter activate`, "
                "or correct the robot's name. Where the robot's controller corrects by itself (`kilter robot show`), no "
                "setpoint is corrected a second time."
            )
        if config is not None and self.alive:
            raise StreamError(
                f"{self._corrector_label} takes this certificate, and its access list lets it listen only: use the folder of a "
                f"controller that has robot {robot!r} (`kilterd zenoh-config --controller NAME=ROBOT,...`)."
            )
        raise StreamError(self._silent)


log = logging.getLogger("kilter.stream")

RENEW_AT = 0.5  # of its lifetime: as much is left to outlast an outage of the API
UNANSWERED_S = 5.0  # a corrector that is there and answers nothing for so long does not know the session's secret


class Sessions:
    """Sessions of one stream. ``signed`` None: sign when a session can be had, or when it must be."""

    def __init__(
        self,
        site: str,
        robot: str,
        stream: str,
        endpoints: Sequence[str],
        found: dict[str, Any],
        signed: bool | None,
        take_over: bool = False,
    ) -> None:
        self._take_over = take_over
        self._address = (site, robot, stream)
        self._endpoints = endpoints
        self._file = Path(found["stream_keys"]) if "stream_keys" in found else None
        self._signed = signed
        self._renew_at = 0.0  # monotonic clock: the other may be set at any moment
        self._asked_at = 0.0

    def initial_session(self, given: Session | None) -> Session | None:
        """The session to begin with; None for an unsigned stream.

        Raises:
            StreamError: there is none, and the stream may not be unsigned.

        """
        if self._signed is False:
            return None
        session = given or self._local() or self._of_api()
        if session is None and (self._signed or not all(map(_is_local, self._endpoints))):
            raise StreamError(
                f"No session for stream {self._address[2]!r} of robot {self._address[1]!r}: set KILTER_URL and KILTER_TOKEN "
                "so that the API gives one, or pass session=. Unsigned setpoints are taken on the corrector's own machine "
                "only (signed=False)."
            )
        self._plan(session)
        return session

    def due(self) -> bool:
        """Whether it is time for the next session."""
        return 0.0 < self._renew_at < time.monotonic()

    def mark_expired(self) -> None:
        """Say that the corrector takes the present session no longer."""
        self._renew_at = 1e-9

    def mark_unanswered(self) -> bool:
        """Say that the corrector answers nothing; returns whether another session is worth a try again."""
        if not 0.0 < self._asked_at < time.monotonic() - UNANSWERED_S:
            return False
        self._asked_at = time.monotonic()
        self.mark_expired()
        return True

    def next_session(self) -> Session | None:
        """Another session; None when there is none at present, and it is tried again in a minute."""
        session = self._local() or self._of_api()
        self._plan(session)
        return session

    def _plan(self, session: Session | None) -> None:
        self._asked_at = time.monotonic()
        left_s = 0.0 if session is None else session.expires_s - time.time()
        if not 0.0 < left_s <= LIFETIME_S:  # the clocks of both machines differ
            left_s = LIFETIME_S
        self._renew_at = self._asked_at + (60.0 if session is None else RENEW_AT * left_s)

    def _local(self) -> Session | None:
        return on_this_machine(self._file, *self._address) if self._file else None

    def _of_api(self) -> Session | None:
        if not os.environ.get("KILTER_URL"):
            return None
        _, robot, stream = self._address
        try:
            with Kilter() as kilter:
                document = kilter.robots.stream_session(robot, stream, LIFETIME_S / 3600.0, self._take_over)
        except KilterError as error:
            if isinstance(error, ConflictError) or self._signed or not all(map(_is_local, self._endpoints)):
                raise StreamError(f"The API gives no session: {error}") from error
            return None
        for warning in document.get("warnings") or ():
            log.warning("%s", warning["message"])
        self._take_over = False  # once: whoever takes it over from this one later is not driven out by the next renewal
        return from_document(document)


def _is_local(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if endpoint.startswith(("unixsock-stream/", "unixpipe/")) or host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
