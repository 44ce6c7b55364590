"""What breaks while an arm moves: processes killed or stopped, the router, the network, the database, the start itself."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zenoh

from kilter_client.stream import CorrectedStream
from kilter_core.model import Calibration
from kilter_service.ground.settings import DATABASE_FILE, Settings
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import config
from kilter_service.stream.corrector.wire import Flag, Status
from tests.corrector.live import ROBOT, ROOT, Line, Q, on_time, open_stream, point, until
from tests.corrector.stored import descendants, store_active
from tests.service.forked import ForkedPopen, children_of

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def max_age_s() -> float:
    """Shorter than a stop that leaves the link as it is."""
    return 0.2


def test_killed_in_motion_it_is_noticed_before_the_deadline_and_comes_back(corrector: Corrector) -> None:
    """Notice, hold, bypass, back: in that order. The deadline of a minute shows that liveliness ends the wait."""
    sources: list[str] = []
    with open_stream(corrector, "killed", deadline_s=60.0, hold_cycles=3) as stream:
        for k in itertools.count():
            if k == 20:
                os.kill(corrector._children["stream"].pid or 0, signal.SIGKILL)
                until(lambda: not stream.alive)
                supervisor = threading.Thread(target=corrector.poll)
                until(lambda: not corrector._children["stream"].alive)
            sources.append(stream.correct([x + 1e-4 * k for x in Q]).source)
            if k == 26:
                supervisor.start()
                supervisor.join()
                until(lambda: stream.alive)
                deadline = time.monotonic() + 60.0
            if k > 26:
                if sources[-1] == "corrected":
                    break
                assert time.monotonic() < deadline
                time.sleep(0.001)
    order = [source for source, _ in itertools.groupby(sources)]
    assert order == ["corrected", "held", "bypass", "slowed", "corrected"]  # fades in again, and says so
    assert sources.count("held") == 3


def seq_of_fresh_answer(line: Line, seq: int, flags: int = 0) -> int:
    """Return the first sequence number that is answered OK: a busy machine may keep a setpoint longer than it may live."""
    for k in range(seq, seq + 100):
        answer = line.ask(point(k, flags))
        if answer.status == Status.OK:
            return k
        assert answer.status == Status.STALE
    raise AssertionError("no setpoint is young enough")


def test_a_burst_after_the_corrector_was_stopped_is_stale(corrector: Corrector) -> None:
    """SIGSTOP of the peer for longer than a setpoint may live; what waited meanwhile comes back without numbers."""
    pid = corrector._children["stream"].pid
    assert pid is not None
    with Line(tuple(corrector.endpoints.values()), "stopped") as line:
        first = seq_of_fresh_answer(line, 1, Flag.RESET | Flag.SETTLED)
        os.kill(pid, signal.SIGSTOP)
        try:
            for seq in range(first + 1, first + 39):
                line.send(point(seq))
            time.sleep(0.4)  # shorter than the lease, so the link stays; twice as long as a setpoint lives
        finally:
            os.kill(pid, signal.SIGCONT)
        late = line.take(38)
        assert {answer.status for answer in late} == {Status.STALE}
        assert all(answer.values.size == 0 for answer in late)
        assert seq_of_fresh_answer(line, first + 39)


STOPPED_S = 8.0  # eight leases: the link is given up and made anew


@pytest.mark.slow
def test_a_corrector_stopped_for_eight_seconds_is_bypassed_and_found_again(corrector: Corrector) -> None:
    """What it was sent before it hung may come back in a burst; the arm is never told to go where it was."""
    pid = corrector._children["stream"].pid or 0
    sources: list[str] = []
    with ExitStack() as stack, open_stream(corrector, "hung", deadline_s=0.05, hold_cycles=3) as stream:
        begin = time.monotonic()
        stopped = False
        while time.monotonic() - begin < STOPPED_S + 22.0:
            now = time.monotonic() - begin
            if not stopped and now > 1.0:
                os.kill(pid, signal.SIGSTOP)
                stopped = True
                stack.callback(os.kill, pid, signal.SIGCONT)
            if now > 1.0 + STOPPED_S:
                os.kill(pid, signal.SIGCONT)
            wanted = [x + 0.04 * now for x in Q[:1]] + list(Q[1:])
            answer = stream.correct(wanted)
            sources.append(answer.source)
            # 0.02 rad are half a second of this motion, and more than twice the largest correction of this robot
            assert max(abs(a - b) for a, b in zip(answer, wanted, strict=True)) < 0.02
            if now > 1.0 + STOPPED_S and answer.source == "corrected":
                break
            time.sleep(0.005)
    order = [source for source, _ in itertools.groupby(sources)]
    assert order[:3] == ["corrected", "held", "bypass"]
    assert order[-1] == "corrected"


MOVING_CONTROLLER = """
import sys, time
from kilter_client.stream import CorrectedStream
with CorrectedStream(sys.argv[1], endpoints=[sys.argv[2]], site="test", stream="sleeper", deadline_s=0.2,
                     hold_cycles=2, settled=True, connect_timeout_s=30.0) as stream:
    begin = time.monotonic()
    while True:
        wanted = [float(x) for x in sys.argv[3:]]
        wanted[0] += 0.04 * (time.monotonic() - begin)
        answer = stream.correct(wanted)
        print(answer.source, max(abs(a - b) for a, b in zip(answer, wanted)), flush=True)
        time.sleep(0.002)
"""


@pytest.mark.slow
def test_a_controller_stopped_for_eight_seconds_gets_no_old_numbers(corrector: Corrector) -> None:
    """The peer hangs, comes back, and goes on: what the corrector answers with numbers was sent just before."""
    ages: list[float] = []

    def heard(sample: zenoh.Sample) -> None:
        answer = wire.decode_answer(sample.payload.to_bytes())
        if answer.status == Status.OK:
            ages.append((time.monotonic_ns() - answer.header.t_send_ns) * 1e-9)

    endpoint = corrector.endpoints["stream"]
    with (
        zenoh.open(config("tcp/127.0.0.1:0", (endpoint,))) as session,
        subprocess.Popen(
            [sys.executable, "-c", MOVING_CONTROLLER, ROBOT, endpoint, *map(str, Q)], stdout=subprocess.PIPE, text=True
        ) as controller,
    ):
        session.declare_subscriber(f"{ROOT}/stream/sleeper/out", heard)
        try:
            until(lambda: len(ages) > 200)
            controller.send_signal(signal.SIGSTOP)
            time.sleep(STOPPED_S)
            before = len(ages)
            controller.send_signal(signal.SIGCONT)
            until(lambda: len(ages) > before + 200)
        finally:
            controller.kill()
        said = [line.split() for line in controller.stdout or ()]
    assert max(ages) < 0.5
    assert max(float(away) for _, away in said) < 0.02
    assert said[-1][0] == "corrected"


def test_two_controllers_on_one_key_never_both_get_numbers(corrector: Corrector) -> None:
    endpoints = tuple(corrector.endpoints.values())
    with Line(endpoints, "shared") as one, Line(endpoints, "shared") as other:
        assert one.ask(point(1, Flag.RESET | Flag.SETTLED)).status == Status.OK
        other.take(1)
        for k in range(5):
            seen = []
            for line, seq in ((one, 2 + k), (other, 1000 + k)):
                seen.append(line.ask(point(seq)).status)
                (other if line is one else one).take(1)  # both hear every answer
            assert seen.count(Status.OK) <= 1
            assert set(seen) <= {Status.OK, Status.SEQ_GAP, Status.SEQ_BACK}


def test_a_reset_starts_the_sequence_anew(corrector: Corrector) -> None:
    with Line(tuple(corrector.endpoints.values()), "reset") as line:
        assert line.ask(point(500, Flag.RESET | Flag.SETTLED)).status == Status.OK
        assert line.ask(point(1)).status == Status.SEQ_BACK
        assert line.ask(point(1, Flag.RESET)).status == Status.OK
        assert line.ask(point(2)).status == Status.OK


def test_no_numbers_and_an_unknown_version_get_none_back(corrector: Corrector) -> None:
    with Line(tuple(corrector.endpoints.values()), "none") as line:
        line.ask(point(1, Flag.RESET | Flag.SETTLED))
        refused = line.ask(point(2, q=(*Q[:4], float("nan"))))
        assert (refused.status, refused.values.size) == (Status.NOT_FINITE, 0)
        unknown = wire.encode_setpoints(
            np.array([Q]), joints=5, seq=3, t_send_ns=time.monotonic_ns(), t_apply_ns=0, version=12345
        )
        assert line.ask(unknown).status == Status.VERSION_MISMATCH
        assert line.ask(point(4)).status == Status.OK


def test_a_version_changes_in_motion_without_a_step(
    corrector: Corrector,
    source: object,
    calibration_of: Callable[..., Calibration],
    active_of: Callable[..., Active],
) -> None:
    old = source.versions[ROBOT]  # type: ignore[attr-defined]
    with open_stream(corrector, "motion") as stream:
        before = [stream.correct([x + 1e-4 * k for x in Q]) for k in range(20)]
        source.use(active_of(calibration_of(ROBOT, seed=8), epoch=old.epoch + 1, ramp_s=0.5))  # type: ignore[attr-defined]
        corrector.poll()
        until(lambda: stream.active is not None and stream.active["epoch"] == old.epoch + 1)
        after = [stream.correct([x + 1e-4 * k for x in Q]) for k in range(20, 60)]
    path = np.array([setpoint.delta for setpoint in before + after])
    assert {setpoint.source for setpoint in after} == {"corrected"}
    assert any(setpoint.flags & Flag.RAMPING for setpoint in after)
    assert np.abs(np.diff(path, axis=0)).max() < np.radians(0.01)


@pytest.fixture
def router() -> Iterator[Callable[[], str]]:
    """Starts a zenoh router in a process of its own, on the same port each time; the one before is killed."""
    running: list[subprocess.Popen[str]] = []
    endpoint = ["tcp/127.0.0.1:0"]
    script = (
        "import sys, zenoh\n"
        "from kilter_service.stream.corrector.session import config, with_free_port\n"
        "endpoint = with_free_port(sys.argv[1])\n"
        "made = config(endpoint)\n"
        "made.insert_json5('mode', '\"router\"')\n"
        "with zenoh.open(made):\n"
        "    print(endpoint, flush=True)\n"
        "    sys.stdin.read()\n"
    )

    def start() -> str:
        for old in running:
            old.kill()
            old.wait()
        process = subprocess.Popen(
            [sys.executable, "-c", script, endpoint[0]],
            cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        running.append(process)
        assert process.stdout is not None
        endpoint[0] = process.stdout.readline().strip()
        return endpoint[0]

    yield start
    for process in running:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()


@pytest.mark.slow
def test_the_stream_comes_back_after_the_router_was_restarted(
    router: Callable[[], str], source: object, tmp_path: Path
) -> None:
    """The controller knows the router only: it must hear that the corrector is out of reach, and find it again."""
    endpoint = router()
    file = tmp_path / "zenoh.json5"
    file.write_text(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
    settings = Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", zenoh_config=file, site="test")
    behind = Corrector(settings, source)  # type: ignore[arg-type]
    behind.start()
    try:
        options = {"endpoints": [endpoint], "site": "test", "stream": "router", "deadline_s": 2.0, "settled": True}
        with CorrectedStream(ROBOT, connect_timeout_s=20.0, **options) as stream:  # type: ignore[arg-type]
            assert stream.correct(Q).source == "corrected"
            router()
            until(lambda: stream.alive and stream.correct(Q).source == "corrected", 60)
    finally:
        behind.stop()


@pytest.mark.parametrize("ready", [pytest.param(ready, marks=pytest.mark.slow) for ready in (1, 4, 7)] + [5])
def test_sigterm_during_the_start_leaves_nothing_behind(tmp_path: Path, ready: int) -> None:
    """Told to stop as soon as so many processes exist: with one of them, with all, with those of the corrector."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment |= {"KILTER_DATA": str(tmp_path), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    with subprocess.Popen(
        [sys.executable, "-m", "kilter_service", "serve"], cwd=REPOSITORY, env=environment, stderr=subprocess.DEVNULL
    ) as server:
        until(lambda: len(descendants(server.pid)) >= ready, 60)
        started = descendants(server.pid)
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
    until(lambda: not any(Path(f"/proc/{pid}/exe").exists() for pid in started))
    assert not (tmp_path / "corrector.json").exists()
    assert not (tmp_path / "server.json").exists()


def test_the_stream_outlives_the_api_and_the_database(tmp_path: Path, katana: Calibration) -> None:
    """A server as users run it: its API is killed, then its database removed. The version in use stays in use."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment |= {"KILTER_DATA": str(tmp_path), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    settings = Settings(data=tmp_path, site="kilter")
    store_active(settings, katana)
    with ForkedPopen(
        [sys.executable, "-m", "kilter_service", "serve"],
        cwd=REPOSITORY, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ) as server:  # fmt: skip
        try:
            assert server.stdout is not None
            assert server.stdout.readline()
            with CorrectedStream(ROBOT, data=tmp_path, deadline_s=5.0, settled=True, connect_timeout_s=30.0) as stream:
                used = [stream.correct(Q)]
                os.kill(children_of(server.pid)["api"], signal.SIGKILL)
                used += [stream.correct(Q) for _ in range(20)]
                for file in tmp_path.glob(f"{DATABASE_FILE}*"):
                    file.unlink()
                for _ in range(40):  # half a second and more: the corrector looks four times a second
                    used.append(stream.correct(Q))
                    time.sleep(0.02)
                epochs = {stream.active["epoch"] if stream.active else None}
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait(60)
    assert set(on_time(used)) == {("corrected", "OK")}
    assert epochs == {1}


def ip(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)


@pytest.fixture
def cable() -> Iterator[tuple[str, str]]:
    """A network namespace behind a virtual cable: its name, and that of the cable's near end."""
    tag = f"{os.getpid() % 10_000}"
    name, near, far = f"kilter{tag}", f"kn{tag}", f"kf{tag}"
    if shutil.which("ip") is None or ip("netns", "add", name).returncode != 0:
        pytest.skip("network namespaces need root and iproute2")
    try:
        for arguments in (
            ("link", "add", near, "type", "veth", "peer", "name", far, "netns", name),
            ("address", "add", "10.213.7.1/30", "dev", near),
            ("link", "set", near, "up"),
            ("-n", name, "address", "add", "10.213.7.2/30", "dev", far),
            ("-n", name, "link", "set", far, "up"),
        ):
            if ip(*arguments).returncode != 0:
                pytest.skip("this system does not allow virtual network cables")
        yield name, near
    finally:
        ip("link", "delete", near)
        ip("netns", "delete", name)


FAR_CONTROLLER = """
import sys, time
from pathlib import Path
from kilter_client.stream import CorrectedStream
with CorrectedStream(sys.argv[1], data=Path(sys.argv[2]), stream="cable", deadline_s=0.2,
                     hold_cycles=2, settled=True, connect_timeout_s=30.0) as stream:
    last = None
    while True:
        source = stream.correct([0.1, 0.6, 0.4, 0.3, 0.2]).source
        if source != last:
            print(source, flush=True)
            last = source
        time.sleep(0.01)
"""


@pytest.mark.slow
def test_a_cut_cable_is_bypassed_and_found_again(cable: tuple[str, str], source: object, tmp_path: Path) -> None:
    """Two network namespaces; the cable between them is cut, without any process noticing but by silence."""
    name, near = cable
    file = tmp_path / "zenoh.json5"
    file.write_text("{}")
    settings = Settings(data=tmp_path, zenoh_listen="tcp/10.213.7.1:0", zenoh_config=file, site="test")
    here = Corrector(settings, source)  # type: ignore[arg-type]
    here.start()
    try:
        with subprocess.Popen(
            ["ip", "netns", "exec", name, sys.executable, "-c", FAR_CONTROLLER, ROBOT, str(tmp_path)],
            cwd=REPOSITORY, stdout=subprocess.PIPE, text=True,
        ) as controller:  # fmt: skip
            try:
                assert controller.stdout is not None
                assert controller.stdout.readline() == "corrected\n"
                ip("link", "set", near, "down")
                heard = [controller.stdout.readline() for _ in range(2)]
                ip("link", "set", near, "up")
                heard.append(controller.stdout.readline())
            finally:
                controller.kill()
    finally:
        here.stop()
    assert heard == ["held\n", "bypass\n", "corrected\n"]
