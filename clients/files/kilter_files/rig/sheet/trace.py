"""The drawn line in the unrolled ring: found, followed, and its middle measured between the printed dashes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from kilter_files.ground.arrays import Floats
from kilter_files.rig.sheet.camera import Camera, Pixels
from kilter_files.rig.sheet.layout import Sheet, aruco

STIFFNESS = 0.35  # price of a step of 1 mm from gap to gap, in the darkness of a line
WINDOW_MM = 0.9  # the line's middle is sought this far around its ridge
DASH_FREE_MM = 0.35  # and so far from a dash
PIECE_MM = 0.4
LEAST_DARK = 0.05
LEAST_OVER_NOISE = 5.0
SECOND_SHARE = 0.45
APART_MM = 0.9
STROKE_BAND_MM = (0.9, 2.6)  # off the line, where a stroke is alone
STROKE_SHARE = 0.3
EDGE_MM = 0.25
PRINT_FREE_MM = 0.65  # the printed circle is read where the pencil is farther away


@dataclass(frozen=True)
class Line:
    """Per gap: ``out_mm`` of the drawn line (NaN where there is none), its ``sigma_mm``, ``width_mm`` and ``dark``."""

    out_mm: Floats
    sigma_mm: Floats
    width_mm: Floats
    dark: Floats
    second: NDArray[np.bool_]
    channel: int


@dataclass(frozen=True)
class Strokes:
    """Per gap: ``along_mm`` of the stroke across the line, counterclockwise (NaN where there is none), its sigma."""

    along_mm: Floats
    sigma_mm: Floats


def trace(ring: Ring) -> Line:
    """Follow the drawn line through the gaps and measure its middle."""
    gaps, free = ring.gaps(), _free(ring)
    # A median over the gap: a stroke in it is the lesser part, wherever it stands.
    profiles = np.median(gaps[:, :, :, free], axis=3)
    ridges = [_ridge(_smooth(of_channel)) for of_channel in profiles]
    darkness = [
        float(np.median(_values_along_path(of_channel, path)))
        for of_channel, path in zip(profiles, ridges, strict=True)
    ]
    channel = int(np.argmax(darkness))
    profile, path = profiles[channel], ridges[channel]
    noise = _noise(profile)
    smooth = _smooth(profile)
    dark = _values_along_path(smooth, path) - np.median(smooth, axis=1)
    there = dark > max(LEAST_DARK, LEAST_OVER_NOISE * noise, 0.3 * float(np.median(dark)))
    out, sigma, width = _measure(ring, gaps[channel], path, there)
    return Line(out, sigma, width, dark, _second(smooth, path, dark, noise) & there, channel)


def _free(ring: Ring) -> NDArray[np.bool_]:
    """Angles of a period that are in the gap and not at its very ends."""
    along = np.abs(ring.along_mm())
    period = 2 * np.pi * ring.sheet.radius_mm / ring.periods
    return np.asarray(along < period / 4 - DASH_FREE_MM)


def _smooth(profile: Floats) -> Floats:
    return np.asarray(gaussian_filter1d(profile, 0.1 / STEP_MM, axis=1))


def _values_along_path(profile: Floats, path: NDArray[np.int64]) -> Floats:
    return np.asarray(profile[np.arange(len(path)), path])


def _noise(profile: Floats) -> float:
    """Scatter of paper: from differences, so that shades and lines do not count."""
    step = max(1, round(0.3 / STEP_MM))
    return float(1.4826 * np.median(np.abs(profile[:, step:] - profile[:, :-step])) / np.sqrt(2))


def _ridge(profile: Floats) -> NDArray[np.int64]:
    """Return the darkest way (gaps) around the ring that does not jump, by dynamic programming twice around."""
    edge = round(EDGE_MM / STEP_MM)
    gain = profile - np.median(profile, axis=1, keepdims=True)
    gain[:, :edge] = gain[:, -edge:] = -1.0
    scale = max(float(np.quantile(gain.max(axis=1), 0.5)), 1e-6)
    rows = np.concatenate([gain, gain]) / scale
    count, radii = rows.shape
    steps = np.arange(radii) * STEP_MM
    price = STIFFNESS * (steps[:, None] - steps[None, :]) ** 2
    best, came = rows[0], np.zeros((count, radii), dtype=np.int64)
    for k in range(1, count):
        ways = best[None, :] - price
        came[k] = np.argmax(ways, axis=1)
        best = rows[k] + ways[np.arange(radii), came[k]]
    path = np.empty(count, dtype=np.int64)
    path[-1] = int(np.argmax(best))
    for k in range(count - 1, 0, -1):
        path[k - 1] = came[k][path[k]]
    # The middle of two turns has forgotten where it began and where it ends.
    quarter, turn = len(profile) // 2, len(profile)
    return np.asarray(np.concatenate([path[turn : turn + quarter], path[quarter:turn]]))


def _measure(
    ring: Ring, gaps: Floats, path: NDArray[np.int64], there: NDArray[np.bool_]
) -> tuple[Floats, Floats, Floats]:
    """Middle of the line in pieces of each gap beside strokes; their mean, its sigma, and the line's width."""
    along = ring.along_mm()
    pieces = _pieces(ring, along)
    found = np.full((ring.periods, len(pieces), 2), np.nan)
    for k in np.flatnonzero(there):
        crossed = _crossed_columns(ring, gaps[k], path[k])
        for i, columns in enumerate(pieces):
            good = columns & ~crossed
            if np.count_nonzero(good) >= 0.6 * np.count_nonzero(columns):
                found[k, i] = line_middle_and_width(
                    gaps[k][:, good].mean(axis=1), ring.out_mm, ring.out_mm[path[k]], WINDOW_MM
                )
    at = np.array([float(along[columns].mean()) for columns in pieces])
    out, sigma = _gap_means_and_sigmas(found[:, :, 0], at)
    known = ~np.isnan(found[:, :, 1])
    width = np.where(known, found[:, :, 1], 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return out, sigma, np.where(known.any(axis=1), width, np.nan)


def _pieces(ring: Ring, along: Floats) -> list[NDArray[np.bool_]]:
    free = _free(ring)
    reach = float(np.abs(along[free]).max())
    count = max(2, 2 * round(reach / PIECE_MM))
    edges = np.linspace(-reach - 1e-6, reach + 1e-6, count + 1)
    return [free & (along >= low) & (along < high) for low, high in itertools.pairwise(edges)]


def _crossed_columns(ring: Ring, gap: Floats, ridge: int) -> NDArray[np.bool_]:
    """Columns that a stroke darkens beside the line."""
    off = np.abs(ring.out_mm - ring.out_mm[ridge])
    band = (off > STROKE_BAND_MM[0]) & (off < STROKE_BAND_MM[1])
    beside = gap[band].mean(axis=0)
    line = float(np.median(gap[max(0, ridge - 2) : ridge + 3].mean(axis=0)))
    dark = beside - np.median(beside) > max(0.2 * line, 0.04)
    reach = max(1, round(0.15 / float(np.diff(ring.along_mm()[:2])[0])))
    return np.convolve(dark, np.ones(2 * reach + 1), mode="same") > 0.5


def line_middle_and_width(profile: Floats, at: Floats, near: float, window: float) -> tuple[float, float]:
    """Return middle and width of the dark line nearest to ``near``: the centre of what is above a third of its peak."""
    middle = near
    width = np.nan
    for _ in range(6):
        beside = (np.abs(at - middle) > window) & (np.abs(at - middle) < 2 * window)
        if np.count_nonzero(beside) < 4:
            return np.nan, np.nan
        slope, level = np.polyfit(at[beside] - middle, profile[beside], 1)
        lifted = profile - level - slope * (at - middle)
        inside = np.abs(at - middle) <= window
        peak = int(np.argmax(np.where(inside, lifted, -np.inf)))
        if lifted[peak] <= 0:
            return np.nan, np.nan
        above = lifted > lifted[peak] / 3
        low = peak - int(np.argmin(above[: peak + 1][::-1])) + 1 if not above[: peak + 1].all() else 0
        high = peak + int(np.argmin(above[peak:])) - 1 if not above[peak:].all() else len(at) - 1
        weight = lifted[low : high + 1] - lifted[peak] / 3
        moved = float((weight * at[low : high + 1]).sum() / max(weight.sum(), 1e-12))
        width = float(at[high] - at[low])
        if abs(moved - middle) < 1e-3:
            return moved, width
        middle = moved
    return middle, width


def _gap_means_and_sigmas(found: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Mean (gaps) over the pieces at the gap's middle, and its sigma from how the pieces of all gaps scatter."""
    out, sigma = np.full(len(found), np.nan), np.full(len(found), np.nan)
    slope = _slope(found, at)
    level = found - slope[:, None] * at
    count = np.count_nonzero(~np.isnan(level), axis=1)
    good = count > 0
    out[good] = np.nanmedian(level[good], axis=1)
    rest = level - out[:, None]
    scatter = float(np.sqrt(np.nansum(rest**2) / max(1, int((count[good] - 1).sum())))) if good.any() else np.nan
    # Neighbouring pieces share pencil grain and pixels; half of them are taken as independent.
    sigma[good] = 1.25 * scatter / np.sqrt(np.maximum(count[good] / 2, 1))
    return out, sigma


def _slope(found: Floats, at: Floats) -> Floats:
    """How steeply the line crosses each gap, from the gaps beside it: a gap is too short to tell."""
    level = np.full(len(found), np.nan)
    good = ~np.isnan(found).all(axis=1)
    level[good] = np.nanmedian(found[good], axis=1)
    period = 4 * max(float(np.abs(at).max()), 1e-9)
    slope = (np.roll(level, -1) - np.roll(level, 1)) / (2 * period)
    return np.where(np.isnan(slope), 0.0, slope)


def _second(smooth: Floats, path: NDArray[np.int64], dark: Floats, noise: float) -> NDArray[np.bool_]:
    """Gaps in which another line runs apart from the first."""
    away = np.abs(np.arange(smooth.shape[1])[None, :] - path[:, None]) * STEP_MM > APART_MM
    rest = np.where(away, smooth, -np.inf).max(axis=1) - np.median(smooth, axis=1)
    return np.asarray(rest > np.maximum(SECOND_SHARE * dark, max(LEAST_DARK, LEAST_OVER_NOISE * noise)))


def strokes(ring: Ring, line: Line) -> Strokes:
    """Find the strokes across the line and where along the circle they stand."""
    gaps = ring.gaps()[line.channel]
    along = ring.along_mm()
    found = np.full((len(gaps), 2), np.nan)
    for k in np.flatnonzero(~np.isnan(line.out_mm)):
        for i, side in enumerate((-1.0, 1.0)):
            found[k, i] = _stroke(ring, gaps[k], along, side, float(line.out_mm[k]), float(line.dark[k]))
    both = ~np.isnan(found).any(axis=1)
    middle = np.where(both, found.mean(axis=1), np.nan)
    # On paper, arcs are as long as the line's own radius makes them.
    middle = middle * (ring.sheet.radius_mm + line.out_mm) / ring.sheet.radius_mm
    apart = (found[:, 1] - found[:, 0])[both]
    scatter = 1.4826 * float(np.median(np.abs(apart - np.median(apart)))) / 2 if len(apart) > 2 else 0.05
    return Strokes(middle, np.where(both, np.hypot(scatter, line.sigma_mm), np.nan))


def _stroke(ring: Ring, gap: Floats, along: Floats, side: float, out: float, dark: float) -> float:
    off = (ring.out_mm - out) * side
    band = (off > STROKE_BAND_MM[0]) & (off < STROKE_BAND_MM[1]) & (np.abs(ring.out_mm) < REACH_MM - 0.1)
    if np.count_nonzero(band) < 8:
        return float("nan")
    profile = np.median(gap[band], axis=0)
    profile = profile - np.median(profile)
    peak = int(np.argmax(profile))
    if profile[peak] < max(STROKE_SHARE * dark, LEAST_DARK):
        return float("nan")
    return line_middle_and_width(profile, along, float(along[peak]), 0.6)[0]


def printed_circle(ring: Ring, line: Line) -> tuple[NDArray[np.int64], Floats]:
    """Return dashes and where their middles are, mm out of the circle, as far as the drawn line leaves them free.

    Dash ``k`` follows gap ``k``.
    """
    channels, radii, _ = ring.dark.shape
    shifted = np.roll(ring.dark, -(ring.per_period // 2), axis=2)
    dashes = shifted.reshape(channels, radii, ring.periods, ring.per_period).transpose(0, 2, 1, 3)
    columns = _free(ring)
    profiles = np.median(dashes[:, :, :, columns], axis=3)
    drawn = np.stack([line.out_mm, np.roll(line.out_mm, -1)])
    close = np.zeros(ring.periods, dtype=bool)
    known = ~np.isnan(drawn).all(axis=0)
    close[known] = np.nanmin(np.abs(drawn[:, known]), axis=0) < PRINT_FREE_MM
    free = np.flatnonzero(~close)
    near = np.abs(ring.out_mm) < 0.5
    if not len(free):
        return free, np.zeros(0)
    peaks = [np.median(profile[free][:, near].max(axis=1)) for profile in profiles]
    best = profiles[int(np.argmax(peaks))]
    noise = _noise(best)
    found = []
    for k in free:
        start = float(ring.out_mm[near][int(np.argmax(best[k][near]))])
        high = float(best[k][near].max() - np.median(best[k]))
        found.append(
            line_middle_and_width(best[k], ring.out_mm, start, 0.45)[0] if high > max(0.04, 5 * noise) else np.nan
        )
    out = np.array(found)
    good = ~np.isnan(out)
    return free[good], out[good]


REACH_MM = 4.4  # inside and outside the circle; the printed ticks begin behind it
STEP_MM = 0.04
ALONG_MM = 0.08
PAPER_MM = 2.4


@dataclass(frozen=True)
class Ring:
    """``dark`` (channels, radii, angles): 0 paper, 1 black; ``out_mm`` (radii) from the circle; ``turn`` (angles) rad.

    Angles come period by period: ``per_period`` of them around each gap's middle, from dash middle to dash middle.
    """

    sheet: Sheet
    dark: Floats
    out_mm: Floats
    turn: Floats
    per_period: int

    @property
    def periods(self) -> int:
        """How many gaps there are."""
        return self.sheet.dashes

    def gaps(self) -> Floats:
        """Return the darkness (channels, gaps, radii, angles of a period)."""
        channels, radii, _ = self.dark.shape
        return self.dark.reshape(channels, radii, self.periods, self.per_period).transpose(0, 2, 1, 3)

    def along_mm(self) -> Floats:
        """Return where the angles of a period are, in mm along the circle from the gap's middle."""
        k = np.arange(self.per_period) - (self.per_period - 1) / 2
        return np.asarray(k * (2 * np.pi * self.sheet.radius_mm / self.dark.shape[2]))


def unroll(rgb: Pixels, camera: Camera, sheet: Sheet) -> Ring:
    """Resample the ring and divide it by its paper, so that shadows and lamps are gone."""
    cv2, _ = aruco()
    period = 2 * np.pi * sheet.radius_mm / sheet.dashes
    per_period = max(16, round(period / ALONG_MM))
    count = per_period * sheet.dashes
    out: Floats = np.arange(-REACH_MM, REACH_MM + STEP_MM / 2, STEP_MM, dtype=np.float64)
    turn = np.asarray((np.arange(count) - (per_period - 1) / 2) * (2 * np.pi / count), dtype=np.float64)
    r = sheet.radius_mm + out[:, None]
    points = np.stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()], axis=1)
    at = camera.to_pixels(points).astype(np.float32)
    shape = (len(out), count)
    map_x, map_y = at[:, 0].reshape(shape), at[:, 1].reshape(shape)
    # OpenCV counts pixels of the result in 16 bits.
    parts = [
        cv2.remap(
            rgb,
            map_x[:, k : k + 16_000],
            map_y[:, k : k + 16_000],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(255, 255, 255),
        )
        for k in range(0, count, 16_000)
    ]
    light = np.concatenate(parts, axis=1).astype(np.float64).transpose(2, 0, 1)
    return Ring(sheet, 1.0 - light / _paper(light), out, turn, per_period)


def _paper(light: Floats) -> Floats:
    """Return how bright the paper would be: a level and slope over the radius at each angle, smooth along the angle."""
    half = light.shape[1] // 2
    x = np.linspace(-1, 1, light.shape[1])[None, :, None]
    # The brighter part of either side is paper, whatever is drawn along it; the median passes over strokes across it.
    inner, outer = (np.quantile(part, 0.7, axis=1) for part in (light[:, :half], light[:, half:]))
    window = (1, 2 * round(PAPER_MM / ALONG_MM / 2) + 1)
    inner, outer = (
        gaussian_filter1d(median_filter(part, window, mode="wrap"), 6, mode="wrap") for part in (inner, outer)
    )
    return np.maximum((inner + outer)[:, None, :] / 2 + (outer - inner)[:, None, :] * x, 8.0)
