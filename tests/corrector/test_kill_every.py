"""A short campaign of kills under a moving arm; ``tools.lab kills-stream`` runs 200 at 1 kHz and prints milliseconds."""

from __future__ import annotations

import json
import os
import signal
import socket
from pathlib import Path

import pytest

from kilter_client.stream import CorrectedStream
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.process import Corrector
from tests.corrector.kill_every import Pace, campaign
from tests.corrector.live import ROBOT, Q, open_stream, until


@pytest.mark.timeout(600)  # a machine with other work restarts a server slowly
def test_an_arm_is_corrected_on_while_what_is_above_its_stream_is_killed(tmp_path: Path) -> None:
    done = campaign(tmp_path, 3, print, Pace(0.005, 6.0))  # patient: nothing here depends on being fast
    lost = {kill.victim: kill for kill in done.kills}
    assert lost.keys() == {"corrector", "stream", "supervisor"}
    assert lost["corrector"].bypass_s == lost["supervisor"].bypass_s == 0.0
    # For a moment nobody is there; what this moment lasts is for python -m tools.lab kills-stream.
    assert lost["stream"].held_s + lost["stream"].bypass_s > 0.0
    assert done.largest_step <= 1.0
    assert done.last == "corrected"


def deserted(made: Corrector) -> int:
    """Let a corrector end as one that was killed does; the process id of its stream."""
    pid = made._children["stream"].pid or 0
    made._children["query"].stop()
    made.leave()
    made._children["stream"]._pipe.close()  # type: ignore[union-attr]
    return pid


def test_a_stream_that_went_on_alone_is_taken_over_with_its_versions(source: object, tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", site="test")
    version = source.versions[ROBOT]  # type: ignore[attr-defined]
    first = Corrector(settings, source)  # type: ignore[arg-type]
    first.start()
    with open_stream(first, "alone", connect_timeout_s=60.0) as stream:
        assert stream.correct(Q).source == "corrected"
        pid = deserted(first)
        assert stream.correct(Q).source == "corrected"
        source.fails = True  # type: ignore[attr-defined]  # the next one cannot read what is active
        second = Corrector(settings, source)  # type: ignore[arg-type]
        try:
            second.start()
            assert second._children["stream"].pid == pid
            assert second.endpoints == first.endpoints
            second.poll()
            assert stream.correct(Q).source == "corrected"
            source.fails = False  # type: ignore[attr-defined]
            source.withdraw(ROBOT)  # type: ignore[attr-defined]  # what was withdrawn meanwhile is not corrected on
            second.poll()
            until(lambda: stream.active is None)
        finally:
            second.stop()
            source.fails = False  # type: ignore[attr-defined]
            source.use(version)  # type: ignore[attr-defined]
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_stream_for_other_settings_ends_when_the_next_corrector_comes(source: object, tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", site="test")
    first = Corrector(settings, source)  # type: ignore[arg-type]
    first.start()
    pid = deserted(first)
    second = Corrector(settings.model_copy(update={"stream_unsigned": False}), source)  # type: ignore[arg-type]
    try:
        second.start()
        assert second._children["stream"].pid != pid
        until(lambda: not Path(f"/proc/{pid}").exists())
        assert second.endpoints["stream"] == first.endpoints["stream"]  # clients find it where it was
    finally:
        second.stop()


def test_a_controller_reads_the_address_again(source: object, tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", site="test")
    first = Corrector(settings, source)  # type: ignore[arg-type]
    first.start()
    with CorrectedStream(
        ROBOT, data=tmp_path, stream="moved", deadline_s=2.0, settled=True, connect_timeout_s=60.0
    ) as stream:
        until(lambda: stream.correct(Q).source == "corrected")
        before = first.endpoints["stream"]
        os.kill(first._children["stream"].pid or 0, signal.SIGKILL)
        first._children["stream"].stop()
        first.leave()
        with socket.create_server(("127.0.0.1", int(before.rpartition(":")[2]))):  # somebody else took its port
            second = Corrector(settings, source)  # type: ignore[arg-type]
            try:
                second.start()
                assert json.loads(second.file.read_text())["endpoints"]["stream"] != before
                until(lambda: stream.correct(Q).source == "corrected", 30)
            finally:
                second.stop()


def test_a_stream_that_went_on_alone_is_corrected_on_while_a_database_migrates(source: object, tmp_path: Path) -> None:
    """Whoever starts a server migrates first: for so long nobody knows what is active, and nothing may be dropped."""
    settings = Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", site="test")
    first = Corrector(settings, source)  # type: ignore[arg-type]
    first.start()
    with open_stream(first, "migrating", connect_timeout_s=60.0) as stream:
        assert stream.correct(Q).source == "corrected"
        deserted(first)

        class Migrating:
            def stamp(self) -> None:
                return None

            def load(self) -> dict[str, object]:
                return {}

            def close(self) -> None:
                """It holds nothing."""

        second = Corrector(settings, Migrating())  # type: ignore[arg-type]
        try:
            second.start()
            second.poll()
            assert [stream.correct(Q).source for _ in range(20)] == ["corrected"] * 20
        finally:
            second.stop()
