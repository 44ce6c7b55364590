"""The sentence of a check says which lengths it tells: those at the tool, or those by views."""

from __future__ import annotations

import pytest

from kilter_core.watch.arm_check import Check
from kilter_service.versions.drift.wire import sentence


@pytest.mark.parametrize(("by_views", "said"), [(False, "0.12 mm apart (rms)"), (True, "0.12 mm by views apart (rms)")])
def test_a_check_says_which_lengths_it_tells(by_views: bool, said: str) -> None:
    found = Check("ok", (), (), 0.4, 20.0, 18, 6, 1.2e-4, 5e-5, {}, (), (), by_views=by_views)
    told = sentence(found)
    assert told.startswith("ok: 6 poses agree with the version; measured and predicted are ")
    assert said in told
