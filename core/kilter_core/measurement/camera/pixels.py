"""Corners of boards that cameras see: pixels, whitened by what is known of each corner, through camera and chain.

A row is one view: one camera saw one board. Residuals are told in metres, pixels times what a pixel is wide where the
boards were, one constant for all rows: so they weigh as pixels, and read as lengths.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.rig_fit import estimate_start_rig, fit_rig, fit_rig_beside_arm, thin_views
from kilter_core.measurement.camera.views import (
    ToolErrors,
    Views,
    camera_board_pairs,
    sight,
    sight_and_slopes,
    sight_by_tool,
)
from kilter_core.measurement.kind import POINTS, Block, Kind, Rows, Spanned, find_anchor
from kilter_core.model import Calibration, Prediction
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.observations.rig import Rig
from kilter_core.types import Bools, Floats, Ints

MOST_TOLD = 4  # calibrations whose errors are kept


@dataclass(frozen=True)
class Pixels(Kind):
    """Views of boards beside another measurement of the tool. ``anchor`` are the rows that say where cameras stand."""

    name = "pixels"
    summary = "corners of boards that cameras see"
    group = "pixels"
    follows_tool = True
    observations: Observations
    anchor: Pixels | None = None

    @classmethod
    def from_rows(cls, rows: Rows) -> Kind | None:
        """Rows that have pixels; where nothing else tells of the tool, they do."""
        o = rows.observations
        if o.pixels is None or o.rig is None or rows.relative:
            return None
        alone = o.position is None and o.markers is None
        return (PixelsAlone if alone else Pixels)(o, cast("Pixels | None", find_anchor(cls.name, rows)))

    @property
    def rig(self) -> Rig:
        """The cameras and boards."""
        assert self.observations.rig is not None
        return self.observations.rig

    @property
    def pixels(self) -> Floats:
        """Corners (N, M, 2) px."""
        assert self.observations.pixels is not None
        return self.observations.pixels

    @property
    def _places(self) -> tuple[Ints, Ints]:
        assert self.observations.camera is not None
        assert self.observations.board is not None
        return self.observations.camera, self.observations.board

    def check(self) -> None:
        """Refuse views of a camera and a board that move together."""
        for c, b in camera_board_pairs(*self._places):
            one, other = self.rig.cameras[c], self.rig.boards[b]
            if one.mount == other.mount:
                raise ObservationError(
                    f"Camera {one.name!r} and board {other.name!r} are both {_describe_mount(one.mount)}: such views "
                    "do not follow the "
                    "arm. Correct the mount of one of them, or leave these rows out.",
                    code="mounts_alike",
                    camera=one.name,
                    board=other.name,
                )

    def measured_row_mask(self) -> Bools:
        """Rows with corners."""
        return np.asarray(~np.isnan(self.pixels).all(axis=(1, 2)))

    def scalars(self) -> int:
        """Numbers that were seen."""
        return int(np.count_nonzero(~np.isnan(self.pixels)))

    @property
    def observes_orientation(self) -> bool:
        """A board shows how it is rotated."""
        return True

    @property
    def equations_per_pose(self) -> int:
        """A view tells a pose."""
        return 6

    @cached_property
    def metres_per_px(self) -> float:
        """What a pixel is wide at the boards, m: the median over the views of how far corners are apart there and here."""
        board, corners = self._places[1], np.full((len(self.rig.boards), self.pixels.shape[1], 3), np.nan)
        for k, one in enumerate(self.rig.boards):
            corners[k, : len(one.corners)] = one.corners
        seen = ~np.isnan(self.pixels).any(axis=2) & (board >= 0)[:, None]
        wide, here = (_spread(values, seen) for values in (corners[board], self.pixels))
        ratio = wide[here > 0.0] / here[here > 0.0]
        return float(np.median(ratio)) if len(ratio) else 1e-3

    @cached_property
    def weights(self) -> Floats | float:
        """Metres per whitened pixel: those of every corner (N, M, 2) where it says how well it is known."""
        sigma = self.observations.pixel_sigma
        if sigma is None:
            return self.metres_per_px
        common = float(np.sqrt(np.nanmean(np.where(np.isnan(self.pixels), np.nan, sigma) ** 2)))
        return np.asarray(self.metres_per_px * common / np.where(np.isnan(sigma), common, sigma))

    def views(self, prediction: Prediction) -> Views:
        """The views of a predicted arm."""
        return Views(*self._places, prediction.position, prediction.rotation)

    def fit_rig_to_rows(self, prediction: Prediction) -> PlacedRig:
        """The rig where it fits these rows best, the arm held as predicted, which need not be right."""
        views = self.views(prediction)
        start = estimate_start_rig(self.rig, views, self.pixels)
        return fit_rig_beside_arm(start, views, self.pixels, self.observations.pixel_sigma).rig

    def initial_rig(self, prediction: Prediction) -> PlacedRig:
        """Where a fit begins: places as known or as they fit, intrinsics and scales as stated, for an arm not yet fitted
        would be made up for by them.
        """
        known = prediction.instrument
        if known is not None and known.rig.has(self.rig):
            return known.rig.select_parts(self.rig)
        whole, sigma = self.views(prediction), self.observations.pixel_sigma
        some = np.concatenate([thin_views(which, self.pixels) for which, _, _ in whole.pairs()])
        views, pixels = whole.only(some), self.pixels[some]
        held = estimate_start_rig(self.rig, views, pixels).with_description(self.rig.with_fixed_parameters())
        return fit_rig(held, views, pixels, None if sigma is None else sigma[some]).rig.with_description(self.rig)

    def resolve_rig(self, prediction: Prediction) -> PlacedRig:
        """The rig as it is known; where a prediction knows nothing of these cameras, as it fits these rows best."""
        known = prediction.instrument
        return (
            known.rig.select_parts(self.rig)
            if known is not None and known.rig.has(self.rig)
            else self.fit_rig_to_rows(prediction)
        )

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted corners (N, M, 2), whitened by what is known of each, in m at the boards."""
        w, given = self.weights, (self.resolve_rig(prediction), self.views(prediction), self.pixels.shape[1])
        if J is None:
            return (Block(self.group, w * (self.pixels - sight(*given))),)
        pixels, slopes = sight_and_slopes(*given)
        r = w * (self.pixels - pixels)
        n, m = r.shape[:2]
        span, of_rig = slopes.low_rank_factors()
        span *= w if isinstance(w, float) else w[..., None]
        unseen = np.isnan(r)
        if unseen.any():
            span[unseen] = 0.0
        inner = np.zeros((*of_rig.shape[:2], J.shape[2]))
        inner[:, :6] = J[:, :6]
        if prediction.instrument is not None and len(prediction.instrument.columns):
            columns = prediction.instrument.columns
            fitted = np.flatnonzero(columns >= 0)
            inner[:, :, columns[fitted]] += of_rig[:, :, fitted]
        return (Block(self.group, r, Spanned(span.reshape(n, 2 * m, -1), inner)),)

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 3) m and (K,) rad of the tool, by what each view says without its noise."""
        found = self.tool_errors(calibration)
        e = found.without_noise
        return e[:, :3], np.asarray(np.sqrt(np.sum(e[:, 3:] ** 2, axis=1)), dtype=np.float64)

    def row_errors(self, calibration: Calibration) -> tuple[Floats, Floats, Floats]:
        """Errors (N, 3) m and (N,) rad of the tool by each row, as :meth:`errors` has them, and the length (N,) of what the
        row says, noise included, in standard deviations. NaN where a row's corners tell no pose.
        """
        found = self.tool_errors(calibration)
        place, turn, size = (np.full((len(self.observations), *shape), np.nan) for shape in ((3,), (), ()))
        place[found.rows], turn[found.rows] = self.errors(calibration)
        square = np.einsum("ni,nij,nj->n", found.motion, np.linalg.inv(found.covariance), found.motion)
        size[found.rows] = np.sqrt(square) / max(found.sigma_px, np.finfo(np.float64).tiny)
        return place, turn, size

    def tool_errors(self, calibration: Calibration) -> ToolErrors:
        """Motions of the tool that explain what is left of each view best."""
        for known, values, found in self._recent_errors:
            if known is calibration and np.array_equal(values, calibration.values):
                return found
        prediction = calibration.predict(self.observations)
        rig = self._resolve_calibration_rig(calibration, prediction)
        seen, by_tool = sight_by_tool(rig, self.views(prediction), self.pixels.shape[1])
        w = np.broadcast_to(self.weights, self.pixels.shape) / self.metres_per_px
        made = ToolErrors.from_residuals(w * (self.pixels - seen), by_tool * w[..., None])
        self._recent_errors.append((calibration, calibration.values.copy(), made))
        return made

    @cached_property
    def _recent_errors(self) -> deque[tuple[Calibration, Floats, ToolErrors]]:
        """The last few errors: a report asks for those of one stage several times over."""
        return deque(maxlen=MOST_TOLD)

    def _resolve_calibration_rig(self, calibration: Calibration, prediction: Prediction) -> PlacedRig:
        """The rig of a calibration; where it has none, as it fits the anchor, or else these rows."""
        known = prediction.instrument
        if (known is not None and known.rig.has(self.rig)) or self.anchor is None:
            return self.resolve_rig(prediction)
        found = self.anchor.resolve_rig(calibration.predict(self.anchor.observations))
        return found.select_parts(self.rig) if found.has(self.rig) else self.fit_rig_to_rows(prediction)


class PixelsAlone(Pixels):
    """Views of boards where nothing else tells of the tool."""

    group = POINTS
    follows_tool = False
    observes_tool = True
    places_itself = True
    plain_fits_only = True


def _describe_mount(mount: str) -> str:
    return "fixed in the room" if mount == "fixed" else "on the flange"


def _spread(points: Floats, seen: Bools) -> Floats:
    """Root mean square distance (N,) of points (N, M, d) that are ``seen (N, M)`` from their middle; 0 of fewer than two."""
    count = seen.sum(axis=1)
    told = np.where(seen[..., None], points, 0.0)
    middle = told.sum(axis=1) / np.maximum(count, 1)[:, None]
    square = np.where(seen, np.sum((told - middle[:, None]) ** 2, axis=2), 0.0).sum(axis=1)
    return np.asarray(np.sqrt(square / np.maximum(count, 1)) * (count > 1))
