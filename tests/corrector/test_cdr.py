"""CDR of the two messages against the rosbags library, byte for byte, both ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from kilter_service.stream import ros2_messages

STORE = get_typestore(Stores.ROS2_JAZZY)
STATE, TRAJECTORY = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"

texts = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=9)
heads = st.builds(
    ros2_messages.Head,
    st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1)),
    texts,
    st.lists(texts, max_size=8).map(tuple),
)


def of_rosbags(kind: str, **fields: object) -> object:
    return STORE.types[kind](**fields)


def header(head: ros2_messages.Head) -> object:
    stamp = of_rosbags("builtin_interfaces/msg/Time", sec=head.stamp[0], nanosec=head.stamp[1])
    return of_rosbags("std_msgs/msg/Header", stamp=stamp, frame_id=head.frame_id)


def by_rosbags(message: ros2_messages.JointTrajectory) -> object:
    points = [
        of_rosbags(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            **{part: getattr(message, part)[k] for part in ros2_messages.PARTS},
            time_from_start=of_rosbags(
                "builtin_interfaces/msg/Duration", sec=int(message.time[k, 0]), nanosec=int(message.time[k, 1])
            ),
        )
        for k in range(len(message.time))
    ]
    return of_rosbags(TRAJECTORY, header=header(message.head), joint_names=list(message.head.names), points=points)


def trajectory(
    head: ros2_messages.Head, points: int, counts: tuple[int, int, int, int], seed: int = 0
) -> ros2_messages.JointTrajectory:
    rng = np.random.default_rng(seed)
    parts = [rng.normal(size=(points, count)) for count in counts]
    time = np.stack([rng.integers(-(2**31), 2**31 - 1, points), rng.integers(0, 10**9, points)], axis=1)
    return ros2_messages.JointTrajectory(head, time.astype(np.int32), *parts)


def assert_same(a: ros2_messages.JointTrajectory, b: ros2_messages.JointTrajectory) -> None:
    assert a.head == b.head
    for name in ("time", *ros2_messages.PARTS):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


@settings(deadline=None, max_examples=60)
@given(heads, st.lists(st.sampled_from((0, 1, 6, 7)), min_size=3, max_size=3), st.sampled_from(("<", ">")))
def test_joint_states_are_those_of_rosbags(head: ros2_messages.Head, counts: list[int], order: str) -> None:
    parts = [np.linspace(-3, 3, count) for count in counts]
    ours = ros2_messages.JointState(head, *parts)
    message = of_rosbags(
        STATE, header=header(head), name=list(head.names), position=parts[0], velocity=parts[1], effort=parts[2]
    )
    assert ros2_messages.encode_joint_state(ours) == bytes(STORE.serialize_cdr(message, STATE))
    back = ros2_messages.decode_joint_state(bytes(STORE.serialize_cdr(message, STATE, little_endian=order == "<")))
    assert back.head == head
    for mine, theirs in zip((back.position, back.velocity, back.effort), parts, strict=True):
        assert np.array_equal(mine, theirs)


@settings(deadline=None, max_examples=60)
@given(
    heads,
    st.integers(0, 4),
    st.lists(st.sampled_from((0, 1, 6, 7)), min_size=4, max_size=4).filter(any),
    st.sampled_from(("<", ">")),
)
def test_trajectories_are_those_of_rosbags(
    head: ros2_messages.Head, points: int, counts: list[int], order: str
) -> None:
    ours = trajectory(head, points, tuple(counts))  # type: ignore[arg-type]
    message = by_rosbags(ours)
    assert ros2_messages.encode_joint_trajectory(ours) == bytes(STORE.serialize_cdr(message, TRAJECTORY))
    back = ros2_messages.decode_joint_trajectory(
        bytes(STORE.serialize_cdr(message, TRAJECTORY, little_endian=order == "<"))
    )
    assert back.head == head
    if points:
        assert_same(back, ours)


def test_a_long_trajectory_of_six_joints_is_that_of_rosbags() -> None:
    ours = trajectory(ros2_messages.Head((1, 2), "base", tuple("abcdef")), 1000, (6, 6, 6, 0))
    data = ros2_messages.encode_joint_trajectory(ours)
    assert data == bytes(STORE.serialize_cdr(by_rosbags(ours), TRAJECTORY))
    assert_same(ros2_messages.decode_joint_trajectory(data), ours)


def test_points_that_carry_different_numbers_are_refused() -> None:
    message = by_rosbags(trajectory(ros2_messages.Head((0, 0), "", ("a", "b")), 3, (2, 2, 0, 0)))
    message.points[2].velocities = np.zeros(0)  # type: ignore[attr-defined]
    message.points[2].effort = np.zeros(2)  # type: ignore[attr-defined]
    with pytest.raises(ros2_messages.CdrError, match="differ"):
        ros2_messages.decode_joint_trajectory(bytes(STORE.serialize_cdr(message, TRAJECTORY)))


@pytest.mark.parametrize("decode", [ros2_messages.decode_joint_state, ros2_messages.decode_joint_trajectory])
def test_damaged_bytes_are_refused_and_nothing_else_happens(decode: object) -> None:
    whole = ros2_messages.encode_joint_trajectory(
        trajectory(ros2_messages.Head((0, 0), "f", ("a", "b")), 3, (2, 0, 0, 0))
    )
    rng = np.random.default_rng(1)
    refused = 0
    for k in range(20_000):
        data = bytearray(whole[: rng.integers(0, len(whole))] if k % 2 else whole)
        for _ in range(3):
            if data:
                data[rng.integers(0, len(data))] = rng.integers(0, 256)
        try:
            decode(bytes(data))  # type: ignore[operator]
        except ros2_messages.CdrError:
            refused += 1
    assert refused > 10_000
