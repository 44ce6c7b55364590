"""The query process: whole trajectories and descriptions, apart from the stream so that it never waits for them."""

from __future__ import annotations

import json
import logging
import signal
import struct
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
import zenoh

from kilter_core.correct import walk_from_rest, warm_up
from kilter_core.errors import ObservationError
from kilter_core.types import Floats
from kilter_service.stream.corrector import endpoints, wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.session import ENCODING, QuerySpec, Rules, close, open_inside
from kilter_service.stream.corrector.wire import Flag, FrameError, Header, Kind, Status
from kilter_service.stream.signing import sealed, service
from kilter_service.stream.signing.sealed import Session

log = logging.getLogger("kilter.corrector.queries")


@dataclass(frozen=True)
class Trajectory:
    """A decoded trajectory: ``t (N,)`` s, ``values (N, width * J)``."""

    header: Header
    version: int | None
    t: Floats
    values: Floats


UNSIGNED = (
    "Messages must be signed here (KLT2): ask for a session with POST /v1/robots/{robot}/stream/sessions, or update the "
    "client library."
)


class QueryError(Exception):
    """A refusal, sent to the caller as JSON: code, message, first_bad_index, joints (from 1)."""

    def __init__(self, code: str, message: str, index: int | None = None, mask: int = 0) -> None:
        super().__init__(message)
        joints = [j + 1 for j in range(16) if mask >> j & 1]
        self.document = {"code": code, "message": message, "first_bad_index": index, "joints": joints}


def encode_trajectory(
    t: Floats, values: Floats, *, joints: int, flags: int = 0, version: int | None = None, seq: int = 0
) -> bytes:
    """Bytes of a request: header, version when given, N and J, t[N], then q, qd, qdd side by side [N, width J]."""
    if version is not None:
        flags |= Flag.VERSION
    parts = [wire.HEADER.pack(wire.MAGIC, Kind.TRAJECTORY, joints, flags, seq, 0, 0)]
    if version is not None:
        parts.append(wire.VERSION.pack(version))
    parts += [wire.BLOCK.pack(len(t), joints), t.astype("<f8").tobytes(), values.astype("<f8").tobytes()]
    return b"".join(parts)


def decode_trajectory(data: bytes) -> Trajectory:
    """Read a request.

    Raises:
        FrameError: anything that is not exactly such a frame.

    """
    header = wire.decode_header(data)
    offset = wire.HEADER.size
    version = None
    try:
        if header.flags & Flag.VERSION:
            (version,) = wire.VERSION.unpack_from(data, offset)
            offset += wire.VERSION.size
        points, joints = wire.BLOCK.unpack_from(data, offset)
    except struct.error:
        raise FrameError("cut off", header) from None
    offset += wire.BLOCK.size
    wide = joints * wire.width(header.flags)
    if header.kind != Kind.TRAJECTORY or joints != header.joints or not 0 < joints <= wire.MAX_JOINTS:
        raise FrameError("not a trajectory, or another number of joints in the header", header)
    if not 0 < points <= wire.MAX_TRAJECTORY or len(data) != offset + 8 * points * (1 + wide):
        raise FrameError(f"{len(data)} bytes do not hold {points} points of {joints} joints", header)
    numbers = np.frombuffer(bytearray(data), dtype="<f8", offset=offset)
    return Trajectory(header, version, numbers[:points], numbers[points:].reshape(points, wide))


def correct_trajectory(request: Trajectory, active: Active | None) -> bytes:
    """Bytes of the answer: header, verdict, N and J, t[N], q[N, J]. The arm rests at the first point.

    Raises:
        QueryError: no version, another one than expected, or a point that is refused.

    """
    joints = request.header.joints
    if active is None:
        raise QueryError(Status.NO_VERSION.name, "The robot has no active version: activate one.")
    if joints != active.program.n_joints or request.version not in (None, active.number):
        raise QueryError(
            Status.VERSION_MISMATCH.name,
            f"The active version is {active.version_id} for {active.program.n_joints} joints: ask for that one.",
        )
    began = time.monotonic_ns()
    try:
        walked = walk_from_rest(active.program, request.values, wire.width(request.header.flags), request.t)
    except ObservationError as error:
        index = error.context["row"] - 1
        raise QueryError(Status.SEQ_BACK.name, "The times go back or are not numbers.", index) from error
    refused = walked.refusal
    if refused is not None:
        name = Status(refused.status).name
        raise QueryError(name, f"Point {refused.index} is refused: {name}.", refused.index, refused.limit_mask)
    spent = min(time.monotonic_ns() - began, 0xFFFFFFFF)
    head = wire.HEADER.pack(wire.MAGIC, Kind.TRAJECTORY, joints, walked.all_flags, request.header.seq, 0, 0)
    verdict = wire.VERDICT.pack(
        active.number, active.epoch, Status.OK, 0, spent, wire.nanometres(walked.remaining_error_m)
    )
    return b"".join([head, verdict, wire.BLOCK.pack(len(walked.q), joints), request.t.tobytes(), walked.q.tobytes()])


def describe(robot: str, active: Active | None, unsigned: bool) -> bytes:
    """JSON of what a stream of the robot expects and does."""
    rules = Rules()
    document = {
        "robot": robot,
        "frame": {"magic": wire.MAGIC.decode(), "header_bytes": wire.HEADER.size, "units": "rad, m, rad/s, m/s"},
        "signed_frame": {"magic": sealed.MAGIC.decode(), "trailer_bytes": sealed.TRAILER, "required": not unsigned},
        "statuses": {status.name: int(status) for status in Status},
        "flags": {str(flag.name): int(flag) for flag in Flag},
        "max_age_ms": rules.max_age_ns / 1e6,
        "active": json.loads(active.announcement()) if active else None,
        "workspace": active.workspace if active else None,
    }
    return json.dumps(document).encode()


class Queries:
    """Answers the queries of a site until its session closes; the versions come through a pipe."""

    def __init__(self, session: zenoh.Session, spec: QuerySpec, pipe: Connection) -> None:
        self.active: dict[str, Active] = {}
        self._masters = spec.masters
        self._spec = spec
        self._session = session
        self._pipe = pipe
        self._thread = threading.Thread(target=self._follow, name="versions")
        self._queryable = session.declare_queryable(
            endpoints.every_query(spec.site, "*"), zenoh.handlers.FifoChannel(32), complete=True
        )

    def run(self) -> None:
        """Answer until the session is closed."""
        self._thread.start()
        for query in self._queryable.handler:
            with query:
                try:
                    self._answer(query)
                except QueryError as error:
                    self._refuse(query, error)
                except Exception:
                    log.exception("query %s failed", query.key_expr)
                    self._refuse(query, QueryError("internal_error", "Kilter failed; its log has the cause."))
        self._thread.join()

    def _answer(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        robot = endpoints.robot_from_key(key)
        active = self.active.get(robot)
        if key.endswith("/@rpc/describe"):
            document = self._sign_reply(query, describe(robot, active, self._spec.unsigned))
            query.reply(key, document, encoding=zenoh.Encoding.APPLICATION_JSON)
            return
        if not key.endswith("/@rpc/correct"):
            procedure = key.rpartition("/")[2]
            raise QueryError("not_found", f"There is no procedure {procedure!r}: correct and describe are.")
        data = _payload(query)
        session_key = self._session_key(query, data)
        try:
            request = decode_trajectory(sealed.strip_signature(data) if session_key else data)
        except FrameError as error:
            raise QueryError(Status.BAD_FRAME.name, str(error)) from error
        answer = correct_trajectory(request, active)
        if session_key:
            asked = data[-sealed.TAG_BYTES :]
            answer = sealed.sign_frame(answer, sealed.session_id_from_frame(data), session_key, sealed.REPLY, asked)
        query.reply(key, answer, encoding=zenoh.Encoding(ENCODING))

    def _session_key(self, query: zenoh.Query, data: bytes) -> bytes | None:
        """Key of a signed request; None for a plain one, where those are taken."""
        if not sealed.is_signed(data):
            if self._spec.unsigned:
                return None
            raise QueryError(Status.UNSIGNED.name, UNSIGNED)
        stream = query.parameters.get("stream") or ""
        robot = endpoints.robot_from_key(str(query.key_expr))
        key = self._masters.session_key(sealed.session_id_from_frame(data), self._spec.site, robot, stream)
        expires_s = Session(*sealed.ID.unpack(sealed.session_id_from_frame(data))).expires_s
        if key is None or not sealed.fits(key, sealed.QUESTION, data) or expires_s < time.time():
            raise QueryError(
                Status.NO_SESSION.name,
                "The request is not signed with the key of a session that is valid here: name its stream in the selector "
                "(`?stream=main`), or ask the API for a new session.",
            )
        return key

    def _refuse(self, query: zenoh.Query, error: QueryError) -> None:
        document = self._sign_reply(query, json.dumps(error.document).encode())
        query.reply_err(document, encoding=zenoh.Encoding.APPLICATION_JSON)

    def _sign_reply(self, query: zenoh.Query, document: bytes) -> bytes:
        key, data = str(query.key_expr), _payload(query)
        # The tag of a signed request is as good as a nonce: it covers a random sequence number and time.
        question = data[-sealed.TRAILER :] if sealed.is_signed(data) else data
        stream = query.parameters.get("stream")
        return service.reply(
            self._masters, question, key, self._spec.site, endpoints.robot_from_key(key), stream, document
        )

    def _follow(self) -> None:
        """Keep to the supervisor's versions; close the session when it says stop, or is gone."""
        try:
            while True:
                message, *rest = self._pipe.recv()
                if message == "use":
                    self.active[rest[0].robot] = rest[0]
                elif message == "drop":
                    self.active.pop(rest[0], None)
                elif message == "masters":
                    self._masters = rest[0]
                elif message == "stop":
                    return
        except (EOFError, OSError):
            return
        finally:
            close(self._session)


def _payload(query: zenoh.Query) -> bytes:
    return query.payload.to_bytes() if query.payload else b""


def query_main(spec: QuerySpec, pipe: Connection) -> None:
    """Entry of the spawned query process; says ("listening", None, False) when it is reached through the stream's port."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up()
    session = open_inside(spec.private_endpoint, spec.zenoh_config, pipe.poll)
    if session is None:
        return
    with session:
        queries = Queries(session, spec, pipe)
        pipe.send(("listening", None, False))
        queries.run()
