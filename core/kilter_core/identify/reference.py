"""In which frames a correction puts the tool where the nominal robot would be: its own, the registration's, a start's.

One way for every fit that makes a version: what identifies and what searches must correct alike, wherever the tracker stood.
"""

from __future__ import annotations

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.identify.estimate import registration_only
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.registry import METHODS
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.parameters import mm
from kilter_core.transforms import rotation_log
from kilter_core.types import Floats

Frames = tuple[Floats, Floats]

NEAR_M = 0.010  # frames nearer than this to the robot's own are taken to be the robot's own
NEAR_RAD = np.radians(1.0)
# A tracker that was set up anew stands elsewhere by far more. Taken for the same, what it moved would be corrected as if
# the arm had; taken for another, a tracker in its place costs nothing but a new registration. So these are tight.
SAME_M = 0.001
SAME_RAD = np.radians(0.1)
CONTRADICTED = 5.0  # times the registration's error that a held frame may leave, as with mixed-up rows


def register_nominal(start: Calibration, shown: Measurement, loss: str = "linear") -> Calibration:
    """The nominal robot of ``start`` in the base and tool frames that fit the measurement best.

    Raises:
        NotConvergedError: no minimum found.

    """
    return registration_only(Calibration.nominal(start.robot), shown, loss)


def place_nominal(begin: Calibration, shown: Measurement, options: IdentifyOptions, prior: Prior | None) -> Calibration:
    """The nominal robot in fitted frames; where a filter continues, in those of its start: two poses cannot fit any."""
    if is_continued(options, prior):
        return begin.nominal_in_wanted_frames()
    return register_nominal(begin, shown, options.loss)


def is_continued(options: IdentifyOptions, prior: Prior | None) -> bool:
    """Whether a filter goes on from what is known."""
    return METHODS[options.method].continues and prior is not None


def wanted_frames(
    start: Calibration, found: Calibration, shown: Measurement, options: IdentifyOptions, continued: bool = False
) -> Frames:
    """Base and tool frames (4, 4) a correction should work in, as the option ``reference`` asks.

    ``start`` is what the fit began with, ``found`` the registered nominal robot. Wanted frames of a start are kept where
    the measurements were taken in its frames; ``continued`` says that they were.
    """
    if options.reference == "auto" and (continued or _can_keep_start_frames(start, shown, options)):
        wanted = start.nominal_in_wanted_frames().model
        return wanted.T_base, wanted.T_tool
    base = _choose_frame(start, found, "base", options.base, True, options.reference)
    tool = _choose_frame(start, found, "tool", options.tool, shown.observes_orientation, options.reference)
    return base, tool


def refuse_contradicted(
    options: IdentifyOptions, start: Calibration, found: Calibration, fitted_m: float, registered_m: float
) -> None:
    """Refuse a held base or tool that the rows contradict: held, everything together leaves far more than frames alone.

    ``fitted_m`` and ``registered_m`` are the errors of the fit and of the registered nominal robot ``found``.

    Raises:
        OptionError: the frame, how far off it is, and what to do.

    """
    held = [which for which in ("base", "tool") if getattr(options, which) == "fixed"]
    if not held or fitted_m <= CONTRADICTED * registered_m:
        return
    off = [
        float(np.linalg.norm(getattr(start.model, f"T_{k}")[:3, 3] - getattr(found.model, f"T_{k}")[:3, 3]))
        for k in held
    ]
    which, far = max(zip(held, off, strict=True), key=lambda pair: pair[1])
    raise OptionError(
        f"The {which} is held where the robot has it, and the rows say that it is {mm(far):.4g} mm away: held, "
        f"{mm(fitted_m):.3g} mm are left, with frames fitted and nothing else {mm(registered_m):.3g} mm. Fit it "
        f"(--{which} free), or correct the {which} of the robot.",
        option=which,
    )


def frame_sources(calibration: Calibration) -> dict[str, str]:
    """Where the wanted frames of a calibration come from: "robot" (its own) or "registration"."""
    sources = {}
    for which in ("base", "tool"):
        wanted, own = getattr(calibration, f"wanted_{which}"), getattr(calibration.robot, f"T_{which}")
        sources[which] = "robot" if wanted is None or np.array_equal(wanted, own) else "registration"
    return sources


def _can_keep_start_frames(start: Calibration, shown: Measurement, options: IdentifyOptions) -> bool:
    """Whether the start's wanted frames hold for these measurements: its frames are held, or found where they were."""
    if start.wanted_base is None or start.wanted_tool is None:
        return False
    if options.base == options.tool == "fixed":
        return True
    there = registration_only(start, shown, options.loss).predict(shown.observations)
    here = start.predict(shown.observations)
    moved = np.sqrt(np.mean(np.sum((there.position - here.position) ** 2, axis=1)))
    turned = rotation_log(there.rotation.transpose(0, 2, 1) @ here.rotation)
    angle = np.sqrt(np.mean(np.sum(turned**2, axis=1)))
    return bool(moved < SAME_M and (not shown.observes_orientation or angle < SAME_RAD))


def _choose_frame(
    start: Calibration, found: Calibration, which: str, state: str, turns: bool, reference: str
) -> Floats:
    """One frame (4, 4): that of the start where it is held, the robot's own, or the registration's."""
    own: Floats = getattr(start.robot, f"T_{which}")
    fitted: Floats = getattr(found.model, f"T_{which}")
    if reference != "auto":
        return own if reference == "robot" else fitted
    wanted: Floats | None = getattr(start, f"wanted_{which}")
    if state != "free" and wanted is not None:
        return wanted
    stands = fitted if state == "free" else getattr(start.model, f"T_{which}")
    return own if _are_frames_close(own, stands, turns) else fitted


def _are_frames_close(own: Floats, stands: Floats, turns: bool) -> bool:
    apart = np.linalg.norm(own[:3, 3] - stands[:3, 3])
    angle = float(np.linalg.norm(rotation_log((own[:3, :3].T @ stands[:3, :3])[None])))
    return bool(apart < NEAR_M and (not turns or angle < NEAR_RAD))
