"""An upper arm that bends and twists: MuJoCo settles it in pieces, its elbow and its own mass beside the shaft."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.effects.test_link_torsion import Drawn
from tests.core.effects.test_link_torsion import robot as drawn_robot

Floats = NDArray[np.float64]

EI, GJ = 1.5e4, 1.0e4  # N m² of the upper arm
LENGTH, SEGMENTS = 0.6, 30
PIECE = LENGTH / SEGMENTS
LOADED = 15  # pieces of the upper arm below the place of its own mass
AXES = ("z", "y", "y", "x", "z")
ELBOW = np.array([0.0, -0.17, LENGTH])  # in the upper arm: the shaft is its z, the offset lies along the parallel axis
PLACES = (
    (0.0, 0.0, 0.3),
    (0.0, 0.22, 0.1),
    tuple(ELBOW),
    (0.0, 0.05, 0.3),
    (0.1, 0.0, 0.25),
)  # each in the link before
MASSES = (6.0, 14.0, 6.0, 3.0, 2.0)
BESIDE = np.array([0.05, 0.12, LOADED * PIECE])  # the mass of the upper arm, a motor beside it
CENTRES = ((0.03, 0.02, 0.1), tuple(BESIDE), *((0.03, 0.02, 0.1),) * 3)
TOOL = (0.12, 0.15, 0.1)
ELASTIC = tuple(f"{axis}{k}" for k in range(SEGMENTS) for axis in "xyz")
GIVES = np.tile([PIECE / EI, PIECE / EI, PIECE / GJ], SEGMENTS)


def at(place: Any) -> str:
    return " ".join(f"{v:.12g}" for v in place)


def ball(kg: float, place: Any) -> str:
    return f'<geom type="sphere" size="0.03" mass="{kg}" pos="{at(place)}"/>'


def upper_arm() -> tuple[str, Floats]:
    """Pieces that hinge in their middle about x, y and z, and where the last one's frame is from the joint."""
    out = ""
    for k in range(SEGMENTS):
        middle = (k + 0.5) * PIECE
        out += f'<body pos="0 0 {0.5 * PIECE if k == 0 else PIECE}">'
        for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True):
            out += f'<joint name="{axis}{k}" type="hinge" axis="{along}"/>'
        out += ball(1e-6, (0, 0, 0))
        if k == LOADED - 1:
            out += ball(MASSES[1], BESIDE - [0.0, 0.0, middle])
    return out, np.array([0.0, 0.0, LENGTH - 0.5 * PIECE])


def settled(q: Floats) -> Floats:
    """Tool points (N, 3) m of the arm at rest."""
    arm, beyond, pieces = "", np.zeros(3), 0
    for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True)):
        along = " ".join("1" if axis == one else "0" for one in "xyz")
        arm += f'<body pos="{at(np.array(place) - beyond)}"><joint name="q{k}" type="hinge" axis="{along}"/>'
        beyond = np.zeros(3)
        if k == 1:
            arm += ball(1e-6, (0, 0, 0))
            flexible, beyond = upper_arm()
            arm, pieces = arm + flexible, SEGMENTS
        else:
            arm += ball(MASSES[k], CENTRES[k])
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody>' + arm + f'<site name="tool" pos="{at(TOOL)}"/>'
        + "</body>" * (len(AXES) + pieces) + "</worldbody></mujoco>"
    )  # fmt: skip
    data, out = mujoco.MjData(model), np.empty((len(q), 3))
    driven = [model.joint(f"q{k}").id for k in range(len(AXES))]
    elastic = [model.joint(name).id for name in ELASTIC]
    for k, pose in enumerate(q):
        data.qpos[:] = 0.0
        data.qpos[driven] = pose
        for _ in range(12):
            mujoco.mj_forward(model, data)  # at rest the bias is what gravity needs to be held
            data.qpos[elastic] = -data.qfrc_bias[elastic] * GIVES
        mujoco.mj_forward(model, data)
        out[k] = data.site("tool").xpos
    return out


def robot(shift: float = 0.0) -> Robot:
    return drawn_robot(shift, Drawn(AXES, PLACES, MASSES, CENTRES, TOOL))


@pytest.fixture(scope="module")
def rows() -> Observations:
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.0, 2.0, (90, len(AXES)))
    return Observations(q, position=settled(q) + rng.normal(0.0, 1e-5, (90, 3)))


def fitted(arm: Robot, rows: Observations, **of_both: Any) -> tuple[dict[str, float], float]:
    """Values of a fit of bending and torsion to the first 60 rows, and what it leaves of the others, m."""
    effects = tuple({"id": name, "joints": [2], **of_both} for name in ("link_bending", "link_torsion"))
    options = IdentifyOptions(effects=effects, noise_mm=0.01, masses="as_stated")
    found = identify(arm, rows.select(slice(0, 60)), options=options).calibration
    rest = rows.select(slice(60, 90))
    left = np.asarray(found.predict(rest).position) - np.asarray(rest.position)
    return dict(zip(found.names, found.values, strict=True)), float(np.sqrt(np.mean(left**2)))


@pytest.mark.parametrize("shift", [0.0, 0.17, 0.5])
def test_a_shaft_bends_and_twists_as_its_pieces_do_wherever_the_elbow_is_drawn(
    rows: Observations, shift: float
) -> None:
    values, left = fitted(robot(shift), rows)
    assert values["bending_2"] == pytest.approx(1.0 / EI, rel=0.02)
    assert values["torsion_2"] == pytest.approx(LENGTH / GJ, rel=0.02)
    assert left < 1.5e-5


@pytest.mark.parametrize(
    "wrong", [{"directions": [[ELBOW[2], ELBOW[1], 0.0]]}, {"centres_m": [0.0]}], ids=["line", "own"]
)
def test_the_line_from_joint_to_joint_or_a_link_without_its_mass_leaves_more(rows: Observations, wrong: Any) -> None:
    """As both effects were before: a shaft 16 deg aside, and nothing of the motor beside it."""
    _, left = fitted(robot(), rows, **wrong)
    assert left > 2e-5


@pytest.mark.parametrize("name", ["link_bending", "link_torsion"])
def test_a_version_from_before_keeps_its_law(name: str) -> None:
    """Its document says nothing of directions, that of a torsion nothing of centres: lines from joint to joint, no own mass."""
    arm = robot()
    line = arm.chain.link_vectors[1]
    rows = Observations(np.random.default_rng(1).uniform(-2.0, 2.0, (9, len(AXES))))
    value = {"link_bending": "bending_2", "link_torsion": "torsion_2"}[name]

    def points(keep: tuple[str, ...], **stated: Any) -> Floats:
        made = RobotModel(arm, (make_effect(name, joints=(1,)),))
        document = Calibration(made, made.values0()).to_document()
        (effect,) = document["effects"]
        assert effect["directions"] == [pytest.approx([1.0, 0.0, 0.0])]  # z of the link is x of the joint frame
        assert effect["centres_m"] == [pytest.approx(BESIDE[2])]
        document["effects"] = [{k: effect[k] for k in ("id", "joints", *keep)} | stated]
        document["values"][value] = 1e-4
        return np.asarray(Calibration.from_document(arm, document).predict(rows).position)

    kept = ("centres_m",) if name == "link_bending" else ()
    own = {} if name == "link_bending" else {"centres_m": [0.0]}
    assert points(kept) == pytest.approx(points(kept, directions=[(2.0 * line).tolist()], **own), abs=1e-12)
    assert np.abs(points(kept) - points((), directions=[[1.0, 0.0, 0.0]], centres_m=[BESIDE[2]])).max() > 1e-5
    for wrong in ([[0.0, 0.0, 0.0]], [[1.0, 0.0]], [[1.0, 0.0, 0.0]] * 2):
        with pytest.raises(OptionError, match="one of directions"):
            points(kept, directions=wrong)
    with pytest.raises(OptionError, match=r"across the link after joint 2: give the one along"):
        points(kept, directions=[[0.0, 1.0, 0.0]])
