"""How well a view of a pose that was not measured yet would tell where the tool is: by the derivatives of its own pixels.

The places of a camera and a board take the part that base and tool have with a tracker: without one, base and tool stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import Batch, Effect, Local
from kilter_core.effects.physical import INSTRUMENT
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.views import Views, camera_board_pairs, sight_by_tool
from kilter_core.measurement.frames import register
from kilter_core.measurement.poses import Scale, weights
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.transforms import inverse, inverses
from kilter_core.types import Bools, Floats

RIM = 0.02  # share of the picture left free at its edges
SLANTED = 0.5  # cosine between normal and line of sight below which corners blur into each other
FLAT = 1e-3  # of its size that a board may be thick


@dataclass(frozen=True)
class PlannedViews:
    """Cameras and boards of a ``rig`` as views ``pairs`` of them found these, with corners of ``sigma_px``.

    ``sides`` say on which side of its plane each pair's board is printed, 1 or -1 (0 of a solid); weights are in numbers of
    ``scale``.
    """

    known: Calibration
    rig: PlacedRig
    pairs: tuple[tuple[int, int], ...]
    sides: tuple[float, ...]
    sigma_px: float
    scale: Scale

    @staticmethod
    def from_measured_views(
        known: Calibration, rig: PlacedRig, rows: Observations, sigma_px: float, scale: Scale
    ) -> PlannedViews:
        """From the views ``rows`` that were measured."""
        assert rows.camera is not None
        assert rows.board is not None
        pairs = camera_board_pairs(rows.camera, rows.board)
        bare = known.with_effects(())  # others look for columns that planned poses lack, and move them by millimetres
        made = PlannedViews(bare, rig, tuple(pairs), (), sigma_px, scale)
        sides = []
        for c, b in pairs:
            own = rows.select((rows.camera == c) & (rows.board == b))
            sides.append(float(np.sign(np.median(made._cosines(made._views(own, c, b), c, b)))))
        return PlannedViews(bare, rig, tuple(pairs), tuple(sides), sigma_px, scale)

    def weights(self, rows: Observations) -> Floats:
        """Weights (N, 6, 6) of the tool's pose, as :func:`~kilter_core.measurement.poses.weights` has them.

        All cameras that see a whole board count; where none does, nothing is told.
        """
        H = np.zeros((len(rows), 6, 6))
        for (c, b), side in zip(self.pairs, self.sides, strict=True):
            views = self._views(rows, c, b)
            pixels, by_tool = sight_by_tool(self.rig, views, len(self.rig.rig.boards[b].corners))
            seen = self._in_sight(pixels, c) & self._shows_printed_side(self._cosines(views, c, b), side)
            A = (by_tool * seen[:, None, None, None]).reshape(len(rows), -1, 6) / self.sigma_px
            H += A.transpose(0, 2, 1) @ A
        out = np.zeros_like(H)
        told = np.flatnonzero(H.any(axis=(1, 2)))
        if len(told):
            out[told] = weights(np.asarray(np.linalg.inv(H[told])), self.scale)
        return out

    def _views(self, rows: Observations, c: int, b: int) -> Views:
        tool = self.known.predict(Observations(rows.q))
        camera, board = (np.full(len(rows), k, dtype=np.int64) for k in (c, b))
        return Views(camera, board, tool.position, tool.rotation)

    def _in_sight(self, pixels: Floats, c: int) -> Bools:
        """Whether the whole board is in the picture."""
        size = np.array(self.rig.rig.cameras[c].size)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= RIM * size) & (pixels <= (1.0 - RIM) * size - 1.0)
        return np.asarray(inside.all(axis=(1, 2)))

    def _shows_printed_side(self, cosine: Floats, side: float) -> Bools:
        """Whether a flat board shows its printed side, and not too slanted; of a solid always."""
        return np.asarray((cosine * side >= SLANTED) | (side == 0.0))

    def _cosines(self, views: Views, c: int, b: int) -> Floats:
        """Cosine (N,) between the normal of a flat board and the line of sight; zero of a solid."""
        corners, camera = self.rig.corners(b), self.rig.rig.cameras[c]
        middle = corners.mean(axis=0)
        _, size, axes = np.linalg.svd(corners - middle, full_matrices=False)
        if size[2] > FLAT * size[0]:
            return np.zeros(len(views.position))
        p, R = views.position, views.rotation
        if camera.mount == "flange":
            p, R = inverses(p, R)
        X, Y = inverse(self.rig.cameras[c].pose), self.rig.boards[b].pose
        R_board = X[:3, :3] @ R @ Y[:3, :3]
        place = (p + R @ Y[:3, 3]) @ X[:3, :3].T + X[:3, 3] + R_board @ middle
        return np.asarray(np.sum((R_board @ axes[2]) * place, axis=1) / np.linalg.norm(place, axis=1))


@dataclass(frozen=True)
class Cameras(Effect):
    """Where the cameras and boards of ``rig`` stand, and their intrinsics and scales. It moves nothing of the arm."""

    id = "cameras"
    summary = "places of cameras and boards"
    source = "a camera that stands somewhere"
    physical = INSTRUMENT
    stage = "measurement"
    at_joints = False

    rig: PlacedRig | None = None

    @property
    def instrument(self) -> Any:
        """The cameras and boards."""
        return self.rig

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Increments of every place, and what is unknown of the cameras and boards themselves."""
        assert self.rig is not None
        return self.rig.parameters

    def local(self, batch: Batch, values: Floats) -> Local:
        """Nothing: cameras only look."""
        return Local()


def with_cameras(begin: Calibration, train: Observations, measurement: Measurement) -> Calibration:
    """The model to fit with the cameras that measured ``train``, from where they stood before or from nothing.

    Raises:
        ObservationError: what the views do not tell.

    """
    if measurement.pixels is None:
        return begin
    model, values = begin.model.absorb_frame_increments(begin.values)
    if measurement.observes_places:
        model = model.in_frames(*register(model, values, measurement.of_tool()))
    seen = train if train.camera is None else train.select(train.camera >= 0)
    seen = replace(seen, position=None, rotation=None, markers=None, sigma=None)  # views begin by themselves
    here = Calibration(model, values, begin.marker_points)
    views = Measurement.from_observations(seen, held=True).pixels
    assert views is not None
    known = None if measurement.observes_places else begin.rig
    rig = views.initial_rig(replace(here, rig=known).predict(seen)).with_folded_increments()
    effects = (*(e for e in begin.model.effects if not isinstance(e, Cameras)), Cameras(rig=rig))
    found = begin.with_effects(effects)
    start = found.values.copy()
    start[len(start) - len(rig.unknowns) :] = rig.values
    return replace(found, values=start)


def with_rig(calibration: Calibration, measurement: Measurement) -> Calibration:
    """The calibration with cameras and boards where they fit other rows best, all of the arm held."""
    views = measurement.pixels
    assert views is not None
    return replace(calibration, rig=views.fit_rig_to_rows(calibration.predict(measurement.observations)))


def unknown_rig(model: RobotModel) -> PlacedRig | None:
    """Cameras and boards whose unknowns are parameters of a model; None where no camera measured."""
    return next((e.rig for e in model.effects if isinstance(e, Cameras)), None)


def rig_from_calibration(calibration: Calibration) -> PlacedRig | None:
    """Cameras and boards as a calibration has them, the fitted ones where it has an effect of them."""
    fitted = rig_from_values(calibration.model, calibration.values)
    return calibration.rig if fitted is None else fitted.with_folded_increments()


def rig_from_values(model: RobotModel, values: Floats) -> PlacedRig | None:
    """Cameras and boards of an effect of a model, with the increments that ``values (P,)`` are; None where it has none."""
    for effect, at in model.effects_with_slices:
        if isinstance(effect, Cameras) and effect.rig is not None:
            return effect.rig.with_values(values[at])
    return None
