"""What a prior of the type does to an arm, without the luck of one noise: ``python -m benchmarks.fleet_linear``.

A linear study in plain numpy that shares no code with what it judges. Arm by arm the error is averaged over draws of the noise
of the same poses, with and without the prior on the same draws, so that a ratio says what the prior does and not what the
draw did. Arms, spread and noise are those of ``benchmarks.fleet``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tests.core.identify.fleet.simulated import ANGLE, LENGTH, PARALLEL, TOOL, Arm, poses, shifted

Floats = NDArray[np.float64]
NOISE, FITTED, UNSEEN, BETWEEN, DRAWS = 5e-5, 60, 300, 200, 200
WIDE = 30.0  # an ordinary prior, in spreads of the type
ODD_SHARE, ODD_WIDTH = 0.02, 20.0  # each of fifty parameters, so many times as wide
WORSE = 1.05
MOST, WIDTHS = 0.26, np.geomspace(1.0, 30.0, 35)  # of the error expected without; how wide the type is taken
MEAN_OF_UNIT = 4.0  # arms that the mean variance of a unit counts for
ERRORS = [(k, c) for k in range(6) for c in range(5) if c < 4 or k == PARALLEL]
SPREAD = np.array([(ANGLE, LENGTH, LENGTH, ANGLE, ANGLE)[c] for _, c in ERRORS])
IS_LENGTH = SPREAD == LENGTH
FRAMES = 9  # a base and the tool point, free in every fit


def derivatives(q: Floats) -> Floats:
    """Derivatives (3 N, 25 + 9) of measured points by errors in spreads, by the base and by the tool point."""
    steps = np.array([*SPREAD, *([1e-4] * FRAMES)])
    out = []
    for k, step in enumerate(steps):
        ends = [_moved(k, sign * step, q) for sign in (1.0, -1.0)]
        out.append((ends[0] - ends[1]).ravel() / 2.0)
    return np.stack(out, axis=1)


def _moved(k: int, step: float, q: Floats) -> Floats:
    errors, place, tool = np.zeros((6, 5)), np.zeros(6), TOOL.copy()
    if k < len(ERRORS):
        errors[ERRORS[k]] = step
    elif k < len(ERRORS) + 6:
        place[k - len(ERRORS)] = step
    else:
        tool[k - len(ERRORS) - 6] += step
    base = shifted(*place[:3])
    x, y, z = place[3:]
    base[:3, :3] += np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return Arm(errors, base, tool).points(q)


@dataclass(frozen=True)
class Prior:
    """What the others say of an arm's errors, in spreads: ``mean (25,)``, ``covariance (25, 25)``."""

    mean: Floats
    covariance: Floats

    @staticmethod
    def of(versions: Floats, known: Floats) -> Prior:
        """Moments of versions (R, 25) that are known to a mean covariance (25, 25), drawn towards a diagonal one."""
        robots, size = versions.shape
        mean = versions.mean(axis=0)
        found = np.cov(versions.T) - known
        variances = np.clip(np.diag(found), 1e-3, None)
        for unit in (IS_LENGTH, ~IS_LENGTH):
            told = variances[unit]
            variances[unit] = (robots * told + MEAN_OF_UNIT * told.mean()) / (robots + MEAN_OF_UNIT)
        shrunk = found * robots / (robots + size)
        np.fill_diagonal(shrunk, variances)
        w, V = np.linalg.eigh(shrunk)
        spread = (V * np.clip(w, 1e-3, None)) @ V.T
        return Prior(mean, spread + (spread + known) / robots)


@dataclass(frozen=True)
class Station:
    """Poses of a campaign and unseen ones, as derivatives in units of the noise."""

    seen: Floats
    unseen: Floats
    between: Floats  # those at which a fit with its type is compared with one without

    def fitted(self, y: Floats, prior: Prior) -> tuple[Floats, Floats]:
        """Errors (34, D) from noisy rows ``y (3 N, D)``, and their covariance (34, 34); linear, Gaussian prior."""
        C = np.zeros((self.seen.shape[1],) * 2)
        C[: len(SPREAD), : len(SPREAD)] = prior.covariance
        C[len(SPREAD) :, len(SPREAD) :] = np.diag(np.full(FRAMES, 1e6))
        mean = np.concatenate([prior.mean, np.zeros(FRAMES)])[:, None]
        gain = C @ self.seen.T @ np.linalg.inv(self.seen @ C @ self.seen.T + np.eye(len(y)))
        return mean + gain @ (y - self.seen @ mean), C - gain @ self.seen @ C

    def limited(self, y: Floats, prior: Prior, alone: Floats, covariance: Floats) -> Floats:
        """Errors (34, D) with a prior that is taken wider, draw by draw, until it moves the tool by little enough.

        That is ``MOST`` of the error that is expected of the fit ``alone``, at poses of their own.
        """
        most = MOST * np.sqrt(np.einsum("ij,jk,ik->", self.between, covariance, self.between))
        found, left = alone.copy(), np.ones(y.shape[1], dtype=bool)
        for width in WIDTHS:
            some = self.fitted(y[:, left], Prior(prior.mean, prior.covariance * width**2))[0]
            near = np.linalg.norm(self.between @ (some - alone[:, left]), axis=0) <= most
            found[:, np.flatnonzero(left)[near]] = some[:, near]
            left[np.flatnonzero(left)[near]] = False
            if not left.any():
                break
        return found

    def squares(self, found: Floats, x: Floats) -> float:
        """Sum of the squared errors of all draws (34, D) at unseen poses of an arm ``x (34,)``."""
        return float(np.sum((self.unseen @ (found - x[:, None])) ** 2))

    def odd(self, y: Floats, prior: Prior) -> Floats:
        """Which parameter of another make each draw of rows shows (D,); -1: none."""
        free = np.linalg.qr(self.seen[:, len(SPREAD) :], mode="complete")[0][:, FRAMES:]
        J = free.T @ self.seen[:, : len(SPREAD)]
        r = free.T @ y - J @ prior.mean[:, None]
        V = J @ prior.covariance @ J.T + np.eye(len(r))
        inverse = np.linalg.inv(V)
        wider = (ODD_WIDTH**2 - 1.0) * np.diag(prior.covariance)
        told = np.einsum("rk,rs,sk->k", J, inverse, J)
        more = 1.0 + wider * told
        gain = (J.T @ inverse @ r) ** 2 * (wider / more)[:, None] - np.log(more)[:, None]
        best = np.argmax(gain, axis=0)
        likely = gain[best, np.arange(gain.shape[1])] > -2.0 * np.log(ODD_SHARE / (1.0 - ODD_SHARE))
        return np.where(likely, best, -1)


@dataclass(frozen=True)
class Case:
    """One of ``among`` the parameters is so many spreads ``off``, of the arm itself or of one of the ``others``."""

    words: str
    off: float
    whose: Literal["own", "other's"]
    among: Sequence[int]
    others: int


def ratio(station: Station, x: Floats, prior: Prior, rng: np.random.Generator, limit: bool) -> float:
    """How many times the rms error without the prior an arm has with it, over draws of the noise."""
    y = (station.seen @ x)[:, None] + rng.standard_normal((len(station.seen), DRAWS))
    without, covariance = station.fitted(y, Prior(np.zeros(len(SPREAD)), WIDE**2 * np.eye(len(SPREAD))))
    found, which = np.zeros_like(without), station.odd(y, prior)
    for k in np.unique(which):
        C = prior.covariance.copy()
        if k >= 0:
            C[k, k] += (ODD_WIDTH**2 - 1.0) * C[k, k]
        some, own = which == k, Prior(prior.mean, C)
        found[:, some] = (
            station.limited(y[:, some], own, without[:, some], covariance)
            if limit
            else station.fitted(y[:, some], own)[0]
        )
    return float(np.sqrt(station.squares(found, x) / station.squares(without, x)))


def ratios(arms: int, count: int, case: Case, rng: np.random.Generator, limit: bool) -> Iterator[float]:
    """The ratios of so many arms with ``count`` poses, each beside others of its type."""
    many = derivatives(poses(FITTED, rng)) / NOISE
    whole: Floats = np.linalg.inv(many.T @ many + np.eye(many.shape[1]) / WIDE**2).astype(np.float64)
    known = whole[: len(SPREAD), : len(SPREAD)]
    unseen, between = (_short(derivatives(poses(size, rng)) / NOISE) for size in (UNSEEN, BETWEEN))
    for _ in range(arms):
        kind = rng.standard_normal(len(SPREAD))
        versions = kind + rng.standard_normal((case.others, len(SPREAD)))
        versions += rng.multivariate_normal(np.zeros(len(SPREAD)), known, case.others)
        x = np.concatenate([kind + rng.standard_normal(len(SPREAD)), np.zeros(FRAMES)])
        odd = x if case.whose == "own" else versions[0]
        odd[int(rng.choice(case.among))] += case.off * rng.choice([-1.0, 1.0])
        station = Station(derivatives(poses(count, rng)) / NOISE, unseen, between)
        yield ratio(station, x, Prior.of(versions, known), rng, limit)


def _short(J: Floats) -> Floats:
    """As many rows as columns with the same sums of squares."""
    return np.asarray(np.linalg.qr(J, mode="r"))


def cases(others: int, off: float) -> list[Case]:
    """What is studied: an arm of the type, an odd one, and one of whose fleet another is odd."""
    zeros = [ERRORS.index((joint, 0)) for joint in range(1, 5)]
    anything = range(len(ERRORS))
    return [
        Case("of the type", 0.0, "own", zeros, others),
        Case(f"one zero {off:g} spreads off", off, "own", zeros, others),
        Case(f"any one {off:g} spreads off", off, "own", anything, others),
        Case(f"another's {off:g} spreads off", off, "other's", anything, others),
    ]


def main() -> None:
    """Print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=300)
    parser.add_argument("--others", type=int, default=11)
    parser.add_argument("--off", type=float, default=10.0)
    parser.add_argument("--poses", type=int, nargs="+", default=[12, 14, 20])
    parser.add_argument("--whole", action="store_true", help="the prior as it is, whatever it moves")
    given = parser.parse_args()
    rng = np.random.default_rng(30)
    print(
        f"{given.arms} arms, each with {given.others} others of its type; error with the prior over that without, "
        f"{DRAWS} draws"
    )
    print("poses   arm                          mean   median   largest   above 1.05")
    for count in given.poses:
        for case in cases(given.others, given.off):
            found = np.array(list(ratios(given.arms, count, case, rng, not given.whole)))
            share = 100.0 * float(np.mean(found > WORSE))
            told = f"{np.mean(found):6.3f}   {np.median(found):6.3f}   {found.max():7.3f}   {share:8.1f} %"
            print(f"{count:5d}   {case.words:25} {told}", flush=True)


if __name__ == "__main__":
    main()
