"""A document in another convention: the same arm over HTTP, and refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.arm.presets import preset_document
from kilter_service.robots.documents import convert as converted
from kilter_service.robots.documents import core_document
from kilter_service.robots.wire import DOCUMENT
from tests.core.arm.test_documents import poses
from tests.core.truth import some_arm, ur10, with_bodies


def convert(client: httpx.Client, document: dict[str, Any], to: str) -> dict[str, Any]:
    answer = client.post(f"/v1/robots/convert?to={to}", json=document)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.mark.parametrize("to", ["chain", "dh", "mdh", "s_model", "poe", "cpc", "mcpc", "urdf"])
def test_the_published_ur10_in_every_convention(shared_client: httpx.Client, to: str) -> None:
    found = convert(shared_client, preset_document("ur10"), to)
    assert found["convention"] == to
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    position, rotation = poses(core_document(found).document, q)
    np.testing.assert_allclose(position, ur10().poses(q)[0], atol=1e-12, rtol=0)
    np.testing.assert_allclose(rotation, ur10().poses(q)[1], atol=1e-12, rtol=0)
    # What comes out goes in again.
    assert shared_client.post("/v1/robots/check", json=found).status_code == 200


@pytest.mark.parametrize("seed", range(4))
def test_the_urdf_of_an_arm_that_slides_and_follows_is_read_by_pinocchio(
    shared_client: httpx.Client, seed: int
) -> None:
    arm = some_arm(np.random.default_rng(seed), 4, prismatic=True, coupled=True)
    found = convert(shared_client, {**arm.document(), "links": None}, "urdf")
    model = pinocchio.buildModelFromXML(found["urdf"], True)
    assert model.nq == 4
    data, flange = model.createData(), model.getFrameId(found["tip_link"])
    for q in np.random.default_rng(seed).uniform(-2, 2, (5, 4)):
        order = np.array(
            [
                q[int(model.names[k + 1][1:]) - 1]
                for k in range(model.njoints - 1)
                if "follower" not in model.names[k + 1]
            ]
        )
        pinocchio.framesForwardKinematics(model, data, order)
        pose = arm.base * data.oMf[flange] * arm.tool
        np.testing.assert_allclose(pose.translation, arm.poses(q[None])[0][0], atol=1e-12, rtol=0)
    back = convert(shared_client, found, "poe")
    q = np.random.default_rng(seed).uniform(-2, 2, (5, 4))
    np.testing.assert_allclose(poses(back, q)[0], arm.poses(q)[0], atol=1e-12, rtol=0)


def test_what_cannot_be_said_is_refused(shared_client: httpx.Client) -> None:
    coupled = some_arm(np.random.default_rng(0), 3, coupled=True).document()
    answer = shared_client.post("/v1/robots/convert?to=dh", json={**coupled, "links": None})
    assert answer.status_code == 400
    assert answer.json()["code"] == "robot_invalid"
    assert "one axis per joint" in answer.json()["detail"]
    assert shared_client.post("/v1/robots/convert?to=euler", json=coupled).status_code == 422


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 7), slides=st.booleans())
def test_to_urdf_and_back_keeps_any_arm(seed: int, n: int, slides: bool) -> None:
    rng = np.random.default_rng(seed)
    arm = with_bodies(some_arm(rng, n, prismatic=slides), rng)
    urdf = converted(DOCUMENT.validate_python(arm.document()), "urdf")
    for to in ("poe", "mcpc", "chain"):
        back = converted(DOCUMENT.validate_python(urdf), to)
        q = rng.uniform(-2.0, 2.0, (4, n))
        position, rotation = poses(back, q)
        np.testing.assert_allclose(position, arm.poses(q)[0], atol=1e-12, rtol=0)
        np.testing.assert_allclose(rotation, arm.poses(q)[1], atol=1e-12, rtol=0)
        robot = robot_from_document(back)
        found = axial_loads(robot, joint_loads(robot, q))
        root = replace(arm, base=pinocchio.SE3.Identity())
        np.testing.assert_allclose(found, [-root.reactions(row)[0] for row in q], atol=1e-9, rtol=0)
