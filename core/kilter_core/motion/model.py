"""The torques that a motion needs, by what a log showed: bodies of links, friction, and the effects that unseen motions bore
out. Gravity, inertia and friction are told ahead (computed torque; Siciliano and others 2009, sec. 8.5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Link, Robot
from kilter_core.errors import ObservationError
from kilter_core.motion.effects import LEAST_SPEED, MOTION_EFFECTS, SIGN_SHARE
from kilter_core.motion.fit import Fit
from kilter_core.motion.kernels import torque
from kilter_core.motion.layout import Known, Layout, Term
from kilter_core.motion.loads import friction_document, loads_document, tell_friction, tell_loads
from kilter_core.motion.normal import Equations
from kilter_core.motion.record import Path
from kilter_core.motion.regressor import (
    PER_LINK,
    base_columns,
    base_sums,
    describe_body,
    link_elements,
    moving_elements,
    stated_numbers,
    symmetric,
)
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior, metres, mm
from kilter_core.types import Bools, Floats

NEAR = 0.25  # weight of the divergence against squares of standard deviations
LEAST_KG = 1e-2  # of a link that the description leaves without a mass
LEAST_GYRATION_M = 0.02
STEPS = 50
WEIGHTS = 12
SUFFICIENT = 0.1  # of the fall that the slope promises
DONE = 1e-9  # promised fall of the cost
UPPER = np.triu_indices(3)


def physical_links(robot: Robot, base: Floats, information: Floats) -> tuple[Link, ...]:
    """Return links with the ``base (p,)`` parameters, as far as links that could be real have them.

    ``information (p, p)`` is the inverse of their covariance; it says which sums may differ from the fit.
    """
    K = base_sums(robot)
    start = np.stack([_make_definite(numbers) for numbers in stated_numbers(robot).reshape(-1, PER_LINK)])
    found = _find_nearest(start, K.T @ information @ K, K.T @ information @ base)
    return tuple(
        Link(element, *describe_body(numbers)) for element, numbers in zip(link_elements(robot), found, strict=True)
    )


def _find_nearest(start: Floats, A: Floats, b: Floats) -> Floats:
    """Numbers (L, 10) that make the least of ``x A x / 2 - b x`` and of their divergence from ``start``.

    Newton's steps, from a weight of the divergence at which it decides down to the one it has.
    """
    x = start.ravel()
    weights = np.geomspace(max(np.abs(A @ x - b).max() * np.abs(x).max(), NEAR), NEAR, WEIGHTS)
    for weight in weights:
        x = _follow_slope(x, start, A / weight, b / weight)
    return x.reshape(-1, PER_LINK)


def _follow_slope(x: Floats, start: Floats, A: Floats, b: Floats) -> Floats:
    """Newton's steps from ``x (10 L,)``, with a divergence of weight one."""
    pull = np.einsum("lab,iba->li", np.linalg.inv(_pseudo_inertia(start)), BASIS).ravel() - b

    def cost(x: Floats) -> float:
        J = _pseudo_inertia(x.reshape(-1, PER_LINK))
        if np.linalg.eigvalsh(J).min() <= 0.0:
            return np.inf
        return float(0.5 * x @ A @ x + pull @ x - np.linalg.slogdet(J)[1].sum())

    for _ in range(STEPS):
        inverse = np.linalg.inv(_pseudo_inertia(x.reshape(-1, PER_LINK)))
        slopes = inverse[:, None] @ BASIS  # (L, 10, 4, 4)
        gradient = A @ x + pull - np.einsum("liaa->li", slopes).ravel()
        H = A.copy()
        for k, own in enumerate(np.einsum("liab,ljba->lij", slopes, slopes)):
            at = slice(PER_LINK * k, PER_LINK * (k + 1))
            H[at, at] += own
        scale = 1.0 / np.sqrt(np.diag(H))
        step = -scale * np.linalg.solve(scale[:, None] * H * scale, scale * gradient)
        promised, share, here = float(-gradient @ step), 1.0, cost(x)
        while share > DONE and cost(x + share * step) > here - SUFFICIENT * share * promised:
            share *= 0.5
        x = x + share * step
        if promised < DONE:
            break
    return x


def _pseudo_inertia(numbers: Floats) -> Floats:
    """Second moments (L, 4, 4) of mass of links, of their places and one."""
    return np.asarray(np.einsum("li,iab->lab", numbers, BASIS))


def _basis() -> Floats:
    """The pseudo-inertia (10, 4, 4) of one unit of each number."""
    out = np.zeros((PER_LINK, 4, 4))
    for i, unit in enumerate(np.eye(PER_LINK)):
        inertia = symmetric(unit[4:])
        out[i, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        out[i, :3, 3] = out[i, 3, :3] = unit[1:4]
        out[i, 3, 3] = unit[0]
    return out


def _make_definite(numbers: Floats) -> Floats:
    """Return the numbers of a body that has some thickness; where none is stated, of a small one."""
    mass, moment = max(float(numbers[0]), LEAST_KG), numbers[1:4]
    spread = np.outer(moment, moment) / mass
    places = 0.5 * np.trace(symmetric(numbers[4:])) * np.eye(3) - symmetric(numbers[4:]) - spread
    values, axes = np.linalg.eigh(places)
    places = (axes * np.maximum(values, mass * LEAST_GYRATION_M**2)) @ axes.T + spread
    return np.array([mass, *moment, *(np.trace(places) * np.eye(3) - places)[UPPER]])


BASIS = _basis()


FEWEST_ROWS = 6
COLUMNS = {  # of an effect in the rows of joints of a table; without the temperature, what follows it is zero
    "torque_offset": torque.OFFSET,
    "coulomb": torque.COULOMB,
    "viscous": torque.VISCOUS,
    "stribeck": torque.STRIBECK,
    "root_speed": torque.ROOT,
    "quadratic_speed": torque.QUADRATIC,
    "one_sided_damping": torque.ONE_SIDED,
    "load_friction": torque.LOADED,
    "motor_inertia": torque.ROTOR,
    "drive_gain": torque.GAIN,
    "gear_ripple": torque.RIPPLE,
    "spring": torque.SPRING,
    "counterbalance": torque.BALANCE,
    "cable_curve": torque.CABLE,
}
SPLINE = 5  # degree: accelerations are smooth too


@dataclass(frozen=True, eq=False)
class TorqueModel:
    """``layout`` has the base parameters and the terms, ``values (width,)`` are theirs.

    ``links`` could be real and have these base parameters; where the log says nothing they are as described. ``joints`` are
    those (from 0) of which the log says something; of the others no torque is told. ``loads`` is what it says of the masses
    that loads of poses come from, ``friction (n, 2)`` N m of that of each joint near rest.
    """

    layout: Layout
    values: Floats
    links: tuple[Link, ...]
    joints: tuple[int, ...]
    loads: CorrelatedPrior | None = None
    friction: Floats | None = None

    @classmethod
    def from_fit(
        cls, equations: Equations, fit: Fit, terms: Sequence[Term], joints: Sequence[int], blocks: Bools
    ) -> Self:
        """Return the model of a fit of these terms to these blocks, without what a motion to come does not have."""
        p = equations.base  # base parameters come first
        base, information = fit.theta[:p], np.asarray(np.linalg.inv(fit.inverse[:p, :p]), dtype=np.float64)
        links = physical_links(equations.layout.robot, base, information)
        kept = [term for term in terms if term.effect.ahead and term.session is None and term.joint in joints]
        found = [(term, fit.theta[term.columns]) for term in kept]
        model = cls._of_terms(equations.layout, base, found, links, tuple(joints))
        return replace(model, loads=tell_loads(equations, fit, blocks), friction=tell_friction(equations, fit, blocks))

    @classmethod
    def _of_terms(
        cls,
        layout: Layout,
        base: Floats,
        found: Sequence[tuple[Term, Floats]],
        links: tuple[Link, ...],
        joints: tuple[int, ...],
    ) -> Self:
        at, terms = len(base), []
        for term, values in found:
            terms.append(replace(term, columns=np.arange(at, at + len(values))))
            at += len(values)
        whole = replace(layout, terms=tuple(terms), width=at, carried=())
        return cls(whole, np.concatenate([base, *(values for _, values in found)]), links, joints)

    def torques(self, path: Path) -> Floats:
        """Return the torques (N, n) N m (forces N) that a path needs; NaN at joints of which nothing is known."""
        known = Known.from_values(self.layout, self.values)
        bodies = self.layout.bodies(path)
        out = np.full(path.q.shape, np.nan)
        for j in self.joints:
            X = self.layout.joint_columns(path, bodies, j, known)
            out[:, j] = bodies.stated[:, j] + X @ self.values[self.layout.places(j)]
        return out

    def table(self) -> Floats:
        """Return the model as the table ``P`` of :func:`~kilter_core.motion.kernels.torque.feed_forward`."""
        layout, robot = self.layout, self.layout.robot
        elements, carried = robot.chain.elements, moving_elements(robot)
        m, n = len(elements), robot.n_joints
        P = np.zeros((m + n + 1, torque.TORQUE_COLUMNS))
        for row, (k, one) in zip(P, enumerate(elements), strict=False):
            rotates, axis = one.axis.rotates, one.axis % 3
            row[: torque.SINE] = rotates, axis, (axis + 1) % 3, (axis + 2) % 3
            row[torque.SINE : torque.JOINT] = (np.sin(one.value), np.cos(one.value)) if rotates else (one.value, 0.0)
            row[torque.JOINT : torque.CARRIES] = -1 if one.joint is None else one.joint, one.ratio, one.value
            row[torque.CARRIES] = k in carried
        bodies = np.zeros(PER_LINK * len(link_elements(robot)))
        bodies[layout.kept] = self.values[: len(layout.kept)]
        for k, numbers in zip(link_elements(robot), bodies.reshape(-1, PER_LINK), strict=True):
            P[k, torque.BODY : torque.BODY + PER_LINK] += numbers
        joints = P[m : m + n]
        joints[:, torque.WIDTH] = np.maximum(SIGN_SHARE * layout.speeds, LEAST_SPEED)
        joints[:, torque.LOOSE] = layout.fade_speeds
        joints[:, torque.MIDDLE], joints[:, torque.ORDER] = layout.middles, [one or 0.0 for one in layout.orders]
        joints[list(self.joints), torque.KNOWN] = 1.0
        for term in layout.terms:
            if (at := COLUMNS.get(term.effect.id)) is not None:
                joints[term.joint, at : at + len(term.columns)] = self.values[term.columns]
        P[m + n, :3] = robot.gravity
        return P

    def to_document(self) -> dict[str, Any]:
        """Return the model as a document: kg, mm, kg m2 in the links' frames; angles of terms in rad, as in URDF and MJCF."""
        layout = self.layout
        return {
            "base": self.values[: len(layout.kept)],
            "links": [
                {
                    "link": k + 1,
                    "mass_kg": link.mass,
                    "centre_mm": mm(np.asarray(link.com)),
                    "inertia_kg_m2": link.inertia,
                }
                for k, link in enumerate(self.links)
            ],
            "terms": [
                {"id": term.effect.id, "joint": term.joint + 1, "values": self.values[term.columns]}
                for term in layout.terms
            ],
            "joints": [j + 1 for j in self.joints],
            "loads": loads_document(layout.robot, self.loads),
            "friction": friction_document(self.friction),
            "usual_speeds": layout.speeds,
            "middles": layout.middles,
            "orders": list(layout.orders),
            "fades": list(layout.fades),
            "mean_temperature_c": None if np.isnan(layout.mean_c) else layout.mean_c,
        }

    @classmethod
    def from_document(cls, robot: Robot, document: Mapping[str, Any]) -> Self:
        """Read the model of a robot."""
        links = tuple(
            Link(
                element, one["mass_kg"], np.array([metres(x) for x in one["centre_mm"]]), np.array(one["inertia_kg_m2"])
            )
            for element, one in zip(link_elements(robot), document["links"], strict=True)
        )
        mean_c = document["mean_temperature_c"]
        layout = Layout(
            robot,
            base_columns(robot),
            (),
            0,
            np.array(document["usual_speeds"]),
            np.array(document["middles"]),
            tuple(document["orders"]),
            0.0,
            np.nan if mean_c is None else mean_c,
            fades=tuple(document.get("fades", ())),
        )
        effects = {effect.id: effect for effect in MOTION_EFFECTS}
        found = [
            (Term(effects[one["id"]], one["joint"] - 1, np.zeros(0, dtype=np.int64)), np.array(one["values"]))
            for one in document["terms"]
        ]
        return cls._of_terms(layout, np.array(document["base"]), found, links, tuple(j - 1 for j in document["joints"]))


def path_of_rows(rows: Observations) -> Path:
    """Return a path with ``t (N,)`` s, joints ``q (N, n)`` rad or m, their speeds and accelerations, and what is carried.

    Speeds and accelerations are those of the rows, else of a spline through their joints.

    Raises:
        ObservationError: no times, times that do not rise, fewer than six rows, or a load that changes along the path.

    """
    t, q = rows.t, rows.q
    if t is None:
        raise ObservationError("Torques follow speed and acceleration: add the column 't_s'.", column="t_s")
    if len(t) < FEWEST_ROWS:
        raise ObservationError(
            f"The path has {len(t)} rows: give {FEWEST_ROWS} or more, so that its accelerations are known."
        )
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        row = int(late[0]) + 2
        raise ObservationError(f"Row {row}, column 't_s': the time must rise from row to row.", row=row, column="t_s")
    carried = np.zeros(len(t)) if rows.payload_kg is None else rows.payload_kg
    centre = np.zeros((len(t), 3)) if rows.payload_com is None else rows.payload_com
    if np.ptp(carried) > 0.0 or np.ptp(centre, axis=0).any():
        raise ObservationError(
            "The payload changes along the path: send the path in parts that carry one load each.", column="payload_kg"
        )
    speeds, rates = rows.qd, rows.qdd
    if speeds is None or rates is None:
        from scipy.interpolate import make_interp_spline  # 12 MB, which most processes do without

        spline = make_interp_spline(t, q, k=SPLINE)
        speeds = np.asarray(spline(t, 1)) if speeds is None else speeds
        rates = np.asarray(spline(t, 2)) if rates is None else rates
    step_s = float(np.median(np.diff(t)))
    return Path(0, float(carried[0]), centre[0], np.zeros(len(t)), q, speeds, rates, rows.temperature_c, step_s)
