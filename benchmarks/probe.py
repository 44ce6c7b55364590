"""Somebody who reads a robot ten times a second, in a process of its own: whoever makes the load would be measured too.

Prints the times of the answers in ms, sorted, as JSON. `KILTER_URL` and `KILTER_TOKEN` say where.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time

import httpx

PER_S = 10


def main() -> None:
    """Read for as many seconds as the first argument says."""
    times = []
    with httpx.Client(
        base_url=os.environ["KILTER_URL"], headers={"Authorization": f"Bearer {os.environ['KILTER_TOKEN']}"}, timeout=60
    ) as client:
        client.get("/v1/robots/arm").raise_for_status()  # the connection
        gc.collect()
        gc.disable()
        end = time.monotonic() + float(sys.argv[1])
        while time.monotonic() < end:
            began = time.perf_counter()
            client.get("/v1/robots/arm").raise_for_status()
            times.append(1e3 * (time.perf_counter() - began))
            time.sleep(max(0.0, 1 / PER_S - times[-1] / 1e3))
    json.dump(sorted(times), sys.stdout)


if __name__ == "__main__":
    main()
