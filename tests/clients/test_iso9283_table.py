"""The table of ISO 9283 that ``kilter version evaluate`` prints."""

from __future__ import annotations

import pytest

from kilter_client.cli.reports.results import show_result


def test_criteria_and_refusals_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    report = {
        "metrics": {"AP": {"mm": 0.21, "demands": 30, "poses": [{"pose": 1, "n": 31}]},
                    "AD": {"mm": 0.05, "demands": 30, "n": 30}},
        "refused": [{"symbol": "AT", "message": "AT of ISO 9283 cannot be given: no session."}],
    }  # fmt: skip
    show_result({"iso9283": {"cmp_1": report}})
    out = capsys.readouterr().out
    assert "cmp_1" in out
    assert [line.split() for line in out.splitlines() if line.strip().startswith(("AP", "AD"))] == [
        ["AP", "0.21", "31", "30"], ["AD", "0.05", "30", "30"],
    ]  # fmt: skip
    assert "AT of ISO 9283 cannot be given" in out
