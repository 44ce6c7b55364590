"""Logs as a fit reads them: on one even clock, in motions without a gap, with one filter for every signal.

What is filtered alike stays linear: torques and every column of the model pass the same filter ("parallel filtering", Gautier
and Poignet 2001), so that a sign of the speed and the friction it makes are smoothed in the same way.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

BREAK = 5.0  # times the usual step of the clock: a longer one ends a motion
LONGEST_S = 120.0  # one motion is read in parts of so long: memory stays flat
SHORTEST_S = 2.0
FASTEST_HZ = 50.0  # rows that come faster are thinned first: torques are compared far below
CUT_OFF_HZ = 5.0
JOINT_BAND = 4.0  # joints pass a filter so many times as wide, so that their accelerations keep what the torques keep
ROWS_PER_PERIOD = 4.0  # of the cut-off: rows that come faster repeat each other
EDGE_PERIODS = 1.5  # cut at both ends of a part, where a filter that runs both ways is not to be trusted
ORDER = 4
CLIPPED_ROWS = 5  # equal extremes in a row: the drive or its sensor gave no more
REST_SHARE = 0.02  # of the speed that a joint reaches: slower is at rest
REST_RAD_S = 0.02
REST_S = 0.5  # of rest of all joints: one motion ends, another begins
PATH_POINTS = 51  # by which two motions are compared
SAME_PATH = 0.02  # of the spread of the joints: a path as near to another is that one again
SAME_DURATION = 0.05
LEAST_SPREAD = 1e-3  # rad or m, of a joint that hardly moves


@dataclass(frozen=True)
class Path:
    """A motion without a gap: ``t (N,)`` s, joints, speeds and accelerations ``(N, n)``, ``temperature_c (N,)`` or None.

    ``payload_kg`` is stated to hang at ``payload_com (3,)`` m in the tool frame.
    """

    session: int
    payload_kg: float
    payload_com: Floats
    t: Floats
    q: Floats
    qd: Floats
    qdd: Floats
    temperature_c: Floats | None
    step_s: float


@dataclass(frozen=True)
class Part(Path):
    """A stretch of a log, on an even clock: a path with its torques ``tau (N, n)``.

    ``motion (N,)`` numbers the motions. ``usable (N, n)`` are torques that were not clipped.
    """

    motion: Ints
    tau: Floats
    usable: Bools
    rest_rad_s: Floats
    cut_off_hz: float

    def smooth(self, columns: Floats) -> Floats:
        """Return columns (N, ...) filtered as the torques are, at the :attr:`rows` that are compared."""
        return self.filter_columns(columns)[self.rows]

    def filter_columns(self, columns: Floats) -> Floats:
        """Return columns (N, ...) filtered as the torques are."""
        return _filter_columns(columns, self.cut_off_hz, self.step_s)

    @property
    def rows(self) -> slice:
        """Rows that are compared."""
        edge = int(np.ceil(EDGE_PERIODS / self.cut_off_hz / self.step_s))
        thin = max(1, int(1.0 / (ROWS_PER_PERIOD * self.cut_off_hz * self.step_s)))
        return slice(edge, len(self.t) - edge, thin)

    @property
    def moving(self) -> Bools:
        """Rows (N, n) in which each joint moves: at rest the friction may be anything up to its limit."""
        return np.abs(self.qd) > self.rest_rad_s


@dataclass(frozen=True)
class Log:
    """Joint logs with torques: ``t (N,)`` s, ``q (N, n)`` rad or m, ``tau (N, n)`` N m or N; ``starts`` are
    rows at which its clock breaks.
    """

    observations: Observations
    t: Floats
    tau: Floats
    starts: Ints
    step_s: float

    @classmethod
    def from_observations(cls, observations: Observations) -> Log:
        """Read a log; a gap of the clock, another session or a rest of all joints begins another motion.

        Raises:
            ObservationError: no clock, no torque, or a clock that does not run. TooFewPosesError: no motion of 2 s.

        """
        if observations.t is None or observations.tau is None:
            lacks = "t_s" if observations.t is None else "tau1_nm ..."
            raise ObservationError(
                f"A log of motions needs a clock and torques, and these rows have no {lacks}: upload it with that column.",
                code="log_incomplete",
            )
        t, tau = observations.t, observations.tau
        steps = np.diff(t)
        forward = steps[steps > 0.0]
        step = float(np.median(forward)) if len(forward) else 0.0
        if step <= 0.0:
            raise ObservationError(
                "t_s never goes forward in these rows: give the time of each row, s.", code="log_clock"
            )
        breaks = (steps > BREAK * step) | (steps <= 0.0)
        if observations.session is not None:
            breaks |= np.diff(observations.session) != 0
        starts = np.concatenate([[0], 1 + np.flatnonzero(breaks), [len(t)]])
        log = cls(observations, t, tau, starts, max(step, 1.0 / FASTEST_HZ))
        if not any(True for _ in log.parts()):
            raise TooFewPosesError(
                f"No motion of these rows lasts {SHORTEST_S:g} s without a gap: record longer motions, or fewer gaps in t_s."
            )
        return log

    def parts(self) -> Iterator[Part]:
        """Each stretch on an even clock, long ones in several parts; what is shorter than 2 s is passed over."""
        for start, end in self.stretches():
            count = max(1, int(np.ceil((self.t[end - 1] - self.t[start]) / LONGEST_S)))
            for piece in np.array_split(np.arange(start, end), count):
                if self.t[piece[-1]] - self.t[piece[0]] >= SHORTEST_S:
                    yield self._resample_stretch(piece)

    def stretches(self) -> Iterator[tuple[int, int]]:
        """First row of each stretch without a gap, and the one behind its last."""
        return pairwise(self.starts.tolist())

    @cached_property
    def motion(self) -> Ints:
        """Number (N,) of the motion of each row. A path that is driven again is one motion with the first."""
        ends = [self.starts[1:]]
        for start, end in self.stretches():
            if end - start > 2:
                rate = np.abs(np.gradient(self.observations.q[start:end], self.t[start:end], axis=0))
                ends.append(start + _ends_of_motions(self.t[start:end], np.all(rate < self._rest_speeds, axis=1)))
        edges = np.unique(np.concatenate([[0], *ends]))
        spread = np.maximum(self.observations.q.std(axis=0), LEAST_SPREAD)
        paths: list[tuple[float, Floats]] = []
        out = np.empty(len(self.t), dtype=np.int64)
        for start, end in pairwise(edges.tolist()):
            path = self._path(start, end) / spread
            duration = float(self.t[end - 1] - self.t[start])
            known = (k for k, one in enumerate(paths) if _is_driven_again(duration, path, *one))
            out[start:end] = next(known, len(paths))
            if out[start] == len(paths):
                paths.append((duration, path))
        return out

    def _path(self, start: int, end: int) -> Floats:
        """Joints (PATH_POINTS, n) of a motion at even times."""
        at = np.linspace(self.t[start], self.t[end - 1], PATH_POINTS)
        return np.stack([np.interp(at, self.t[start:end], one) for one in self.observations.q[start:end].T], axis=1)

    @cached_property
    def _rest_speeds(self) -> Floats:
        """Speed (n,) below which each joint counts as at rest."""
        reached = np.zeros(self.observations.q.shape[1])
        for start, end in self.stretches():
            if end - start > 2:
                rate = np.abs(np.gradient(self.observations.q[start:end], self.t[start:end], axis=0))
                reached = np.maximum(reached, np.quantile(rate, 0.95, axis=0))
        return np.minimum(REST_RAD_S, np.maximum(REST_SHARE * reached, 1e-4))

    def _resample_stretch(self, piece: Ints) -> Part:
        obs, t = self.observations, self.t[piece]
        clock = np.arange(t[0], t[-1], self.step_s)
        tau = self.tau[piece]
        nearest = np.minimum(np.searchsorted(t, clock), len(t) - 1)
        band = min(JOINT_BAND * self.cut_off_hz, 0.4 / self.step_s)
        q = _filter_columns(_interpolate(clock, t, obs.q[piece]), band, self.step_s)
        qd = _differentiate(q, self.step_s)
        warm = None if obs.temperature_c is None else np.interp(clock, t, obs.temperature_c[piece])
        session = 0 if obs.session is None else int(obs.session[piece[0]])
        carried = 0.0 if obs.payload_kg is None else float(obs.payload_kg[piece[0]])
        return Part(
            session,
            carried,
            np.zeros(3) if obs.payload_com is None else obs.payload_com[piece[0]],
            clock,
            q,
            qd,
            _differentiate(qd, self.step_s),
            warm,
            self.step_s,
            self.motion[piece][nearest],
            _interpolate(clock, t, tau),
            ~clipped_rows(tau)[nearest],
            self._rest_speeds,
            self.cut_off_hz,
        )

    @property
    def cut_off_hz(self) -> float:
        """Above which nothing is compared: 5 Hz, or less where rows are few."""
        return min(CUT_OFF_HZ, 0.2 / self.step_s)


@cache
def _design_filter(cut_off_hz: float, step_s: float) -> Floats:
    from scipy.signal import butter

    return np.asarray(butter(ORDER, cut_off_hz, fs=1.0 / step_s, output="sos"))


def _filter_columns(columns: Floats, cut_off_hz: float, step_s: float) -> Floats:
    from scipy.signal import sosfiltfilt  # 35 MB, which the API does without: it only asks what is a log

    return np.asarray(sosfiltfilt(_design_filter(cut_off_hz, step_s), columns, axis=0))


def _differentiate(values: Floats, step_s: float) -> Floats:
    """Central differences of fourth order: those of second order lose a per cent of accelerations above 1 Hz at 50 rows/s."""
    out = np.gradient(values, step_s, axis=0)
    out[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step_s)
    return out


def _ends_of_motions(t: Floats, resting: Bools) -> Ints:
    """Rows in the middle of each rest that lasts, with enough motion before it and behind it to be one of its own."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(np.int8), [0]])))
    firsts, lasts = edges[::2], edges[1::2] - 1
    moved_s = np.cumsum(np.where(resting, 0.0, np.gradient(t)))
    ends, before = [], 0.0
    for row in ((firsts + lasts)[t[lasts] - t[firsts] >= REST_S] // 2).tolist():
        if min(moved_s[row] - before, moved_s[-1] - moved_s[row]) >= SHORTEST_S:
            ends.append(row)
            before = moved_s[row]
    return np.array(ends, dtype=np.int64)


def _is_driven_again(duration: float, path: Floats, known_duration: float, known: Floats) -> bool:
    return (
        abs(duration - known_duration) <= SAME_DURATION * known_duration
        and float(np.sqrt(np.mean((path - known) ** 2))) < SAME_PATH
    )


def _interpolate(clock: Floats, t: Floats, values: Floats) -> Floats:
    """Values (N, n) on the clock; means, where they come faster than it."""
    width = int((len(t) - 1) / max(t[-1] - t[0], 1e-9) * (clock[1] - clock[0]))
    if width > 1:
        from scipy.ndimage import uniform_filter1d

        values = uniform_filter1d(values, width, axis=0)
    return np.stack([np.interp(clock, t, column) for column in values.T], axis=1)


def clipped_rows(tau: Floats) -> Bools:
    """Rows (N, n) in which a torque stands at the largest of the log, several rows in a row: it was cut off there."""
    at_most = np.abs(tau) >= (1.0 - 1e-6) * np.abs(tau).max(axis=0, initial=0.0)
    out = np.zeros(tau.shape, dtype=bool)
    for j, column in enumerate(at_most.T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(np.int8), [0]])))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if end - start >= CLIPPED_ROWS and np.abs(tau[start, j]) > 0.0:
                out[start:end, j] = True
    return out


def join_logs(parts: Sequence[Observations]) -> Observations:
    """Stack logs by what a search in torques reads: a payload that is not stated is none, a temperature must all have."""
    warm = all(one.temperature_c is not None for one in parts)
    return Observations.concatenate(
        [
            Observations(
                q=one.q,
                t=one.t,
                tau=one.tau,
                session=np.zeros(len(one), dtype=np.int64) if one.session is None else one.session,
                temperature_c=one.temperature_c if warm else None,
                payload_kg=np.zeros(len(one)) if one.payload_kg is None else one.payload_kg,
                payload_com=np.zeros((len(one), 3)) if one.payload_com is None else one.payload_com,
            )
            for one in parts
        ]
    )
