"""A checked robot as a PNG picture, with nothing but the standard library: two views side by side."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Sequence
from typing import Any

Colour = tuple[int, int, int]

SIZE, MARGIN = 480, 40
WHITE, LINK, AXIS, MARK, TEXT = (255, 255, 255), (60, 90, 160), (210, 120, 40), (30, 30, 30), (30, 30, 30)
AXIS_PIXELS = 26
VIEWS = ((0, 2, "xz"), (0, 1, "xy"))
# 3 x 5 pixels each, rows from the top
FONT = {
    "0": (7, 5, 5, 5, 7), "1": (2, 6, 2, 2, 7), "2": (7, 1, 7, 4, 7), "3": (7, 1, 7, 1, 7), "4": (5, 5, 7, 1, 1),
    "5": (7, 4, 7, 1, 7), "6": (7, 4, 7, 5, 7), "7": (7, 1, 2, 2, 2), "8": (7, 5, 7, 5, 7), "9": (7, 5, 7, 1, 7),
    "x": (0, 5, 2, 5, 0), "y": (5, 5, 2, 2, 4), "z": (7, 1, 2, 4, 7), "T": (7, 2, 2, 2, 2),
}  # fmt: skip


class Canvas:
    """Pixels of one picture, (0, 0) at the upper left."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._pixels = bytearray(bytes(WHITE) * (width * height))

    def dot(self, x: float, y: float, colour: Colour, radius: int = 0) -> None:
        """Fill a square around a point."""
        for row in range(round(y) - radius, round(y) + radius + 1):
            for column in range(round(x) - radius, round(x) + radius + 1):
                if 0 <= row < self.height and 0 <= column < self.width:
                    place = 3 * (row * self.width + column)
                    self._pixels[place : place + 3] = bytes(colour)

    def line(self, a: tuple[float, float], b: tuple[float, float], colour: Colour, radius: int) -> None:
        """Draw a straight line."""
        steps = max(1, round(max(abs(b[0] - a[0]), abs(b[1] - a[1]))))
        for k in range(steps + 1):
            self.dot(a[0] + (b[0] - a[0]) * k / steps, a[1] + (b[1] - a[1]) * k / steps, colour, radius)

    def text(self, x: float, y: float, text: str) -> None:
        """Write digits and the few letters there are, two pixels to a dot."""
        for place, character in enumerate(text):
            for row, bits in enumerate(FONT[character]):
                for column in range(3):
                    if bits >> (2 - column) & 1:
                        self.dot(x + 8 * place + 2 * column, y + 2 * row, TEXT, 1)

    def png(self) -> bytes:
        """Return the picture as a PNG file."""
        stride = 3 * self.width
        rows = b"".join(b"\0" + self._pixels[k * stride : (k + 1) * stride] for k in range(self.height))
        header = struct.pack(">IIBBBBB", self.width, self.height, 8, 2, 0, 0, 0)
        parts = (_chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(rows, 9)), _chunk(b"IEND", b""))
        return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def picture(check: dict[str, Any]) -> bytes:
    """Draw the arm at zero: links blue, axes orange and numbered, T the tool; from the side (left) and from above."""
    canvas = Canvas(2 * SIZE, SIZE)
    points, axes = check["zero"]["points_mm"], check["axes"]
    for number, (across, up, letters) in enumerate(VIEWS):
        _view(canvas, number * SIZE, points, axes, (across, up))
        _compass(canvas, number * SIZE, letters)
    return canvas.png()


def _view(
    canvas: Canvas, left: int, points: Sequence[Sequence[float]], axes: Sequence[dict[str, Any]], plane: tuple[int, int]
) -> None:
    flat = [(p[plane[0]], p[plane[1]]) for p in points]
    low = [min(p[k] for p in flat) for k in (0, 1)]
    span = max(max(p[k] for p in flat) - low[k] for k in (0, 1)) or 1.0
    scale = (SIZE - 2 * MARGIN) / span
    placed = [(left + MARGIN + (x - low[0]) * scale, SIZE - MARGIN - (y - low[1]) * scale) for x, y in flat]
    for a, b in itertools.pairwise(placed):
        canvas.line(a, b, LINK, 2)
    for number, (axis, (x, y)) in enumerate(zip(axes, placed[1:], strict=False), 1):
        dx, dy = (AXIS_PIXELS * axis["direction"][k] for k in plane)
        canvas.line((x - dx, y + dy), (x + dx, y - dy), AXIS, 1)
        canvas.dot(x, y, MARK, 3)
        canvas.text(x + 8, y - 14, str(number))
    canvas.text(placed[-1][0] - 12, placed[-1][1] - 14, "T")


def _compass(canvas: Canvas, left: int, letters: str) -> None:
    x, y = left + 14, SIZE - 14
    canvas.line((x, y), (x + 20, y), MARK, 0)
    canvas.line((x, y), (x, y - 20), MARK, 0)
    canvas.text(x + 24, y - 6, letters[0])
    canvas.text(x - 4, y - 34, letters[1])
