"""Whether rows can be compared with a version at all: the same tool, and a temperature that its own rows had."""

from __future__ import annotations

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats

MOST_K = 15.0  # beyond the temperatures of the fit: what a check then lets pass for expansion hides most changes
GROWTH = 15e-6  # 1/K, standard deviation of the expansion of an arm: steel has 12, aluminium 23
ZEROS = 8e-6  # rad/K or m/K, standard deviation of what each zero moves with the temperature


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


def expansion(calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None) -> Floats | None:
    """Displacements (N, 6, n + 1) of one standard deviation each that the temperature of rows explains beyond that of the
    fit, (lowest, highest): growth of the arm about its base, and its zeros. None where nobody knows the temperatures, where
    the version models them, and where none is beyond.

    Raises:
        ObservationError: more than 15 K outside.

    """
    if fitted_c is None or rows.temperature_c is None or "temperature_c" in calibration.model.needs:
        return None
    low, high = fitted_c
    beyond = rows.temperature_c - np.clip(rows.temperature_c, low, high)
    worst = int(np.abs(beyond).argmax())
    if abs(beyond[worst]) > MOST_K:
        between = f"{low:.4g} deg C" if high - low < 0.05 else f"{low:.4g} to {high:.4g} deg C"
        raise ObservationError(
            f"Row {worst + 1} was measured at {rows.temperature_c[worst]:.4g} deg C, and the version at {between}: at more "
            f"than {MOST_K:g} K of difference an arm expands by more than what a check looks for. Measure at the temperature "
            "of the version, or identify one with thermal_growth and thermal_drift from rows of several temperatures.",
            code="another_temperature", row=worst + 1, column="temperature_c", fitted_c=[low, high],
        )  # fmt: skip
    if not beyond.any():
        return None
    found, motions = calibration.model.joint_jacobian(rows, calibration.values)
    grown = np.zeros((len(rows), 6, 1))
    grown[:, :3, 0] = GROWTH * (found.position - calibration.model.T_base[:3, 3])
    return np.concatenate([grown, ZEROS * motions], axis=2) * beyond[:, None, None]
