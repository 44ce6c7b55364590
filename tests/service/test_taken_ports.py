"""A port that another program has: one sentence with the variable to set, and an end instead of restarts."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def taken() -> Iterator[int]:
    """A port of this machine that somebody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        yield other.getsockname()[1]


def ended(tmp_path: Path, command: str, **settings: str) -> str:
    """Run `kilterd` until it ends by itself with 2; what it said on stderr."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment = plain | {"KILTER_DATA": str(tmp_path / "data"), "KILTER_PORT": "0"}
    environment |= {"KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"} | settings
    done = forked_command(command, environment=environment, folder=REPOSITORY)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "data" / "server.json").exists()
    return done.stderr


@pytest.mark.parametrize("command", ["serve", "api"])
def test_the_port_of_the_api(command: str, taken: int, tmp_path: Path) -> None:
    said = ended(tmp_path, command, KILTER_PORT=str(taken))
    assert said.startswith(f"kilterd: The API cannot listen on 127.0.0.1 port {taken}, another program listens there: ")
    assert said.endswith("set KILTER_PORT (or --port) to another, 0 takes a free one.\n")


@pytest.mark.parametrize("command", ["serve", "corrector"])
def test_the_port_of_the_corrector(command: str, taken: int, tmp_path: Path) -> None:
    said = ended(tmp_path, command, KILTER_ZENOH_LISTEN=f"tcp/127.0.0.1:{taken}")
    assert said.startswith(
        f"kilterd: The corrector cannot listen on tcp/127.0.0.1:{taken}, another program listens there"
    )
    assert "set KILTER_ZENOH_LISTEN to another endpoint" in said
    assert said.count("\n") == 1


def test_what_only_a_process_finds_out_ends_the_server_too(tmp_path: Path) -> None:
    """Zenoh alone knows its protocols: the corrector ends with its sentence, and `kilterd serve` with it."""
    said = ended(tmp_path, "serve", KILTER_ZENOH_LISTEN="nothing/127.0.0.1:1")
    assert said.count("The corrector cannot listen on nothing/127.0.0.1:1") == 1
    assert "it starts again" not in said


def test_an_address_of_another_machine(tmp_path: Path) -> None:
    said = ended(
        tmp_path,
        "api",
        KILTER_HOST="203.0.113.1",
        KILTER_TOKEN="0123456789abcdefghijklmnop",
        KILTER_PROXY="203.0.113.2",
    )
    assert "set KILTER_HOST (or --host) to an address of this machine" in said
