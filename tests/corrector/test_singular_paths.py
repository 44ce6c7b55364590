"""Paths through a wrist and past a stretched elbow, over zenoh to the joints that the client gives back.

Pinocchio is the arm: what counts is where it puts the tool with the joints that a controller would send to it. Setpoints
act 2 ms apart; they are sent as fast as they are answered, so nothing here depends on the speed of the machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_client.stream import CorrectedStream
from kilter_client.streaming.frames import Setpoint, Statistics
from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.process import Corrector
from tests.core.truth import Arm, ur10
from tests.corrector.conftest import MemorySource
from tests.corrector.live import until

PERIOD_NS, PERIOD_S = 2_000_000, 0.002
NAME = "arm"


@dataclass(frozen=True)
class Twin:
    """An arm as it should be and as it is, and the version that knows the difference."""

    ideal: Arm
    real: Arm
    calibration: Calibration

    def off_mm(self, wanted: np.ndarray, sent: np.ndarray) -> np.ndarray:
        """How far the real tool is from where the ideal one would be (N,)."""
        away = self.real.poses(sent)[0] - self.ideal.poses(wanted)[0]
        return np.asarray(np.linalg.norm(away, axis=1) * 1e3)

    def turned_rad(self, wanted: np.ndarray, sent: np.ndarray) -> np.ndarray:
        """By what angle the real tool is rotated from the ideal one (N,)."""
        pairs = zip(self.real.poses(sent)[1], self.ideal.poses(wanted)[1], strict=True)
        return np.array([np.linalg.norm(pin.log3(real @ ideal.T)) for real, ideal in pairs])


def twin_of(seed: int, metres: float = 3e-4, radians: float = math.radians(0.03)) -> Twin:
    rng, ideal = np.random.default_rng(seed), ur10(limits=(-3.1, 3.1))
    sizes = {s.name: rng.normal(0.0, metres if s.axis[0] == "t" else radians) for s in ideal.steps}
    robot = robot_from_document({**ideal.document(), "name": NAME})
    nominal = Calibration.nominal(robot)
    values = nominal.values.copy()
    for k, name in enumerate(nominal.model.names):
        values[k] += sizes.get(name, 0.0)
    assert set(sizes) <= set(nominal.model.names)
    return Twin(ideal, ideal.moved(sizes), Calibration(nominal.model, values))


@dataclass(frozen=True)
class Run:
    """What the client gave back along a path."""

    wanted: np.ndarray
    setpoints: list[Setpoint]
    statistics: Statistics
    announced: dict[str, Any]

    @property
    def sent(self) -> np.ndarray:
        return np.array(self.setpoints)

    @property
    def rate_deg_s(self) -> float:
        """The most that the correction of a joint changed by."""
        return float(np.degrees(np.abs(np.diff(self.sent - self.wanted, axis=0)).max()) / PERIOD_S)

    @property
    def acceleration_deg_s2(self) -> float:
        """The most that this changed by in turn."""
        return float(np.degrees(np.abs(np.diff(self.sent - self.wanted, n=2, axis=0)).max()) / PERIOD_S**2)

    @property
    def left_mm(self) -> np.ndarray:
        """What the setpoints say is left; NaN where they do not."""
        return np.array([math.nan if one.left_mm is None else one.left_mm for one in self.setpoints])


def smooth(start: np.ndarray, end: np.ndarray, count: int) -> np.ndarray:
    """At rest at both ends."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    return np.asarray(start + (end - start) * s**3 * (10.0 - 15.0 * s + 6.0 * s * s))


def through_the_wrist() -> np.ndarray:
    """Joint 5 goes through zero, where the axes of joints 4 and 6 coincide."""
    start = np.array([0.3, -1.2, 1.4, -0.7, -0.5, 0.4])
    return smooth(start, start + np.array([0.15, 0.1, -0.1, 0.1, 1.0, 0.2]), 1000)


def past_a_stretched_elbow() -> np.ndarray:
    """Joint 3 goes close to zero, where the arm is at its longest, and back."""
    start = np.array([0.3, -1.0, 0.6, -0.7, 0.9, 0.4])
    there = start + np.array([0.3, 0.2, -0.59, 0.1, 0.0, 0.0])
    return np.vstack([smooth(start, there, 600), smooth(there, start + 0.6 * np.eye(6)[0], 600)])


@pytest.fixture(scope="module")
def run(corrector: Corrector, source: MemorySource, active_of: Callable[..., Active]) -> Callable[..., Run]:
    epochs = iter(range(100, 1000))

    def follow(twin: Twin, wanted: np.ndarray, client: dict[str, Any] | None = None, **options: Any) -> Run:
        epoch = next(epochs)
        source.use(active_of(twin.calibration, epoch=epoch, **options))
        corrector.poll()
        given = {
            "deadline_s": 2.0,
            "stream": f"path{epoch}",
            "settled": True,
            "connect_timeout_s": 20.0,
            **(client or {}),
        }
        with CorrectedStream(NAME, data=corrector.file.parent, **given) as stream:
            until(lambda: stream.active is not None and stream.active["epoch"] == epoch)
            start = time.monotonic_ns()
            made = [stream.correct(q.tolist(), t_apply_ns=start + k * PERIOD_NS) for k, q in enumerate(wanted)]
            announced = stream.active
        assert announced is not None
        return Run(wanted, made, stream.statistics, announced)

    return follow


SMALL, LARGE = (3e-4, math.radians(0.03)), (6e-4, math.radians(0.12))  # errors of lengths and angles
SLACK = 1.0 + 1e-4  # of a rate: joints have rounding errors, and are divided by 2 ms


@pytest.mark.parametrize(("seed", "sizes"), [(0, SMALL), (4, LARGE), (2, LARGE)])
def test_through_the_wrist_the_tool_stays_in_place_and_the_drives_get_no_more_than_is_stated(
    run: Callable[..., Run], seed: int, sizes: tuple[float, float]
) -> None:
    twin, path = twin_of(seed, *sizes), through_the_wrist()
    done = run(twin, path)
    assert {one.source for one in done.setpoints} == {"corrected"}
    off = twin.off_mm(path, done.sent)
    assert twin.off_mm(path, path).max() > 1.0
    assert off.max() <= 0.05
    assert np.abs(done.left_mm - off).max() < 1e-3
    assert (done.announced["rate_deg_s"], done.announced["acceleration_deg_s2"]) == (5.0, 250.0)
    assert done.rate_deg_s <= 5.0 * SLACK
    assert done.acceleration_deg_s2 <= 250.0 * SLACK
    # What the correction gives up there, the rotation, is marked wherever it is.
    turned = twin.turned_rad(path, done.sent)
    marked = np.array([one.damped or one.slowed for one in done.setpoints])
    assert turned[~marked].max() < 1.5e-4
    assert turned[marked].max() > 3e-4
    assert sum(marked) <= len(path)
    counted = done.statistics.held_back
    assert counted["damped"] == sum(one.damped for one in done.setpoints) > 0
    assert counted["slowed"] == sum(one.slowed for one in done.setpoints)


def test_a_client_that_follows_slowly_goes_the_straight_way_and_says_so(run: Callable[..., Run]) -> None:
    twin, path = twin_of(1, *SMALL), through_the_wrist()
    done = run(twin, path, {"quickest_s": 5.0})  # 5 deg in 5 s
    off = twin.off_mm(path, done.sent)
    slowed = np.array([one.source == "slowed" for one in done.setpoints])
    assert 50 < slowed.sum() == done.statistics.slowed < len(path)
    assert off.max() <= 0.2
    assert done.rate_deg_s <= SLACK
    # Each joint by itself at that rate, as the client followed before: the same answers, on the same arm.
    answered = done.sent - path + np.array([one.lag for one in done.setpoints])
    most, by_joint = math.radians(1.0) * PERIOD_S, [answered[0]]
    for delta in answered[1:]:
        by_joint.append(by_joint[-1] + np.clip(delta - by_joint[-1], -most, most))
    assert twin.off_mm(path, path + np.array(by_joint)).max() > 5.0 * off.max()
    for k, one in enumerate(done.setpoints):
        assert one.slowed or not slowed[k]
        assert (one.left_mm is None) == slowed[k]
        assert one.lag_mm is not None
        assert off[k] <= one.lag_mm + 1e-3  # the lag at the tool is at most that
    assert np.nanmax(done.left_mm) < 1e-3


def test_past_a_stretched_elbow_setpoints_are_saturated_and_none_is_refused(run: Callable[..., Run]) -> None:
    twin, path = twin_of(4, *LARGE), past_a_stretched_elbow()
    done, refusing = run(twin, path), run(twin, path, {"release_s": 0.02}, at_limit="refuse")
    assert (done.announced["at_limit"], refusing.announced["at_limit"]) == ("saturate", "refuse")
    assert {one.source for one in done.setpoints} == {"corrected"}
    off = twin.off_mm(path, done.sent)
    assert np.abs(done.left_mm - off).max() < 1e-3
    assert off.max() <= 0.1
    marked = np.array([one.saturated or one.damped or one.slowed for one in done.setpoints])
    assert off[~marked].max() < 1e-3
    assert sum(one.saturated for one in done.setpoints) > 20
    assert done.rate_deg_s <= 5.0 * SLACK
    # Without it the arm is driven uncorrected there.
    assert refusing.statistics.refused["CORRECTION_TOO_LARGE"] > 20
    assert {"held", "bypass"} <= {one.source for one in refusing.setpoints}
    assert twin.off_mm(path, refusing.sent).max() > 10.0 * off.max()


def test_an_error_beyond_the_largest_correction_is_corrected_as_far_as_that_goes(run: Callable[..., Run]) -> None:
    twin, path = twin_of(3, *LARGE), through_the_wrist()
    before = twin.off_mm(path, path)
    assert before.min() < 5.0 < before.max()  # the version may move the tool by 5 mm
    done = run(twin, path)
    off = twin.off_mm(path, done.sent)
    assert {one.source for one in done.setpoints} == {"corrected"}
    assert np.abs(done.left_mm - off).max() < 1e-3
    beyond = before > 5.0
    assert np.abs(off[beyond] - (before[beyond] - 5.0)).max() < 0.05
    assert all(done.setpoints[k].saturated for k in np.flatnonzero(beyond))
    assert off[~beyond].max() <= 0.05
    assert done.rate_deg_s <= 5.0 * SLACK
    assert done.statistics.held_back["saturated"] >= beyond.sum()
    assert done.statistics.document()["most_left_mm"] == pytest.approx(off.max(), abs=1e-3)
