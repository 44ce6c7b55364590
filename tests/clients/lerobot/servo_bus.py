"""Feetech servos behind a pseudo terminal, written from the protocol: what LeRobot's own bus talks to in these tests.

Each servo has the registers of an STS3215. It is at once where it is told to be, and reads whole ticks.
"""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Mapping, Sequence

HEADER, BROADCAST = b"\xff\xff", 0xFE
PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x82, 0x83
LOW_LIMIT, HIGH_LIMIT, HOMING, TORQUE, GOAL, PRESENT = 9, 11, 31, 40, 42, 56
MODEL_STS3215 = 777


def signed(value: int, bit: int) -> int:
    """A number as the servo keeps it: its size, and the sign in a bit."""
    return abs(value) | ((value < 0) << bit)


class Servo:
    """The registers of one servo."""

    def __init__(self, homing_offset: int, low: int, high: int, position: int) -> None:
        self.memory = bytearray(256)
        self.memory[0:2] = bytes((3, 10))
        self.put(3, MODEL_STS3215)
        self.put(LOW_LIMIT, low)
        self.put(HIGH_LIMIT, high)
        self.put(HOMING, signed(homing_offset, 11))
        self.put(PRESENT, position)

    def put(self, address: int, value: int) -> None:
        self.memory[address : address + 2] = value.to_bytes(2, "little")

    def get(self, address: int) -> int:
        return int.from_bytes(self.memory[address : address + 2], "little")

    def write(self, address: int, content: bytes) -> None:
        self.memory[address : address + len(content)] = content
        if address == GOAL and self.memory[TORQUE]:
            self.put(PRESENT, self.get(GOAL))


class Bus:
    """Servos by number on a port that a program opens by its name."""

    def __init__(self, servos: Mapping[int, Servo]) -> None:
        self.servos = dict(servos)
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        waiting = b""
        while True:
            try:
                waiting += os.read(self._master, 4096)
            except OSError:
                return
            while (packet := self._first(waiting)) is not None:
                used, number, instruction, rest = packet
                waiting = waiting[used:]
                self._answer(number, instruction, rest)

    @staticmethod
    def _first(waiting: bytes) -> tuple[int, int, int, bytes] | None:
        """Bytes used, number, instruction and parameters of the first whole packet."""
        start = waiting.find(HEADER)
        if start < 0 or len(waiting) < start + 4:
            return None
        end = start + 4 + waiting[start + 3]
        if len(waiting) < end:
            return None
        body = waiting[start + 2 : end]
        assert (~sum(body[:-1]) & 0xFF) == body[-1], "a packet with a wrong checksum"
        return end, body[0], body[2], body[3:-1]

    def _answer(self, number: int, instruction: int, rest: bytes) -> None:
        if instruction == SYNC_READ:
            for one in rest[2:]:
                self._say(one, self.servos[one].memory[rest[0] : rest[0] + rest[1]])
        elif instruction == SYNC_WRITE:
            size = rest[1]
            for at in range(2, len(rest), size + 1):
                self.servos[rest[at]].write(rest[0], rest[at + 1 : at + 1 + size])
        elif number in self.servos:
            if instruction == WRITE:
                self.servos[number].write(rest[0], rest[1:])
            told = self.servos[number].memory[rest[0] : rest[0] + rest[1]] if instruction == READ else b""
            self._say(number, told)
        elif number == BROADCAST and instruction == PING:
            for one in self.servos:
                self._say(one, b"")

    def _say(self, number: int, content: Sequence[int] | bytes | bytearray) -> None:
        body = bytes((number, len(content) + 2, 0, *content))
        os.write(self._master, HEADER + body + bytes((~sum(body) & 0xFF,)))
