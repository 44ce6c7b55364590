"""Under which conditions rows are compared with a version: the same tool, the temperature, the set-up, the day's noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError, OptionError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats

MOST_K = 15.0  # beyond the temperatures of the fit: what a check then lets pass for expansion hides most changes
GROWTH = 15e-6  # 1/K, standard deviation of the expansion of an arm: steel has 12, aluminium 23
ZEROS = 8e-6  # rad/K or m/K, standard deviation of what each zero moves with the temperature
UNSTATED_K = 5.0  # between an arm and its fit where nobody stated how warm either was: a hall by day and by night
REFERENCE_C = 20.0  # of the growth, whose derivative it does not change


@dataclass(frozen=True)
class Conditions:
    """What a check takes for granted of what nobody stated; the defaults are those of a check whose conditions all are stated.

    ``within_k`` is by how much (K) the arm may differ from its temperature at the fit where that of the rows or of the fit is
    not stated. ``setup`` is the standard deviation (m) with which the set-up repeats: a coordinate of the place of the
    instrument. ``noise_known``: the noise of the day is that of the version or the one stated; else the rows may scatter by
    more, as far as they show it themselves.
    """

    within_k: float = 0.0
    setup: float = 0.0
    noise_known: bool = True

    def of_rows(
        self, calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, placed: bool = True
    ) -> Conditions:
        """What is open of these rows: nothing of the temperature where rows and fit state theirs, or the version models it,
        and nothing of the set-up unless they are ``placed`` where the instrument stands.
        """
        stated = fitted_c is not None and rows.temperature_c is not None
        within = 0.0 if stated or "temperature_c" in calibration.model.needs else self.within_k
        return replace(self, within_k=within, setup=self.setup if placed else 0.0)


STATED = Conditions()


def refuse_another_tool(calibration: Calibration, rows: Observations) -> None:
    """Refuse markers where the version knows a point of the tool, and points where it knows markers.

    Raises:
        ObservationError: nobody says where on the tool the rows were measured.

    """
    marked = rows.markers is not None
    if marked == (calibration.marker_points is not None):
        return
    if marked:
        said = "The rows have markers, and the version does not know where on the tool they are"
        remedy = "Measure the point that the version was identified with (x_mm, y_mm, z_mm)"
    else:
        said = "The rows have a point, and the version knows the tool by its markers alone"
        remedy = "Measure these markers (m1x_mm ...)"
    raise ObservationError(
        f"{said}: nobody says where on the tool was measured. {remedy}, or identify a version with this tool.",
        code="tool_not_stated",
    )


def allowance(
    calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, conditions: Conditions
) -> Floats | None:
    """Displacements (N, 6, K) of one standard deviation each that the conditions explain: temperature and set-up; None of none.

    Raises:
        ObservationError: more than 15 K outside of the temperatures of the fit (lowest, highest).

    """
    parts = [expansion(calibration, rows, fitted_c, conditions.of_rows(calibration, rows, fitted_c).within_k)]
    if conditions.setup > 0.0:
        parts.append(setup_motions(calibration, rows, conditions.setup))
    made = [one for one in parts if one is not None]
    return np.concatenate(made, axis=2) if made else None


def setup_motions(calibration: Calibration, rows: Observations, sigma: float) -> Floats:
    """Displacements (N, 6, 6) of the measured places by an instrument set up again ``sigma`` m (one standard deviation) off.

    Three shifts, and three rotations about the middle of the rows, which move a place at their rms distance by as much.
    """
    position = calibration.predict(rows).position
    arm = position - position.mean(axis=0)
    lever = max(float(np.sqrt(np.mean(np.sum(arm**2, axis=1)))), sigma)
    out = np.zeros((len(rows), 6, 6))
    out[:, :3, :3] = sigma * np.eye(3)
    out[:, 3:, 3:] = sigma / lever * np.eye(3)
    out[:, :3, 3:] = -np.cross(arm[:, None, :], out[:, 3:, 3:], axis=2).transpose(0, 2, 1)
    return out


def expansion(
    calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, within_k: float = 0.0
) -> Floats | None:
    """Displacements (N, 6, K) of one standard deviation each that the temperature of rows explains beyond that of the fit,
    (lowest, highest): growth of the arm about its base, of each link by itself, and its zeros. Where nobody knows the
    temperatures they are ``within_k`` of each other; None where they are not beyond, and where the version models them.

    Raises:
        ObservationError: more than 15 K outside.

    """
    if "temperature_c" in calibration.model.needs:
        return None
    if fitted_c is None or rows.temperature_c is None:
        return within_k * _per_kelvin(calibration, rows) if within_k > 0.0 else None
    low, high = fitted_c
    beyond = rows.temperature_c - np.clip(rows.temperature_c, low, high)
    worst = int(np.abs(beyond).argmax())
    if abs(beyond[worst]) > MOST_K:
        between = f"{low:.4g} deg C" if high - low < 0.05 else f"{low:.4g} to {high:.4g} deg C"
        raise ObservationError(
            f"Row {worst + 1} was measured at {rows.temperature_c[worst]:.4g} deg C, and the version at {between}: at more "
            f"than {MOST_K:g} K of difference an arm expands by more than what a check looks for. Measure at the temperature "
            "of the version, or identify one with thermal_growth and thermal_drift from rows of several temperatures.",
            code="another_temperature",
            row=worst + 1,
            column="temperature_c",
            fitted_c=[low, high],
        )
    if not beyond.any():
        return None
    return _per_kelvin(calibration, rows) * beyond[:, None, None]


def _per_kelvin(calibration: Calibration, rows: Observations) -> Floats:
    """Displacements (N, 6, K) of one standard deviation each by one kelvin."""
    found, motions = calibration.model.joint_jacobian(rows, calibration.values)
    grown = np.zeros((len(rows), 6, 1))
    grown[:, :3, 0] = GROWTH * (found.position - calibration.model.T_base[:3, 3])
    links = GROWTH * _growth_of_links(calibration, rows)
    return np.concatenate([grown, links, ZEROS * motions], axis=2)


def _growth_of_links(calibration: Calibration, rows: Observations) -> Floats:
    """Derivatives (N, 6, K) of the tool by the growth of each link that has a length."""
    model = calibration.model
    try:
        grown = replace(model, effects=(*model.effects, make_effect("link_growth", reference_c=REFERENCE_C)))
    except OptionError:  # no link has a length
        return np.zeros((len(rows), 6, 0))
    at = np.arange(len(model.names), len(grown.names))
    warmer = replace(rows, temperature_c=np.full(len(rows), REFERENCE_C + 1.0))
    return grown.jacobian(warmer, np.append(calibration.values, np.zeros(len(at))), at)[1]
