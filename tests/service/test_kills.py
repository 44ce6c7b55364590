"""A short campaign of kills; ``python -m tools.lab kills`` runs a long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.kill_campaign import campaign

KILLS, SEED = 4, 20261122  # python -m tools.lab kills has hundreds


@pytest.mark.timeout(900)  # a machine with other work restarts processes slowly
def test_kills_lose_and_double_nothing(tmp_path: Path) -> None:
    done = campaign(tmp_path, KILLS, SEED, print)
    assert done["kills"] == KILLS
    assert done["campaigns"] > 0
    assert done["requests"] > KILLS
