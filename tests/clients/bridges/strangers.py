"""Packets of strangers, sent as fast as wanted by a process of its own: it shares no code with Kilter."""

from __future__ import annotations

import itertools
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

AXES = " ".join(f'A{k}="{10 * k}"' for k in range(1, 7))


def _tag(number: int, size: int) -> bytes:
    """The key of a field of protobuf with a message of so many bytes (below 128)."""
    return bytes((number << 3 | 2, size))


def packets() -> dict[str, bytes]:
    """Return one packet of each kind by its name: those of a controller, those that are slow to read, and noise."""
    rng = random.Random(1)
    rob = f'<Rob TYPE="KUKA"><ASPos {AXES}/><Delay D="1"/>'.encode()
    header = _tag(1, 4) + b"\x08\x81\x80\x02"  # a sequence number
    return {
        "empty": b"",
        "noise": rng.randbytes(1400),
        "zeros": b"\0" * 1500,
        "too large": b"<Rob " + b"x" * 8000,
        "open delays": b"<Rob><IPOC>8</IPOC>" + b"<Delay " * 210,
        "open delays, 4 kB": b"<Rob><IPOC>8</IPOC>" + b"<Delay " * 580,
        "one delay of many D": b"<Rob><IPOC>8</IPOC><Delay " + b" D='" * 360,
        "open positions": b"<Rob><IPOC>8</IPOC>" + b"<ASPos " * 210,
        "positions of many axes": b"<Rob><ASPos " + b'A1="1" ' * 200 + b"/><IPOC>8</IPOC>",
        "blanks in a stamp": b"<Rob><IPOC>" + b" " * 1400,
        "digits in a stamp": b"<Rob><IPOC>" + b"1" * 1400 + b"</IPOC>",
        "many stamps": b"<Rob>" + b"<IPOC> 1 " * 160,
        "a controller's": rob + b"<IPOC>8</IPOC></Rob>",
        "a controller's, from the future": rob + b"<IPOC>999999999999999999</IPOC></Rob>",
        "many fields": header + b"\x08\x01" * 740,
        "many headers": header * 240,
        "varints without an end": header + b"\xff" * 1400,
        "deep messages": b"".join(_tag(2, size) for size in range(126, 1, -2)) + b"\0" * 1200,
        "an arm's": header + _tag(2, 56) + _tag(1, 54) + (b"\x09" + b"\0" * 8) * 6,
    }


@contextmanager
def strangers(port: int, per_second: int, source: str = "127.0.0.1", only: str = "") -> Iterator[None]:
    """Send packets of all kinds (or ``only`` one) to a UDP port of this machine, from an address of it."""
    process = subprocess.Popen([sys.executable, __file__, str(port), str(per_second), source, only])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def main() -> None:
    """Send until killed."""
    port, per_second, source, only = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
    kinds = itertools.cycle([data for name, data in packets().items() if only in ("", name)])
    senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    for one in senders:
        one.bind((source, 0))
    burst, began = max(1, per_second // 500), time.monotonic()
    for bursts in itertools.count(1):
        for sender in itertools.islice(itertools.cycle(senders), burst):
            sender.sendto(next(kinds), ("127.0.0.1", port))
        time.sleep(max(0.0, began + bursts * burst / per_second - time.monotonic()))


if __name__ == "__main__":
    main()
