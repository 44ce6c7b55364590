"""A version of the one or few parameters that moved: everything else stays as it was identified.

The change is the least-squares one of the whitened innovation, made anew about what was found. What the version knows of its
parameters follows: with the derivatives J of the rows and the weights P of the estimate, the errors e of the parameters become
A e - E P n, A = I - E P J, where E puts the changed ones in their places and n is the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import CoreError, ObservationError, OptionError
from kilter_core.identify.estimate import Frame, new_frames, refit_frames
from kilter_core.identify.seen_poses import as_seen_places
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import QUANTILE, Floats, Ints
from kilter_core.watch.arm_check import Check, Judged, absorb_frame_increments, check
from kilter_core.watch.causes import Cause
from kilter_core.watch.innovation import STATED, Conditions, Innovation
from kilter_core.watch.sockets import held_by_sockets

PASSES = 5
SETTLED = 1e-3  # of its standard deviation that a change may still move by
APART = 1e-6  # of the largest singular value: below it two changes look the same
CODE = "rezero_not_carried"


@dataclass(frozen=True)
class Rezeroed:
    """The arm after the change; ``names`` changed by ``change (F,)`` SI with standard deviations ``sigma (F,)``.

    ``together (F, F)`` is the covariance of the change. ``before`` and ``after`` are the checks of the rows against the version
    and against this.
    """

    calibration: Calibration
    known: Predictive
    names: tuple[str, ...]
    change: Floats
    sigma: Floats
    together: Floats
    causes: tuple[Cause, ...]
    before: Check
    after: Check

    @property
    def changed_causes(self) -> tuple[Judged, ...]:
        """Each cause with what changed in the version; a check looks at each alone, where it takes up what the others did."""
        judged = {one.cause: one for one in self.before.judged}
        if len(self.causes) == 1:
            return (judged[self.causes[0]],)
        out, first = [], 0
        for cause in self.causes:
            own = slice(first, first + (6 if cause.frame else 1))
            first, change = own.stop, self.change[own]
            sigma = np.where(self.sigma[own] > 0.0, self.sigma[own], np.inf)
            size_sigma = _of_sizes(change, self.together[own, own]) if cause.frame else np.zeros(0)
            told = replace(judged[cause], change=change, sigma=sigma, size_sigma=size_sigma)
            out.append(replace(told, summed=change, summed_sigma=sigma))
        return tuple(out)


def rezero(
    calibration: Calibration,
    rows: Observations,
    known: Predictive,
    causes: Sequence[str] = (),
    *,
    noise: float | None = None,
    new_setup: Sequence[str] = (),
    fitted_c: tuple[float, float] | None = None,
    conditions: Conditions = STATED,
) -> Rezeroed:
    """Change what a check of the rows names, or the ``causes`` named here, as ``zero_3``, and nothing else.

    Views are places of the tool by the cameras of the version, as in a check. Frames of ``new_setup``, [], ["base"] or
    ["base", "tool"], are estimated beside the causes and then dropped: the version keeps its own. ``conditions`` as there.

    Raises:
        CoreError: the data do not carry it: nothing has moved, several causes may be it, a cause named is refuted or has not
            changed, or the rows still miss the arm afterwards. OptionError: no such cause or set-up.
        Whatever ``check`` refuses.

    """
    anew = new_frames(new_setup, "new_setup")
    calibration = absorb_frame_increments(calibration)
    if held_by_sockets(rows):
        raise ObservationError(
            "A ball in sockets shows that an arm has moved, and by how much only beside what it does not see: re-zero from "
            "rows that measure the tool (x_mm, y_mm, z_mm), or identify a version anew from the sockets.",
            code=CODE,
        )
    rows = as_seen_places(calibration, rows, noise)
    before = check(calibration, rows, known, noise=noise, new_setup=anew, fitted_c=fitted_c, conditions=conditions)
    chosen = _chosen(before, causes)
    names = [name for cause in chosen for name in _parameters(calibration, cause)]
    known = _extend_with_exact_names(known, names)
    at, change, together, covariance = _estimate_change(calibration, rows, known, names, noise, anew, fitted_c)
    sigma = np.sqrt(np.diag(together))
    for cause in chosen:
        _refuse_unchanged(
            cause, *(part[[names.index(n) for n in _parameters(calibration, cause)]] for part in (change, sigma))
        )
    now = replace(known, covariance=covariance)
    after = check(at, rows, now, noise=noise, new_setup=anew, fitted_c=fitted_c, conditions=conditions)
    if after.verdict != "ok":
        raise CoreError(
            f"After the change the rows still miss the arm by {mm(after.misfit):.3g} mm, more than chance explains (p = "
            f"{after.p_value:.1g}): more has changed than {_join_cause_names(chosen)}. Measure a campaign and "
            "identify a version anew.",
            code=CODE,
            causes=[one.name for one in chosen],
        )
    return Rezeroed(absorb_frame_increments(at), now, tuple(names), change, sigma, together, chosen, before, after)


def _chosen(found: Check, wanted: Sequence[str]) -> tuple[Cause, ...]:
    known = {one.cause.name: one for one in found.judged}
    missing = [name for name in wanted if name not in known]
    if missing:
        raise OptionError(
            f"The rows show no cause {missing[0]!r}: name one of {', '.join(sorted(known))}.", option="causes"
        )
    if found.verdict == "ok":
        raise CoreError(
            "Nothing has moved: the rows agree with the version, so there is nothing to re-zero. Go on with the version.",
            code=CODE,
        )
    if not wanted:
        if len(found.causes) != 1:
            may = " or ".join(one.cause.name for one in found.causes) or "no single cause"
            raise CoreError(
                f"The rows do not say what moved: it is {may}. Find out by other means and name it (`causes`), or measure a "
                "campaign and identify a version anew.",
                code=CODE,
                causes=[one.cause.name for one in found.causes],
            )
        return (found.causes[0].cause,)
    if len(wanted) == 1 and known[wanted[0]].refuted:
        raise CoreError(
            f"The rows refute {wanted[0]}: {found.judged[0].cause.name} explains what it leaves. Name that, or measure a "
            "campaign and identify a version anew.",
            code=CODE,
            causes=list(wanted),
        )
    return tuple(known[name].cause for name in dict.fromkeys(wanted))


def _parameters(calibration: Calibration, cause: Cause) -> list[str]:
    """Names of the parameters of a cause."""
    names = calibration.names
    if cause.kind in ("base", "tool"):
        return _frame_parameters(calibration, cause.kind)
    found: str | None = None
    if cause.kind == "zero" and cause.joint is not None:
        chain = calibration.robot.chain
        found = chain.elements[chain.primary[cause.joint - 1]].name
    elif cause.kind == "sag":
        found = f"compliance_{cause.joint}"
    if found is None or found not in names:
        raise OptionError(
            f"The version has no parameter for {cause.name}: "
            + (
                "the scale is the instrument's, not the arm's. Look at its calibration."
                if cause.kind == "scale"
                else "identify a version with axial_compliance at that joint."
                if cause.kind == "sag"
                else "name that joint's element in the robot's description."
            ),
            option="causes",
        )
    return [found]


def _frame_parameters(calibration: Calibration, frame: str) -> list[str]:
    """Names (6) of the increments of the base or of the tool."""
    n = calibration.model.n_geometric
    return list(calibration.names[:6] if frame == "base" else calibration.names[n - 6 : n])


def _extend_with_exact_names(known: Predictive, names: Sequence[str]) -> Predictive:
    """The same with more names, which count as known exactly so far."""
    more = [name for name in names if name not in known.names]
    C = np.zeros((len(known.names) + len(more),) * 2)
    C[: len(known.names), : len(known.names)] = known.covariance
    return replace(known, names=(*known.names, *more), covariance=C)


def _estimate_change(
    calibration: Calibration,
    rows: Observations,
    known: Predictive,
    names: Sequence[str],
    noise: float | None,
    anew: Sequence[Frame],
    fitted_c: tuple[float, float] | None,
) -> tuple[Calibration, Floats, Floats, Floats]:
    """The calibration after the change, the change (F,) and its covariance (F, F), and that of all parameters (K, K)."""
    frames = [name for frame in anew for name in _frame_parameters(calibration, frame)]
    places = np.array([calibration.names.index(name) for name in (*names, *frames)], dtype=np.int64)
    at, change = calibration, np.zeros(len(places))
    if anew:  # an instrument that was set up elsewhere is metres away: derivatives reach from near it only
        at = absorb_frame_increments(
            refit_frames(at, Innovation.from_observations(at, rows, known, noise, fitted_c).measurement, anew)
        )
    for _ in range(PASSES):
        innovation = Innovation.from_observations(at, rows, known, noise, fitted_c)
        W = _derivatives(innovation, at, places)
        P = _inverse(W)
        step = P @ innovation.r
        values = at.values.copy()
        values[places] += step
        at, change = replace(at, values=values), change + step
        sigma = np.linalg.norm(P, axis=1)
        if np.all(np.abs(step) <= SETTLED * np.where(sigma > 0, sigma, np.inf)):
            break
    P, change = P[: len(names)], change[: len(names)]
    covariance = _covariance(known, names, P, _derivatives(innovation, at, _known_parameter_indices(at, known)), at)
    values = calibration.values.copy()
    values[places[: len(names)]] += change
    return replace(calibration, values=values), change, P @ P.T, covariance


def _known_parameter_indices(calibration: Calibration, known: Predictive) -> Ints:
    return np.array([k for k, name in enumerate(calibration.names) if name in known.names], dtype=np.int64)


def _covariance(known: Predictive, names: Sequence[str], P: Floats, J: Floats, at: Calibration) -> Floats:
    """Covariance (K, K) after parameters took on an estimate with weights ``P (F, R)``; ``J (R, G)`` by those known."""
    ours = [known.names.index(at.names[k]) for k in _known_parameter_indices(at, known)]
    E = np.zeros((len(known.names), len(names)))
    E[[known.names.index(name) for name in names], range(len(names))] = 1.0
    A = np.eye(len(known.names))
    A[:, ours] -= E @ P @ J
    of_version = P @ J @ known.covariance[np.ix_(ours, ours)] @ J.T @ P.T
    C = A @ known.covariance @ A.T + E @ (P @ P.T - of_version) @ E.T  # whitened rows have covariance one
    return np.asarray(0.5 * (C + C.T))


def _derivatives(innovation: Innovation, calibration: Calibration, places: Ints) -> Floats:
    """Whitened derivatives (R, F) by parameters in these places."""
    order = np.argsort(places)
    J = calibration.model.jacobian(innovation.measurement.observations, calibration.values, places[order])[1]
    return innovation.white(J[:, :, np.argsort(order)])


def _inverse(W: Floats) -> Floats:
    """Pseudo-inverse (F, R) of the derivatives by the parameters that change."""
    size = np.linalg.norm(W, axis=0)
    seen = size > APART * size.max()
    scaled = W[:, seen] / size[seen]
    s = np.linalg.svd(scaled, compute_uv=False)
    if s[-1] < APART * s[0]:
        raise CoreError(
            "The rows do not tell these changes apart: name fewer causes, or measure more poses.", code=CODE
        )
    P = np.zeros((W.shape[1], W.shape[0]))
    P[seen] = np.linalg.pinv(scaled) / size[seen, None]
    return P


def _refuse_unchanged(cause: Cause, change: Floats, sigma: Floats) -> None:
    if np.all(np.abs(change) <= QUANTILE * sigma):
        raise CoreError(
            f"The rows do not show that {cause.name} changed: its 95 % interval holds none at all. Leave it out, or measure "
            "more poses.",
            code=CODE,
            causes=[cause.name],
        )


def _of_sizes(change: Floats, covariance: Floats) -> Floats:
    """Standard deviations (2,) of the lengths of a frame's shift and rotation."""
    out = []
    for part in (slice(0, 3), slice(3, 6)):
        size = float(np.linalg.norm(change[part]))
        along = change[part] / size if size else np.zeros(3)
        out.append(float(np.sqrt(along @ covariance[part, part] @ along)) if size else np.inf)
    return np.array(out)


def _join_cause_names(causes: Sequence[Cause]) -> str:
    return " and ".join(one.name for one in causes)
