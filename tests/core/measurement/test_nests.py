"""One reflector that is moved between nests: no row shows three markers, the visits of a pose do together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import ObservationError
from kilter_core.gap import find_gap
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.measurement.frames import Errors
from kilter_core.observations import Observations
from kilter_core.types import Floats

NESTS = np.array([[0.08, 0.0, 0.1], [-0.05, 0.07, 0.12], [-0.04, -0.06, 0.05]])
NOISE = 3e-5
RNG = np.random.default_rng(77)
A = np.array([0.0, -0.612, -0.5723, 0.0, 0.0, 0.0]) + RNG.normal(0.0, 4e-4, 6)
D = np.array([0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922]) + RNG.normal(0.0, 4e-4, 6)
ALPHA = np.radians(np.array([90.0, 0.0, 0.0, 90.0, -90.0, 0.0]) + RNG.normal(0.0, 0.05, 6))
ZERO = np.radians(RNG.normal(0.0, 0.1, 6))
TURN, PLACE = Rotation.from_rotvec([0.1, 0.2, 0.5]).as_matrix(), np.array([1.5, -0.3, 0.8])


def flange(q: Floats) -> Floats:
    """A UR10 with errors, by Denavit and Hartenberg's matrices."""
    T = np.eye(4)
    for theta, a, d, alpha in zip(q + ZERO, A, D, ALPHA, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return T


def visited(poses: int, nests: tuple[int, ...], seed: int, again: bool = True) -> Observations:
    """Visit the poses (``again`` the same) once with the reflector in each nest."""
    rng = np.random.default_rng(seed)
    q, seen = [], []
    places = rng.uniform(-2.0, 2.0, (poses, 6))
    for nest in nests:
        places = places if again else rng.uniform(-2.0, 2.0, (poses, 6))
        for joints in places:
            row = np.full((3, 3), np.nan)
            point = (flange(joints) @ np.append(NESTS[nest], 1.0))[:3]
            row[nest] = TURN @ point + PLACE + rng.normal(0.0, NOISE, 3)
            q.append(joints)
            seen.append(row)
    return Observations(np.array(q), markers=np.array(seen))


def test_an_arm_is_identified_from_one_reflector_in_three_nests() -> None:
    robot = robot_from_document(preset_document("ur10"))
    found = identify(robot, visited(40, (0, 1, 2), 1), visited(20, (0, 1, 2), 2), IdentifyOptions())
    shape = found.calibration.marker_points
    assert shape is not None
    np.testing.assert_allclose(pdist(shape), pdist(NESTS), atol=4 * NOISE / np.sqrt(40))
    assert found.noise_m == pytest.approx(NOISE, rel=0.15)
    held = found.metrics["validation"]
    assert held["registration_only"]["mean_mm"] > 1.0
    assert held["identified"]["mean_mm"] < 1.3 * 1e3 * NOISE * np.sqrt(
        8.0 / np.pi
    )  # the mean length of that noise in space
    # Rows of one nest alone are compared with the shape that is known now.
    one = Measurement.from_observations(visited(20, (1,), 3), shape)
    assert Errors.from_calibration(found.calibration, one).mean < 1.3 * NOISE * np.sqrt(8.0 / np.pi)


def test_by_nests_nothing_is_named_of_a_clean_arm() -> None:
    """Each row shows three numbers of nine: what the others would have shown is not zero."""
    rows = visited(40, (0, 1, 2), 1)
    found = find_gap(robot_from_document(preset_document("ur10")), rows)
    assert (found.verdict, found.effects) == ("not_known", ())  # no pose was repeated
    assert [one["code"] for one in found.warnings] == ["rows_without_tool", "no_repeats"]
    assert "80 rows" in found.warnings[0]["message"]


def test_the_visits_of_another_session_show_nothing_together() -> None:
    rows = visited(10, (0, 1, 2), 4)
    together = rows.markers_of_poses
    assert together is not None
    assert np.isfinite(together).all()
    apart = replace(rows, session=np.repeat([1, 2, 3], 10)).markers_of_poses
    np.testing.assert_array_equal(apart, rows.markers)


def test_other_poses_in_every_nest_are_refused_with_the_remedy() -> None:
    with pytest.raises(ObservationError, match="visit the same poses with the reflector in each of three nests"):
        Measurement.from_observations(visited(10, (0, 1, 2), 5, again=False))
