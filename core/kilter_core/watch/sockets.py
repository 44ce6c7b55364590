"""A check by the joint log alone: the tool's ball was seated in one socket by several poses, and nobody measured where.

The socket is where the version puts its rows on average; only differences between rows of a socket count. What moves all of
them alike, as base, first joint and scale do, is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement.contacts import Contacts
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats, Ints

FEWEST = 3  # poses beyond the first of each socket: what they tell is nine numbers
ALIKE = 1e-9  # of a derivative: less of it is rounding, where what moves all rows of a socket alike was taken out
MOST = 500  # rows whose differences are taken together


def held_by_sockets(rows: Observations) -> bool:
    """Whether the rows say only which socket held the tool's ball."""
    return rows.socket is not None and rows.position is None and rows.markers is None and rows.pixels is None


def place_rows_in_sockets(calibration: Calibration, rows: Observations) -> tuple[Observations, Seated]:
    """Rows of sockets as if their tool point had been measured where the version puts their sockets, and what of them counts.

    Rows that no socket held, or one that held no other, are left out.

    Raises:
        ObservationError: planes or bars. TooFewPosesError: too few poses in a socket, or one pose repeated.

    """
    assert rows.socket is not None
    if rows.plane is not None or rows.bar is not None:
        raise ObservationError(
            "A check by the joint log alone takes balls in sockets, and the rows have plane_id or bar_id too: send the rows "
            "of the sockets alone.",
            code="contacts_mixed",
            columns=["plane_id", "bar_id"],
        )
    if calibration.marker_points is not None:
        raise ObservationError(
            "The version knows the tool by its markers alone, and not where its ball is: identify a version with the ball, "
            "or measure the markers (m1x_mm ...).",
            code="tool_not_stated",
        )
    numbers, counts = np.unique(rows.socket[rows.socket > 0], return_counts=True)
    rows = rows.select(np.isin(rows.socket, numbers[counts > 1]))
    more = len(np.unique(rows.pose_groups())) - int(np.sum(counts > 1)) if len(rows) else 0
    if more < FEWEST:
        raise TooFewPosesError(
            f"A check by the joint log alone needs {FEWEST} poses more than sockets, each socket in two poses or more: this "
            f"log has {max(more, 0)} more. Seat the ball in one socket by six poses that rotate the tool as far as they can.",
            poses=max(more, 0),
            needed=FEWEST,
        )
    if len(rows) > MOST:
        rows = rows.select(np.arange(MOST) * len(rows) // MOST)
    assert rows.socket is not None
    position = by_socket(rows.socket, calibration.predict(rows).position)
    return replace(rows, socket=None, position=position), Seated(rows.socket)


def noise_of_seating(known: Predictive) -> float:
    """Noise (m) of a coordinate of a seated ball, of a version that was fitted to such.

    Raises:
        OptionError: the version was fitted to something else.

    """
    if known.noise_of == Contacts.name and known.noise > 0.0:
        return known.noise
    raise OptionError(
        "The version was not fitted to a ball in sockets and does not say how well it sits: state that as noise (noise_mm), "
        "larger than zero; 0.02 mm is usual of a ground ball in a cone.",
        option="noise",
    )


class Measured:
    """What counts of rows whose places were measured: every coordinate, against the place that is predicted."""

    alone = False  # whether a joint log says it all

    def observable_part(self, coordinates: Floats) -> Floats:
        """What counts (R,) or (R, K) of measured ``coordinates``, their columns or derivatives."""
        return coordinates

    def covariance(self, of_coordinates: Floats) -> Floats:
        """Its covariance (R, R) from that of the coordinates."""
        return of_coordinates

    def columns(self, coordinates: Floats) -> Floats:
        """As :meth:`observable_part`, with zeros for a derivative of which only rounding is left."""
        return coordinates

    def places(self, predicted: Floats) -> Floats:
        """Where the rows (N, 3) are, from where each of them is predicted."""
        return predicted

    def at_places(self, J: Floats, predicted: Floats) -> Floats:
        """Derivatives (N, 6, K) of position and rotation vector of the tool at those places."""
        return J


@dataclass(frozen=True)
class Seated(Measured):
    """What counts of rows that ``sockets (N,)`` held: differences between the rows of each, at its mean place."""

    alone = True

    sockets: Ints

    def observable_part(self, coordinates: Floats) -> Floats:
        """Differences."""
        return np.asarray(self._contrasts @ coordinates)

    def covariance(self, of_coordinates: Floats) -> Floats:
        """Theirs."""
        return np.asarray(self._contrasts @ of_coordinates @ self._contrasts.T)

    def columns(self, coordinates: Floats) -> Floats:
        """Differences; what moves all rows of a socket alike leaves none."""
        out = self.observable_part(coordinates)
        out[:, np.linalg.norm(out, axis=0) <= ALIKE * np.linalg.norm(coordinates, axis=0)] = 0.0
        return out

    def places(self, predicted: Floats) -> Floats:
        """One for all rows of a socket."""
        return by_socket(self.sockets, predicted)

    def at_places(self, J: Floats, predicted: Floats) -> Floats:
        """What rotates about a place that rows put apart rotates them alike where the socket is."""
        J = J.copy()
        J[:, :3] += np.cross(J[:, 3:], (self.places(predicted) - predicted)[:, :, None], axis=1)
        return J

    @cached_property
    def _contrasts(self) -> Floats:
        return contrasts(self.sockets)


def by_socket(sockets: Ints, places: Floats) -> Floats:
    """The mean place (N, 3) of the socket (N,) of each row."""
    _, group, counts = np.unique(sockets, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, group, places)
    return np.asarray(sums[group] / counts[group][:, None])


def contrasts(sockets: Ints) -> Floats:
    """Orthonormal differences (R, 3 N) of the coordinates of rows in sockets (N,): what no place of these changes."""
    numbers, group = np.unique(sockets, return_inverse=True)
    column = (group[:, None] * 3 + np.arange(3)).ravel()
    shared = np.zeros((len(column), 3 * len(numbers)))
    shared[np.arange(len(column)), column] = 1.0
    return np.asarray(null_space(shared.T).T)
