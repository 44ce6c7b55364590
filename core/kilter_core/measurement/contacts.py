"""Calibration without an instrument: the tool's ball held in a socket, on a plane, or at the end of a ball bar.

Where sockets, planes and bars stand is not known and not wanted: for every guess of the robot they are put where they fit
best, and the Jacobian is cleared of what their own moves would explain (variable projection, Kaufman 1975).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.kind import Block, Kind, Rows, find_anchor
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

UNKNOWNS = {"socket": 3, "plane": 3, "bar": 3}
LEAST_ROWS = {"socket": 2, "plane": 4, "bar": 4}
STEPS = 60
SETTLED_M = 1e-12
LEVEL = 1e-3  # share of the best seen move of a place below which lengths leave it where it is, smoothly
FLAT = 0.2  # share of the second width of the points below which the third makes them lie near a plane
ALMOST = 3e-4  # as LEVEL, of a base's height over the plane of its points: about 1 mm where lengths are read to 1e-6 m


@dataclass(frozen=True)
class Contact:
    """Rows of one socket, plane or bar, ``name`` "socket 1"; ``length (K,)`` m that a bar reads."""

    kind: str
    number: int
    rows: Ints
    length: Floats | None = None

    @property
    def name(self) -> str:
        """Kind and number."""
        return f"{self.kind} {self.number}"


@dataclass(frozen=True)
class Contacts(Kind):
    """Rows that were held, each by one contact. ``distances`` m are known between pairs of sockets.

    ``anchor`` are the rows that say where the contacts stand, the rows' own when None.
    """

    name = "contacts"
    summary = "rows held by sockets, planes and bars"
    observes_tool = True
    places_ball = True
    plain_fits_only = True

    observations: Observations
    distances: Mapping[tuple[int, int], float] = field(default_factory=dict)
    anchor: Contacts | None = None

    @classmethod
    def from_rows(cls, rows: Rows) -> Contacts | None:
        """Rows that say what held them, beside views where cameras saw others."""
        o = rows.observations
        if not has_contacts(o):
            return None
        beside = o.pixels is not None and o.rig is not None
        if beside and not group_contacts(o):
            return None
        anchor = cast("Contacts | None", find_anchor(cls.name, rows))
        return (ContactsBeside if beside else cls)(o, {} if anchor else dict(rows.socket_distances), anchor)

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The rows grouped by what held them."""
        return group_contacts(self.observations)

    def check(self) -> None:
        """Refuse a contact with fewer rows than it has unknowns, a distance of a socket that has none, and stated sigmas."""
        if self.observations.sigma is not None:
            raise ObservationError(
                "Rows held by contacts measure no position whose deviation sx_mm, sy_mm and sz_mm could state: give them "
                "without these columns, and state how closely a contact holds the ball with noise_mm."
            )
        self._refuse_unplaced_ball()
        _refuse_small(self.contacts, self.anchor)
        numbers = {c.number for c in self.contacts if c.kind == "socket"}
        for pair in self.distances:
            if not set(pair) <= numbers:
                raise ObservationError(
                    f"socket_distances_mm names socket {min(set(pair) - numbers)}, of which there are no rows.",
                    code="contact_too_small",
                )

    def _refuse_unplaced_ball(self) -> None:
        """Beside markers the tool point is their mean, unless a tip was digitised, and a contact holds another."""
        o = self.observations
        if o.markers is not None and (o.tip is None or np.isnan(o.tip).all()):
            raise ObservationError(
                "Markers do not say where on the tool the ball is that sockets, planes and bars hold: digitise the ball's "
                "centre in some rows of the markers (tipx_mm, tipy_mm, tipz_mm), or give the tracker's points of the ball "
                "(x_mm, y_mm, z_mm) in place of the markers.",
                code="ball_unknown",
            )

    @property
    def tells_scale(self) -> bool:
        """Whether a length is known that a larger arm would contradict."""
        return bool(self.distances) or any(c.kind == "bar" for c in self.contacts)

    def measured_row_mask(self) -> Bools:
        """Rows that a contact held."""
        out = np.zeros(len(self.observations), dtype=bool)
        for c in self.contacts:
            out[c.rows] = True
        return out

    @property
    def relative_tolerance(self) -> float:
        """Where a bar's base is hardly seen a fit creeps along for ever; a ten-thousandth is far below what noise tells."""
        return 1e-4 if any(c.kind == "bar" for c in self.contacts) else 0.0

    @property
    def equations_per_pose(self) -> int:
        """Three numbers in a socket, one on a plane or a bar."""
        return 3 if all(c.kind == "socket" for c in self.contacts) else 1

    def numbers(self) -> int:
        """Numbers left when every contact has its place."""
        each = sum(len(c.rows) * (3 if c.kind == "socket" else 1) - UNKNOWNS[c.kind] for c in self.contacts)
        return each + len(self.distances)

    def scalars(self) -> int:
        """As :meth:`numbers`: what the contacts' places take is lost."""
        return max(self.numbers(), 1)

    @property
    def redundancy(self) -> float:
        """Residuals for each number left."""
        size = sum(len(c.rows) * (3 if c.kind == "socket" else 1) for c in self.contacts) + len(self.distances)
        return size / self.scalars()

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """What is left (S, 1, 1) m when each contact stands where it fits best, and the projected Jacobian."""
        p = prediction.position
        left, slopes, centres = [], [], {}
        for c in self.contacts:
            place = fitted_place(c, p[c.rows])
            left.append(_contact_residuals(c, p[c.rows], place))
            if c.kind == "socket":
                centres[c.number] = c
            if J is not None:
                slopes.append(
                    _project_out_place(*_moves(c, p[c.rows], place), _slope(c, p[c.rows], place, J[c.rows, :3]))
                )
        for (a, b), known in self.distances.items():
            r, slope = _distance_residual(centres[a].rows, centres[b].rows, known, p, J)
            left.append(r)
            slopes += [] if slope is None else [slope]
        points = np.concatenate(left)[:, None, None]
        return (Block(self.group, points, None if J is None else np.concatenate(slopes)[:, None, None, :]),)

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors of a calibration: (K, 1) m, of a socket the distance from its place."""
        p = calibration.predict(self.observations).position
        places = {} if self.anchor is None else _places(self.anchor, calibration)
        out = []
        for c in self.contacts:
            # A placement that the anchor does not have stands where it fits its own rows best.
            place = places[c.name] if c.name in places else fitted_place(c, p[c.rows])
            r = _contact_residuals(c, p[c.rows], place)
            out.append(np.linalg.norm(r.reshape(-1, 3), axis=1) if c.kind == "socket" else r)
        return np.concatenate(out)[:, None], None


class ContactsBeside(Contacts):
    """Contacts in a fit with views of other rows: those say where the arm is, these where its ball is, and how large it is."""

    group = "contacts"
    observes_tool = False
    follows_tool = True

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """The same by rows (N, 3 + D, 1) m: up to three numbers of what held a row, and of each of D distances between sockets
        one, at the first row of its socket. So what every row measured is found, as that of the kinds beside.
        """
        (block,) = super().blocks(prediction, J)
        rows, slots = self._places
        r = np.full((len(self.observations), 3 + len(self.distances), 1), np.nan)
        r[rows, slots] = block.r[:, 0]
        if block.J is None:
            return (Block(self.group, r),)
        slopes = np.zeros((*r.shape, block.J.shape[-1]))
        slopes[rows, slots] = block.J[:, 0]
        return (Block(self.group, r, slopes),)

    @cached_property
    def _places(self) -> tuple[Ints, Ints]:
        """The row and the place in it of each of the residuals (S,)."""
        rows, slots = [], []
        for c in self.contacts:
            each = 3 if c.kind == "socket" else 1
            rows.append(np.repeat(c.rows, each))
            slots.append(np.tile(np.arange(each), len(c.rows)))
        first = {c.number: c.rows[0] for c in self.contacts if c.kind == "socket"}
        rows.append(np.array([first[a] for a, _ in self.distances], dtype=np.int64))
        slots.append(3 + np.arange(len(self.distances)))
        return np.concatenate(rows), np.concatenate(slots)


def has_contacts(observations: Observations) -> bool:
    """Whether rows say what held them."""
    return any(getattr(observations, kind) is not None for kind in UNKNOWNS)


def placements(observations: Observations) -> tuple[Ints, tuple[str, ...]] | None:
    """The placement (N,) of each row, and the names of the placements: one set-up of a socket, plane or bar is one.

    None where nothing held the tool.
    """
    if not has_contacts(observations):
        return None
    every = group_contacts(observations)
    numbers = np.zeros(len(observations), dtype=np.int64)
    for k, contact in enumerate(every):
        numbers[contact.rows] = k
    return numbers, tuple(contact.name for contact in every)


def group_contacts(observations: Observations) -> tuple[Contact, ...]:
    """The rows grouped by what held them."""
    return tuple(_contacts(observations))


def _contacts(o: Observations) -> Iterator[Contact]:
    for kind in UNKNOWNS:
        numbers = getattr(o, kind)
        for number in [] if numbers is None else sorted(set(numbers[numbers > 0].tolist())):
            rows = np.flatnonzero(numbers == number)
            yield Contact(
                kind, int(number), rows, o.bar_length[rows] if kind == "bar" and o.bar_length is not None else None
            )


def _refuse_small(contacts: tuple[Contact, ...], anchor: Contacts | None) -> None:
    known = set() if anchor is None else {c.name for c in anchor.contacts}
    for c in contacts:
        if c.name not in known and len(c.rows) < LEAST_ROWS[c.kind]:
            where = "" if anchor is None else " is only in the rows held out and"
            raise ObservationError(
                f"{c.name.capitalize()}{where} holds {len(c.rows)} rows: {LEAST_ROWS[c.kind]} or more are needed, for its own "
                "place is found from them. Measure more poses in it, or leave it out.",
                code="contact_too_small",
                contact=c.name,
            )


def _contact_residuals(c: Contact, p: Floats, place: Floats) -> Floats:
    """Residuals (S,) of a contact's rows ``p (K, 3)``."""
    if c.kind == "socket":
        return np.asarray((place - p).reshape(-1))
    if c.kind == "plane":
        return np.asarray(place[3] - p @ place[:3])
    assert c.length is not None
    return np.asarray(c.length - np.linalg.norm(p - place[:3], axis=1) - place[3])


def _moves(c: Contact, p: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Derivative (S, U) of what the rows' residuals compare by the place, and the stiffness (U, U) that holds the place."""
    if c.kind == "socket":
        D = np.tile(np.eye(3), (len(p), 1))
    elif c.kind == "plane":
        along, (u, v) = p - p.mean(axis=0), square_to(place[:3])
        D = np.column_stack([np.ones(len(p)), along @ u, along @ v])
    else:
        ray = p - place[:3]
        D = ray / np.linalg.norm(ray, axis=1)[:, None]
        if place[3] != 0.0:
            normal = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2][2]
            return np.column_stack([D, np.ones(len(p))]), _stiffness(normal, len(p))
    return D, LEVEL**2 * float(np.linalg.norm(D, 2)) ** 2 * np.eye(3)


def _slope(c: Contact, p: Floats, place: Floats, J: Floats) -> Floats:
    """Derivative (S, P) of what the rows' residuals compare, from the points' ``J (K, 3, P)``."""
    if c.kind == "socket":
        return J.reshape(-1, J.shape[2])
    if c.kind == "plane":
        return np.asarray(np.einsum("i,kip->kp", place[:3], J))
    ray = p - place[:3]
    return np.asarray(np.einsum("ki,kip->kp", ray / np.linalg.norm(ray, axis=1)[:, None], J))


def _project_out_place(D: Floats, stiffness: Floats, slope: Floats) -> Floats:
    """The slope without what moves ``D`` of the place take up; moves that hardly show take up nothing."""
    return np.asarray(slope - D @ np.linalg.solve(D.T @ D + stiffness, D.T @ slope))


def fitted_place(c: Contact, p: Floats) -> Floats:
    """Where a contact fits the points best: a socket's centre (3,), a plane's normal and distance (4,), a bar's base
    and the offset of its lengths (4,).
    """
    if c.kind == "socket":
        return np.asarray(p.mean(axis=0))
    if c.kind == "plane":
        normal = np.linalg.svd(p - p.mean(axis=0), full_matrices=len(p) < 3)[2][2]
        return np.append(normal, normal @ p.mean(axis=0))
    assert c.length is not None
    return _foot(p, c.length)


def _foot(p: Floats, length: Floats) -> Floats:
    """Centre (3,) from which the points are ``length (K,)`` away, and an offset of the lengths: none off a plane.

    In a plane the height of the base changes all lengths alike, by its square, and which side it is on changes nothing:
    chosen by what fits best, rounding would choose, and a fit would jump. An offset stands for the square, and the height
    for what it does to points beside the plane, which is as its first power.
    """
    middle = p.mean(axis=0)
    local = p - middle
    A = np.column_stack([2.0 * local, -np.ones(len(p))])
    foot = np.linalg.lstsq(A, np.sum(local**2, axis=1) - length**2, rcond=0.03)[0][:3]
    _, s, Vt = np.linalg.svd(local, full_matrices=False)
    if s[2] >= FLAT * s[1]:
        return np.append(_solve_bar_base(local, length, foot) + middle, 0.0)
    return np.asarray(_near_plane(local, length, foot, Vt[2]) + np.append(middle, 0.0))


def _solve_bar_base(local: Floats, length: Floats, foot: Floats) -> Floats:
    """Base by damped Gauss-Newton steps. What lengths hardly see hardly moves."""
    for _ in range(STEPS):
        ray = local - foot
        size = np.maximum(np.linalg.norm(ray, axis=1), SETTLED_M)
        D = ray / size[:, None]
        H = D.T @ D
        step = np.linalg.solve(H + LEVEL**2 * np.trace(H) * np.eye(3), D.T @ (size - length))
        foot = foot + step
        if np.linalg.norm(step) < SETTLED_M:
            break
    return foot


def _near_plane(local: Floats, length: Floats, foot: Floats, normal: Floats) -> Floats:
    """Base near the plane with this normal and offset of the lengths, joined (4,)."""
    place, stiffness = np.append(foot - (normal @ foot) * normal, 0.0), _stiffness(normal, len(local))
    for _ in range(STEPS):
        ray = local - place[:3]
        size = np.maximum(np.linalg.norm(ray, axis=1), SETTLED_M)
        D = np.column_stack([ray / size[:, None], -np.ones(len(local))])
        step = np.linalg.solve(D.T @ D + stiffness, D.T @ (size + place[3] - length) - stiffness @ place)
        place = place + step
        if np.linalg.norm(step) < SETTLED_M:
            break
    return np.asarray(place)


def _stiffness(normal: Floats, rows: int) -> Floats:
    """What holds (4, 4) the height of a base near the plane and the offset of the lengths, against one a row."""
    height = np.append(normal, 0.0)
    return np.asarray(rows * (ALMOST**2 * np.outer(height, height) + LEVEL**2 * np.diag([0.0, 0.0, 0.0, 1.0])))


def _distance_residual(a: Ints, b: Ints, known: float, p: Floats, J: Floats | None) -> tuple[Floats, Floats | None]:
    apart = p[a].mean(axis=0) - p[b].mean(axis=0)
    size = float(np.linalg.norm(apart))
    slope = None if J is None else (apart / size) @ (J[a, :3].mean(axis=0) - J[b, :3].mean(axis=0))
    return np.array([known - size]), None if slope is None else slope[None]


def _places(anchor: Contacts, calibration: Calibration) -> dict[str, Floats]:
    p = calibration.predict(anchor.observations).position
    return {c.name: fitted_place(c, p[c.rows]) for c in anchor.contacts}


def square_to(normal: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors square to a unit normal (3,) and to each other."""
    u = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    u /= np.linalg.norm(u)
    return u, np.cross(normal, u)
