"""Sockets, planes and ball bars in a search: where they stand is fitted beside the geometry and projected off with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from kilter_core.effects import Batch, Effect
from kilter_core.errors import ObservationError
from kilter_core.gap.search.sources.source import Linear
from kilter_core.gap.search.sources.tool_source import ToolSource, with_columns
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import Contact, fitted_place, group_contacts, square_to
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import Prior
from kilter_core.types import Bools, Floats, Ints

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


BALL = ("tool_x", "tool_y", "tool_z")
SAME = 1e-6  # of the clearest move of ball and places, below which two of them are one
SEEN = 0.05  # of what growing the arm moves, that places and ball cannot follow: from there the rows show its scale


@dataclass(frozen=True)
class ContactSource(ToolSource):
    """Rows that contacts held. Values are where the ``places`` stand, from their first guesses, then the model's values."""

    observes_places = False

    places: tuple[Place, ...]

    @staticmethod
    def from_tool_source(source: ToolSource, values: Floats) -> tuple[ContactSource, Floats]:
        """The source with its contacts where the model of these values puts them, and the values with their places."""
        refuse_mixed(source.measurement)
        points = source.model.predict(source.batch, values).position
        places = initial_places(group_contacts(source.observations), points)
        own = np.zeros(OWN * len(places))
        kept = {f.name: getattr(source, f.name) for f in fields(ToolSource)}
        kept["prior"] = Prior(own, own + WIDE).append_prior(source.prior)
        return ContactSource(**kept, places=places), np.concatenate([own, values])

    @staticmethod
    def of_known_scale(source: ToolSource, values: Floats) -> tuple[ContactSource, Floats]:
        """The same; where the contacts do not show the scale of the arm its longest length is held.

        A smaller arm has smaller errors, those of the noise too: without a scale the best fit is an arm of no size.
        """
        made, placed = ContactSource.from_tool_source(source, values)
        held = made.sets_scale(placed)
        if held is None:
            return made, placed
        free = source.free[source.free != held]
        return ContactSource.from_tool_source(
            ToolSource.from_model(source.model, source.measurement, free, source.n_library), values
        )

    def sets_scale(self, values: Floats) -> int | None:
        """The parameter to hold so that the arm keeps its scale; None where the rows, or what is held already, show it."""
        model, inner = self.model, self.model_values(values)
        named = [e for e in model.robot.chain.elements if e.name is not None and not e.axis.rotates]
        lengths = [model.names.index(str(e.name)) for e in named]
        long = [k for k, e in zip(lengths, named, strict=True) if inner[k] != 0.0 and not e.dependent]
        if not long or not set(long) <= set(self.free.tolist()):
            return None
        grown = self.of_columns(lengths, values) @ inner[lengths]
        left = self.project_off_contacts(grown[:, :, None], values)
        if np.linalg.norm(left) > SEEN * np.linalg.norm(grown):
            return None
        return max(long, key=lambda k: abs(float(inner[k])))

    def of_columns(self, columns: Sequence[int], values: Floats) -> Floats:
        """Derivatives (V, w, K) of what was measured of the tool by some parameters of the model."""
        alone = replace(self, free=np.sort(np.array(columns, dtype=np.int64)))
        order = np.argsort(np.argsort(np.array(columns)))
        return ContactSource.linear(alone, values, None, []).G[:, : self.tool_numbers, self.place_value_count + order]

    def project_off_contacts(self, columns: Floats, values: Floats) -> Floats:
        """Columns (V, w, K) off what places and ball would take up of them."""
        basis = self.contact_basis(values)
        flat = columns.reshape(-1, columns.shape[2])
        return np.asarray((flat - basis @ (basis.T @ flat)).reshape(columns.shape))

    def contact_basis(self, values: Floats) -> Floats:
        """Orthonormal basis (V w, K) of what places and ball explain."""
        ball = [k for k, name in enumerate(self.model.names) if name in BALL and k in self.free]
        alone = replace(self, free=np.array(ball, dtype=np.int64))
        D = ContactSource.linear(alone, values, None, []).G[:, : self.tool_numbers]
        u, s, _ = np.linalg.svd(D.reshape(-1, D.shape[2]), full_matrices=False)
        return np.asarray(u[:, s > SAME * s.max(initial=1e-300)])

    @property
    def place_value_count(self) -> int:
        """How many values say where the places stand."""
        return OWN * len(self.places)

    @property
    def soft(self) -> Bools:
        """Which of the free parameters their priors hold: no place is."""
        return np.concatenate([np.zeros(self.place_value_count, dtype=bool), super().soft])

    @property
    def of_loads(self) -> Bools:
        """Which of the free parameters are load errors."""
        return np.concatenate([np.zeros(self.place_value_count, dtype=bool), super().of_loads])

    @cached_property
    def contacts(self) -> tuple[tuple[Contact, slice], ...]:
        """The contacts of the rows, with the values that say where each stands."""
        index = {place.name: k for k, place in enumerate(self.places)}
        return tuple(
            (c, slice(OWN * index[c.name], OWN * (index[c.name] + 1))) for c in group_contacts(self.observations)
        )

    def model_values(self, values: Floats) -> Floats:
        """Values of the model."""
        return values[self.place_value_count :]

    def on_rows(self, rows: Observations) -> ToolSource:
        """The same model and places on other rows."""
        return self.with_measurement(replace(self.measurement, observations=with_columns(rows, self.observations)))

    def bears(self, values: Floats) -> bool:
        """Whether an effect that follows loads has any of these values."""
        return super().bears(self.model_values(values))

    def with_loads_at_values(self, values: Floats) -> ToolSource:
        """The same rows with loads on the chain of these values."""
        return super().with_loads_at_values(self.model_values(values))

    def doubt(self, values: Floats) -> Floats:
        """Covariance (V, m, m) of the residuals that the blurred signs leave open."""
        inner, size = self.model_values(values), self.residual(values).shape[1]
        prediction, J = self.model.doubts(self.batch, inner, self.measurement.reads_joints)
        if not J.shape[2]:
            return np.zeros((len(J), size, size))
        D = self._compare_with_contacts(prediction, values, J)[1]
        return np.asarray(np.einsum("vik,vjk->vij", D, D))

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m)."""
        return self._compare_with_contacts(self.model.predict(self.batch, self.model_values(values)), values)[0]

    def linear(self, values: Floats, batch: Batch | None = None, only: Sequence[int] | None = None) -> Linear:
        """Residuals and derivatives; those by the places come first."""
        found = super().linear(values, batch, only)
        points = self.model.predict(self.batch, self.model_values(values)).position
        G = np.zeros((*found.r.shape, self.place_value_count))
        for c, own in self.contacts:
            slope = self._place(own).by_place(points[c.rows], values[own])
            G[c.rows, : slope.shape[1], own] = slope
        return Linear(found.r, np.concatenate([G, found.G], axis=2), found.W)

    def geometry(self, values: Floats) -> Floats:
        """Places, then the free geometric parameters."""
        return np.concatenate([values[: self.place_value_count], super().geometry(self.model_values(values))])

    def apply_step(self, values: Floats, geometry: Floats, library: Floats) -> Floats:
        """Take a step."""
        inner = super().apply_step(self.model_values(values), geometry[self.place_value_count :], library)
        return np.concatenate([values[: self.place_value_count] + geometry[: self.place_value_count], inner])

    def joint_columns(self, values: Floats) -> Callable[[int], Floats]:
        """Derivative (V, m) of what was measured by each joint's motion."""
        inner = self.model_values(values)
        prediction, JQ = self.model.joint_jacobian(self.batch, inner, self.measurement.reads_joints)
        return lambda joint: self._compare_with_contacts(prediction, values, JQ[:, :, [joint]])[1][:, :, 0]

    def with_effects(self, rows: Observations, effects: Sequence[Effect], fitted: Floats) -> tuple[ToolSource, Floats]:
        """The fitted model on other rows, whose contacts stand, and whose ball sits, where those rows fit best."""
        measurement = Measurement.from_observations(with_columns(rows, self.observations), held=True)
        started = len(self.model.effects) - self._library_effects()
        model = replace(self.model, effects=(*self.model.effects[:started], *effects))
        known = dict(zip(self.model.names, self.model_values(fitted), strict=True))
        values = np.array([known[p.name] for p in model.parameters])
        alone = ToolSource.from_model(model, measurement, self.free, 0).with_load_blur(self.batch.blur)
        source, values = ContactSource.from_tool_source(alone, values)
        return HeldContacts(**{f.name: getattr(source, f.name) for f in fields(ContactSource)}, at=values), values

    def to_calibration(self, values: Floats, model: RobotModel, begin: Calibration) -> Calibration:
        """The fitted state as a calibration of ``model``; no version holds where contacts stood."""
        return super().to_calibration(self.model_values(values), model, begin)

    def fitted_names(self) -> list[str | None]:
        """Places have none; then the names of the free parameters."""
        return [*[None] * self.place_value_count, *super().fitted_names()]

    def by_version(
        self, values: Floats, version: Calibration, names: Sequence[str]
    ) -> tuple[Floats, list[str], Floats]:
        """Columns of all named parameters but base and tool."""
        G, found, moved = super().by_version(values, version, names)
        return G[:, :, self.place_value_count :], found, moved

    def all_columns(self, values: Floats, names: Sequence[str]) -> tuple[Floats, list[str]]:
        """Derivatives (V, m, K) by all parameters of the model among the names."""
        G, found = super().all_columns(values, names)
        return G[:, :, self.place_value_count :], found

    def _row_slices(self, columns: int) -> list[slice]:
        """All rows at once: contacts hold rows all over."""
        return [slice(0, max(1, len(self.batch)))]

    def _residuals_and_derivatives(
        self, batch: Batch, rows: slice, values: Floats, columns: Ints
    ) -> tuple[Floats, Floats]:
        """Residuals and their derivatives by the model's parameters ``columns``."""
        reads = self.measurement.reads_joints
        prediction, J = self.model.jacobian(batch, self.model_values(values), columns, False, reads)
        r, D = self._compare_with_contacts(prediction, values, J)
        D[np.isnan(r)] = 0.0
        return r, D

    def _compare_with_contacts(
        self, prediction: Prediction, values: Floats, J: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Residuals (V, m) of a prediction and the derivatives (V, m, K) of what is predicted; of the tool first."""
        points, width = prediction.position, self.tool_numbers
        r = np.full((len(points), width), np.nan)
        D = np.zeros((len(points), width, 0 if J is None else J.shape[2]))
        for c, own in self.contacts:
            place, p = self._place(own), points[c.rows]
            r[c.rows] = place.residuals(c, p, values[own])
            if J is not None:
                D[c.rows] = place.by_point(p, values[own]) @ J[c.rows, :3]
        blocks = [b for kind in self.measurement.kinds[1:] for b in kind.blocks(prediction, J)]
        rest = [b.r.reshape(len(points), -1) for b in blocks]
        slopes = [b.J.reshape(len(points), -1, D.shape[2]) for b in blocks if b.J is not None]
        return np.concatenate([r, *rest], axis=1), np.concatenate([D, *slopes], axis=1)

    def _place(self, own: slice) -> Place:
        return self.places[int(own.start) // OWN]


@dataclass(frozen=True)
class HeldContacts(ContactSource):
    """Rows of whole placements that took no part in a fit: sockets, planes and bars stand, and the ball sits, where these
    rows fit best, for neither is the arm's. ``at`` are the values at which that is linearised.
    """

    at: Floats

    @property
    def left_share(self) -> float:
        """Share of the numbers that is left when places and ball have taken theirs."""
        numbers, lost = self._contact_basis.shape
        return float(1.0 - lost / max(1, numbers))

    def residual(self, values: Floats) -> Floats:
        """Residuals (V, m) with places and ball fitted to them."""
        return self._project_off_contacts(super().residual(values)[:, :, None])[:, :, 0]

    def all_columns(self, values: Floats, names: Sequence[str]) -> tuple[Floats, list[str]]:
        """Derivatives (V, m, K) by parameters of the model, less what places and ball would take up."""
        J, found = super().all_columns(values, names)
        return self._project_off_contacts(J), found

    @cached_property
    def _contact_basis(self) -> Floats:
        return self.contact_basis(self.at)

    def _project_off_contacts(self, columns: Floats) -> Floats:
        """Columns (V, m, K) off what places and ball take up; what was measured beside the tool stays."""
        w = self.tool_numbers
        flat = columns[:, :w].reshape(-1, columns.shape[2])
        left = flat - self._contact_basis @ (self._contact_basis.T @ flat)
        return np.concatenate([left.reshape(len(columns), w, -1), columns[:, w:]], axis=1)


def refuse_mixed(measurement: Measurement) -> None:
    """Refuse sockets beside planes or bars: three numbers and one have no noise in common that repeats could show.

    Raises:
        ObservationError: both are there; the remedy.

    """
    sockets = [c.kind == "socket" for c in group_contacts(measurement.observations)]
    if any(sockets) and not all(sockets):
        raise ObservationError(
            "A search takes sockets apart from planes and ball bars, for a row of one measures three numbers and of the other "
            "one: search one campaign of each, and name the other as the confirmation. An identification takes them together.",
            code="contacts_mixed",
        )
