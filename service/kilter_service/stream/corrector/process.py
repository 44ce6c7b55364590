"""`kilterd corrector`: supervises the stream process and the query process, and follows the active versions.

Of its processes only this one reads the database, so a slow or absent database never touches a setpoint: the stream
goes on with the version in use.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
import select
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from kilter_service.ground.child_process import running, stop_event
from kilter_service.ground.correction_limits import sentence
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.active import Active, DatabaseSource, VersionSource
from kilter_service.stream.corrector.endpoints import PrivateSocket, check_listening, is_local
from kilter_service.stream.corrector.fork_server import POLL_S, ForkedChild, ForkServer, StoppedError
from kilter_service.stream.corrector.session import QUERY, STREAM, QuerySpec, Rules, StreamSpec, take_over
from kilter_service.stream.signing.masters import Masters, load_masters
from kilter_service.web.pulse import Pulse

log = logging.getLogger("kilter.corrector")

CORRECTOR_FILE = "corrector.json"
MOST_STREAMS = 200


class Corrector:
    """Both processes and the versions they use, from :meth:`start` to :meth:`stop`."""

    def __init__(
        self,
        settings: Settings,
        source: VersionSource,
        rules: Rules | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._settings = settings
        self._stopped = stopped
        self._source = source
        self._rules = rules or Rules()
        self._stamp: Hashable = object()
        self._active: dict[str, Active] = {}
        self._looking = Failing(log, "the active versions cannot be read; the versions in use stay")
        self.instance = f"{os.getpid()}-{secrets.token_hex(4)}"
        self.endpoints: dict[str, str] = {}
        self._fork_server = ForkServer()
        self._children: dict[str, ForkedChild] = {}
        self._private: PrivateSocket | None = None
        self._announced = False
        self._told: dict[str, int | None] = {}
        self._masters: Masters | None = None
        self._keys_readable = True
        self._unsigned = settings.stream_unsigned and is_local(settings.zenoh_listen)
        self._streams: dict[tuple[str, str], dict[str, Any]] = {}

    @property
    def details(self) -> dict[str, Any]:
        """What the streams have last said of themselves, for the metrics."""
        return {"streams": list(self._streams.values())}

    @property
    def file(self) -> Path:
        """Where clients on this machine find the endpoints."""
        return self._settings.data / CORRECTOR_FILE

    def start(self) -> None:
        """Start both processes, write the corrector file and take over the active versions.

        Raises:
            ServiceError: the endpoint may not be listened on.

        """
        check_listening(self._settings)
        self._fork_server.start()  # it imports meanwhile
        site, config = self._settings.site, self._settings.zenoh_config
        keys = self._settings.stream_keys_file
        masters = self._masters = load_masters(keys)
        again = self._endpoint_before()

        def make_stream_spec(private: str) -> StreamSpec:
            listen, rules = self._settings.zenoh_listen, self._rules
            return StreamSpec(site, self.instance, listen, private, masters, self._unsigned, config, rules, keys, again)

        found = take_over(self.file, make_stream_spec(""))
        self._private = PrivateSocket(self._settings.data, found.spec.private_endpoint if found else None)
        stream = replace(found.spec, again=found.endpoint) if found else make_stream_spec(self._private.endpoint)
        queries = QuerySpec(site, self._private.endpoint, masters, self._unsigned, config)
        self._children = {
            "stream": ForkedChild("stream", STREAM, stream, self._fork_server, found),
            "query": ForkedChild("query", QUERY, queries, self._fork_server),
        }
        if found:
            self.instance, self._active = found.spec.instance, dict(found.active)
            log.info("the stream process %d, which went on alone, is taken over", found.pid)
        else:
            self._children["stream"].start()
        self._children["query"].start()
        self._poll_activations()  # while they import; they get what it finds when they listen
        if found:
            self.endpoints["stream"] = found.endpoint
            self._children["stream"].send("masters", self._masters)
        else:
            self._take_child("stream")
        self._take_child("query")

    def _endpoint_before(self) -> str | None:
        """Where a corrector that was killed listened."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            return str(json.loads(self.file.read_text(encoding="utf-8"))["endpoints"]["stream"])
        return None

    def _take_child(self, name: str) -> None:
        endpoint, real_time = self._children[name].listening(self._stopped)
        # Queries go through the stream's port.
        self.endpoints[name] = endpoint or self.endpoints["stream"]
        log.info("%s process is at %s%s", name, self.endpoints[name], ", real-time priority" if real_time else "")
        self._write_file()  # first: whoever serves must be found
        self._children[name].send("masters", self._masters)  # they may have been rotated since its first start
        for active in self._active.values():
            self._children[name].send("use", active)

    def _write_file(self) -> None:
        document = {
            "pid": os.getpid(),
            "site": self._settings.site,
            "instance": self.instance,
            "endpoints": self.endpoints,
            "stream_keys": str(self._settings.stream_keys_file),
            "unsigned": self._unsigned,
            "zenoh_config": str(self._settings.zenoh_config) if self._settings.zenoh_config else None,
            "private": self._private.endpoint if self._private else None,
            "processes": self._processes,
        }
        self._told = self._processes
        self._settings.data.mkdir(parents=True, exist_ok=True)
        part = self.file.with_suffix(".part")
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        part.replace(self.file)
        self._announced = True

    @property
    def _processes(self) -> dict[str, int | None]:
        """Their process ids, for whoever looks at them from outside."""
        above = {"nursery": self._fork_server.pid, "spare": self._fork_server.spare_pid}
        return above | {name: child.pid for name, child in self._children.items()}

    @property
    def well(self) -> bool:
        """Whether both processes run and were not stopped from outside."""
        return all(child.alive and running(child.pid) for child in self._children.values())

    def poll(self) -> None:
        """Look once: restart what died, take over what was activated."""
        self._fork_server.start()
        self._fork_server.keep_spare()
        for name, child in self._children.items():
            if child.watch():
                self._take_child(name)
        if self._processes != self._told:
            self._write_file()
        for _, documents in self._children["stream"].heard():
            self._note(documents)
        self._follow_masters()
        self._poll_activations()

    def _note(self, documents: list[dict[str, Any]]) -> None:
        for document in documents:
            place = (document["robot"], document["stream"])
            self._streams.pop(place, None)
            self._streams[place] = document
        while len(self._streams) > MOST_STREAMS:  # whoever sends chooses the names
            del self._streams[next(iter(self._streams))]

    def _follow_masters(self) -> None:
        """Take a rotated master secret over; whatever the file says, sessions of those in use stay valid."""
        try:
            masters = load_masters(self._settings.stream_keys_file, make=False)
        except (ServiceError, OSError) as error:
            if self._keys_readable:
                log.error("the secrets of the stream cannot be read, those in use stay: %s", error)
            self._keys_readable = False
            return
        self._keys_readable = True
        if masters != self._masters:
            self._masters = masters
            self._send_all("masters", masters)
            log.info("secrets of the stream: %d are valid, %d sessions revoked", len(masters.all), len(masters.revoked))

    def _poll_activations(self) -> None:
        """Take over what was activated."""
        try:
            stamp = self._source.stamp()
            # None: a server that starts migrates, and nothing is known yet. A stream that went on alone keeps what it has.
            if stamp is not None and stamp != self._stamp:
                self._take_over(self._source.load())
                self._stamp = stamp
            self._looking.report_success()
        except Exception as error:  # whatever the database says, the stream continues with what it has
            self._looking.report_failure(error)

    def _take_over(self, versions: Mapping[str, Active]) -> None:
        for robot in [robot for robot in self._active if robot not in versions]:
            del self._active[robot]
            self._send_all("drop", robot)
        for robot, active in versions.items():
            known = self._active.get(robot)
            if known is not None and (known.epoch, known.number) == (active.epoch, active.number):
                continue
            self._active[robot] = active
            self._send_all("use", active)
            if active.program.unsupported:
                said = sentence(active.program.unsupported, active.program.where_stated)
                log.warning("version %s of %s: %s", active.version_id, robot, said)
            log.info("robot %s follows version %s, epoch %d", robot, active.version_id, active.epoch)

    def _send_all(self, *message: Any) -> None:
        for child in self._children.values():
            if child.listens:
                child.send(*message)

    def wait_for_child_exit(self, seconds: float) -> None:
        """Sleep, and wake at once when a process has ended: each millisecond is one that an arm is not corrected for."""
        ended = select.poll()
        for child in self._children.values():
            if child.pipe is not None:
                ended.register(child.pipe, 0)
        ended.poll(timedelta(seconds=seconds) / timedelta(milliseconds=1))

    def leave(self) -> None:
        """End, and leave the stream as it is: another corrector takes it over."""
        self._fork_server.close()
        if self._private is not None:
            self._private.leave()
        self._source.close()

    def stop(self) -> None:
        """Stop both processes and remove the corrector file."""
        for child in self._children.values():
            child.stop()
        self._fork_server.close()
        if self._private is not None:
            self._private.close()
        if self._announced:  # a corrector that could not start leaves the file of the one that runs alone
            self.file.unlink(missing_ok=True)
        self._source.close()


def run(settings: Settings, deserted: Callable[[], bool] = lambda: False) -> None:
    """Correct until SIGTERM or Ctrl-C; the stream goes on alone when whoever started this process was killed (``deserted``)."""
    stopped = stop_event()
    corrector = Corrector(
        settings, DatabaseSource(settings.database, settings.temperature_c, settings.data), stopped=stopped.is_set
    )
    try:
        corrector.start()
        with Pulse(settings, "corrector", settings.site, lambda: corrector.well, lambda: corrector.details) as pulse:
            while not stopped.is_set():
                corrector.poll()
                pulse.round()
                corrector.wait_for_child_exit(POLL_S)
    except StoppedError:
        log.info("stopped before the stream was up")
    finally:
        if deserted():
            corrector.leave()
        else:
            corrector.stop()
