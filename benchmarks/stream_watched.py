"""What it costs the corrected stream that somebody looks at it: one corrector, watched and unwatched in turns.

    python -m benchmarks.stream_watched [--seconds 60] [--rate 1000]

The same processes are measured with and without a subscription like that of an open page, in turns of two seconds, so that
whatever else the machine does meets both. A bare zenoh echo beside them says how quiet the machine was.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.stream import (
    ECHO,
    ROBOT,
    STREAMS,
    Line,
    beside_an_echo,
    calibration,
    echo_main,
    quiet,
    report,
    take_turns,
)
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_service.stream.corrector.active import Active, version_number
from kilter_service.stream.live.session import LiveSession, read_corrector_place

TURN_S = 2.0


def watcher_main(pipe: Connection, file: Path) -> None:
    """Look at all streams while it is told to, as the API process does, and say how many messages came."""
    while pipe.recv() == "look":
        place = read_corrector_place(file)
        assert place is not None
        session, messages = LiveSession(place), 0
        pipe.send(0)
        while not pipe.poll(0.1):
            messages += len(session.messages())
        pipe.recv()
        session.close()
        pipe.send(messages)


def main() -> None:
    """Run everything once."""
    parser = argparse.ArgumentParser(description="The corrected stream, watched and unwatched.")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long, both together")
    parser.add_argument("--rate", type=float, default=1000.0, help="setpoints per second")
    given = parser.parse_args()
    quiet()
    program = compile_program(calibration(), CorrectionOptions())
    active = Active(ROBOT, "ver_bench", version_number(program.digest), 1, program)
    context = multiprocessing.get_context("spawn")
    with beside_an_echo(active, echo_main, "stream", lambda s: s.put(f"{ECHO}/in", b"")) as (session, corrector):
        ours, theirs = context.Pipe()
        watcher = context.Process(target=watcher_main, args=(theirs, corrector.file))
        watcher.start()
        echo, line = Line(session, ECHO), Line(session, f"{STREAMS}/corrected")
        take_turns([echo, line], 200, given.rate)
        gc.freeze()
        gc.disable()
        trips: dict[str, list[np.ndarray]] = {"echo": [], "watched": [], "unwatched": []}
        messages = 0
        for turn in range(max(2, int(given.seconds / TURN_S / 2) * 2)):
            looked = turn % 2 == 0
            if looked:
                ours.send("look")
                ours.recv()
                time.sleep(0.7)  # the corrector looks for subscribers twice a second
            first = len(echo.arrived), len(line.arrived)
            take_turns([echo, line], int(TURN_S / 2 * given.rate), given.rate)
            trips["echo"].append(since(echo, first[0]))
            trips["watched" if looked else "unwatched"].append(since(line, first[1]))
            if looked:
                ours.send("stop")
                messages += ours.recv()
                time.sleep(0.7)
        ours.send("end")
        watcher.join()
        print(
            f"lost: echo {echo.seq - len(echo.arrived)}, corrected {line.seq - len(line.arrived)}; messages {messages}"
        )
    whole = {name: np.concatenate(parts) for name, parts in trips.items()}
    figures = {name: report(name, trips, len(trips)) for name, trips in whole.items()}
    ratio = [with_it / without for with_it, without in zip(figures["watched"], figures["unwatched"], strict=True)]
    print(f"watched / unwatched p50={ratio[0]:.3f} p99={ratio[1]:.3f}")


def since(line: Line, first: int) -> np.ndarray:
    """Round trips of the frames that came back since, µs."""
    return np.array([at - line.sent[int.from_bytes(data[8:16], "little")] for at, data in line.arrived[first:]]) / 1e3


if __name__ == "__main__":
    main()
