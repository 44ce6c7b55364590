"""All joints of any nominal six-axis arm that bring its flange to a pose, as the roots of a polynomial of degree 16.

The method of Raghavan and Roth (1993) as an eigenvalue problem (Manocha and Canny 1994), for axes instead of tables of
Denavit and Hartenberg. Of axis 6 a point p and the direction l do not move with joint 6. The vector
(l, p, p.p, l.p, l x p, (p.p) l - 2 (l.p) p, 1) is moved by a rotation about any line as by a matrix (15, 15) whose entries are
linear in cosine and sine of the angle. So 14 equations hold between joints 3, 4, 5 and joints 1, 2; six are left without
the latter, and as half-angle tangents they are 12 in 12 monomials of joints 4 and 5, quadratic in that of joint 3.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig

from kilter_core.arm.robot import Robot
from kilter_core.model import RobotModel
from kilter_core.model.closed_inverse import Axes, Posture, about, angle_about, any_across, closed_form_kind, solutions
from kilter_core.observations import Observations
from kilter_core.transforms import inverse, rotations_about
from kilter_core.types import Bools, Floats

# An eigenvalue is off by its condition times the rounding of the pencil, and that of the equations grows as their rank falls;
# the largest seen was a thirtieth of this product. A root whose imaginary part is larger than ten times it is not real.
ROUNDED = 10.0 * float(np.finfo(float).eps)
OWN_ROOT = 1e-2  # rad, within which joint 3 after the steps is the one that its root said
REACHED = 1e-11  # m and rad
SAME_RAD = 1e-6
SINGULAR = 1e-5  # of the Jacobian's singular values in m and rad
STEPS = 12
RANK = 1e-9  # below this share the equations do not determine the joints
NEARLY = 0.05  # m and rad
# From where the angles of joints 3, 4 and 5 are counted: a tangent of half an angle has no number for 180 degrees.
SHIFTS = ((0.37, -1.13, 2.29), (-2.41, 0.83, -0.59))

MOST_STEPS = 40
STEP_LIMIT_RAD = 0.3
REACHED_M = 1e-7


@dataclass(frozen=True)
class Found:
    """Angles of axes (N, 6) rad, and whether these are surely all.

    Not certain: two computations differ, a root of the polynomial belongs to no angles, or some angles are singular, where
    two solutions become one or joints cannot be told apart.
    """

    angles: Floats
    singular: tuple[bool, ...]
    certain: bool


def reaching(axes: Axes, T: Floats) -> tuple[list[Posture], bool]:
    """Return the postures that bring the flange to ``T (4, 4)``, and whether these are surely all: in closed form they are."""
    if closed_form_kind(axes) is not None:
        return solutions(axes, T), True
    found = all_angles(axes, T)
    out = []
    for angles, singular in zip(found.angles, found.singular, strict=True):
        q = np.array([math.remainder(value, 2.0 * math.pi) for value in axes.joints @ angles])
        out.append(Posture(q, front=False, elbow_up=False, wrist=False, singular=singular, named=False))
    return out, found.certain


def all_angles(axes: Axes, T: Floats) -> Found:
    """Find the angles of six axes that bring the flange to ``T (4, 4)``, in the frame of the robot's root."""
    scaled, moved = _scale_to_unit_size(axes, T @ inverse(axes.home))
    longest = float(np.linalg.norm(np.diff(scaled.p, axis=0), axis=1).sum())
    if np.linalg.norm(moved[:3, :3] @ scaled.p[5] + moved[:3, 3] - scaled.p[0]) > longest + REACHED:
        return Found(np.empty((0, 6)), (), certain=True)  # beyond all links in a line
    found: list[Floats] = []
    certain, counts = True, []
    for one in _best_splits(scaled, moved):
        mine: list[Floats] = []
        certain = _solve(scaled, moved, one, mine) and certain
        counts.append(len(mine))
        for angles in mine:
            if not any(_are_same_angles(angles, other) for other in found):
                found.append(angles)
    singular = tuple(_singular(scaled, angles) for angles in found)
    certain = certain and counts == [len(found)] * 2 and not any(singular)
    return Found(np.array(found).reshape(-1, 6), singular, bool(certain))


@dataclass(frozen=True)
class _Split:
    """The closed loop of arm and pose begun at another axis, and its equations; what joint its first is."""

    axes: Axes
    first: int
    shifts: Floats
    A: Floats
    rank: float

    def angles(self, mine: Floats) -> Floats:
        """Return the angles in the order of the arm."""
        return np.roll(mine, self.first)


def _best_splits(axes: Axes, moved: Floats) -> list[_Split]:
    """The one of the six in which the equations say most, twice: where axes meet or are parallel they say nothing in some."""
    found, first = [], axes
    for k in range(6):
        found.append((_split(first, moved, k, SHIFTS[0]), first))
        # The first axis comes last, where the pose took it: E2 ... E6 (M^-1 E1 M) = M.
        back = inverse(moved)
        h, p = back[:3, :3] @ first.h[0], back[:3, :3] @ first.p[0] + back[:3, 3]
        first = Axes(np.vstack([first.h[1:], h]), np.vstack([first.p[1:], p]), first.home, first.joints)
    best, begun = max(found, key=lambda one: one[0].rank)
    return [best, _split(begun, moved, best.first, SHIFTS[1])]


def _split(axes: Axes, moved: Floats, first: int, shifts: tuple[float, ...]) -> _Split:
    A, rank = _equations(axes, moved, np.array(shifts))
    M = A[0] + 0.61 * (A[1] + 0.61 * A[2])
    sizes = np.linalg.svd(M / np.linalg.norm(M, axis=1, keepdims=True), compute_uv=False)
    return _Split(axes, first, np.array(shifts), A, min(rank, float(sizes[-1] / sizes[0])))


def _scale_to_unit_size(axes: Axes, moved: Floats) -> tuple[Axes, Floats]:
    """The arm about 1 long, with axis 3 through the origin: powers of lengths are of one size then."""
    origin = axes.p[2]
    scale = float(np.max(np.linalg.norm(axes.p - origin, axis=1))) or 1.0
    T = moved.copy()
    T[:3, 3] = (moved[:3, :3] @ origin + moved[:3, 3] - origin) / scale
    return Axes(axes.h, (axes.p - origin) / scale, axes.home, axes.joints), T


def _line(point: Floats, along: Floats) -> Floats:
    """The 15 numbers of a point and a direction."""
    pp, lp = point @ point, along @ point
    return np.concatenate([along, point, [pp, lp], np.cross(along, point), pp * along - 2.0 * lp * point, [1.0]])


def _rotations(h: Floats, p: Floats) -> Floats:
    """Matrices (3, 15, 15) of a rotation about a line: the constant, what goes with the cosine, and with the sine."""
    at = [_moving(h, p, angle) for angle in (0.0, 0.5 * math.pi, math.pi)]
    constant, cosine = 0.5 * (at[0] + at[2]), 0.5 * (at[0] - at[2])
    return np.array([constant, cosine, at[1] - constant])


def _moving(h: Floats, p: Floats, angle: float) -> Floats:
    """Matrix (15, 15) of one rotation."""
    R = rotations_about(h, np.array([angle]))[0]
    t = p - R @ p
    M = np.zeros((15, 15))
    u, x, xx, ux, m, v, one = slice(0, 3), slice(3, 6), 6, 7, slice(8, 11), slice(11, 14), 14
    M[u, u] = M[x, x] = M[m, m] = M[v, v] = R
    M[x, one] = t
    M[xx, xx] = M[ux, ux] = M[one, one] = 1.0
    M[xx, x], M[xx, one] = 2.0 * t @ R, t @ t
    M[ux, u] = t @ R
    M[m, u] = -_cross(t) @ R
    M[v, m] = 2.0 * _cross(t) @ R
    M[v, u] = (t @ t) * R - 2.0 * np.outer(t, t) @ R
    M[v, ux] = -2.0 * t
    return M


def _cross(t: Floats) -> Floats:
    return np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])


def _solve(axes: Axes, moved: Floats, split: _Split, out: list[Floats]) -> bool:
    """Add what is found to ``out``; whether the equations have a rank, and every root that may be real has angles."""
    if split.rank < RANK:
        return False
    explained = True
    for x3 in _roots(split.A, ROUNDED / split.rank):
        third = 2.0 * math.atan(x3) + float(split.shifts[0])
        some = False
        for guess in map(split.angles, _guesses(split, moved, x3)):
            near = next((other for other in out if _are_same_angles(guess, other, 1e-5)), None)
            angles = _polish_angles(axes, moved, guess) if near is None else near
            if angles is not None:
                off = math.remainder(float(angles[(split.first + 2) % 6]) - third, 2.0 * math.pi)
                some = some or abs(off) < OWN_ROOT
                if not any(_are_same_angles(angles, other) for other in out):
                    out.append(angles)
        explained = explained and some
    return explained


def _guesses(split: _Split, moved: Floats, x3: float) -> list[Floats]:
    """Angles that nearly reach, for one tangent of the third; the nearest, where none does."""
    ranked = []
    for x4, x5 in _remaining_tangents(split.A, x3):
        for angles in _complete_angles(split.axes, moved, *(2.0 * np.arctan([x3, x4, x5]) + split.shifts)):
            off = float(np.linalg.norm(_twist(moved @ inverse(_jacobian(split.axes, angles)[0]))))
            ranked.append((off, angles))
    ranked.sort(key=lambda one: one[0])
    return [angles for k, (off, angles) in enumerate(ranked) if k == 0 or off < NEARLY]


def _equations(axes: Axes, moved: Floats, shifts: Floats) -> tuple[Floats, float]:
    """Matrices (3, 12, 12) of the powers of joint 3's tangent; columns are powers 0 to 3 of joint 4's by 0 to 2 of 5's.

    Second, of what size the smallest singular value of what joints 1 and 2 do is: zero where they leave out an equation.
    """
    h, p = axes.h, axes.p
    start = _line(p[5], h[5])
    goal = _line(moved[:3, :3] @ p[5] + moved[:3, 3], moved[:3, :3] @ h[5])
    one, two = _rotations(-h[0], p[0]), _rotations(-h[1], p[1])
    left = np.einsum("aij,bjk,k->iab", two, one, goal).reshape(15, 9)[:14]
    three, four, five = (_tangents(_rotations(h[k], p[k]), shifts[k - 2]) for k in (2, 3, 4))
    right = np.einsum("aij,bjk,ckl,l->iabc", three, four, five, start)[:14]
    # The constant goes to the other side: times (1 + x^2) of all three.
    whole = np.einsum("a,b,c->abc", *3 * [np.array([1.0, 0.0, 1.0])])
    right -= left[:, 0, None, None, None] * whole
    U, sizes, _ = np.linalg.svd(left[:, 1:], full_matrices=True)
    six = np.einsum("ie,iabc->aebc", U[:, 8:], right)
    A = np.zeros((3, 12, 4, 3))
    A[:, :6, :3] = six
    A[:, 6:, 1:] = six
    return A.reshape(3, 12, 12), float(sizes[-1] / sizes[0])


def _tangents(rotations: Floats, shift: float) -> Floats:
    """A rotation times 1 + x^2, by powers of the tangent x of half the angle from ``shift``."""
    constant, cosine, sine = rotations
    c, s = math.cos(shift), math.sin(shift)
    along, across = c * cosine + s * sine, c * sine - s * cosine
    return np.array([constant + along, 2.0 * across, constant - along])


def _roots(A: Floats, rounded: float) -> list[float]:
    """Tangents of joint 3 that may be real where the pencil's entries are off by ``rounded``, each once.

    The bound of an eigenvalue x of low v = x high v with left vector u is, to first order, that times
    (|low| + |x| |high|) |u| |v| / |u* high v|: two roots that are nearly one have a large one.
    """
    zero, one = np.zeros((12, 12)), np.eye(12)
    size = np.linalg.norm(A, axis=(0, 2), keepdims=True)
    B = A / np.where(size > 0.0, size, 1.0)
    low = np.block([[zero, one], [-B[0], -B[1]]])
    high = np.block([[one, zero], [zero, B[2]]])
    (alpha, beta), left, right = eig(low, high, left=True, right=True, homogeneous_eigvals=True)
    some = np.abs(beta) > 1e-13 * np.abs(alpha)
    x, left, right = alpha[some] / beta[some], left[:, some], right[:, some]
    moved = (np.linalg.norm(low) + np.abs(x) * np.linalg.norm(high)) * np.linalg.norm(left, axis=0)
    moved *= np.linalg.norm(right, axis=0)
    held = np.abs(np.einsum("ik,ij,jk->k", left.conj(), high, right))
    real = x[np.abs(x.imag) * held <= rounded * moved].real
    found: list[float] = []
    for value in sorted(real):
        if not found or abs(math.atan(value) - math.atan(found[-1])) > 1e-9:
            found.append(float(value))
    return found


def _remaining_tangents(A: Floats, x3: float) -> Iterator[tuple[float, float]]:
    """Tangents of joints 4 and 5 for one of joint 3: of the vectors that the matrix brings to nothing."""
    M = A[0] + x3 * (A[1] + x3 * A[2])
    M = M / np.linalg.norm(M, axis=1, keepdims=True)
    sizes, rows = np.linalg.svd(M)[1:]
    for many in range(1, 5):
        if many > 1 and sizes[12 - many] > 1e-4 * sizes[0]:
            break
        V = rows[12 - many :].T.reshape(4, 3, many)
        by_four = np.linalg.lstsq(V[:3].reshape(9, many), V[1:].reshape(9, many), rcond=None)[0]
        by_five = np.linalg.lstsq(V[:, :2].reshape(8, many), V[:, 1:].reshape(8, many), rcond=None)[0]
        W = np.linalg.eig(by_four + 0.7310 * by_five)[1]
        for w in W.T:
            one = (V @ w) if many > 1 else V[:, :, 0]
            x4 = np.vdot(one[:3], one[1:]) / np.vdot(one[:3], one[:3])
            x5 = np.vdot(one[:, :2], one[:, 1:]) / np.vdot(one[:, :2], one[:, :2])
            yield float(x4.real), float(x5.real)


def _complete_angles(axes: Axes, moved: Floats, third: float, fourth: float, fifth: float) -> Iterator[Floats]:
    """Angles of joints 1, 2 and 6 for those between: by the direction of axis 6, or where that says nothing by its point."""
    h, p = axes.h, axes.p
    bent = about(h[2], p[2], third) @ about(h[3], p[3], fourth) @ about(h[4], p[4], fifth)
    along, point = bent[:3, :3] @ h[5], bent[:3, :3] @ p[5] + bent[:3, 3]
    goal_along, goal_point = moved[:3, :3] @ h[5], moved[:3, :3] @ p[5] + moved[:3, 3]
    for second in _seconds(axes, along, point, goal_along, goal_point):
        rotated = about(h[1], p[1], second)
        u, w = rotated[:3, :3] @ along, rotated[:3, :3] @ point + rotated[:3, 3] - p[0]
        pairs = [(u, goal_along), (w, goal_point - p[0])]
        v, goal = max(pairs, key=lambda pair: float(np.linalg.norm(np.cross(h[0], pair[0]))))
        first = angle_about(h[0], v, goal)
        rest = (about(h[0], p[0], first) @ rotated @ bent)[:3, :3].T @ moved[:3, :3]
        across = any_across(h[5])
        yield np.array([first, second, third, fourth, fifth, angle_about(h[5], across, rest @ across)])


def _seconds(axes: Axes, along: Floats, point: Floats, goal_along: Floats, goal_point: Floats) -> Iterator[float]:
    """Angles of joint 2 that leave of axis 6 what joint 1 cannot change: its slope to axis 1, and its point's height on it."""
    h, p = axes.h, axes.p
    if np.linalg.norm(np.cross(h[0], h[1])) > 1e-6:
        yield from _to_height(h[1], h[0], along, float(h[0] @ goal_along))
        yield from _to_height(h[1], h[0], point - p[1], float(h[0] @ (goal_point - p[1])))
        return
    s, w, goal = (v - h[0] * float(h[0] @ v) for v in (p[1] - p[0], point - p[1], goal_point - p[0]))
    wanted = 0.5 * float(goal @ goal - s @ s - w @ w)
    yield from _to_height(h[1], s, w, wanted)


def _to_height(h: Floats, n: Floats, v: Floats, height: float) -> Iterator[float]:
    """Angles of ``v`` about ``h`` at which ``n . v`` is this, the nearest where none is."""
    along = h * float(h @ v)
    a, b = float(n @ (v - along)), float(n @ np.cross(h, v))
    size = math.hypot(a, b)
    if size < 1e-9:
        return
    middle, half = math.atan2(b, a), math.acos(max(-1.0, min(1.0, (height - float(n @ along)) / size)))
    yield middle + half
    yield middle - half


def _polish_angles(axes: Axes, moved: Floats, angles: Floats) -> Floats | None:
    """Newton steps to the last digits; None: they lead nowhere."""
    q = angles.copy()
    for _ in range(STEPS):
        at, J = _jacobian(axes, q)
        off = _twist(moved @ inverse(at))
        if np.linalg.norm(off) > 3.0:
            return None
        step = np.linalg.lstsq(J, off, rcond=1e-12)[0]
        longest = float(np.abs(step).max())
        q = q + step * min(1.0, 0.3 / max(longest, 1e-300))
        if longest < 1e-13:
            break
    off = _twist(moved @ inverse(_jacobian(axes, q)[0]))
    return None if np.linalg.norm(off) > REACHED else np.array([math.remainder(a, 2.0 * math.pi) for a in q])


def _jacobian(axes: Axes, q: Floats) -> tuple[Floats, Floats]:
    """How the flange moved (4, 4), and its Jacobian (6, 6): rotations, then motions at the origin."""
    T, J = np.eye(4), np.empty((6, 6))
    for k in range(6):
        h, p = T[:3, :3] @ axes.h[k], T[:3, :3] @ axes.p[k] + T[:3, 3]
        J[:3, k], J[3:, k] = h, np.cross(p, h)
        T = T @ about(axes.h[k], axes.p[k], float(q[k]))
    return T, J


def _twist(T: Floats) -> Floats:
    """A small motion (6,): rotation, then motion of the origin."""
    R = T[:3, :3]
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = float(np.linalg.norm(w)), 0.5 * (float(np.trace(R)) - 1.0)
    rotation = w * (math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0)
    return np.concatenate([rotation if cosine > -0.999 else rotation + math.pi, T[:3, 3]])


def _singular(axes: Axes, q: Floats) -> bool:
    return bool(np.linalg.svd(_jacobian(axes, q)[1], compute_uv=False)[-1] < SINGULAR)


def _are_same_angles(one: Floats, other: Floats, within: float = SAME_RAD) -> bool:
    return bool(np.abs(np.remainder(one - other + math.pi, 2.0 * math.pi) - math.pi).max() < within)


def reach(robot: Robot, targets: Floats, starts: Floats, margin: float = 0.01) -> tuple[Floats, Bools]:
    """Joints (N, n) whose nominal tool point is at ``targets (N, 3)`` m in the frame of the robot's base pose.

    Newton steps of least norm from ``starts (N, n)``, kept inside the limits by ``margin`` of each joint's range, which
    leaves room for a correction. Returns the joints and which arrived.
    """
    model = RobotModel(robot)
    values = model.values0()
    lower, upper = robot.limits.T
    room = np.where(np.isfinite(upper - lower), margin * (upper - lower), 0.0)
    lower, upper = lower + room, upper - room
    q = np.clip(starts, lower, upper)
    for _ in range(MOST_STEPS):
        prediction, J = model.joint_jacobian(Observations(q), values)
        error = targets - prediction.position
        if np.max(np.linalg.norm(error, axis=1), initial=0.0) < REACHED_M:
            break
        A = J[:, :3]
        damped = A @ A.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        step = np.einsum("nij,ni->nj", A, np.linalg.solve(damped, error[:, :, None])[:, :, 0])
        q = np.clip(q + np.clip(step, -STEP_LIMIT_RAD, STEP_LIMIT_RAD), lower, upper)
    left = np.linalg.norm(targets - model.predict(Observations(q), values).position, axis=1)
    return q, left < 10 * REACHED_M
