"""How a recording is read: frames, gaps and noise of each marker."""

from __future__ import annotations

from typing import Any

import numpy as np

from kilter_files.tables.recording import Recording
from kilter_files.tables.survey import SHOWN, survey


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Describe a recording: its frames, each marker, and the places where it cannot be right."""
    found = survey(recording)
    markers = []
    for k, name in enumerate(recording.markers):
        seen = int(found.seen[k])
        markers.append(
            {
                "name": name,
                "seen": round(seen / max(1, found.frames), 6),
                "longest_gap_frames": int(found.longest_gap[k]),
                "low_mm": [round(float(v), 4) for v in found.low[k]] if seen else None,
                "high_mm": [round(float(v), 4) for v in found.high[k]] if seen else None,
                "noise_mm": None if np.isnan(found.noise_mm[k]) else round(float(found.noise_mm[k]), 5),
            }
        )
    place = "line" if recording.kind.endswith("csv") else "frame"
    return {
        "kind": recording.kind,
        "frames": found.frames,
        "rate_hz": recording.rate_hz,
        "duration_s": recording.duration_s,
        "markers": markers,
        "frames_without_marker": found.empty_frames,
        "notes": list(recording.notes),
        "warnings": [*recording.warnings, *found.doubts],
        "problems": [{place: row, "what": what} for row, what in found.faults[:SHOWN]]
        + ([{"what": f"{len(found.faults) - SHOWN} more of these"}] if len(found.faults) > SHOWN else []),
    }
