"""Identify 24 geometric parameters from 118 positions: Kilter beside pybotics, FIGAROH and robotkinecal on the same data.

The peers run in environments of their own, made by ``python -m tools.lab peers``; without them they are left out.

The campaign every tool is given: a UR10 with table errors, in plain numpy, sharing code with none of them.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    draw = np.random.default_rng(0)

    def identify_new_rows() -> None:  # what is kept of rows seen before helps nobody who has new ones
        rows = Observations(data.q, position=data.position * 1e-3 + draw.normal(scale=1e-9, size=data.position.shape))
        identify(arm, rows, None, options)

    return {
        "seconds": best_of(
            lambda: estimate(Calibration.nominal(arm), Measurement.from_observations(train), options), ROUNDS
        ),
        "whole_seconds": best_of(identify_new_rows, ROUNDS),
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


Floats = NDArray[np.float64]

# Modified DH of a UR10 (alpha rad, a mm, theta rad, d mm), the table pybotics ships.
UR10 = np.array([
    [0.0, 0.0, 0.0, 118.0],
    [np.pi / 2, 0.0, np.pi, 0.0],
    [0.0, 612.7, 0.0, 0.0],
    [0.0, 571.6, 0.0, 163.9],
    [-np.pi / 2, 0.0, 0.0, 115.7],
    [np.pi / 2, 0.0, np.pi, 92.2],
])  # fmt: skip
TOOL_MM = np.array([50.0, 20.0, 100.0])
TRAIN, HELD_OUT = 118, 500
NOISE_MM = 0.02
ERRORS = np.array([1e-3, 0.5, 1e-3, 0.5])  # standard deviations, as the columns of the table


@dataclass(frozen=True)
class Campaign:
    """Joints rad and positions mm to fit and to predict."""

    q: Floats
    position: Floats
    q_held: Floats
    position_held: Floats

    def save(self, path: Path) -> None:
        """Write all arrays to an npz file, which any tool can read."""
        np.savez(
            path,
            q=self.q,
            position=self.position,
            q_held=self.q_held,
            position_held=self.position_held,
            table=UR10,
            tool=TOOL_MM,
        )


def positions(table: Floats, q: Floats) -> Floats:
    """Tool points (N, 3) mm of Rx(alpha) Tx(a) Rz(theta + q) Tz(d) chains."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (alpha, a, theta, d), angle in zip(table, q.T, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        step = np.zeros((len(q), 4, 4))
        step[:, 0, 0], step[:, 0, 1], step[:, 0, 3] = c, -s, a
        step[:, 1, 0], step[:, 1, 1], step[:, 1, 2], step[:, 1, 3] = s * ca, c * ca, -sa, -sa * d
        step[:, 2, 0], step[:, 2, 1], step[:, 2, 2], step[:, 2, 3] = s * sa, c * sa, ca, ca * d
        step[:, 3, 3] = 1.0
        T = T @ step
    return np.asarray(T[:, :3, :3] @ TOOL_MM + T[:, :3, 3])


def campaign(seed: int = 0) -> Campaign:
    """118 noisy positions to fit, 500 exact ones to predict."""
    rng = np.random.default_rng(seed)
    truth = UR10 + rng.normal(size=UR10.shape) * ERRORS
    q, held = rng.uniform(-2.5, 2.5, (TRAIN, 6)), rng.uniform(-2.5, 2.5, (HELD_OUT, 6))
    noise = rng.normal(0.0, NOISE_MM, (TRAIN, 3))
    return Campaign(q, positions(truth, q) + noise, held, positions(truth, held))
