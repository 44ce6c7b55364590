"""Identify 24 geometric parameters from 118 positions: Kilter beside pybotics, FIGAROH and robotkinecal on the same data.

The peers run in environments of their own, made by ``python -m tools.lab peers``; without them they are left out.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaign import TOOL_MM, UR10, Campaign, campaign
from benchmarks.table import Line, best_of
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.estimate import estimate
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations

HERE = Path(__file__).resolve().parent
# Times faster than each that Kilter should be, and which of Kilter's times holds the like work: pybotics' time is its
# optimiser alone, as is robotkinecal's; FIGAROH's also reads the rows, selects parameters and evaluates, so it meets the
# whole of `identify`. robotkinecal has no figure to reach.
PEERS: dict[str, tuple[int | None, str, str]] = {
    "pybotics": (1000, "seconds", ".venv-peers"),
    "figaroh": (200, "whole_seconds", ".venv-peers"),
    "robotkinecal": (None, "seconds", ".venv-peers-poe"),
}
ROUNDS = 20


def robot() -> Robot:
    """The nominal arm; the rotations that Kilter adds for parallel axes are held, so that it fits the same 24."""
    rows = [
        {"alpha_deg": np.degrees(alpha), "a_mm": a, "theta_offset_deg": np.degrees(theta), "d_mm": d}
        for alpha, a, theta, d in UR10
    ]
    x, y, z = TOOL_MM
    return robot_from_document({"convention": "mdh", "rows": rows, "tool": {"x_mm": x, "y_mm": y, "z_mm": z}})


def of_kilter(data: Campaign) -> dict[str, Any]:
    """Seconds of the fit alone and of all that `identify` does; held-out error.

    The whole adds the fit of base and tool alone to compare with, metrics, null directions and noise.
    """
    arm, options = robot(), IdentifyOptions(base="fixed", tool="fixed", fix=("beta_*",))
    train = Observations(data.q, position=data.position * 1e-3)
    held = Observations(data.q_held, position=data.position_held * 1e-3)
    result = identify(arm, train, held, options)
    return {
        "seconds": best_of(
            lambda: estimate(Calibration.nominal(arm), Measurement.from_observations(train), options), ROUNDS
        ),
        "whole_seconds": best_of(lambda: identify(arm, train, None, options), ROUNDS),
        "parameters": len(result.free_names),
        "held_out_mm": result.metrics["validation"]["identified"]["mean_mm"],
    }


def of_peer(name: str, data: Campaign) -> dict[str, Any] | None:
    """What a peer's own script prints; None without the peer's environment."""
    python = HERE.parent / PEERS[name][2] / "bin" / "python"
    if not python.exists():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.npz"
        data.save(path)
        run = subprocess.run(
            [python, "-W", "ignore", HERE / "peers" / f"{name}_identify.py", path],
            capture_output=True,
            text=True,
            check=True,
        )
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return found


def lines() -> list[Line]:
    """Kilter's time and error, and each peer's with the ratio."""
    data = campaign()
    mine = of_kilter(data)
    out = [
        Line("identify, 118 positions: kilter, the fit", _text(mine)),
        Line("identify, 118 positions: kilter, with its report", f"{mine['whole_seconds'] * 1e3:.1f} ms"),
    ]
    for name, (target, like, _) in PEERS.items():
        theirs = of_peer(name, data)
        if theirs is None:
            out.append(Line(f"identify, 118 positions: {name}", "not installed: python -m tools.lab peers"))
            continue
        ratio = theirs["seconds"] / mine[like]
        out.append(Line(f"identify, 118 positions: {name}", _text(theirs)))
        out.append(
            Line(
                f"  kilter is faster than {name} by",
                f"{ratio:.0f} x",
                "" if target is None else f">= {target} x",
                None if target is None else ratio >= target,
            )
        )
        better = theirs["held_out_mm"] / mine["held_out_mm"]
        out.append(Line(f"  held-out error of {name} over kilter's", f"{better:.2f}", ">= 1", better >= 1.0))
    return out


def _text(found: dict[str, Any]) -> str:
    return f"{found['seconds'] * 1e3:.1f} ms, {found['parameters']} parameters, held-out {found['held_out_mm']:.4f} mm"
