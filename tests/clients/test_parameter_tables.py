"""Parameter tables: nominal, change and interval with the digits that the uncertainty allows; comparison with nominal."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.reports.results import show_result
from kilter_client.errors import ApiError
from kilter_client.results.record import decimals, ends, estimate

Capture = pytest.CaptureFixture[str]


def printed(capsys: Capture, *arguments: object, code: int = 0) -> str:
    capsys.readouterr()
    found = run([str(argument) for argument in arguments])
    out = capsys.readouterr()
    assert found == code, out.out + out.err
    return out.out + (out.err if code else "")


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (12.3456789, 0.01234, "12.346"),
        (-612.0004321, 0.25, "-612.00"),
        (1234.5, 130.0, "1230"),
        (0.00019, 0.0996, "0.00"),
        (0.0023456, 0.00000023, "2.34560e-03"),
        (90.0000049, 0.0000091, "90.0000049"),  # a power of ten serves numbers that begin with zeros
        (-0.001, 0.5, "0.00"),
        (3.14159, None, "3.142"),
        (3.14159, 0.0, "3.142"),
    ],
)
def test_two_significant_digits_of_sigma(value: float, sigma: float | None, text: str) -> None:
    assert estimate(value, decimals(sigma)) == text


@given(st.floats(-1e4, 1e4), st.floats(1e-9, 1e3))
def test_no_digit_is_finer_than_sigma_and_rounding_costs_a_twentieth_of_it_at_most(value: float, sigma: float) -> None:
    text = estimate(value, decimals(sigma))
    assert abs(float(text) - value) <= 0.051 * sigma + 1e-12 * abs(value)
    mantissa, _, power = text.partition("e")
    last = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    assert float(text) == 0.0 or last > sigma / 101 or last >= 1.0


def test_intervals_as_computed_else_by_sigma() -> None:
    assert ends(1.0, 0.1, None, None) == "0.80 to 1.20"
    assert ends(1.0, 0.1, 0.7, 1.1) == "0.70 to 1.10"
    assert ends(None, 0.1, None, None) == ends(1.0, None, None, None) == ""


def test_the_table_says_nominal_change_interval_unit_and_what_is_not_identifiable(capsys: Capture) -> None:
    row = {"name": "a_2", "value": 190.0123, "nominal": 190.0, "change": 0.0123, "sigma": 0.0012, "unit": "mm"}
    show_result({"parameters": [{**row, "identifiable": True}, {**row, "name": "d_5", "identifiable": False}]})
    text = capsys.readouterr().out
    assert text.splitlines()[1].split() == ["parameter", "nominal", "value", "change", "95", "%", "unit"]
    assert re.search(r"a_2 +190 +190\.0123 +0\.0123 +190\.0099 to 190\.0147 +mm", text)
    assert re.search(r"d_5 .*not identifiable", text)


@pytest.fixture
def version(kilter: Kilter, robot: str, write_campaign: Callable[..., Path]) -> dict[str, Any]:
    campaign = kilter.campaigns.add(robot, "c")["id"]
    kilter.campaigns.upload(campaign, write_campaign())
    options = {"effects": ["axial_compliance"]}
    job = kilter.jobs.run("identify", robot, [campaign], options=options, name="first")
    assert job["state"] == "succeeded", job["error"]
    return kilter.versions.get(job["result"]["version_id"])


def test_a_version_compares_with_nominal(kilter: Kilter, robot: str, version: dict[str, Any], capsys: Capture) -> None:
    found = json.loads(printed(capsys, "diff", "nominal", "first", "--robot", robot, "--json"))
    assert (found["a"], found["b"]) == ("nominal", version["id"])
    assert found["effects_added"] == ["axial_compliance", "load_error"]  # masses count as uncertain beside it
    changes = {p["name"]: p for p in found["parameters"]}
    for row in version["parameters"]:
        if not re.fullmatch(r"(base|tool)_r[xyz]", row["name"]):
            assert changes[row["name"]]["a"] == pytest.approx(row["nominal"], abs=1e-9)
            assert changes[row["name"]]["change"] == pytest.approx(row["change"], abs=1e-6)
            assert changes[row["name"]]["sigma_b"] == pytest.approx(row["sigma"])
        assert row["change"] == pytest.approx(math.remainder(row["value"] - row["nominal"], 360.0), abs=1e-9)
    listed = printed(capsys, "versions", robot)
    assert "axial_compliance; masses uncertain" in listed
    assert " load_error" not in listed + printed(capsys, "effects")
    back = kilter.versions.diff(version["id"], "nominal")
    assert back["effects_removed"] == ["axial_compliance", "load_error"]
    name = "compliance_2"
    assert [p["b"] for p in back["parameters"] if p["name"] == name] == [0.0]
    table = printed(capsys, "diff", version["id"], "nominal")
    assert re.search(r"^ *parameter +first +nominal +change +unit", table, re.MULTILINE)
    with pytest.raises(ApiError, match="name a version to compare"):
        kilter.versions.diff("nominal", "nominal")


def test_nominal_is_no_name_of_a_version_nor_of_the_job_that_makes_one(
    robot: str, version: dict[str, Any], capsys: Capture
) -> None:
    assert "'latest' or 'nominal'" in printed(capsys, "versions", "name", version["id"], "nominal", code=1)
    campaign = version["campaigns"][0]["id"]
    assert "'latest' or 'nominal'" in printed(capsys, "identify", robot, "-c", campaign, "--name", "nominal", code=1)
