"""Thrift's compact protocol, as far as Parquet's descriptions of itself need it."""

from __future__ import annotations

from typing import Any

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
DEEPEST = 12
FIXED = {BYTE: 1, DOUBLE: 8}


class Thrift:
    """Reads one struct after another from bytes; damaged ones raise ValueError or IndexError."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Fields by number: integers, structs and lists; what else there is, is passed over and None."""
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind == TRUE if kind in (TRUE, FALSE) else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError("nested too deeply")
        if kind in (I16, I32, I64):
            return self._integer()
        if kind == STRUCT:
            return self.struct(depth + 1)
        if kind in (LIST, SET):
            return self._list(depth)
        if kind not in (TRUE, FALSE, BYTE, DOUBLE, BINARY):
            raise ValueError(f"a field of type {kind}")
        size = 1 if kind in (TRUE, FALSE) else FIXED.get(kind) or self._varint()
        self.at += size
        if self.at > len(self.data):
            raise ValueError("cut off")
        return None

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        size = self._varint() if head >> 4 == 15 else head >> 4
        if size > len(self.data) - self.at:
            raise ValueError("a list longer than its bytes")
        return [self._value(head & 15, depth + 1) for _ in range(size)]

    def _byte(self) -> int:
        byte = self.data[self.at]
        self.at += 1
        return byte

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("an endless number")

    def _integer(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)
