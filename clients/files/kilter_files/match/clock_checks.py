"""What is refused of two clocks: jumps against each other, a drift no clock has, a motion the model does not explain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.faults import fault
from kilter_files.match.arm import Arm
from kilter_files.match.clock_jumps import Jump, LagPath, lag_path
from kilter_files.match.dwells import Thinned
from kilter_files.match.speeds import likeness
from kilter_files.tables.joint_log import JointLog

LEAST_CORRELATION = 0.3
MOST_DRIFT = 5e-4  # quartz clocks agree within a few hundred parts in a million
SHOWN = 5


@dataclass(frozen=True)
class Checks:
    """What is known to check a pairing by, and what the person allows.

    ``arm`` is the robot's model. ``piecewise``: match the parts between jumps of the clocks each by itself. ``unchecked``:
    what would be refused is a warning. Rows from ``since_s`` to ``until_s`` of the recording count.
    """

    arm: Arm | None = None
    piecewise: bool = False
    unchecked: bool = False
    since_s: float = -float("inf")
    until_s: float = float("inf")

    def refuse(self, path: Path, what: str, remedy: str) -> str:
        """Refuse, or return the warning where the person allows it.

        Raises:
            FileError: what was found is not allowed.

        """
        if not self.unchecked:
            raise fault(path, what, f"{remedy} --unchecked sends it anyway.")
        return what


UNTOLD = Checks()


@dataclass(frozen=True)
class Followed:
    """Parts of a recording (start, end, lag; s) that may be matched, but for what is ``lost``; and warnings.

    ``sure``: the lags are the model's, good to some milliseconds.
    """

    parts: list[tuple[float, float, float]]
    lost: tuple[tuple[float, float], ...]
    correlation: float
    warnings: list[str]
    sure: bool = False


def follow_clocks(path: Path, thinned: Thinned, log: JointLog, checks: Checks) -> Followed:
    """Find the lag between the clocks, and refuse jumps.

    Raises:
        FileError: a motion that is not the log's, or clocks that jump or run apart.

    """
    alike = likeness(thinned, log)
    found = lag_path(thinned, log, checks.arm) if checks.arm is not None else None
    warnings: list[str] = []
    if found is not None and found.found is None:
        warnings.append(_refuse_other_model(path, log, checks, found.left or 1.0))
        found = None
    if found is None:
        if alike.correlation < LEAST_CORRELATION:
            what = f"its motion is not that of {log.path.name}: the speeds correlate by {alike.correlation:.2f} at best"
            raise fault(path, what, "Is it the log of this recording? Do both hold the same motion?")
        found = lag_path(thinned, log, None)
    if found.jumps:
        warnings.append(_refuse_jumps(path, log, found, checks))
    else:
        warnings += refuse_drift(path, log, found.drift, found.drift_sigma, checks)
    warnings += _lost_interval_warnings(found)
    return Followed(found.parts, found.lost, alike.correlation, warnings, found.found is not None)


def _refuse_other_model(path: Path, log: JointLog, checks: Checks, left: float) -> str:
    assert checks.arm is not None
    what = (
        f"the model of {checks.arm.name} explains no part of it with the joints of {log.path.name}: "
        f"{left:.0%} of the markers' motion is left at best"
    )
    remedy = (
        "Is it the log of this recording, the robot that was measured, and are the joints in its order and direction?"
    )
    return checks.refuse(path, what, remedy)


def refuse_drift(path: Path, log: JointLog, drift: float, sigma: float, checks: Checks) -> list[str]:
    """Refuse a drift that no clock has; a warning where the person allows it.

    Raises:
        FileError: the clocks drift apart by more than 500 ppm, beyond three standard deviations.

    """
    if not abs(drift) - 3 * sigma > MOST_DRIFT:
        return []
    what = (
        f"its clock and that of {log.path.name} drift apart by {drift * 1e6:+.0f} ppm (± {sigma * 1e6:.0f}); clocks agree "
        f"within a few hundred, {MOST_DRIFT * 1e6:.0f} is the limit"
    )
    return [checks.refuse(path, what, "Is the frame rate right (--rate), and t_s of the log in seconds?")]


def describe_jump(jump: Jump) -> str:
    """Say a jump in words."""
    return f"by {jump.size_s:+.2f} s between {jump.from_s:.2f} and {jump.to_s:.2f} s"


def _refuse_jumps(path: Path, log: JointLog, found: LagPath, checks: Checks) -> str:
    named = "; ".join(describe_jump(jump) for jump in found.jumps[:SHOWN]) + (
        " ..." if len(found.jumps) > SHOWN else ""
    )
    what = f"its clock and that of {log.path.name} jump against each other {named}"
    if found.found is None:
        what += " (by the speeds alone, so roughly)"
        remedy = (
            "Name the robot (--robot or --model): its model finds time and size, and --piecewise matches the parts."
        )
    elif checks.piecewise:
        return f"{what}: matched part by part"
    else:
        remedy = "Match the parts before and after separately with --piecewise, or one of them with --until or --since."
    if checks.unchecked and found.found is None:
        return checks.refuse(path, what, remedy)
    raise fault(path, what, remedy)


def _lost_interval_warnings(found: LagPath) -> list[str]:
    return [f"from {a:.2f} to {b:.2f} s no lag explains where the markers are: left out" for a, b in found.lost]
