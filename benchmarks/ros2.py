"""What ROS 2's bytes cost: a JointTrajectory of 1000 points and a JointState, six joints, beside the rosbags library.

    python -m benchmarks.ros2

The last line is ``cdr trajectory=... us state=... us``, each encoding and decoding together.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from kilter_service.stream.ros2 import cdr

POINTS, JOINTS = 1000, 6


def best_us(call: Callable[[], object], number: int, repeat: int = 15) -> float:
    """Processor time of one call, µs: the best of several runs."""
    best = math.inf
    for _ in range(repeat):
        begin = time.process_time()
        for _ in range(number):
            call()
        best = min(best, time.process_time() - begin)
    return best / number * 1e6


def trajectory(parts: int) -> cdr.JointTrajectory:
    """A trajectory with the first ``parts`` of positions, velocities, accelerations."""
    rng = np.random.default_rng(0)
    given = [rng.normal(size=(POINTS, JOINTS if k < parts else 0)) for k in range(4)]
    ns = np.arange(POINTS) * 2_000_000
    head = cdr.Head((1, 2), "base_link", tuple(f"joint_{k + 1}" for k in range(JOINTS)))
    return cdr.JointTrajectory(head, np.stack(np.divmod(ns, 10**9), axis=1).astype(np.int32), *given)


def rosbags_us(data: bytes) -> float | None:
    """Encoding and decoding by the rosbags library, µs; None where it is not installed."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return None
    store, kind = get_typestore(Stores.ROS2_JAZZY), "trajectory_msgs/msg/JointTrajectory"
    message = store.deserialize_cdr(data, kind)
    assert bytes(store.serialize_cdr(message, kind)) == data
    encode = best_us(lambda: store.serialize_cdr(message, kind), 2, 3)
    return encode + best_us(lambda: store.deserialize_cdr(data, kind), 2, 3)


def main() -> None:
    """Run everything once."""
    totals = []
    for parts, name in ((1, "positions"), (3, "positions, velocities, accelerations")):
        message = trajectory(parts)
        data = cdr.encode_joint_trajectory(message)
        encode = best_us(lambda message=message: cdr.encode_joint_trajectory(message), 300)
        decode = best_us(lambda data=data: cdr.decode_joint_trajectory(data), 300)
        theirs = rosbags_us(data)
        beside = f", rosbags {theirs:.0f} µs" if theirs else ""
        print(f"{POINTS} points, {name}: encode {encode:.1f} + decode {decode:.1f} µs, {len(data)} bytes{beside}")
        totals.append(encode + decode)
    empty = np.zeros(0)
    state = cdr.JointState(trajectory(1).head, np.zeros(JOINTS), empty, empty)
    raw = cdr.encode_joint_state(state)
    each = best_us(lambda: cdr.encode_joint_state(state), 3000) + best_us(lambda: cdr.decode_joint_state(raw), 3000)
    print(f"cdr trajectory={totals[0]:.1f} us state={each:.1f} us")


if __name__ == "__main__":
    main()
