"""The budget of what is not known of where a calibrated arm's tool is, and of an error that was measured of it.

JCGM 100:2008 (GUM): contributions add as variances, correlated ones with their covariance (5.2.2, equation (13)); the expanded
uncertainty is U = k u with k = 2, about 95 % (6.2.1, 6.3.3). Two sums are taken of the same contributions:

- of a prediction: everything. Within U of what the version predicts a new measurement of the tool is found.
- of a measured error: instrument, repeatability, registration and temperature. The version's own doubt is not part of it, for
  what is judged is this version, whatever the true parameters are.

Whether measured errors prove that an arm keeps a tolerance, or that it does not: ISO 14253-1.

ISO 14253-1:2017, 5: conformity is proved by measured values inside the tolerance by at least the guard band, and
nonconformity by one outside it by as much. In between neither can be proved. The guard band is the expanded uncertainty U of
the measured error, k = 2, which is wider than the 1.65 u that the standard takes by default.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.parameters import mm
from kilter_core.types import Floats

RECTANGULAR = 3.0**0.5  # half width over standard deviation: JCGM 100:2008 (GUM), 4.3.7, equation (7)


@dataclass(frozen=True)
class PermissibleError:
    """MPE of a length L, m: ``fixed`` + ``per_length`` L, as ISO 10360-10:2021 and 10360-12:2016 state E_Uni,MPE."""

    fixed: float
    per_length: float = 0.0

    def half_width(self, length: Floats) -> Floats:
        """MPE (N,) m of lengths (N,) m."""
        return np.asarray(self.fixed + self.per_length * length)

    def standard(self, length: Floats) -> Floats:
        """Standard uncertainty (N,) m of a coordinate at these lengths.

        Type B. Nothing is known but that the error is within the MPE, so it is as likely anywhere there: rectangular. The MPE
        of a length counts whole for each coordinate of its end, which is more than its share.
        """
        return np.asarray(self.half_width(length) / RECTANGULAR)


K = 2.0  # coverage factor, about 95 %: JCGM 100:2008, 6.3.3
EXPANSION_PER_K = 23e-6  # of aluminium, which of the metals of arms expands most
OF_AN_ERROR = ("instrument", "repeatability", "registration", "temperature")
TYPES = {
    "instrument": ("B", "rectangular"),
    "repeatability": ("A", "normal"),
    "registration": ("A", "normal"),
    "temperature": ("B", "rectangular"),
    "model": ("A", "normal"),
    "left_over": ("A", "normal"),
}


@dataclass(frozen=True)
class Budget:
    """Variances (N, 3) m² of each row's coordinates by source; one that is not there was not assessed.

    ``correlation`` is that of registration and model before they were told apart, so that they add as they stand.
    """

    variances: Mapping[str, Floats]
    correlation: float

    @staticmethod
    def from_measurement(
        calibration: Calibration,
        known: Predictive,
        measurement: Measurement,
        instrument: PermissibleError | None = None,
        refit: Sequence[str] = (),
    ) -> Budget | None:
        """Return the budget at measured rows; None where no place is measured.

        ``known`` is what the version knows of itself; ``refit`` frames were fitted to these rows. Repeatability is that of
        the rows that were fitted, or of these where a camera or a contact measured those.
        """
        if not measurement.observes_places:
            return None
        measurement = measurement.of_tool()
        known = known.judging(measurement) or replace(known, noise=0.0)
        parts = known.variance_parts(calibration, measurement, refit)
        count = len(measurement.observations)
        whole = np.ones((count, 3))
        found = {"model": parts.model, "registration": parts.registration, "left_over": known.inadequacy**2 * whole}
        if known.noise > 0.0:
            found["repeatability"] = known.noise**2 * whole
        if instrument is not None:
            found["instrument"] = instrument.standard(_lengths(measurement))[:, None] ** 2 * whole
        temperature = _temperature(calibration, measurement)
        if temperature is not None:
            found["temperature"] = temperature[:, None] ** 2 * whole
        return Budget({name: found[name] for name in TYPES if name in found}, parts.correlation)

    @property
    def prediction_uncertainty(self) -> Floats:
        """Standard uncertainties (N, 3) m of where the tool is measured, by what is predicted."""
        return np.asarray(np.sqrt(sum(self.variances.values())))

    @property
    def measured_error_uncertainty(self) -> Floats:
        """Standard uncertainties (N, 3) m of a measured error."""
        return np.asarray(np.sqrt(sum(values for name, values in self.variances.items() if name in OF_AN_ERROR)))

    def along(self, errors: Floats) -> Floats:
        """Standard uncertainties (N,) m of the sizes of measured errors (N, 3) m; of no error the largest of a coordinate."""
        size = np.linalg.norm(errors, axis=1, keepdims=True)
        share = np.divide(errors, size, out=np.zeros_like(errors), where=size > 0.0)
        found = np.sqrt(np.sum((share * self.measured_error_uncertainty) ** 2, axis=1))
        return np.asarray(np.where(size[:, 0] > 0.0, found, self.measured_error_uncertainty.max(axis=1)))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm: root mean squares over rows and coordinates."""
        predicted, measured = _rms(self.prediction_uncertainty**2), _rms(self.measured_error_uncertainty**2)
        total = predicted**2 or 1.0
        sizes = {name: _rms(values) for name, values in self.variances.items()}
        return {
            "rows": len(self.variances["left_over"]),
            "k": K,
            "standard_mm": mm(predicted),
            "expanded_mm": mm(K * predicted),
            "measured_standard_mm": mm(measured),
            "measured_expanded_mm": mm(K * measured),
            "contributions": [
                {
                    "source": name,
                    "type": TYPES[name][0],
                    "distribution": TYPES[name][1],
                    "standard_mm": mm(sizes[name]),
                    "half_width_mm": mm(sizes[name] * RECTANGULAR) if TYPES[name][1] == "rectangular" else None,
                    "share": sizes[name] ** 2 / total,
                    "of_measured": name in OF_AN_ERROR,
                }
                for name in self.variances
            ],
            "correlations": [{"between": ["registration", "model"], "coefficient": self.correlation}],
            "not_assessed": [name for name in TYPES if name not in self.variances],
        }


def _rms(variances: Floats) -> float:
    return float(np.sqrt(np.mean(variances)))


def _lengths(measurement: Measurement) -> Floats:
    """Distances (N,) m of the measured points from their middle, where the registration ties the frames together."""
    rows = measurement.observations
    points = rows.position
    if points is None:
        assert rows.markers is not None
        seen = ~np.isnan(rows.markers)
        count = np.maximum(seen.sum(axis=1), 1)
        points = np.where(seen, rows.markers, 0.0).sum(axis=1) / count
    return np.asarray(np.linalg.norm(points - points.mean(axis=0), axis=1))


def _temperature(calibration: Calibration, measurement: Measurement) -> Floats | None:
    """Standard uncertainties (N,) m by how the temperature varied; None where it was not measured, or is in the model.

    Type B, rectangular over half of what was measured. The arm is as long as from its base to the tool.
    """
    celsius = measurement.observations.temperature_c
    if celsius is None or np.isnan(celsius).any():
        return None
    if "temperature_c" in calibration.model.needs:
        return None
    position = calibration.predict(measurement.observations).position
    lengths = np.linalg.norm(position - calibration.model.T_base[:3, 3], axis=1)
    return np.asarray(EXPANSION_PER_K * 0.5 * float(np.ptp(celsius)) * lengths / RECTANGULAR)


Decision = Literal["accepted", "rejected", "not_proved"]


@dataclass(frozen=True)
class Conformity:
    """A decision about the largest of the errors of rows, m. ``row`` decides it: the worst for it, from 0.

    ``guard`` is the guard band there. ``needed`` is the smallest tolerance that these rows would prove.
    """

    decision: Decision
    tolerance: float
    row: int
    error: float
    guard: float
    needed: float

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm; the row counts from 1."""
        return {
            "decision": self.decision,
            "tolerance_mm": mm(self.tolerance),
            "row": self.row + 1,
            "error_mm": mm(self.error),
            "guard_band_mm": mm(self.guard),
            "provable_mm": mm(self.needed),
        }


def judge(errors: Floats, expanded: Floats, tolerance: float) -> Conformity:
    """Decide by the sizes ``errors (N,)`` m of measured errors and their ``expanded (N,)`` uncertainties, m.

    Accepted: every error and its guard band are within the tolerance. Rejected: some error is beyond it by its guard band.

    Raises:
        OptionError: no rows, or a tolerance that is not above 0.

    """
    if not np.isfinite(tolerance) or tolerance <= 0.0:
        raise OptionError(f"tolerance is {mm(tolerance):g} mm: give a number above 0.", option="tolerance_mm")
    if not len(errors):
        raise OptionError("There are no errors to decide by.", option="campaigns")
    reach, beyond = errors + expanded, errors - expanded
    row = int(np.argmax(reach))
    needed = float(reach[row])
    if needed <= tolerance:
        decision: Decision = "accepted"
    elif float(beyond.max()) > tolerance:
        decision, row = "rejected", int(np.argmax(beyond))
    else:
        decision = "not_proved"
    return Conformity(decision, tolerance, row, float(errors[row]), float(expanded[row]), needed)
