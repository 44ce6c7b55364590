"""Streams as server-sent events: one task and one zenoh session for all who look, and none when nobody does.

Beside it what is known of them at this moment, without waiting for news.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager
from contextvars import Context

from fastapi import FastAPI
from fastapi.concurrency import run_in_threadpool

from kilter_service.ground.db import Database
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream import store
from kilter_service.stream.corrector.endpoints import robot_from_key, stream_from_key
from kilter_service.stream.live.heard import Heard, Reach, RobotShown, Second, bypass
from kilter_service.stream.live.session import LiveSession, Message, open_or_reuse_session, read_corrector_place
from kilter_service.stream.signing.masters import Masters, load_masters

log = logging.getLogger("kilter.api")

PERIOD_S = 0.1
LOOK_S = 1.0  # how often the database and the corrector file are looked at
ALIVE_S = 10.0  # within which a corrector has to have said that it lives
STARTING_S = 3.0
AGAIN_S = 2.0  # what did not change is told again, so that a page knows that its server is there
LONGEST_S = 300.0  # then the browser comes again, and whether it still may is looked up
FORGOTTEN_S = 3600.0
MOST_STREAMS = 64


class Followed:
    """A robot that somebody looks at."""

    def __init__(self) -> None:
        self.followers = 0
        self.streams: dict[str, Heard] = {}
        self.known = store.KnownStreams()
        self.said, self.said_s = "", 0.0
        self._told = asyncio.Event()

    def take_reports(self) -> None:
        """Show what a corrector on another machine says in the database, every two seconds."""
        for report in self.known.reports:
            heard = self.streams.setdefault(report["stream"], Heard())
            heard.take_report(report, time.time_ns(), time.monotonic())

    def publish_news(self, said: str) -> None:
        """Wake all that wait."""
        self.said, self.said_s = said, time.monotonic()
        self._told.set()
        self._told = asyncio.Event()

    async def wait_for_news(self) -> str:
        """Wait for what is to be said next."""
        await self._told.wait()
        return self.said


class Viewers:
    """All who look at streams in this process."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database, self._settings = database, settings
        self._robots: dict[str, Followed] = {}
        self.session: LiveSession | None = None
        self._was_connected = self._here = False
        self._masters: Masters | None = None
        self._began_s = 0.0
        self._task: asyncio.Task[None] | None = None
        self._looking = Failing(log, "the streams that are looked at cannot be looked up")

    async def events(self, robot: str) -> AsyncGenerator[str, None]:
        """Yield what is to be shown of a robot, several times a second while a stream moves."""
        end = time.monotonic() + LONGEST_S
        yield "retry: 1000\n\n"
        with self._following(robot) as followed:
            if followed.said:
                yield _event(followed.said)
            while time.monotonic() < end:
                yield _event(await followed.wait_for_news())

    @contextmanager
    def _following(self, robot: str) -> Iterator[Followed]:
        followed = self._robots.setdefault(robot, Followed())
        followed.followers += 1
        if self._task is None or self._task.done():
            # Without the caller of this request: the task looks at the robots of all callers.
            self._task = asyncio.get_running_loop().create_task(self._watch(), context=Context())
        try:
            yield followed
        finally:
            followed.followers -= 1
            if not followed.followers:
                self._robots.pop(robot, None)

    async def _watch(self) -> None:
        try:
            while self._robots:
                await self._follow_streams()
                await self._leave()  # who comes meanwhile is seen by the loop: this task is not done yet
        finally:
            await self._leave()

    async def _follow_streams(self) -> None:
        self._began_s, looked_s, self._was_connected = time.monotonic(), 0.0, False
        while self._robots:
            if time.monotonic() - looked_s >= LOOK_S:
                looked_s = time.monotonic()
                await self._poll_corrector()
            self._listen()
            await asyncio.sleep(PERIOD_S)

    async def _leave(self) -> None:
        session, self.session = self.session, None
        if session is not None:
            await run_in_threadpool(session.close)

    async def _poll_corrector(self) -> None:
        """Look for the corrector, its keys and the active versions."""
        try:
            self._masters = await run_in_threadpool(load_masters, self._settings.stream_keys_file, False)
        except (ServiceError, OSError):  # no message can be believed; what stands in the database can
            self._masters = None
        try:
            self.session = await run_in_threadpool(open_or_reuse_session, self._settings, self.session)
            found = await run_in_threadpool(_load_robot_states, self._database, list(self._robots))
            self._here = self._settings.corrector_file.exists()
        except Exception as error:  # the database may be away for a while; the followers stay
            self._looking.report_failure(error)
            return
        self._looking.report_success()
        for robot, known in found.items():
            if robot in self._robots:
                self._robots[robot].known = known
                if self.session is None and not self._here:
                    self._robots[robot].take_reports()

    def _listen(self) -> None:
        now_s = time.monotonic()
        for message in self.session.messages() if self.session else ():
            self._accept_message(message, now_s)
        reach = self._reach(now_s)
        for robot, followed in self._robots.items():
            said = self._robot_view(robot, followed, reach, now_s).text()
            if said != followed.said or now_s - followed.said_s >= AGAIN_S:
                followed.publish_news(said)

    def _accept_message(self, message: Message, now_s: float) -> None:
        """Take a message over if it is of a robot that is looked at, and of the corrector."""
        robot, stream = robot_from_key(message.key), stream_from_key(message.key)
        followed = self._robots.get(robot)
        if followed is None or self._masters is None or self.session is None:
            return
        body = self._masters.heard(message.key, self.session.place.site, robot, message.data)
        if body is None:
            return
        if len(followed.streams) >= MOST_STREAMS and stream not in followed.streams:
            followed.streams.pop(next(iter(followed.streams)))
        followed.streams.setdefault(stream, Heard()).accept_message(json.loads(body), now_s)

    def _reach(self, now_s: float) -> Reach:
        connected = self.session is not None and self.session.is_connected
        if connected:
            self._was_connected = True
            return "connected"
        if now_s - self._began_s < STARTING_S and not self._was_connected:
            return "connecting"
        alive = any(followed.known.alive for followed in self._robots.values())
        return "elsewhere" if alive and self.session is None and not self._here else "away"

    async def close(self) -> None:
        """End the task and its session; the process stops."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    def _robot_view(self, robot: str, followed: Followed, reach: Reach, now_s: float) -> RobotShown:
        streams = [heard.stream_view(name, now_s) for name, heard in sorted(followed.streams.items())]
        streams = [stream for stream in streams if stream.seen_s < FORGOTTEN_S]
        streams.sort(key=lambda stream: stream.condition == "silent")  # what moves is first
        since = self.session.place.since if self.session else None
        active = followed.known.active_version
        return RobotShown(robot, reach, since, active, bypass(reach, active, streams, followed.known.twice), streams)


def _load_robot_states(database: Database, robots: list[str]) -> dict[str, store.KnownStreams]:
    found = {}
    with database.reading() as session:
        for robot in robots:
            try:
                found[robot] = store.load_robot_state(session, robot, ALIVE_S)
            except ServiceError:  # it was deleted meanwhile
                continue
    return found


def _event(said: str) -> str:
    return f"event: live\ndata: {said}\n\n"


def get_viewers(app: FastAPI) -> Viewers:
    """Return those who look at streams of an application."""
    if not hasattr(app.state, "viewers"):
        app.state.viewers = Viewers(app.state.database, app.state.settings)
    viewers: Viewers = app.state.viewers
    return viewers


def load_minutes(database: Database, robot: str) -> dict[str, list[Second]]:
    """Return the last minute of each stream of a robot, as the correctors last reported it, by the stream's name.

    Raises:
        ServiceError: no such robot.

    """
    with database.reading() as session:
        known = store.load_robot_state(session, robot, ALIVE_S)
    found = {}
    for report in known.reports:
        heard = Heard()
        heard.take_report(report, time.time_ns(), time.monotonic())
        found[report["stream"]] = heard.minute()
    return found


def load_robot_view(database: Database, settings: Settings, robot: str) -> RobotShown:
    """Return what the corrector last said in the database, every two seconds.

    Raises:
        ServiceError: no such robot.

    """
    with database.reading() as session:
        known = store.load_robot_state(session, robot, ALIVE_S)
    streams = []
    for report in known.reports:
        heard = Heard()
        heard.take_report(report, time.time_ns(), time.monotonic())
        streams.append(heard.stream_view(report["stream"], time.monotonic()))
    place = read_corrector_place(settings.corrector_file)
    reach: Reach = "away" if not known.alive and place is None else "connecting"
    since = place.since if place else None
    why = bypass(reach, known.active_version, streams, known.twice)
    return RobotShown(robot, reach, since, known.active_version, why, streams)
