"""The real processes on loopback: stream, queries, announcements, restart."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from kilter_client.stream import CorrectedStream, Statistics, StreamError, corrected
from kilter_core.correct.program import Track, compile_program
from kilter_core.model import Calibration
from kilter_service.ground.child_process import running
from kilter_service.stream.corrector import fork_server, wire
from kilter_service.stream.corrector.fork_server import ForkedChild
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.queries import encode_trajectory
from kilter_service.stream.corrector.session import QuerySpec, config
from kilter_service.stream.signing.masters import Masters
from tests.corrector.live import ROBOT, ROOT, Q, open_stream, until
from tests.corrector.stored import descendants


def peer(corrector: Corrector) -> zenoh.Session:
    return zenoh.open(config("tcp/127.0.0.1:0", tuple(corrector.endpoints.values())))


def ask(session: zenoh.Session, key: str, payload: bytes = b"") -> zenoh.Reply:
    """The answer to a query, asked again while the session is still connecting."""
    answers: list[zenoh.Reply] = []

    def answered() -> bool:
        answers.extend(session.get(key, payload=payload, timeout=5.0))
        return bool(answers)

    until(answered)
    return answers[0]


def test_a_circle_comes_back_corrected(corrector: Corrector, katana: Calibration) -> None:
    phase = np.linspace(0, 2 * math.pi, 200)
    path = np.array(Q) + 0.1 * np.column_stack([np.sin(phase * k) for k in (1, 1, 2, 1, 1)])
    statistics = Statistics()
    out = list(
        corrected(
            path.tolist(), ROBOT, data=corrector.file.parent, stream="circle", deadline_s=2.0, settled=True,
            statistics=statistics,
        )
    )  # fmt: skip
    assert [setpoint.source for setpoint in out] == ["corrected"] * len(path)
    assert statistics.corrected == statistics.sent == len(path)
    assert not statistics.refused
    first = Track(compile_program(katana), settled=True)
    first.step(path[0].copy(), 1, 0.0)
    assert np.array_equal(out[0], first.out)
    assert max(abs(d) for setpoint in out for d in setpoint.delta) > 1e-4


def test_a_paced_stream_sends_every_setpoint(corrector: Corrector) -> None:
    statistics = Statistics()
    options = {"data": corrector.file.parent, "stream": "paced", "deadline_s": 2.0, "settled": True}
    out = list(corrected([Q] * 50, ROBOT, period_s=0.004, statistics=statistics, **options))
    assert len(out) == statistics.sent == 50


def test_a_chunk_comes_back_in_one_frame(corrector: Corrector) -> None:
    with open_stream(corrector, "chunk") as stream:
        answer = stream.correct_chunk([Q] * 100, 0.002)
    assert answer is not None
    assert (answer.status, answer.joints, len(answer.q)) == ("OK", 5, 500)


def test_streams_in_any_order_get_their_own_answers(corrector: Corrector) -> None:
    rng = np.random.default_rng(5)
    names, heard = ["a", "b", "c", "d"], list[tuple[str, bytes]]()
    rests = {name: np.array(Q) + 0.05 * k for k, name in enumerate(names)}
    seq = dict.fromkeys(names, 0)
    with peer(corrector) as session:
        session.declare_subscriber(
            f"{ROOT}/stream/*/out", lambda sample: heard.append((str(sample.key_expr), sample.payload.to_bytes()))
        )
        publishers = {name: session.declare_publisher(f"{ROOT}/stream/{name}/in") for name in names}
        until(lambda: all(publisher.matching_status.matching for publisher in publishers.values()))
        # in turn, so that each follows another, then as it comes
        order = names * 30 + [names[k] for k in rng.integers(0, 4, 200)]
        for sent, name in enumerate(order, 1):
            seq[name] += 1
            flags = wire.Flag.RESET | wire.Flag.SETTLED if seq[name] == 1 else 0
            now = time.monotonic_ns()
            publishers[name].put(wire.encode_setpoints(
                rests[name][None], joints=5, seq=seq[name], t_send_ns=now, t_apply_ns=0, flags=flags,
            ))  # fmt: skip
            until(lambda sent=sent: len(heard) == sent)  # type: ignore[misc]
    for key, data in heard:
        name, answer = key.split("/")[-2], wire.decode_answer(data)
        assert answer.status in (wire.Status.OK, wire.Status.STALE)  # a loaded machine may be late
        if answer.status == wire.Status.OK:
            assert np.abs(answer.values[0] - rests[name]).max() < 0.02
    assert [key.split("/")[-2] for key, _ in heard] == order


def test_a_refused_setpoint_holds_the_last_correction_then_bypasses(corrector: Corrector) -> None:
    with open_stream(corrector, "hold", hold_cycles=3, release_s=1e9) as stream:
        good = stream.correct(Q)
        beyond = (0.1, 9.0, 0.4, 0.3, 0.2)
        after = [stream.correct(beyond) for _ in range(5)]
        back = stream.correct(Q)
    assert [setpoint.source for setpoint in after] == ["held"] * 3 + ["bypass"] * 2
    assert {setpoint.status for setpoint in after} == {"JOINT_LIMIT"}
    for setpoint in after:
        assert np.allclose(setpoint.delta, good.delta, rtol=0, atol=1e-9)
    assert (back.source, back.left_mm) == ("slowed", None)  # it fades in, for a very long time here
    assert max(map(abs, back.lag)) < 1e-7  # from the correction that was held
    assert stream.statistics.refused == {"JOINT_LIMIT": 5}


def test_the_version_is_announced_followed_and_withdrawn(
    corrector: Corrector, source: object, calibration_of: Callable[..., Calibration], active_of: Callable[..., object]
) -> None:
    old = source.versions[ROBOT]  # type: ignore[attr-defined]
    new = active_of(calibration_of(ROBOT, seed=3), epoch=old.epoch + 1, ramp_s=0.05)
    with open_stream(corrector, "follow") as stream:
        assert stream.active is not None
        assert stream.active["epoch"] == old.epoch
        stream.correct(Q)
        source.use(new)  # type: ignore[attr-defined]
        corrector.poll()
        until(lambda: stream.active is not None and stream.active["epoch"] == old.epoch + 1)
        assert stream.correct(Q).source == "corrected"
        source.withdraw(ROBOT)  # type: ignore[attr-defined]
        corrector.poll()
        until(lambda: stream.active is None)
        assert stream.correct(Q).status == "NO_VERSION"
        with pytest.raises(StreamError, match="knows no active version of a robot 'katana450-chapter4'"):
            open_stream(corrector, "early", connect_timeout_s=3.0).__enter__()
        source.use(active_of(calibration_of(ROBOT), epoch=old.epoch + 2, ramp_s=0.05))  # type: ignore[attr-defined]
        corrector.poll()
        until(lambda: stream.active is not None)
        assert stream.correct(Q).status == "OK"


def test_the_stream_outlives_the_database(corrector: Corrector, source: object) -> None:
    with open_stream(corrector, "database") as stream:
        source.fails = True  # type: ignore[attr-defined]
        try:
            corrector.poll()
            assert stream.correct(Q).source == "corrected"
        finally:
            source.fails = False  # type: ignore[attr-defined]


def test_status_is_published(corrector: Corrector) -> None:
    with peer(corrector) as session, open_stream(corrector, "status") as stream:
        heard: list[dict[str, object]] = []
        with session.declare_subscriber(f"{ROOT}/stream/status/status", zenoh.handlers.RingChannel(8)) as subscriber:

            def listen() -> bool:
                stream.correct(Q)
                sample = subscriber.handler.try_recv()
                if sample is not None:
                    heard.append(json.loads(sample.payload.to_bytes()))
                return bool(heard)

            until(listen)
    assert heard[0]["last_status"] == "OK"
    assert heard[0]["instance"] == corrector.instance


def test_the_supervisor_knows_what_its_streams_count(corrector: Corrector) -> None:
    known: dict[str, dict[str, Any]] = {}
    with open_stream(corrector, "counted") as stream:

        def told() -> bool:
            stream.correct(Q)
            corrector.poll()
            known.update({one["stream"]: one for one in corrector.details["streams"]})
            return "counted" in known

        until(told)
    assert known["counted"]["robot"] == ROBOT
    assert known["counted"]["counters"]["OK"] >= 1
    assert sum(known["counted"]["by_time"]) >= 1
    json.dumps(corrector.details)


def test_a_trajectory_by_query_equals_the_kernel(corrector: Corrector, source: object) -> None:
    t = np.arange(1000) * 0.002
    q = np.array(Q) + 0.2 * np.sin(t)[:, None]
    with peer(corrector) as session:
        reply = ask(session, f"{ROOT}/@rpc/correct", encode_trajectory(t, q, joints=5))
    assert reply.ok is not None
    data = reply.ok.payload.to_bytes()
    numbers = np.frombuffer(data, offset=wire.HEADER.size + wire.VERDICT.size + wire.BLOCK.size)
    track = Track(source.versions[ROBOT].program, settled=True)  # type: ignore[attr-defined]
    done, out, _, _ = track.follow(q, 1, np.diff(t, prepend=t[:1]))
    assert done == len(t)
    assert np.array_equal(numbers[: len(t)], t)
    assert np.array_equal(numbers[len(t) :].reshape(-1, 5), out)


def test_a_bad_trajectory_names_its_first_bad_point(corrector: Corrector) -> None:
    t = np.arange(10) * 0.002
    q = np.tile(Q, (10, 1))
    q[6, 1] = 9.0
    with peer(corrector) as session:
        reply = ask(session, f"{ROOT}/@rpc/correct", encode_trajectory(t, q, joints=5))
        assert reply.err is not None
        refused = json.loads(reply.err.payload.to_bytes())
        assert (refused["code"], refused["first_bad_index"], refused["joints"]) == ("JOINT_LIMIT", 6, [2])
        reply = ask(session, f"{ROOT}/@rpc/correct", b"KLT1 and rubbish")
        assert reply.err is not None
        assert json.loads(reply.err.payload.to_bytes())["code"] == "BAD_FRAME"


def test_the_robot_is_described(corrector: Corrector) -> None:
    with peer(corrector) as session:
        reply = ask(session, f"{ROOT}/@rpc/describe")
    assert reply.ok is not None
    document = json.loads(reply.ok.payload.to_bytes())
    active = document["active"]
    assert active["held_rows"] == ["x", "y", "z"]
    assert document["statuses"]["OK"] == 0
    assert (document["flags"]["SATURATED"], document["flags"]["SLOWED"]) == (0x2000, 0x4000)
    assert (active["task"], active["at_limit"], active["largest_deg"], active["largest_mm"]) == (
        "position",
        "saturate",
        1.0,
        5.0,
    )
    assert (active["rate_deg_s"], active["acceleration_deg_s2"]) == (5.0, 250.0)
    assert (active["rate_mm_s"], active["acceleration_mm_s2"]) == (None, None)  # no prismatic joint
    assert len(active["levers_mm"]) == 5
    assert document["workspace"] is None  # nothing was stored of it


def test_malformed_frames_get_no_numbers_and_stop_nothing(corrector: Corrector) -> None:
    with peer(corrector) as session, open_stream(corrector, "rubbish") as stream:
        with session.declare_subscriber(f"{ROOT}/stream/rubbish2/out", zenoh.handlers.FifoChannel(100)) as answers:
            publisher = session.declare_publisher(f"{ROOT}/stream/rubbish2/in")
            until(lambda: publisher.matching_status.matching)
            for data in (b"", b"KLT1", b"KLT1" + bytes(28), b"KLT1" + bytes(60), os.urandom(200)):
                publisher.put(data)
            session.put(f"{ROOT}/stream/{'x' * 200}/in", b"KLT1")

            def refused() -> bool:
                sample = answers.handler.try_recv()
                return sample is not None and wire.decode_answer(sample.payload.to_bytes()).values.size == 0

            until(refused)
        assert stream.correct(Q).source == "corrected"


def test_the_stream_comes_back_after_kill_9(corrector: Corrector) -> None:
    with open_stream(corrector, "kill", hold_cycles=2) as stream:
        stream.correct(Q)
        pid = corrector._children["stream"].pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        until(lambda: not stream.alive)
        stream.deadline_s = 0.05
        gone = [stream.correct(Q).source for _ in range(4)]
        assert gone == ["held", "held", "bypass", "bypass"]
        until(lambda: not corrector._children["stream"].alive)
        corrector.poll()
        stream.deadline_s = 2.0
        until(lambda: stream.alive)
        until(lambda: stream.correct(Q).source == "corrected")


def test_the_stream_outlives_the_process_that_forked_it(corrector: Corrector) -> None:
    origin = corrector._fork_server
    with open_stream(corrector, "orphan") as stream:
        before = {name: child.pid for name, child in corrector._children.items()}
        assert len({*before.values(), origin.pid, os.getpid()}) == 4
        os.kill(origin.pid or 0, signal.SIGKILL)
        until(lambda: not origin.alive)
        assert stream.correct(Q).source == "corrected"
        corrector.poll()
        assert origin.alive
        assert {name: child.pid for name, child in corrector._children.items()} == before
        assert stream.correct(Q).source == "corrected"


def test_one_forked_ahead_ends_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    server = fork_server.ForkServer()
    server.start()
    pipe = server._fork()
    until(pipe.poll)  # it has told its id: nobody reads it, so that the pipe is reset and not only closed
    pipe.close()
    until(lambda: not descendants(server.pid or 0))
    server.stop()
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("ends", [False, True], ids=["stays frozen", "is killed then"])
def test_a_frozen_fork_server_does_not_hold_up_a_stream_that_was_killed(
    corrector: Corrector, monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    monkeypatch.setattr(fork_server, "STOPPED_S", 20.0 if ends else 0.5)
    monkeypatch.setattr(fork_server, "FORK_S", 20.0)  # of the next one: this machine may be busy
    frozen = corrector._fork_server.pid or 0
    corrector._fork_server._drop_spare()  # or, where it is ready by now, the fork server is not asked at all
    stream = corrector._children["stream"]
    with open_stream(corrector, "nursery", deadline_s=0.5) as line:
        os.kill(frozen, signal.SIGSTOP)
        until(lambda: not running(frozen))
        os.kill(stream.pid or 0, signal.SIGKILL)
        until(lambda: not stream.alive)
        killer = threading.Timer(0.3, os.kill, (frozen, signal.SIGKILL))
        if ends:
            killer.start()
        corrector.poll()
        killer.cancel()
        assert corrector._fork_server.pid != frozen
        until(lambda: line.correct(Q).source == "corrected")


def test_a_fork_server_that_is_frozen_is_replaced_before_it_is_needed(
    corrector: Corrector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fork_server, "STOPPED_S", 0.2)
    frozen, before = corrector._fork_server.pid or 0, {name: child.pid for name, child in corrector._children.items()}
    os.kill(frozen, signal.SIGSTOP)
    until(lambda: corrector.poll() or corrector._fork_server.pid != frozen)  # type: ignore[func-returns-value]
    assert corrector._fork_server.alive
    assert {name: child.pid for name, child in corrector._children.items()} == before


def test_the_corrector_says_that_a_process_of_its_own_is_frozen(
    corrector: Corrector, caplog: pytest.LogCaptureFixture
) -> None:
    pid = corrector._children["query"].pid or 0
    os.kill(pid, signal.SIGSTOP)
    until(lambda: not running(pid))
    corrector.poll()
    assert f"query is frozen (SIGSTOP or a debugger): `kill -CONT {pid}` lets it go on" in caplog.text
    os.kill(pid, signal.SIGCONT)
    until(lambda: running(pid))
    corrector.poll()
    assert "query goes on" in caplog.text
    assert corrector._children["query"].pid == pid


def test_one_that_may_not_begin_is_told_apart_from_one_that_runs(corrector: Corrector) -> None:
    spec = QuerySpec("test", "", Masters(()), unsigned=True)
    child = ForkedChild("broken", "kilter_service.stream.corrector.session:nothing", spec, corrector._fork_server)
    assert not child.alive
    child.start()
    with pytest.raises(RuntimeError, match="The broken process of the corrector did not start"):
        child.listening()
    assert not child.alive
    child.start()
    child.stop()
    assert not child.alive


LEFT_OPEN = """
import sys
from pathlib import Path
from kilter_client.stream import CorrectedStream
stream = CorrectedStream("katana450-chapter4", data=Path(sys.argv[1]), stream="left", deadline_s=2.0).__enter__()
print(stream.correct([0.1, 0.6, 0.4, 0.3, 0.2]).source, "numpy" in sys.modules)
"""


def test_a_stream_left_open_does_not_keep_its_process(corrector: Corrector, tmp_path: Path) -> None:
    script = tmp_path / "left.py"
    script.write_text(LEFT_OPEN)
    done = subprocess.run(
        [sys.executable, str(script), str(corrector.file.parent)],
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stdout.split() == ["corrected", "False"]


def test_without_a_corrector_the_remedy_is_named(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="kilterd serve"):
        CorrectedStream(ROBOT, data=tmp_path)


def test_a_robot_without_a_version_is_told_from_a_corrector_out_of_reach(corrector: Corrector) -> None:
    given = {"stream": "nobody", "connect_timeout_s": 3.0, "site": "test"}
    endpoints = list(corrector.endpoints.values())
    with (
        pytest.raises(StreamError, match="knows no active version of a robot 'nobody': activate one with `kilter"),
        CorrectedStream("nobody", endpoints=endpoints, **given),  # type: ignore[arg-type]
    ):
        pass
    given |= {"site": "elsewhere", "connect_timeout_s": 1.0}
    with (
        pytest.raises(StreamError, match="does not answer: is `kilterd serve` up, and its site 'elsewhere'"),
        CorrectedStream(ROBOT, endpoints=endpoints, **given),  # type: ignore[arg-type]
    ):
        pass


def test_stopping_removes_the_file_and_ends_both_processes(
    tmp_path: Path, source: object, corrector: Corrector
) -> None:
    other = Corrector(corrector._settings.model_copy(update={"data": tmp_path}), source)  # type: ignore[arg-type]
    other.start()
    pids = [child.pid for child in other._children.values()]
    other.stop()
    assert not other.file.exists()
    for pid in pids:
        assert pid is not None
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
