"""What can have changed since a version was made, each as the displacement of the tool that it would cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from kilter_core.arm.chain import increment
from kilter_core.arm.load_wrenches import axial_loads, row_load_wrenches
from kilter_core.identify.estimate import Frame
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats
from kilter_core.watch.innovation import Innovation

Kind = Literal["zero", "sag", "base", "tool", "scale"]

SEEN = 1e-6  # of the largest singular value: a direction below it moves no measured point
TOLD = 0.999  # of a number of a frame that the rows must tell apart from its others
LOADED = 0.05  # of the largest load on a joint of its kind that a joint must carry to sag


@dataclass(frozen=True)
class Cause:
    """One change: of joint ``joint`` (from 1), or of the whole set-up where that is None.

    A base or tool changes by six numbers in its own frame, a shift (m) and a rotation vector (rad); everything else by one:
    a zero by rad or m, a sag by rad/(N m) or m/N, the scale by a factor beyond 1.
    """

    kind: Kind
    joint: int | None = None
    slides: bool = False

    @property
    def name(self) -> str:
        """``zero_3``, ``sag_2``, ``base``, ``tool``, ``scale``."""
        return self.kind if self.joint is None else f"{self.kind}_{self.joint}"

    @property
    def frame(self) -> bool:
        """Whether it is a frame that moved, by six numbers."""
        return self.kind in ("base", "tool")


@dataclass(frozen=True)
class Column:
    """A cause with its whitened derivatives ``white (R, K)``, and an orthonormal basis ``span (R, r)`` of what is seen."""

    cause: Cause
    white: Floats
    span: Floats

    @property
    def is_visible(self) -> bool:
        """Whether these rows show the cause at all."""
        return bool(self.span.shape[1] > 0)

    def change(self, r: Floats) -> Floats:
        """Smallest change (K,) that explains most of a whitened innovation."""
        return self._inverse @ r

    def deviations(self) -> Floats:
        """Standard deviation (K,) of each number of the change; infinite of a number that moves no measured point."""
        return np.where(self._identifiable_mask, np.linalg.norm(self._inverse, axis=1), np.inf)

    def size_deviations(self, change: Floats) -> Floats:
        """Standard deviation (2,) of how long a frame's shift and rotation are, of the numbers that are shown; else (0,)."""
        if not self.cause.frame:
            return np.zeros(0)
        out = []
        for part in (slice(0, 3), slice(3, 6)):
            shown = np.where(self._identifiable_mask[part], change[part], 0.0)
            size = float(np.linalg.norm(shown))
            out.append(float(np.linalg.norm(shown @ self._inverse[part])) / size if size else np.inf)
        return np.array(out)

    @cached_property
    def _identifiable_mask(self) -> Bools:
        """Which numbers (K,) the rows tell apart from the others."""
        return np.asarray(np.einsum("kr,rk->k", self._inverse, self.white) > TOLD)

    @cached_property
    def _inverse(self) -> Floats:
        """Pseudo-inverse (K, R) of the derivatives."""
        if self.white.shape[1] == 1:
            return self.white.T / float(np.sum(self.white**2))
        return np.asarray(np.linalg.pinv(self.white, rcond=SEEN))


def cause_columns(
    innovation: Innovation, calibration: Calibration, new_setup: tuple[Frame, ...] = ()
) -> tuple[Floats, list[Column]]:
    """What frames that were set up anew take up, an orthonormal basis (R, r), and the other causes beside it."""
    caused = derivatives(calibration, innovation.measurement.observations, innovation.prediction, innovation.places)
    made = [(cause, innovation.white(J)) for cause, J in caused]
    anew = [white for cause, white in made if cause.kind in new_setup]
    nuisance = _span(np.hstack(anew), None) if anew else np.zeros((len(innovation.r), 0))
    blind = _blind(made)
    found = []
    for cause, white in made:
        if cause.kind not in new_setup:
            left = white - nuisance @ (nuisance.T @ white)
            span = left[:, :0] if cause.joint in blind else _span(left, white)
            found.append(Column(cause, left, span))
    return nuisance, found


def _blind(made: Sequence[tuple[Cause, Floats]]) -> list[int]:
    """Joints that move no measured point: it is on their axes."""
    moves = {cause.joint: float(np.linalg.norm(white)) for cause, white in made if cause.kind == "zero"}
    return [joint for joint, size in moves.items() if joint is not None and size <= SEEN * max(moves.values())]


def apply_cause(
    calibration: Calibration, rows: Observations, cause: Cause, change: Floats
) -> tuple[Calibration, Observations, float]:
    """Arm, joint angles and unit of length after a change (K,) of a cause, however large.

    The increments of the calibration's frames are zero.
    """
    if cause.joint is not None:
        share = _loads(calibration, rows)[:, [cause.joint - 1]] if cause.kind == "sag" else 1.0
        moved = rows.q + change[0] * share * np.eye(rows.q.shape[1])[cause.joint - 1]
        return calibration, replace(rows, q=moved), 1.0
    if cause.kind == "scale":
        return calibration, rows, 1.0 + float(change[0])
    model = calibration.model
    frames = {"base": model.T_base, "tool": model.T_tool}
    frames[cause.kind] = frames[cause.kind] @ increment(change)
    return replace(calibration, model=model.in_frames(frames["base"], frames["tool"])), rows, 1.0


def derivatives(
    calibration: Calibration, rows: Observations, prediction: Prediction, places: Floats | None = None
) -> Iterator[tuple[Cause, Floats]]:
    """Every cause with the displacement (N, 6, K) of the tool, position and rotation vector, by its numbers.

    An instrument whose unit is wrong puts ``places (N, 3)`` off, the predicted ones when None.
    """
    model = calibration.model
    motions = model.joint_jacobian(rows, calibration.values)[1]
    loads = _loads(calibration, rows)
    slides = np.array([joint.kind != "revolute" for joint in calibration.robot.joints])
    for k, sliding in enumerate(slides.tolist()):
        yield Cause("zero", k + 1, sliding), motions[:, :, [k]]
        alike = float(np.abs(loads[:, slides == sliding]).max())
        if alike and np.abs(loads[:, k]).max() > LOADED * alike:
            yield Cause("sag", k + 1, sliding), motions[:, :, [k]] * loads[:, k, None, None]
    position, rotation = prediction.position, prediction.rotation
    T = model.T_base
    yield Cause("base"), _twists(np.broadcast_to(T[:3, :3], rotation.shape), position - T[:3, 3])
    yield Cause("tool"), _twists(rotation, np.zeros_like(position))
    larger = np.zeros((len(position), 6, 1))
    larger[:, :3, 0] = position if places is None else places
    yield Cause("scale"), larger


def _loads(calibration: Calibration, rows: Observations) -> Floats:
    """Loads (N, n) about or along the joints; none without masses."""
    robot = calibration.model.load_robot
    if not robot.has_masses and rows.payload_kg is None:
        return np.zeros_like(rows.q)
    return axial_loads(robot, row_load_wrenches(robot, rows))


def _twists(axes: Floats, arm: Floats) -> Floats:
    """Derivative (N, 6, 6) by shifts along axes (N, 3, 3) and rotations about them through a place ``arm (N, 3)`` away."""
    out = np.zeros((len(arm), 6, 6))
    out[:, :3, :3] = axes
    out[:, :3, 3:] = np.cross(axes, arm[:, :, None], axis=1)
    out[:, 3:, 3:] = axes
    return out


def _span(columns: Floats, before: Floats | None) -> Floats:
    """Orthonormal basis of columns (R, K), each counted by its own size ``before`` something was taken out of them."""
    size = np.linalg.norm(columns if before is None else before, axis=0)
    if len(size) == 1:
        own = float(np.linalg.norm(columns))
        return columns / own if own > SEEN * float(size[0]) else columns[:, :0]
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = np.where(size > SEEN * size.max(initial=0.0), columns / size, 0.0)
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return U[:, s > SEEN * max(1.0, float(s.max(initial=0.0)))]
