"""A corrected row says where the tool will be: identified and corrected over HTTP, judged by Pinocchio's arms.

What is stated of a row (`u95_x_mm` ...) has to hold the true error of the tool at the corrected joints, wherever the pose
is, and `OK` has to mean that the tool gets there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from tests.core.truth import Arm, Step, dh_steps
from tests.service.conftest import WorkerProcess, wait_for

Floats = NDArray[np.float64]
FINAL = ("succeeded", "failed", "cancelled")
NOISE_MM, FITTED, CORRECTED = 0.02, 120, 400
SHARE = 0.9  # of the range of the joints, for all poses
TOOL = pin.SE3(np.eye(3), np.array([0.03, -0.02, 0.12]))
HALF = math.pi / 2


def arm_of(kind: str) -> Arm:
    """Arms of four makes, without errors."""
    if kind == "6R":  # elbow and a wrist whose axes meet in a point
        rows = ((0.4, 0.025, HALF), (0.0, 0.455, 0.0), (0.0, 0.035, HALF), (0.42, 0.0, -HALF), (0.0, 0.0, HALF),
                (0.08, 0.0, 0.0))  # fmt: skip
        return Arm(dh_steps(rows), 6, tool=TOOL)
    if kind == "7R":
        rows = ((0.34, 0.0, -HALF), (0.0, 0.0, HALF), (0.4, 0.0, HALF), (0.0, 0.0, -HALF), (0.4, 0.0, -HALF),
                (0.0, 0.0, HALF), (0.126, 0.0, 0.0))  # fmt: skip
        return Arm(dh_steps(rows), 7, tool=TOOL)
    if kind == "5R":
        rows = ((0.2, 0.05, HALF), (0.0, 0.3, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, HALF), (0.1, 0.0, 0.0))
        return Arm(dh_steps(rows), 5, tool=TOOL)
    steps = [Step("tz", 0.4, name="d_1"), Step("rz", 0.0, 0, name="theta_offset_1"), Step("tx", 0.325, name="a_1"),
             Step("rx", 0.0, name="alpha_1"), Step("ry", 0.0, name="beta_1"), Step("rz", 0.0, 1, name="theta_offset_2"),
             Step("tx", 0.275, name="a_2"), Step("rx", 0.0, name="alpha_2"), Step("ry", 0.0, name="beta_2"),
             Step("tz", 0.0, 2, name="d_3"), Step("rz", 0.0, 3, name="theta_offset_4")]  # fmt: skip
    return Arm(tuple(steps), 4, tool=TOOL, limits=(-2.5, 2.5))


def limits(arm: Arm) -> Floats:
    """Limits (n, 2) of the joints, rad or m: a slide has 0.2 m."""
    slides = {s.joint for s in arm.moving if s.axis[0] == "t"}
    return np.array([(-0.1, 0.1) if j in slides else arm.limits for j in range(arm.n)])


def document(arm: Arm, name: str) -> dict[str, Any]:
    found = arm.document() | {"name": name}
    for joint, (low, high) in zip(found["joints"], limits(arm), strict=True):
        if "limits_mm" in joint:
            joint["limits_mm"] = [1e3 * low, 1e3 * high]
    return found


def with_errors(arm: Arm, rng: np.random.Generator) -> Arm:
    """Errors of a tenth of a degree and three tenths of a millimetre in every constant."""
    sizes = {s.name: 3e-4 if s.axis[0] == "t" else 1.7e-3 for s in arm.steps}
    return arm.moved({name: float(rng.normal(0.0, size)) for name, size in sizes.items()})


def poses(arm: Arm, rng: np.random.Generator, count: int, near: str = "") -> Floats:
    """Random poses in 90 % of the range; ``near`` "wrist" or "elbow": within five degrees of the singularity."""
    low, high = SHARE * limits(arm).T
    q = rng.uniform(low, high, (count, arm.n))
    if near == "wrist":
        q[:, arm.n - 2] = rng.uniform(-0.09, 0.09, count)
    elif near == "elbow":  # stretched; the forearm of the six-axis arm has an offset
        at = math.atan2(0.42, 0.035) if arm.n == 6 else 0.0
        q[:, {4: 1, 5: 2, 6: 2, 7: 3}[arm.n]] = at + rng.uniform(-0.09, 0.09, count)
    return q


def columns(arm: Arm, q: Floats) -> dict[str, list[float]]:
    slides = {s.joint for s in arm.moving if s.axis[0] == "t"}
    return {
        (f"q{j + 1}_mm" if j in slides else f"q{j + 1}_rad"): (q[:, j] * (1e3 if j in slides else 1.0)).tolist()
        for j in range(arm.n)
    }


@dataclass(frozen=True)
class Judged:
    """Rows of a corrected path: the true error of the tool (N, 3) mm, what was stated of it, and the verdicts."""

    error: Floats
    stated: Floats
    left: Floats
    status: NDArray[np.str_]

    @property
    def answered(self) -> NDArray[np.bool_]:
        return ~np.isnan(self.error).any(axis=1)

    @property
    def inside(self) -> float:
        """Share of the coordinates of all rows answered that are within what is stated."""
        return float((np.abs(self.error) <= self.stated)[self.answered].mean())

    @property
    def furthest_ok(self) -> float:
        """Largest error of a row that is OK, in lengths of what is stated."""
        ok = self.status == "OK"
        size = np.linalg.norm(self.error, axis=1) / np.linalg.norm(self.stated, axis=1)
        return float(size[ok].max(initial=0.0))


def identified(client: httpx.Client, drawn: Arm, real: Arm, name: str, rng: np.random.Generator) -> str:
    """Measure the real arm, identify it with default settings, and return the version."""
    client.post("/v1/robots", json=document(drawn, name)).raise_for_status()
    asked = {"name": "one", "device": "tracker"}
    campaign = client.post(f"/v1/robots/{name}/campaigns", json=asked).raise_for_status().json()["id"]
    q = poses(drawn, rng, FITTED)
    points = 1e3 * real.poses(q)[0] + rng.normal(0.0, NOISE_MM, (FITTED, 3))
    rows = columns(drawn, q) | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}
    client.post(f"/v1/campaigns/{campaign}/observations", json=rows).raise_for_status()
    wish = {"kind": "identify", "robot": name, "campaigns": [campaign], "options": {"level": 2}}
    job = client.post("/v1/jobs", json=wish).raise_for_status().json()["id"]
    wait_for(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in FINAL)
    found = client.get(f"/v1/jobs/{job}").json()
    assert found["state"] == "succeeded", found["error"]
    return str(found["result"]["version_id"])


def judged(client: httpx.Client, drawn: Arm, real: Arm, name: str, version: str, q: Floats, **how: Any) -> Judged:
    """Correct poses over HTTP, and let Pinocchio say where the tool really is."""
    sent = columns(drawn, q)
    answer = client.post(f"/v1/robots/{name}/correct", params={"version": version, **how}, json=sent)
    rows = answer.raise_for_status().json()
    there = np.array([rows[key] for key in sent], dtype=float).T * [1e-3 if "_mm" in key else 1.0 for key in sent]
    status = np.array(rows["status"])
    error = np.full((len(q), 3), np.nan)
    good = ~np.isnan(there).any(axis=1)
    error[good] = 1e3 * (real.poses(there[good])[0] - drawn.poses(q[good])[0])
    stated = np.array([rows[f"u95_{axis}_mm"] for axis in "xyz"], dtype=float).T
    return Judged(error, stated, np.array(rows["left_mm"], dtype=float), status)


def check(client: httpx.Client, kind: str, seeds: range, near: tuple[str, ...]) -> None:
    """Rows of several campaigns together: what was stated of them holds."""
    every: list[Judged] = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drawn = arm_of(kind)
        real, name = with_errors(drawn, rng), f"arm{kind}{seed}".lower()
        version = identified(client, drawn, real, name, rng)
        for where in ("", *near):
            found = judged(client, drawn, real, name, version, poses(drawn, rng, CORRECTED, where))
            print(
                f"{kind} seed {seed} {where or 'anywhere'}: inside {found.inside:.3f}, OK at most "
                f"{found.furthest_ok:.2f} of what is stated, left > 0.05 mm {np.mean(found.left > 0.05):.4f}, largest "
                f"{np.nanmax(found.left):.3f} mm, {dict(zip(*np.unique(found.status, return_counts=True), strict=True))}"
            )
            assert found.furthest_ok < 5.0
            kept = found.left > 0.05
            assert (found.status[kept & found.answered] != "OK").all()
            every.append(found)
    together = Judged(
        *(np.concatenate([getattr(one, part) for one in every]) for part in ("error", "stated", "left", "status"))
    )
    assert together.inside >= 0.94


def test_what_is_stated_of_a_corrected_row_holds(client: httpx.Client, worker: WorkerProcess) -> None:
    worker.start()
    check(client, "6R", range(4), ("elbow", "wrist"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["6R", "7R", "SCARA", "5R"])
def test_what_is_stated_holds_for_every_make_of_arm(client: httpx.Client, worker: WorkerProcess, kind: str) -> None:
    worker.start()
    check(client, kind, range(1, 6), ("elbow",) if kind == "SCARA" else ("elbow", "wrist"))
