"""A camera or board that moved half-way, fitted with a place before and a place after: how far it moved, and how surely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.moved_parts import Moved, Step
from kilter_core.identify.rows.measurement_of_rows import measurement_for
from kilter_core.identify.uncertainty.by_views import by_views, view_scatter
from kilter_core.identify.views.cameras import rig_from_values, with_cameras
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.transforms import inverse, rotation_log
from kilter_core.types import Bools, Floats

STEP = 1e-6  # m, rad: of a difference


@dataclass(frozen=True)
class Apart:
    """Rows in which one of the parts has two names, and the fit to them."""

    fit: Fit
    step: Step
    place: int
    other: int
    later: Bools

    @staticmethod
    def fit_moved_part(
        begin: Calibration, train: Observations, options: IdentifyOptions, step: Step, later: Bools
    ) -> Apart | None:
        """Fit the rows anew, of which those ``later (N,)`` saw the part elsewhere; None where nothing comes of it."""
        assert train.rig is not None
        column, parts = ("camera", train.rig.cameras) if step.part.camera else ("board", train.rig.boards)
        codes = train.camera if step.part.camera else train.board
        assert codes is not None
        place = [one.name for one in parts].index(step.part.name)
        again = replace(parts[place], name=f"{step.part.name} after")
        rig = replace(train.rig, **{f"{column}s": (*parts, again)})
        moved: dict[str, Any] = {column: np.where(later & (codes == place), len(parts), codes)}
        rows = replace(train, rig=rig, **moved)
        try:
            measurement = measurement_for(rows, options, begin.marker_points)
            fit = fit_by_method(with_cameras(begin, rows, measurement), measurement, options)
            return Apart(by_views(fit, view_scatter(fit)), step, place, len(parts), later)
        except CoreError:
            return None

    def estimate_motion(self) -> Moved:
        """How far the part moved at the tool (m, rms over the later rows) and rotated (rad), with standard deviations."""
        names = [self.fit.problem.model.names[k] for k in self.fit.problem.free]
        mine = [k for k, name in enumerate(names) if name.startswith((self._prefix, f"{self._prefix[:-1]} after_"))]
        slopes = np.zeros((2, len(self.fit.names)))
        for k in mine:  # to both sides: a length near zero bends, and what both places share must cancel
            there = STEP * (np.arange(len(self.fit.values)) == self.fit.problem.free[k])
            slopes[:, k] = (self._sizes(self.fit.values + there) - self._sizes(self.fit.values - there)) / (2.0 * STEP)
        size, turn = self._sizes(self.fit.values)
        left = np.sqrt(np.diag(slopes @ self.fit.covariance @ slopes.T))
        return Moved((float(size), float(left[0])), (float(turn), float(left[1])))

    @property
    def _prefix(self) -> str:
        return f"{'camera' if self.step.part.camera else 'board'}_{self.step.part.name}_"

    def _sizes(self, values: Floats) -> Floats:
        model = self.fit.problem.model
        rig = rig_from_values(model, values)
        assert rig is not None
        parts = rig.cameras if self.step.part.camera else rig.boards
        before, after = parts[self.place].pose, parts[self.other].pose
        change = after @ inverse(before)
        turn = np.linalg.norm(rotation_log(change[None, :3, :3])[0])
        at = np.zeros((1, 3))  # the tool point, in whose frame what is on the flange stands
        if self.step.part.fixed:
            at = self.fit.calibration().predict(self.fit.problem.measurement.observations).position[self.later]
        off = at @ (change[:3, :3] - np.eye(3)).T + change[:3, 3]
        return np.array([np.sqrt(np.mean(np.sum(off**2, axis=1))), turn])
