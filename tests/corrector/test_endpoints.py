"""Where the corrector listens: on this machine only unless a zenoh configuration says who may connect, on one port."""

from __future__ import annotations

import json
import os
import signal
import socket
from pathlib import Path

import pytest
import zenoh

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream import ros2_process as ros2
from kilter_service.stream.corrector.endpoints import check_ros2, is_local
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import config
from tests.corrector.live import ROOT, Q, open_stream, until
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("endpoint", "local"), [
    ("tcp/127.0.0.1:7447", True), ("tcp/127.8.0.1:0", True), ("tcp/[::1]:7447", True), ("tcp/localhost:7447", True),
    ("unixsock-stream//run/kilter", True), ("tls/127.0.0.1:7447#iface=lo", True), ("udp/127.0.0.1:7447?rel=1", True),
    ("tcp/0.0.0.0:7447", False), ("tcp/[::]:7447", False), ("tcp/10.0.0.1:7447", False), ("tcp/host:7447", False),
    ("tls/0.0.0.0:7447", False), ("ws/192.168.1.1:80", False), ("tcp/localhost.example:1", False), ("", False),
    ("tcp/:7447", False), ("7447", False),
])  # fmt: skip
def test_only_loopback_is_local(endpoint: str, local: bool) -> None:
    assert is_local(endpoint) == local


@pytest.mark.parametrize("command", ["corrector", "serve"])
def test_beyond_this_machine_it_asks_for_a_configuration(tmp_path: Path, command: str) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment |= {"KILTER_DATA": str(tmp_path), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/0.0.0.0:0"}
    done = forked_command(command, environment=environment, folder=REPOSITORY)
    assert done.returncode == 2
    assert "KILTER_ZENOH_CONFIG" in done.stderr
    assert done.stderr.strip().count("\n") == 0


def test_with_a_configuration_it_listens_where_it_is_told(tmp_path: Path, source: object) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{}")
    settings = Settings(data=tmp_path, zenoh_listen="tcp/0.0.0.0:0", zenoh_config=file, site="test")
    open_to_all = Corrector(settings, source)  # type: ignore[arg-type]
    open_to_all.start()
    open_to_all.stop()
    assert open_to_all.endpoints["stream"].startswith("tcp/0.0.0.0:")


def test_a_port_that_is_taken_is_said_in_one_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
        environment |= {"KILTER_DATA": str(tmp_path), "KILTER_ZENOH_LISTEN": endpoint}
        (tmp_path / "corrector.json").write_text("of another")
        done = forked_command("corrector", environment=environment, folder=REPOSITORY)
    assert done.returncode == 2
    assert done.stderr.strip() == (
        f"kilterd: The corrector cannot listen on {endpoint}, another program listens there: set KILTER_ZENOH_LISTEN to "
        "another endpoint, for example tcp/127.0.0.1:7448 (port 0 takes a free one)."
    )
    assert (tmp_path / "corrector.json").read_text() == "of another"


def listening(pid: int) -> set[str]:
    """Addresses of TCP sockets a process listens on, as /proc has them."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(os.readlink(link))
        except OSError:
            continue
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
                found.add(fields[1])
    return found


def test_both_processes_have_one_port_together(corrector: Corrector) -> None:
    port = int(corrector.endpoints["stream"].rpartition(":")[2])
    pids = {name: child.pid or 0 for name, child in corrector._children.items()}
    assert corrector.endpoints["query"] == corrector.endpoints["stream"]
    assert listening(pids["stream"]) == {f"0100007F:{port:04X}"}
    assert listening(pids["query"]) == set()


def test_queries_come_back_after_either_process_was_killed(corrector: Corrector) -> None:
    made = config("tcp/127.0.0.1:0", (corrector.endpoints["stream"],))
    with zenoh.open(made) as session:

        def described() -> bool:
            replies = [r.ok for r in session.get(f"{ROOT}/@rpc/describe", timeout=1.0) if r.ok is not None]
            return bool(replies) and json.loads(replies[0].payload.to_bytes())["active"] is not None

        until(described)
        for name in ("stream", "query"):
            child = corrector._children[name]
            os.kill(child.pid or 0, signal.SIGKILL)
            until(lambda child=child: not child.alive)  # type: ignore[misc]
            corrector.poll()
            until(described)
    with open_stream(corrector, "after") as stream:
        assert stream.correct(Q).source == "corrected"


def test_the_adaptor_of_ros_listens_nowhere(tmp_path: Path, corrector: Corrector) -> None:
    session = ros2.open_router_session(
        Settings(data=tmp_path, ros2_connect=corrector.endpoints["stream"]), lambda _: True
    )
    assert session is not None
    with session:
        assert not [address for address in listening(os.getpid()) if not address.startswith("0100007F")]


def test_no_session_listens_unless_told_to() -> None:
    made = config(None)
    assert json.loads(made.get_json("listen/endpoints")) == []


def test_a_failed_start_says_why(tmp_path: Path, source: object) -> None:
    refused = Corrector(Settings(data=tmp_path, zenoh_listen="tcp/0.0.0.0:0"), source)  # type: ignore[arg-type]
    with pytest.raises(ServiceError, match="KILTER_ZENOH_CONFIG"):
        refused.start()
    refused.stop()


@pytest.mark.parametrize(("connect", "configured", "taken"), [
    ("tcp/127.0.0.1:7447", False, True), ("tcp/10.0.0.1:7447", False, False), ("tls/10.0.0.1:7447", False, False),
    ("tcp/10.0.0.1:7447", True, False), ("tls/10.0.0.1:7447", True, True),
])  # fmt: skip
def test_ros_beyond_this_machine_needs_tls(tmp_path: Path, connect: str, configured: bool, taken: bool) -> None:
    file = tmp_path / "zenoh.json5" if configured else None
    settings = Settings(data=tmp_path, ros2_connect=connect, ros2_zenoh_config=file)
    if taken:
        check_ros2(settings)
        return
    with pytest.raises(ServiceError, match="KILTER_ROS2_ZENOH_CONFIG"):
        check_ros2(settings)
