"""External axes of a pose: a rail that carries the arm, as somebody stated it, or an axis that stands at zero."""

from __future__ import annotations

import re
from collections.abc import Mapping

from kilter_files.formats.programs.found import NUMBER, Stated, Track
from kilter_files.formats.programs.notations import Frame, Notation

# mm or deg: where an arm of which errors are some mm in a metre stands this far from where it is taken to be, its
# correction is another one by some um at most. Rails that stand still read so.
AT_ZERO = 0.01
WRITTEN = re.compile(rf"\s*+([-+]?)([xyz])\s*+(?:,\s*+({NUMBER})\s*+)?", re.I)
NONE = "none"


def parse_track(said: str) -> Track | None:
    """Read ``x``, ``-y,1000`` (mm for each unit) or ``none``; None where it is none of these."""
    if said.strip().lower() == NONE:
        return Track((0.0, 0.0, 0.0))
    match = WRITTEN.fullmatch(said)
    if match is None or not float(match[3] or 1.0):
        return None
    mm = float(f"{match[1]}1") * float(match[3] or 1.0)
    x, y, z = (mm * (axis == match[2].lower()) for axis in "xyz")
    return Track((x, y, z))


def frame_on_track(stated: Stated, notation: Notation, axes: Mapping[str, float]) -> tuple[Frame | None, str]:
    """Return where the rail's zero is, seen from the arm's root on it, and why that is not known: one of them.

    Both are empty where no axis carries the arm. ``axes`` are the values of external axes by name.
    """
    if not axes:
        return None, ""
    place = [0.0, 0.0, 0.0]
    for name, value in axes.items():
        track = stated.tracks.get(name.lower())
        if track is not None:
            place = [at - along * value for at, along in zip(place, track.along, strict=True)]
        elif abs(value) > AT_ZERO:
            return None, (
                f"an external axis may move its base: state a rail and its direction, --track {name}=x, or that it moves "
                f"no frame, --track {name}={NONE}"
            )
    if not any(place):
        return None, ""
    turn = (1.0, 0.0, 0.0, 0.0) if len(notation.names) == 7 else (0.0, 0.0, 0.0)
    return Frame(notation, (*(at / notation.mm for at in place), *turn)), ""
