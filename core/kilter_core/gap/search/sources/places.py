"""Where sockets, planes and ball bars stand, as unknowns of a search: three numbers each, counted from a first guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.contacts import Contact, fitted_place, square_to
from kilter_core.types import Floats

OWN = 3  # unknowns of a socket, a plane (its distance and two tilts) and a bar
WIDE = 1.0  # m or rad, prior sigma of each: nothing is known of where they stand


@dataclass(frozen=True)
class Place:
    """The first guess of one contact: of a socket its centre, of a bar its base; of a plane a point and the normal."""

    name: str
    kind: str
    point: Floats
    normal: Floats

    @staticmethod
    def from_contact(contact: Contact, points: Floats) -> Place:
        """Where the contact fits the tool points ``(K, 3)`` of its rows best."""
        found = fitted_place(contact, points)
        if contact.kind == "plane":
            return Place(contact.name, contact.kind, points.mean(axis=0), found[:3])
        return Place(contact.name, contact.kind, found[:3], np.zeros(3))

    def residuals(self, contact: Contact, points: Floats, own: Floats) -> Floats:
        """Residuals (K, w) of the rows: three numbers of a socket, one of a plane or a bar."""
        if self.kind == "socket":
            return np.asarray(self.point + own - points)
        if self.kind == "plane":
            return np.asarray(own[0] - (points - self.point) @ self._normal(own))[:, None]
        assert contact.length is not None
        return np.asarray(contact.length - np.linalg.norm(points - self.point - own, axis=1))[:, None]

    def by_point(self, points: Floats, own: Floats) -> Floats:
        """Derivative (K, w, 3) of what is predicted, minus the residual's, by the tool points."""
        if self.kind == "socket":
            return np.tile(np.eye(3), (len(points), 1, 1))
        if self.kind == "plane":
            return np.tile(self._normal(own), (len(points), 1, 1))
        ray = points - self.point - own
        return np.asarray(ray / np.linalg.norm(ray, axis=1)[:, None])[:, None, :]

    def by_place(self, points: Floats, own: Floats) -> Floats:
        """Derivative (K, w, 3) of what is predicted by the three unknowns."""
        if self.kind != "plane":
            return -self.by_point(points, own)
        u, v = square_to(self.normal)
        tilted = self.normal + own[1] * u + own[2] * v
        size = float(np.linalg.norm(tilted))
        normal, along = tilted / size, points - self.point
        slopes = [along @ ((axis - normal * (normal @ axis)) / size) for axis in (u, v)]
        return np.stack([np.full(len(points), -1.0), *slopes], axis=1)[:, None, :]

    def _normal(self, own: Floats) -> Floats:
        u, v = square_to(self.normal)
        tilted = self.normal + own[1] * u + own[2] * v
        return np.asarray(tilted / np.linalg.norm(tilted))


def initial_places(contacts: Sequence[Contact], points: Floats) -> tuple[Place, ...]:
    """First guesses of all contacts, from the tool points (N, 3) of all rows."""
    return tuple(Place.from_contact(contact, points[contact.rows]) for contact in contacts)
