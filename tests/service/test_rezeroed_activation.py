"""A re-zeroed version is judged by rows of the arm as it is: those of the arm as it was speak neither for it nor against it."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from tests.core.watch.drifting import DriftingArm, some_arm
from tests.service.watched_robot import DAY, Watched

STEP = 4e-3


@pytest.fixture
def arm() -> DriftingArm:
    return some_arm(np.random.default_rng(3))


def by_code(found: dict[str, Any]) -> dict[str, str]:
    return {one["code"]: one["message"] for one in found["warnings"]}


def test_rows_of_the_arm_as_it_was_speak_neither_for_nor_against(
    client: httpx.Client, arm: DriftingArm, database: Database
) -> None:
    watched, moved = Watched(client, None, arm, "rezeroed"), arm.after("zero_3", STEP)
    first = watched.calibrated(database, validation=0.25)  # so that the fit has an error of held-out rows
    for number in range(3):
        watched.sent(arm, 10, 50 + number, DAY + timedelta(days=number))
    crashed = watched.sent(moved, 6, 60, DAY + timedelta(days=5))
    made = watched.done_here(database, "rezero", [crashed])["version_id"]
    done = client.post(f"/v1/versions/{made}/activate").raise_for_status().json()
    said = by_code(done)
    assert done["compared"] is None
    assert not {"own_errors_compared", "larger_own_error"} & set(said)
    assert said["campaign_not_compared"].startswith(
        "Not compared, for they show the arm as it was: 4 campaigns from before "
    )
    assert "none from after 2026-09-06, whose rows re-zeroed a version" in said["nothing_to_compare"]

    # What is measured since counts, and alone; also against the version that was before.
    since = watched.sent(moved, 8, 61, DAY + timedelta(days=6))
    refused = client.post(f"/v1/versions/{first}/activate")
    assert (refused.status_code, refused.json()["code"]) == (409, "activation_refused")
    found = refused.json()["context"]
    assert found["compared"]["campaigns"] == [since]
    assert "worse_than_active" in {one["code"] for one in found["objections"]}
