"""A bridge under a controller for long, beside a server of its own: what was late, how long answers took."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from contextlib import nullcontext, redirect_stdout
from pathlib import Path

import numpy as np

from kilter_client import Kilter
from kilter_client.requests.connection import local_server
from tests.clients.bridges.rsi_peer import RsiPeer
from tests.clients.bridges.running_bridge import PRIORITY, add_arm, bridging, off_mm
from tests.clients.bridges.strangers import strangers
from tests.clients.bridges.udp_peer import Floats


def path(t_s: float) -> Floats:
    """A motion of three axes at up to 12 deg/s, with the elbow bent."""
    return np.array([30 * np.sin(0.4 * t_s), 30 + 20 * np.sin(0.5 * t_s), 50 + 30 * np.sin(0.3 * t_s), 0.0, 0.0, 0.0])


def main() -> None:
    """Run the controller and print a JSON document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=150_000)
    parser.add_argument("--cycle-ms", type=float, default=4.0)
    parser.add_argument("--strangers", type=int, default=0, help="packets of others beside it, a second")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, local_server(Path(folder) / "data") as server:
        os.environ.update(server.environment())
        with Kilter() as kilter, redirect_stdout(sys.stderr):
            add_arm(kilter, "cell7", Path(folder))
        with bridging("rsi", "cell7", "--port", "0", "--cycle-ms", str(given.cycle_ms)) as bridge:
            bridge.heard("waiting")
            if PRIORITY:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(PRIORITY)))
            peer = RsiPeer(bridge.port, path, cycle_s=given.cycle_ms / 1000.0).start()
            with strangers(bridge.port, given.strangers) if given.strangers else nullcontext():
                peer.wait(given.cycles, seconds=1e9)
            peer.stop()
            print(bridge.ended())
    answered, offsets, wanted = peer.answered(), peer.offsets(), peer.wanted()
    settled = slice(len(answered) // 2, None)
    found = {
        "cycles": len(answered),
        "late": int((~answered).sum()),
        "error_mm": float(off_mm(wanted, offsets)[settled].max()),
        "without_mm": float(off_mm(wanted, 0 * offsets)[settled].max()),
    }
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
