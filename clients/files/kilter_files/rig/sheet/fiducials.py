"""The printed marks in a picture: square markers by number, or the four quarter targets alone."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.rig.sheet.camera import Camera, Picture, Pixels, fit_camera
from kilter_files.rig.sheet.layout import CORNER_IDS, TARGET_MM, Sheet, aruco, radius_from_marker

SEARCHED_SIDE = 2400  # markers are looked for in a picture made this small, and refined in the whole one
MOST_OFF_MM = 0.3  # prints, scanners and flat paper stay below 0.05
DOUBTFUL_MM = 0.15
MOST_LEFT_OUT = 2  # covered or smudged; more are a sheet that is bent or cut
MOST_TARGETS = 14
REPRINT = "Lay the whole sheet flat in the picture, sharp and with even light, all four corner markers visible."


@dataclass(frozen=True)
class Marks:
    """Which sheet it is, and where its marks are: ``mm`` and ``pixels`` (n, 2), with their names."""

    sheet: Sheet
    mm: Floats
    pixels: Floats
    names: tuple[str, ...]
    way: str


def find_marks(picture: Picture, radius_mm: float | None) -> Marks:
    """Find the sheet in a picture; ``radius_mm`` where the person says it.

    Raises:
        FileError: no marks, a mirrored picture, another sheet than said.

    """
    seen = _markers(picture.rgb)
    corners = [number for number in CORNER_IDS if number in seen]
    if len(corners) < 3:
        if len(_markers(np.ascontiguousarray(picture.rgb[:, ::-1]))) >= 3:
            what = "is mirrored: its markers can be read in a mirror only"
            raise fault(picture.path, what, "Switch mirroring off in the scanner's or the camera's settings.")
        return _by_targets(picture, radius_mm, seen)
    sheet = _sheet(picture, seen, radius_mm)
    known = sheet.markers()
    numbers = [number for number in seen if number in known]
    return Marks(
        sheet,
        np.array([known[number] for number in numbers]),
        np.array([_middle(seen[number]) for number in numbers]),
        tuple(f"marker {number}" for number in numbers),
        "markers",
    )


def _markers(rgb: Pixels) -> dict[int, Floats]:
    """Corners (4, 2) of every marker of the dictionary, in pixels of ``rgb``."""
    cv2, dictionary = aruco()
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, SEARCHED_SIDE / max(grey.shape))
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(small)
    found: dict[int, Floats] = {}
    for number, quad in zip([] if numbers is None else numbers.ravel(), corners, strict=True):
        rough = ((quad.reshape(4, 2) + 0.5) / scale - 0.5).astype(np.float32)
        cell = float(np.linalg.norm(rough[0] - rough[2])) / np.sqrt(2) / 7
        window = max(2, round(0.7 * cell))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.005)
        fine = cv2.cornerSubPix(grey, rough.reshape(4, 1, 2).copy(), (window, window), (-1, -1), stop).reshape(4, 2)
        found[int(number)] = np.asarray(fine, dtype=np.float64)
    return found


def _middle(quad: Floats) -> Floats:
    """Where the diagonals cross: blur that rounds all four corners alike does not move it."""
    (x1, y1), (x3, y3) = quad[0], quad[2]
    (x2, y2), (x4, y4) = quad[1], quad[3]
    A = np.array([[x3 - x1, x2 - x4], [y3 - y1, y2 - y4]])
    t = np.linalg.solve(A, [x2 - x1, y2 - y1])[0]
    return np.array([x1 + t * (x3 - x1), y1 + t * (y3 - y1)])


def _sheet(picture: Picture, seen: dict[int, Any], radius_mm: float | None) -> Sheet:
    said = {radius for number in seen if (radius := radius_from_marker(number)) is not None}
    if len(said) > 1:
        raise fault(picture.path, f"shows sheets of {len(said)} radii", "Leave one sheet in the picture.")
    radius = said.pop() if said else radius_mm
    if radius is None:
        what = "the marker below the circle that says the radius cannot be read"
        raise fault(picture.path, what, "Say it: --radius-mm.")
    if radius_mm is not None and abs(radius - radius_mm) > 1e-6:
        what = f"is the sheet of radius {radius:g} mm, not {radius_mm:g} mm"
        raise fault(picture.path, what, "Take the other sheet, or leave --radius-mm out.")
    return Sheet(radius)


def _by_targets(picture: Picture, radius_mm: float | None, seen: dict[int, Any]) -> Marks:
    """Take the four quarter targets when the markers are cut away or covered."""
    height, width = picture.rgb.shape[:2]
    place = f"in {width} x {height} pixels {len(seen)} markers of a Kilter sheet and"
    targets = _targets(picture)
    if targets is None:
        raise fault(picture.path, f"no fiducials: {place} no four quarter targets were found", REPRINT)
    sheet = _sheet(picture, seen, radius_mm)
    names = tuple(f"target {k}" for k in range(1, 5))
    return Marks(sheet, np.array(sheet.targets()), targets, names, "quarter targets")


def _targets(picture: Picture) -> Floats | None:
    """Centres (4, 2) of ring, bull's eye and two discs that can be one sheet seen from its front."""
    kinds: dict[int, list[tuple[float, Floats]]] = {0: [], 1: [], 2: []}
    for depth, size, centre in _round_things(picture.rgb):
        kinds[depth].append((size, centre))
    if sum(len(found) for found in kinds.values()) > 40:
        kinds = {depth: sorted(found, key=lambda f: -f[0])[:MOST_TARGETS] for depth, found in kinds.items()}
    best: tuple[float, Floats] | None = None
    for ring, eye in itertools.product(kinds[1], kinds[2]):
        for three, four in itertools.permutations(kinds[0], 2):
            quad = np.array([ring[1], eye[1], three[1], four[1]])
            odd = _oddness(quad, np.array([ring[0], eye[0], three[0], four[0]]))
            if odd is not None and (best is None or odd < best[0]):
                best = (odd, quad)
    return None if best is None else best[1]


def _oddness(quad: Floats, sizes: Floats) -> float | None:
    """How unlike a square seen from its front; None when the corners do not run the right way round."""
    edges = np.roll(quad, -1, axis=0) - quad
    after = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if not np.all(turn < 0):  # pixels count downwards
        return None
    lengths = np.linalg.norm(edges, axis=1)
    spread = float(np.ptp(sizes) / sizes.mean() + np.ptp(lengths) / lengths.mean())
    # The targets are 2.8 mm small and stand at least 35 mm apart.
    return spread if spread < 1.2 and lengths.min() > 5 * sizes.max() else None


def _round_things(rgb: Pixels) -> list[tuple[int, float, Floats]]:
    """Dark round things: 0 disc, 1 ring, 2 bull's eye; their radius and centre in pixels."""
    cv2, _ = aruco()
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, SEARCHED_SIDE / max(grey.shape))
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
    block = max(15, int(0.04 * max(small.shape)) | 1)
    dark = cv2.adaptiveThreshold(small, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, 20)
    contours, tree = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if tree is None:
        return []
    ellipses = [_ellipse(cv2, contour) for contour in contours]
    solid = [(k, e) for k, e in enumerate(ellipses) if e is not None and tree[0][k][3] < 0]
    found = []
    for k, (centre, radius) in solid:
        holes = [j for j in range(len(contours)) if tree[0][j][3] == k and ellipses[j] is not None]
        inner = [e for j, e in solid if j != k and 0.1 < e[1] / radius < 0.45 and np.linalg.norm(e[0] - centre) < 2]
        if not holes and not any(
            j != k and e[1] > 1.5 * radius and np.linalg.norm(e[0] - centre) < 2 for j, e in solid
        ):
            found.append((0, radius / scale, (centre + 0.5) / scale - 0.5))
        elif len(holes) == 1:
            found.append((2 if inner else 1, radius / scale, (centre + 0.5) / scale - 0.5))
    return found


def _ellipse(cv2: Any, contour: Any) -> tuple[Floats, float] | None:
    """Centre and mean radius of a contour that is an ellipse of at least 2 pixels."""
    area = cv2.contourArea(contour)
    if len(contour) < 8 or area < 9:
        return None
    moments = cv2.moments(contour)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    spread = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / moments["m00"]
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 1e-9)) * 2
    if large > 2.5 * small or abs(np.pi * small * large / area - 1) > 0.12:
        return None
    return centre, float(np.sqrt(area / np.pi))


def place_sheet(picture: Picture, marks: Marks) -> tuple[Camera, Marks, list[str]]:
    """Fit the camera to the marks, find the quarter targets through it, and leave out a mark that is not where printed.

    Raises:
        FileError: marks that cannot be one flat sheet.

    """
    size = (picture.rgb.shape[1], picture.rgb.shape[0])
    try:
        camera, _ = fit_camera(size, marks.mm, marks.pixels)
        marks = with_targets(picture, marks, camera)
        left_out: list[str] = []
        while True:
            camera, off = fit_camera(size, marks.mm, marks.pixels)
            worst = int(np.argmax(off))
            if off[worst] < DOUBTFUL_MM or len(off) < 7 or len(left_out) == MOST_LEFT_OUT:
                break
            left_out.append(f"{marks.names[worst]} is {off[worst]:.2f} mm off its place and left out")
            keep = np.arange(len(off)) != worst
            names = tuple(name for name, kept in zip(marks.names, keep, strict=True) if kept)
            marks = Marks(marks.sheet, marks.mm[keep], marks.pixels[keep], names, marks.way)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise fault(picture.path, "its marks do not span a sheet", REPRINT) from error
    if off.max() > MOST_OFF_MM or not np.isfinite(off).all():
        what = f"{marks.names[int(np.argmax(off))]} is {off.max():.2f} mm from its printed position"
        raise fault(picture.path, what, "Is it another sheet, cut, or folded? Scan it flat, or print it again.")
    return camera, marks, left_out


def with_targets(picture: Picture, marks: Marks, camera: Camera) -> Marks:
    """Add the quarter targets, or refine them, by their centres of darkness where the camera expects them."""
    where = np.array(marks.sheet.targets())
    found = [_centre_of_dark(picture.rgb, camera, target) for target in where]
    good = [k for k, centre in enumerate(found) if centre is not None]
    names = [name for name in marks.names if not name.startswith("target")]
    keep = [k for k, name in enumerate(marks.names) if not name.startswith("target")]
    if not keep and len(good) < 4:
        return marks
    mm, pixels = list(marks.mm[keep]), list(marks.pixels[keep])
    for k in good:
        mm.append(where[k])
        pixels.append(camera.to_pixels(np.asarray(found[k])[None])[0])
        names.append(f"target {k + 1}")
    return Marks(marks.sheet, np.array(mm), np.array(pixels), tuple(names), marks.way)


def _centre_of_dark(rgb: Pixels, camera: Camera, target: Floats) -> Floats | None:
    """Centre in mm of the dark round thing near ``target``, None when there is none."""
    cv2, _ = aruco()
    reach, step = TARGET_MM + 1.6, 0.05
    centre = target
    for _ in range(3):
        axis = np.arange(-reach, reach + step / 2, step)
        x, y = np.meshgrid(axis, axis)
        at = camera.to_pixels(np.stack([x.ravel(), y.ravel()], axis=1) + centre).astype(np.float32)
        patch = cv2.remap(rgb, at[:, 0].reshape(x.shape), at[:, 1].reshape(x.shape), cv2.INTER_LINEAR)
        value = patch.astype(np.float64).mean(axis=2)
        outside = np.hypot(x, y) > TARGET_MM + 0.9
        # The tick on the inner side is not paper.
        plane = np.stack([np.ones_like(x), x, y], axis=-1)
        paper = outside & (value > np.median(value[outside]) - 40)
        shade = plane @ np.linalg.lstsq(plane[paper], value[paper], rcond=None)[0]
        dark = np.clip(1 - value / np.maximum(shade, 1.0), 0, 1)
        dark[(np.hypot(x, y) > TARGET_MM + 0.5) | (dark < 0.1)] = 0
        if dark.sum() * step**2 < 0.3 * np.pi * TARGET_MM**2:
            return None
        move = np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()
        centre = centre + move
        if np.linalg.norm(move) < 0.002:
            break
    return centre if float(np.linalg.norm(centre - target)) < 1.5 else None
