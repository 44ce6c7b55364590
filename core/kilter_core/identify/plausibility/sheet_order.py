"""Whether a drawn circle starts at the right quarter point. The robot's model decides: the paper looks the same from all.

A circle with four marked points does not change when it is rotated by quarters, so the points fit in four orders. What
was drawn fits in one: errors that belong to one place of the circle fit the robot there and nowhere else. For each
order the errors in the paper's plane are carried to where they would belong and explained by the base, the joint
offsets, small errors of the geometry, clearance and backlash of the joints; the logarithms of the likelihoods say which order
it was. Several sheets are of one arm, and are judged together. (The points the other way round would put the paper face
down, which the client refuses.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.backlash import Backlash, ClearanceTilt
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.observations.groups import last_motion
from kilter_core.parameters import mm
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Floats, Ints

SURE, LIKELY = 5.0, 2.0  # logarithms of how many times likelier another order is, 150 and 7
EXPLAINED = 4.0  # chi-square per degree of freedom up to which the model is believed to explain what was drawn
UNMODELLED = 0.06  # share of the errors that such a simple model may leave, per harmonic
LEAST_M = 3e-6
HARMONICS = 4
OFFSET_RAD, LENGTH_M, ANGLE_RAD = 5e-3, 1e-4, 3e-4  # what a robot's joint offsets, lengths and angles are off by
CLEARANCE_RAD, BACKLASH_RAD = 2e-4, 2e-4  # by which joints tilt, and lag behind their motors
READ_M = 3e-5  # standard deviation of what is read off a sheet where the rows do not state it, alike in near places
LOAD_KG = 1.0  # at the tool: which way gravity tilts a joint, where the robot states no masses
ALL_ORDERS = 4  # sheets of which all combinations of orders are tried; of more, one sheet after the other
ROUND = 0.05  # of the radius: farther off the circle, and it is another path
FEWEST_ROWS = 24  # rows around the circle
WIDEST = np.radians(40.0)  # gap between two rows over which errors are not carried


@dataclass(frozen=True)
class SheetOrder:
    """The likeliest ``order`` of the rows of the points file, ``lead`` of it over the order as given (logarithm of the
    likelihoods), ``clear`` over the next best, and the rms m that is left ``as_given`` and in that order.
    """

    order: tuple[int, ...]
    lead: float
    clear: float
    as_given: float
    left: float
    explained: bool

    @property
    def wrong(self) -> bool:
        """Whether the points cannot be in the order given."""
        return self.lead > SURE and self.explained

    @property
    def doubtful(self) -> bool:
        """Whether another order is likelier, but not for sure."""
        return self.lead > LIKELY and not self.wrong

    @property
    def unseen(self) -> bool:
        """Whether what was drawn fits several orders equally."""
        return self.clear <= LIKELY and not self.wrong and not self.doubtful

    def sentence(self) -> str:
        """What was found, with the remedy."""
        order = ", ".join(map(str, self.order))
        return (
            f"its line fits this robot with the quarter points in the order {order} ({mm(self.left):.3f} mm are left), "
            f"not as given ({mm(self.as_given):.3f} mm). Write the rows of the points file in the order {order}, join the "
            "sheet again (kilter measure sheet-join) and upload what that writes"
        )


def sheet_order(robot: Robot, rows: Observations) -> SheetOrder | None:
    """Find the order of the quarter points that fits the robot best; None where the rows do not make a whole circle."""
    return sheet_orders(robot, [rows])[0]


def sheet_orders(robot: Robot, sheets: Sequence[Observations]) -> list[SheetOrder | None]:
    """Find the orders of the quarter points of several sheets of one arm, which its errors must explain together."""
    circles = [_around(robot, rows) for rows in sheets]
    judged = [k for k, circle in enumerate(circles) if circle is not None]
    read = [[_read(robot, sheets[k], circles[k], quarters) for quarters in range(4)] for k in judged]  # type: ignore[arg-type]
    out: list[SheetOrder | None] = [None] * len(sheets)
    if judged:
        best = _best(read)
        for place, k in enumerate(judged):
            out[k] = _evaluate_sheet(robot, read, best, place)
    return out


def _evaluate_sheet(robot: Robot, read: list[list[_Read]], best: tuple[int, ...], place: int) -> SheetOrder:
    """The order of one sheet, the others in the orders that fit best with each of its own."""
    with_each = [_best(read, place, quarters) for quarters in range(4)]
    losses = np.array([_loss(read, orders)[0] for orders in with_each])
    likeliest = best[place]
    left = [_sheet_misfit(read, orders, place) for orders in with_each]
    freedom = 3 * (2 * HARMONICS + 1) - 6 - robot.n_joints
    chi = left[likeliest][0] / max(freedom, 1)
    lead = (losses - losses[likeliest]) / (2.0 * max(1.0, chi))
    order = tuple(int(v) for v in (np.arange(4) + likeliest) % 4 + 1)
    return SheetOrder(order, float(lead[0]), float(np.sort(lead)[1]), left[0][1], left[likeliest][1], chi < EXPLAINED)


def _best(read: list[list[_Read]], held: int | None = None, at: int = 0) -> tuple[int, ...]:
    """The orders (quarters late) of all sheets that fit best, that of one perhaps ``held`` where it is."""
    choices = [[at] if k == held else range(4) for k in range(len(read))]
    if len(read) <= ALL_ORDERS:
        return min(product(*choices), key=lambda orders: _loss(read, orders)[0])
    now = [at if k == held else 0 for k in range(len(read))]
    for _ in range(2):
        for k, choice in enumerate(choices):
            now[k] = min(choice, key=lambda q, k=k: _loss(read, (*now[:k], q, *now[k + 1 :]))[0])
    return tuple(now)


def _loss(read: list[list[_Read]], orders: Sequence[int]) -> tuple[float, Floats]:
    """Loss with priors of all sheets in these orders, and the errors of the arm (p,), per prior sigma, that explain them."""
    chosen = [sheet[q] for sheet, q in zip(read, orders, strict=True)]
    H = np.sum([c.A.T @ c.A for c in chosen], axis=0)
    g = np.sum([c.A.T @ c.r for c in chosen], axis=0)
    x = np.linalg.solve(H + np.eye(len(g)), g)
    return float(sum(c.r @ c.r for c in chosen) - g @ x), np.asarray(x)


def _sheet_misfit(read: list[list[_Read]], orders: Sequence[int], place: int) -> tuple[float, float]:
    """Chi-square and rms m of what is left of one sheet."""
    one = read[place][orders[place]]
    rest = (one.r - one.A @ _loss(read, orders)[1])[: one.rows].reshape(-1, 3)
    return float(np.sum(rest**2)), float(np.sqrt(np.mean(np.sum((rest * one.sigma) ** 2, axis=1))))


@dataclass(frozen=True)
class _Read:
    """A sheet in one order: what its base does not explain, ``r (m,)``, and by which errors of the arm ``A (m, p)`` it may be.

    All in sigmas; the first ``rows`` of them are of the line, ``sigma (3,)`` m, the others of the base's prior.
    """

    A: Floats
    r: Floats
    rows: int
    sigma: Floats


@dataclass(frozen=True)
class _Circle:
    """A drawn circle: the angle of every row as commanded, harmonics of its errors there (out, along, up), their sigma.

    ``ways`` (n, 3, 3) are the directions out, along and up of every row in the frame of the measurements.
    """

    centre: Floats
    radius: float
    angle: Floats
    ways: Floats
    harmonics: Floats
    sigma: Floats

    def shifted_positions(self, quarters: int) -> Floats:
        """Positions (n, 3) if the points were given ``quarters`` too late; heights were logged, and stay."""
        there, here = (_basis(angle) @ self.harmonics for angle in (self.angle - quarters * np.pi / 2, self.angle))
        error = np.column_stack([there[:, 0] + self.radius, there[:, 1], here[:, 2]])
        return np.asarray(self.centre + np.einsum("nk,nkj->nj", error, self.ways))


def _basis(angle: Floats) -> Floats:
    waves = [wave(k * angle) for k in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)]
    return np.stack([np.ones_like(angle), *waves], axis=1)


def _around(robot: Robot, rows: Observations) -> _Circle | None:
    """The circle the rows were drawn along; angles are those of the nominal robot, which a sheet does not move."""
    if rows.position is None or len(rows) < FEWEST_ROWS:
        return None
    p = rows.position
    middle = p.mean(axis=0)
    axes = np.linalg.svd(p - middle)[2]
    axes = np.array([axes[0], axes[1], np.cross(axes[0], axes[1])]).T
    flat = (p - middle) @ axes[:, :2]
    a, b, c = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(p))]), (flat**2).sum(axis=1), rcond=None)[0]
    radius, centre = float(np.sqrt(c + a * a + b * b)), middle + axes[:, :2] @ [a, b]
    local, wanted = (p - centre) @ axes, (_in_place(robot, rows)[1] - centre) @ axes
    if _clockwise(wanted):
        axes = axes * [1.0, -1.0, -1.0]
        local, wanted = local * [1.0, -1.0, -1.0], wanted * [1.0, -1.0, -1.0]
    angle = np.arctan2(wanted[:, 1], wanted[:, 0])
    ahead = (np.arctan2(local[:, 1], local[:, 0]) - angle + np.pi) % (2 * np.pi) - np.pi
    error = np.stack([np.hypot(local[:, 0], local[:, 1]) - radius, radius * ahead, local[:, 2]], axis=1)
    gaps = np.diff(np.sort(angle), append=np.min(angle) + 2 * np.pi)
    if np.abs(error).max() > ROUND * radius or gaps.max() > WIDEST:
        return None
    read = READ_M if rows.sigma is None else float(np.sqrt(np.mean(rows.sigma**2)))
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(len(p)), np.ones(len(p))
    ways = np.stack([np.stack(way, axis=1) for way in ((c, s, zero), (-s, c, zero), (zero, zero, one))], axis=1)
    return _Circle(centre, radius, angle, ways @ axes.T, *_fit_harmonics(angle, error, read))


def _clockwise(wanted: Floats) -> bool:
    """Whether the rows run clockwise about the third axis: joined ones run as the points of the sheet are numbered."""
    x, y = wanted[:, 0], wanted[:, 1]
    return float(np.median(x[:-1] * y[1:] - x[1:] * y[:-1])) < 0


def _fit_harmonics(angle: Floats, error: Floats, read: float) -> tuple[Floats, Floats]:
    """Harmonics (2 HARMONICS + 1, 3) of the errors, and the sigma (3,) of one row that covers noise and model."""
    B = _basis(angle)
    harmonics = np.linalg.lstsq(B, error, rcond=None)[0]
    noise = np.sum((error - B @ harmonics) ** 2, axis=0) / max(len(B) - B.shape[1], 1)
    size = float(np.sqrt(np.mean((B @ harmonics)[:, :2] ** 2)))
    # A harmonic of n rows is known n / 2 times better than a row; what the model leaves does not average out like that,
    # nor what a scanner or an eye reads alike wrong in near places, which all harmonics share.
    alike = (UNMODELLED * size) ** 2 + 2.0 / HARMONICS * read**2
    sigma = np.asarray(np.sqrt(noise + len(B) / 2.0 * alike + LEAST_M**2))
    return np.asarray(harmonics), sigma


def _read(robot: Robot, rows: Observations, circle: _Circle, quarters: int) -> _Read:
    """The errors of a sheet carried to where they belong in one order, the base of the sheet taken out."""
    position = circle.shifted_positions(quarters)
    moved = replace(rows, position=position, rotation=None, markers=None, direction=last_motion(rows.q))
    moved = moved.carrying(LOAD_KG, (0.0, 0.0, 0.0))
    model, _ = _in_place(robot, moved)
    free, sigma = _free(model)
    prediction, J = model.jacobian(moved, model.values0(), free, turns=False)
    A = (np.einsum("nkj,njf->nkf", circle.ways, J) / circle.sigma[:, None]).reshape(-1, len(free)) * sigma
    r = (np.einsum("nkj,nj->nk", circle.ways, position - prediction.position) / circle.sigma).reshape(-1)
    whole = np.vstack([np.column_stack([A, r]), np.zeros((6, len(free) + 1))])
    whole[len(r) :, :6] = np.eye(6)
    Q = np.linalg.qr(whole[:, :6])[0]
    rest = whole[:, 6:] - Q @ (Q.T @ whole[:, 6:])
    return _Read(rest[:, :-1], rest[:, -1], len(r), circle.sigma)


def _free(model: RobotModel) -> tuple[Ints, Floats]:
    """Base, joint offsets, geometry, clearance and backlash (indices), and how far each may be off."""
    elements = {e.name: e for e in model.robot.chain.elements if e.name and not e.dependent}
    free, sigma = list(range(6)), [model.parameters[k].prior_sigma for k in range(6)]
    for k in range(6, model.n_geometric - 6):
        element = elements.get(model.names[k])
        if element is not None:
            small = LENGTH_M if model.parameters[k].unit == "m" else ANGLE_RAD
            free.append(k)
            sigma.append(OFFSET_RAD if element.joint is not None else small)
    for k in range(model.n_geometric, len(model.names)):
        free.append(k)
        sigma.append(CLEARANCE_RAD if model.names[k].startswith("clearance") else BACKLASH_RAD)
    return np.array(free), np.array(sigma)


def _in_place(robot: Robot, rows: Observations) -> tuple[RobotModel, Floats]:
    """The nominal robot with its base where it fits the rows best, and where it then puts the tool (n, 3)."""
    assert rows.position is not None
    model = Calibration.nominal(robot, (ClearanceTilt(share="vector"), Backlash())).model
    found = Calibration.nominal(robot).predict(rows).position
    a, b = found.mean(axis=0), rows.position.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = nearest_rotation((rows.position - b).T @ (found - a))
    T[:3, 3] = b - T[:3, :3] @ a
    there: Floats = found @ T[:3, :3].T + T[:3, 3]
    return model.in_frames(T @ model.T_base, model.T_tool), there
