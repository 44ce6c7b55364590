"""Packets of strangers: none is read, none holds a bridge up, and whoever is named gets the answers."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Iterator
from importlib import import_module
from itertools import islice
from re import Pattern

import pytest

from kilter_client.bridges import egm
from kilter_client.bridges.correction import Correction
from kilter_client.bridges.egm import From, RsiWire
from kilter_client.bridges.fci import opened_sockets_hear
from kilter_client.bridges.loop import Request
from tests.clients.bridges.strangers import packets, strangers
from tests.clients.bridges.test_loop import (
    GONE_S,
    Controller,
    Make,
    controllers,
    correction,
    guard,
    looping,
    message,
    until_quiet,
)

parser = import_module("re._parser")
__all__ = ["controllers", "correction", "guard"]


class Counted(RsiWire):
    """Messages, and how many were read."""

    reads = 0

    def read(self, data: bytes) -> Request | None:
        self.reads += 1
        return super().read(data)


def sender_at(host: str, address: tuple[str, int]) -> Controller:
    """A sender with an address of this machine."""
    one = Controller.__new__(Controller)
    one.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.socket.bind((host, 0))
    one.socket.connect(address)
    return one


def requests_until_answered(controller: Controller) -> int:
    """Ask as a controller does, again and again: a packet is lost where a busy machine lets those of strangers pile up."""
    for k in range(1, 100):
        if controller.ask(message(4 * k), 0.3) is not None:
            return k
    raise AssertionError("never answered")


def test_nothing_of_a_stranger_is_read_while_a_controller_is_answered(
    correction: Correction, controllers: Make
) -> None:
    wire = Counted([1.0] * 6)
    with looping(correction, wire) as (loop, address, _):
        controller, stranger = controllers(address), controllers(address)
        assert controller.ask(message(2)) is not None
        loop._gone_after_s = 60.0  # a busy machine may keep this thread from asking
        for k in range(1, 20):
            assert controller.ask(message(4 * k)) is not None
            for data in packets().values():
                stranger.socket.send(data)
        assert controller.ask(message(80)) is not None
        assert wire.reads == 21
        assert loop.counts["other_controller"] == 19 * len(packets())
        assert loop.counts["malformed"] == 0
        with pytest.raises(BlockingIOError):
            stranger.socket.recv(2048, socket.MSG_DONTWAIT)
        loop._gone_after_s = GONE_S  # it ends when it is quiet


def test_the_named_controller_is_answered_though_strangers_ask_all_the_time(
    correction: Correction, controllers: Make
) -> None:
    wire = Counted([1.0] * 6)
    with (
        looping(correction, wire, ("127.0.0.1", 0)) as (loop, address, _),
        strangers(address[1], 500, source="127.0.0.2"),
    ):
        stranger = sender_at("127.0.0.2", address)
        assert stranger.ask(message(4), 0.3) is None
        stranger.socket.close()
        asked = 0
        for _ in range(2):  # and once it has gone, strangers do not take its place, nor keep it from coming again
            until_quiet(loop)
            asked += requests_until_answered(controllers(address))
        assert wire.reads <= asked


def test_of_a_named_port_the_others_of_that_address_get_no_answer(correction: Correction, controllers: Make) -> None:
    named = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    named.bind(("127.0.0.1", 0))
    with named, looping(correction, None, named.getsockname()) as (_, address, _):
        assert controllers(address).ask(message(4), 0.2) is None
        named.settimeout(10.0)
        named.sendto(message(4), address)
        assert b"<IPOC>4</IPOC>" in named.recv(2048)


def test_packets_of_more_than_1500_bytes_are_malformed(correction: Correction, controllers: Make) -> None:
    with looping(correction) as (loop, address, _):
        controller = controllers(address)
        whole = message(4)
        assert controller.ask(b" " * (1501 - len(whole)) + whole, 0.2) is None
        assert controller.ask(whole + b" " * 4000, 0.2) is None
        assert loop.counts["malformed"] == 2
        assert controller.ask(b" " * (1500 - len(whole)) + whole) is not None


def test_what_is_no_request_keeps_no_controller_from_coming(correction: Correction, controllers: Make) -> None:
    noise = [data for name, data in packets().items() if "controller" not in name and "arm" not in name]
    over = threading.Event()

    def send(port: int) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            while not over.wait(0.001):
                for data in noise:
                    one.sendto(data, ("127.0.0.1", port))

    with looping(correction) as (loop, address, _):
        assert controllers(address).ask(message(4)) is not None
        thread = threading.Thread(target=send, args=(address[1],))
        thread.start()
        try:
            until_quiet(loop)
        finally:
            over.set()
            thread.join()


class Held(RsiWire):
    """Messages of which one holds the reader up until the test lets it go on."""

    def __init__(self) -> None:
        super().__init__([1.0] * 6)
        self.reads, self.goes_on = threading.Event(), threading.Event()

    def read(self, data: bytes) -> Request | None:
        if data == b"hold":
            self.reads.set()
            assert self.goes_on.wait(20.0)
        return super().read(data)


def test_a_request_among_packets_of_strangers_is_found(correction: Correction, controllers: Make) -> None:
    wire = Held()
    with looping(correction, wire) as (loop, address, _):
        controller, stranger = controllers(address), controllers(address)
        stranger.socket.send(b"hold")
        assert wire.reads.wait(10.0)
        for _ in range(20):
            stranger.socket.send(b"noise")
        controller.socket.send(message(4))
        for _ in range(10):
            stranger.socket.send(b"noise")
        wire.goes_on.set()
        controller.socket.settimeout(10.0)
        assert b"<IPOC>4</IPOC>" in controller.socket.recv(2048)
        assert loop.counts["malformed"] == 21


@pytest.mark.skipif(sys.platform != "linux", reason="packets have no times of arrival")
@pytest.mark.parametrize("noise", [0, 5000])
def test_silence_is_told_by_when_packets_came_unless_some_found_no_room(
    correction: Correction, controllers: Make, noise: int
) -> None:
    """All noise waits at once: a bridge that took time to read for time of arrival would see no silence before it."""
    wire = Held()
    with looping(correction, wire) as (loop, address, _):
        first, second = controllers(address), controllers(address)
        assert first.ask(message(4)) is not None
        first.socket.send(b"hold")
        assert wire.reads.wait(10.0)
        for _ in range(noise):  # one that is dropped may have been a request
            first.socket.send(b"noise")
        time.sleep(1.2 * GONE_S)
        for _ in range(100):
            first.socket.send(b"noise")
        second.socket.send(message(400))
        wire.goes_on.set()
        if noise:
            assert second.ask(message(404), 0.3) is None
            assert loop.counts["no_room"] > 0
        else:
            second.socket.settimeout(10.0)
            assert b"<IPOC>400</IPOC>" in second.socket.recv(2048)


def repeats(tree: object) -> Iterator[int]:
    """The largest counts of all repetitions of a parsed pattern."""
    if isinstance(tree, parser.SubPattern | list | tuple):
        for one in tree:
            if isinstance(one, tuple) and len(one) == 2 and isinstance(one[1], tuple) and "REPEAT" in str(one[0]):
                yield int(one[1][1])
            yield from repeats(one)


@pytest.mark.parametrize("source", list(From))
def test_no_pattern_of_a_message_repeats_without_a_bound(source: From) -> None:
    wire = RsiWire([1.0] * 6, source)
    found = [one for one in [*vars(egm).values(), *vars(wire).values()] if isinstance(one, Pattern)]
    assert len(found) == 5
    for pattern in found:
        most = list(repeats(parser.parse(pattern.pattern)))
        assert parser.MAXREPEAT not in most, pattern.pattern
        assert max(most) <= 400


def test_a_message_of_more_fields_than_a_robot_sends_is_none() -> None:
    assert len(list(egm.fields(b"\x08\x01" * egm.MOST_FIELDS))) == egm.MOST_FIELDS
    many = egm.fields(b"\x08\x01" * 740)
    assert len(list(islice(many, egm.MOST_FIELDS))) == egm.MOST_FIELDS
    with pytest.raises(ValueError, match="more fields"):
        next(many)


def test_a_socket_of_a_robots_library_hears_the_robot_alone() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as library,
    ):
        library.close()
        robot.bind(("127.0.0.1", 0))
        stranger.bind(("127.0.0.2", 0))
        with opened_sockets_hear("127.0.0.1"):
            library = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            library.bind(("0.0.0.0", 0))
            at = ("127.0.0.1", library.getsockname()[1])
            stranger.sendto(b"before", at)
            robot.sendto(b"first state", at)
            stranger.sendto(b"while it waits", at)
        with library:
            assert library.getblocking()
            for data in packets().values():
                stranger.sendto(data, at)
            robot.sendto(b"state", at)
            library.settimeout(10.0)
            assert library.recvfrom(2048) == (b"state", robot.getsockname())
            library.sendto(b"command", robot.getsockname())
            assert robot.recv(2048) == b"command"
