"""Hide cases in arms that MuJoCo settles: ``python -m benchmarks.challenge.multibody DIR --n 20`` writes them and their seals.

Kinematics, loads and settling are MuJoCo's; flexures are joints of their own with springs. Nothing here is Kilter's. Every
arm has other lengths, masses and errors of assembly than the URDF that the search is given.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

X, Y, Z = np.eye(3)
# Where each joint is in the link before it (m), about which axis, mass behind it (kg) and its centre (m): an elbow arm.
PLACES = np.array([[0, 0, 0.20], [0, 0.13, 0.12], [0, -0.03, 0.55], [0.11, 0, 0.10], [0.40, 0, 0], [0.10, 0, 0]])
AXES = (Z, Y, Y, X, Y, X)
MASSES = np.array([12.0, 11.0, 6.0, 3.5, 1.6, 0.7])
CENTRES = np.array([[0, 0.06, 0.05], [0, 0, 0.26], [0.05, 0, 0.05], [0.2, 0, 0], [0.04, 0, 0], [0.02, 0, 0]])
FLANGE = np.array([0.05, 0.0, 0.0])
MARKER = np.array([0.08, 0.03, -0.05])  # from the flange
RANGE = np.radians([160.0, 75.0, 70.0, 160.0, 95.0, 170.0])
NOISE_M, REACH_M = 1.5e-5, 1.5e-5  # of a reading, and of coming back to a pose
POSES, REPEATED, SECOND = 90, 12, 40
LOADS_KG = (0.0, 4.0)
SETTLED = 1e-12  # rad that a flexure still moves when it stands
GIVEN = {"robot": {"base_link": "base", "tip_link": "flange"}, "payload_com_mm": [0.0, 0.0, 0.0]}
POSE_S = 40.0  # from one pose to the next


@dataclass
class Flaw:
    """What one case hides: springs to build in, and what else goes wrong; ``truth`` is what the seal covers."""

    truth: list[dict[str, Any]] = field(default_factory=list)
    springs: dict[int, tuple[Floats, float]] = field(default_factory=dict)  # after a joint: axis, Nm/rad
    reading: Callable[[Floats, Floats], Floats] = lambda q, row: q  # joint angles as they are, from those that are read
    station: Callable[[Floats, Floats, Floats], Floats] = lambda p, row, warm: p  # points as they are seen


def clean(rng: np.random.Generator) -> Flaw:
    """Nothing but errors of assembly."""
    return Flaw()


def compliance(rng: np.random.Generator) -> Flaw:
    """A gear that gives way about its own axis."""
    joint = int(rng.integers(1, 3))
    stiffness = rng.uniform(3e4, 9e4)
    size = {"name": f"compliance_{joint + 1}", "value": np.degrees(1.0 / stiffness)}
    return Flaw(
        [hidden("joint_twist", ["axial_compliance"], [joint + 1], f"gear of joint {joint + 1}", [size])],
        {joint: (AXES[joint], stiffness)},
    )


def torsion(rng: np.random.Generator) -> Flaw:
    """A forearm that twists about its own length, behind the joint that turns about the same line."""
    stiffness = rng.uniform(2e3, 6e3)
    return Flaw([hidden("joint_twist", ["link_torsion"], [3, 4], "torsion of the forearm")], {3: (X, stiffness)})


def belt(rng: np.random.Generator) -> Flaw:
    """A stretched belt: nearly linear in the angle of its joint, over less than a turn."""
    joint, slope, bend = int(rng.integers(0, 4)), rng.uniform(4e-4, 9e-4), rng.uniform(0.3, 0.7)

    def reading(q: Floats, row: Floats) -> Floats:
        moved = q.copy()
        x = q[:, joint] / RANGE[joint]
        moved[:, joint] += slope * RANGE[joint] * (x + bend * 0.2 * x**2 + 0.05 * x**3)
        return moved

    return Flaw([hidden("joint_curve", [], [joint + 1], f"belt of joint {joint + 1}")], reading=reading)


def knock(rng: np.random.Generator) -> Flaw:
    """A joint whose zero jumps in the middle of the campaign."""
    joint, by, share = int(rng.integers(0, 5)), rng.uniform(3e-4, 9e-4) * rng.choice([-1, 1]), rng.uniform(0.3, 0.7)

    def reading(q: Floats, row: Floats) -> Floats:
        moved = q.copy()
        moved[row >= share * row.max(), joint] += by
        return moved

    return Flaw(
        [hidden("joint_zero", ["zero_step"], [joint + 1], f"zero of joint {joint + 1} knocked")], reading=reading
    )


def step(rng: np.random.Generator) -> Flaw:
    """A tripod that is pushed once."""
    by, share = rng.normal(0.0, 2.5e-4, 3), rng.uniform(0.3, 0.7)

    def station(p: Floats, row: Floats, warm: Floats) -> Floats:
        return np.asarray(p + np.where(row >= share * row.max(), 1.0, 0.0)[:, None] * by)

    return Flaw([hidden("station", ["base_step"], [], "tripod pushed")], station=station)


def column(rng: np.random.Generator) -> Flaw:
    """A column below the arm that the sun bends: it leans with the temperature."""
    lean = rng.normal(0.0, 6e-5, 3) * [1.0, 1.0, 0.0]

    def station(p: Floats, row: Floats, warm: Floats) -> Floats:
        return np.asarray(p + np.cross(warm[:, None] * lean, p - [0.0, 0.0, -1.0]))

    return Flaw([hidden("thermal", ["column_bending", "thermal_drift"], [], "column bent by the sun")], station=station)


FAMILIES = {one.__name__: one for one in (clean, compliance, torsion, belt, knock, step, column)}


def hidden(class_: str, effects: list[str], joints: list[int], says: str, sizes: Any = ()) -> dict[str, Any]:
    """One hidden effect as the truth has it."""
    return {"physical_class": class_, "effects": effects, "joints": joints, "sizes": list(sizes), "says": says}


class Arm:
    """The arm as it is, settled by MuJoCo under its own weight and the load at its flange."""

    def __init__(self, nominal: Nominal, flaw: Flaw, rng: np.random.Generator) -> None:
        spec = mujoco.MjSpec()
        spec.option.gravity = [0.0, 0.0, -9.81]
        spec.compiler.degree = False
        parent = spec.worldbody
        for k in range(6):
            parent = parent.add_body(
                name=f"link{k + 1}", pos=nominal.places[k] + rng.normal(0.0, 4e-4, 3), quat=_tilted(rng, 6e-4),
                mass=nominal.masses[k], ipos=CENTRES[k], inertia=[0.01] * 3, explicitinertial=True,
            )  # fmt: skip
            axis = AXES[k] + np.cross(rng.normal(0.0, 4e-4, 3), AXES[k])
            parent.add_joint(name=f"q{k + 1}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
            if k in flaw.springs:
                along, stiffness = flaw.springs[k]
                parent.add_joint(name=f"spring{k}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=along, stiffness=stiffness)
        parent.add_body(
            name="load", pos=FLANGE, mass=1e-9, ipos=[0.0, 0.0, 0.0], inertia=[1e-9] * 3, explicitinertial=True
        )  # without ipos MuJoCo takes pos for it too
        parent.add_site(name="marker", pos=FLANGE + MARKER)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.zeros = rng.normal(0.0, 2e-3, 6)
        names = [mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(self.model.njnt)]
        self.driven = [names.index(f"q{k + 1}") for k in range(6)]
        self.springs = [k for k in range(self.model.njnt) if k not in self.driven]
        self.load = self.model.body("load").id

    def point(self, q: Floats, load_kg: float) -> Floats:
        """Where the marker stands, m, when the motors hold ``q`` (rad) with a load (kg) at the flange."""
        model, data = self.model, self.data
        model.body_mass[self.load] = max(load_kg, 1e-9)
        data.qpos[:], data.qvel[:] = 0.0, 0.0
        data.qpos[self.driven] = q + self.zeros
        for _ in range(60):
            mujoco.mj_forward(model, data)
            told = -data.qfrc_bias[self.springs] / model.jnt_stiffness[self.springs]
            moved = float(np.max(np.abs(told - data.qpos[self.springs]), initial=0.0))
            data.qpos[self.springs] = told
            if moved < SETTLED:
                break
        mujoco.mj_forward(model, data)
        return np.asarray(data.site("marker").xpos.copy())


@dataclass(frozen=True)
class Nominal:
    """The arm as it was drawn: joint places (6, 3) in m, and masses (6,) in kg."""

    places: Floats
    masses: Floats

    @staticmethod
    def drawn(rng: np.random.Generator) -> Nominal:
        """Other lengths and masses for every arm."""
        return Nominal(PLACES * rng.uniform(0.8, 1.25, (6, 1)), MASSES * rng.uniform(0.8, 1.2, 6))

    def urdf(self, rng: np.random.Generator) -> str:
        """What the search is given; masses are believed to a few per cent."""
        told = self.masses * rng.uniform(0.95, 1.05, 6)
        parts = ['<robot name="elbow">', '<link name="base"/>']
        for k in range(6):
            xyz, axis, com = (" ".join(f"{v:.9g}" for v in row) for row in (self.places[k], AXES[k], CENTRES[k]))
            parent = "base" if k == 0 else f"link{k}"
            parts.append(
                f'<link name="link{k + 1}"><inertial><origin xyz="{com}"/><mass value="{told[k]:.6g}"/>'
                '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="q{k + 1}" type="revolute"><parent link="{parent}"/><child link="link{k + 1}"/>'
                f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
                f'<limit lower="{-1.1 * RANGE[k]:.6f}" upper="{1.1 * RANGE[k]:.6f}" effort="300" velocity="2"/></joint>'
            )
        xyz = " ".join(f"{v:.9g}" for v in FLANGE)
        parts.append(
            '<link name="flange"/><joint name="flange_joint" type="fixed"><parent link="link6"/><child link="flange"/>'
            f'<origin xyz="{xyz}"/></joint></robot>'
        )
        return "\n".join(parts)


def measured(arm: Arm, flaw: Flaw, rng: np.random.Generator, poses: int, shares: Floats) -> str:
    """A campaign as CSV: poses in random order, some of them three times, two loads, a warm day, a tracker somewhere.

    ``shares (poses, 6)`` are the poses in parts of the range. A pose comes again with its load and from its side; some
    come once more with the other load.
    """
    again, other = np.split(rng.choice(poses, 2 * min(REPEATED, poses // 4), replace=False), 2)
    visits = np.concatenate([np.arange(poses), again, again, other])
    loads = rng.choice(LOADS_KG, poses)
    sides = rng.choice([-1.0, 1.0], (poses, 6))
    load = np.concatenate([loads, loads[again], loads[again], sum(LOADS_KG) - loads[other]])
    mixed = rng.permutation(len(visits))
    order, load = visits[mixed], load[mixed]
    q, n = shares[order] * RANGE, len(order)
    row = np.arange(n, dtype=np.float64)
    warm = 3.0 * np.sin(2.0 * np.pi * row / n * rng.uniform(0.6, 1.4) + rng.uniform(0, 6)) + rng.normal(0, 0.3, n)
    seen = np.array([arm.point(one, kg) for one, kg in zip(flaw.reading(q, row), load, strict=True)])
    seen = flaw.station(seen, row, warm) + rng.normal(0.0, REACH_M, (n, 3))
    turn = rng.uniform(-np.pi, np.pi)
    frame = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    seen = seen @ frame.T + rng.uniform(-3.0, 3.0, 3) + rng.normal(0.0, NOISE_M, (n, 3))
    head = [*(f"q{k + 1}_deg" for k in range(6)), "x_mm", "y_mm", "z_mm", *(f"dir{k + 1}" for k in range(6)),
            "t_s", "temperature_c", "payload_kg", "pose_id"]  # fmt: skip
    table = np.hstack(
        [np.degrees(q), 1e3 * seen, sides[order], np.stack([POSE_S * row, 21.0 + warm, load, order], axis=1)]
    )
    lines = [",".join(head), *(",".join(f"{value:.9g}" for value in line) for line in table)]
    return "\n".join(lines) + "\n"


def write(folder: Path, family: str, seed: int, poses: int = POSES) -> None:
    """Write one case and its truth."""
    rng = np.random.default_rng(seed)
    nominal, flaw = Nominal.drawn(rng), FAMILIES[family](rng)
    arm = Arm(nominal, flaw, rng)
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(nominal.urdf(rng))
    (folder / "campaign.csv").write_text(measured(arm, flaw, rng, poses, rng.uniform(-1, 1, (poses, 6))))
    (folder / "confirmation.csv").write_text(measured(arm, flaw, rng, SECOND, rng.uniform(-1, 1, (SECOND, 6))))
    (folder / "given.json").write_text(json.dumps(GIVEN))
    truth = {"format": 1, "salt": secrets.token_hex(16), "family": family, "hidden": flaw.truth}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))


def _tilted(rng: np.random.Generator, sigma: float) -> Floats:
    half = rng.normal(0.0, sigma / 2.0, 3)
    return np.array([1.0, *half])


def main() -> None:
    """Write cases of every family in turn, and the seals of their truths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n", type=int, default=2 * len(FAMILIES), help="number of cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--poses", type=int, default=POSES, help="poses of each campaign")
    parser.add_argument("--families", default=",".join(FAMILIES), help="which ones, in turn")
    asked = parser.parse_args()
    families, seals = asked.families.split(","), []
    for k in range(asked.n):
        name = f"case-{asked.seed}-{k:03d}"  # says nothing of what it hides
        write(asked.folder / name, families[k % len(families)], 100_000 * asked.seed + k, asked.poses)
        digest = hashlib.sha256((asked.folder / name / "truth.json").read_bytes()).hexdigest()
        seals.append(f"{digest}  {name}/truth.json\n")
    (asked.folder / "seals.txt").write_text("".join(seals))


if __name__ == "__main__":
    main()
