"""TLS and access control as `kilterd zenoh-config` writes them, between real sessions."""

from __future__ import annotations

import base64
import json
import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from kilter_client.stream import CorrectedStream
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules, config, with_free_port
from tests.corrector.live import ROBOT, ROOT, Q, until
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


def write(folder: Path, *options: str) -> str:
    environment = {"KILTER_SITE": "test", "PATH": "/usr/bin:/bin"}
    command = ("zenoh-config", "--data", str(folder), *options)
    done = forked_command(*command, environment=environment, folder=REPOSITORY)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tls")
    write(made, "--host", "127.0.0.1", "--controller", "main", "--controller", "other=another-robot")
    return made


@pytest.fixture(scope="module")
def guarded(folder: Path, source: object) -> Iterator[Corrector]:
    file = folder / "zenoh" / "corrector" / "zenoh.json5"
    settings = Settings(data=folder, zenoh_listen="tls/127.0.0.1:0", zenoh_config=file, site="test")
    running = Corrector(settings, source, Rules(max_age_ns=5_000_000_000))  # type: ignore[arg-type]
    running.start()
    yield running
    running.stop()


def session_as(folder: Path, role: str, guarded: Corrector) -> zenoh.Session:
    file = folder / "zenoh" / role / "zenoh.json5"
    made = zenoh.Config.from_file(str(file))
    made.insert_json5("connect/endpoints", json.dumps([guarded.endpoints["stream"]]))
    return zenoh.open(made)


def stream_as(folder: Path, role: str, guarded: Corrector, name: str) -> CorrectedStream:
    return CorrectedStream(
        ROBOT, data=guarded.file.parent, stream=name, deadline_s=2.0, settled=True, connect_timeout_s=30.0, signed=True,
        zenoh_config=folder / "zenoh" / role / "zenoh.json5",
    )  # fmt: skip


def test_a_controller_with_its_certificate_is_corrected(folder: Path, guarded: Corrector) -> None:
    with stream_as(folder, "controller-main", guarded, "allowed") as stream:
        assert [stream.correct(Q).source for _ in range(20)] == ["corrected"] * 20


def test_an_observer_hears_and_cannot_send(folder: Path, guarded: Corrector) -> None:
    heard: list[bytes] = []
    with (
        session_as(folder, "observer", guarded) as observer,
        stream_as(folder, "controller-main", guarded, "watched") as stream,
        observer.declare_subscriber(f"{ROOT}/stream/watched/out", lambda s: heard.append(s.payload.to_bytes())),
        Overheard(folder, guarded, f"{ROOT}/stream/watched/in") as arrived,
    ):
        until(lambda: stream.correct(Q).source == "corrected" and len(heard) > 10)
        arrived.clear()
        for _ in range(50):
            observer.put(f"{ROOT}/stream/watched/in", b"KLT1 of an observer")
            observer.put(f"{ROOT}/stream/watched/out", b"KLT1 of an observer")
            observer.put(f"{ROOT}/active", b"{}")
        before = stream.statistics.forged
        assert [stream.correct(Q).source for _ in range(20)] == ["corrected"] * 20
        assert stream.statistics.forged == before == 0
        assert b"KLT1 of an observer" not in arrived


class Overheard:
    """What another observer hears on a key."""

    def __init__(self, folder: Path, guarded: Corrector, key: str) -> None:
        self._session, self._key, self._arrived = session_as(folder, "observer", guarded), key, list[bytes]()

    def __enter__(self) -> list[bytes]:
        self._session.declare_subscriber(self._key, lambda s: self._arrived.append(s.payload.to_bytes()))
        return self._arrived

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def test_a_controller_cannot_answer_or_announce(folder: Path, guarded: Corrector) -> None:
    heard: list[bytes] = []
    with (
        session_as(folder, "controller-main", guarded) as controller,
        session_as(folder, "observer", guarded) as observer,
        observer.declare_subscriber(f"{ROOT}/**", lambda s: heard.append(s.payload.to_bytes())),
        observer.declare_subscriber(f"{ROOT}/active", lambda s: heard.append(s.payload.to_bytes())),
        observer.declare_subscriber(f"{ROOT}/stream/x/in", lambda s: heard.append(s.payload.to_bytes())),
    ):

        def arrives() -> bool:
            controller.put(f"{ROOT}/stream/x/out", b"forged out")
            controller.put(f"{ROOT}/stream/x/status", b"forged status")
            controller.put(f"{ROOT}/active", b"forged active")
            controller.put(f"{ROOT}/stream/x/in", b"a setpoint")
            return b"a setpoint" in heard

        until(arrives)
        assert not {b"forged out", b"forged status", b"forged active"} & set(heard)


def test_a_controller_reaches_its_own_robots_only(folder: Path, guarded: Corrector) -> None:
    with pytest.raises(Exception, match=r"no right to robot"), CorrectedStream(
        ROBOT, data=guarded.file.parent, stream="foreign", connect_timeout_s=1.0, signed=True,
        zenoh_config=folder / "zenoh" / "controller-other" / "zenoh.json5",
    ):  # fmt: skip
        pass


def test_without_a_certificate_there_is_no_session(folder: Path, guarded: Corrector) -> None:
    trusted = base64.b64encode((folder / "zenoh" / "observer" / "authorities.pem").read_bytes()).decode()
    bare = zenoh.Config()
    for key, value in {
        "mode": "client", "connect/endpoints": [guarded.endpoints["stream"]], "scouting/multicast/enabled": False,
        "transport/link/tls/root_ca_certificate_base64": trusted,
    }.items():  # fmt: skip
        bare.insert_json5(key, json.dumps(value))
    with pytest.raises(zenoh.ZError):
        zenoh.open(bare)


@pytest.fixture
def stranger(tmp_path: Path) -> Callable[[], Path]:
    def made() -> Path:
        write(tmp_path, "--host", "127.0.0.1")
        return tmp_path

    return made


def test_a_certificate_of_another_authority_is_refused(guarded: Corrector, stranger: Callable[[], Path]) -> None:
    with pytest.raises(zenoh.ZError):
        session_as(stranger(), "controller-main", guarded)


def test_a_rotation_costs_no_setpoint(folder: Path, guarded: Corrector, tmp_path: Path) -> None:
    """Old and new certificates at the same running corrector, and at one that was started with the new ones."""
    with stream_as(folder, "controller-main", guarded, "rotated") as stream:
        assert stream.correct(Q).source == "corrected"
        old = tmp_path / "old"
        (folder / "zenoh").rename(old)
        subprocess.run(["cp", "-a", str(old), str(folder / "zenoh")], check=True)
        write(folder, "--rotate")
        assert all(stream.correct(Q).source == "corrected" for _ in range(50))
        new_file = folder / "zenoh" / "controller-main" / "zenoh.json5"
        assert new_file.read_bytes() != (old / "controller-main" / "zenoh.json5").read_bytes()
        with stream_as(folder, "controller-main", guarded, "new") as newer:  # new certificate, old corrector
            assert newer.correct(Q).source == "corrected"
        assert all(stream.correct(Q).source == "corrected" for _ in range(50))
        assert stream.statistics.missed == 0
    endpoint = guarded.endpoints["stream"].rpartition(":")[0] + ":0"
    after, free = listening(config(endpoint, file=folder / "zenoh" / "corrector" / "zenoh.json5"))
    with after:  # the corrector's new certificate is taken by an old and by a new controller
        for file in (old / "controller-main" / "zenoh.json5", new_file):
            made = zenoh.Config.from_file(str(file))
            made.insert_json5("connect/endpoints", json.dumps([free]))
            with zenoh.open(made) as session:
                assert session.info.routers_zid() or session.info.peers_zid()


def listening(made: zenoh.Config) -> tuple[zenoh.Session, str]:
    (endpoint,) = json.loads(made.get_json("listen/endpoints"))
    free = with_free_port(endpoint)
    made.insert_json5("listen/endpoints", json.dumps([free]))
    return zenoh.open(made), free


def test_only_their_owner_can_read_the_files(folder: Path) -> None:
    files = [file for file in (folder / "zenoh").rglob("*") if file.is_file() and file.name != "roles.json"]
    assert files
    assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}


def test_the_adaptor_reaches_nodes_behind_a_router_of_ros(folder: Path) -> None:
    """Nodes on the router's machine speak TCP, the adaptor TLS with its certificate."""
    made = zenoh.Config.from_file(str(folder / "zenoh" / "ros-router" / "zenoh.json5"))
    plain, secure = with_free_port("tcp/127.0.0.1:0"), with_free_port("tls/127.0.0.1:0")
    made.insert_json5("listen/endpoints", json.dumps([plain, secure]))
    adaptor = zenoh.Config.from_file(str(folder / "zenoh" / "ros" / "zenoh.json5"))
    adaptor.insert_json5("connect/endpoints", json.dumps([secure]))
    node = config(None, (plain,))
    node.insert_json5("mode", '"client"')
    heard: list[bytes] = []
    with zenoh.open(made), zenoh.open(adaptor) as ours, zenoh.open(node) as theirs:
        theirs.declare_subscriber("0/commands/Type/Hash", lambda s: heard.append(s.payload.to_bytes()))

        def arrives() -> bool:
            ours.put("0/commands/Type/Hash", b"corrected")
            ours.put("elsewhere", b"not allowed")
            return bool(heard)

        until(arrives)
