"""Lists of the page: the lengths of a column have one unit, that of the largest, in front of whoever compares rows."""

from __future__ import annotations

import re
from types import SimpleNamespace as Fields
from typing import Any

import pytest

from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.page.jobs import stages
from kilter_service.page.report.figures import before_and_after
from kilter_service.page.shell import environment
from kilter_service.page.words import in_one_unit

SIZES = (0.31, 0.0871, 0.0021)
LENGTH = re.compile(r">(?:<strong>)?(-?[0-9.]+) (mm|µm)<")
CAMPAIGN = Fields(id="cmp_1", name="grid", uploads=["one"], rows=3)


def row(number: int, size: float) -> Fields:
    return Fields(
        row=number, file_row=number, file=1, error=size, error_mm=size, mm=size, sigma=1.0, q=["0"], at=[0.0] * 3, joints=["0"],
        said_by="rows", why="it is far off", weight=None,
    )  # fmt: skip


def filled(template: str, sizes: tuple[float, ...]) -> str:
    rows = [row(number, size) for number, size in enumerate(sizes, 1)]
    shown: dict[str, dict[str, Any]] = {
        "robot/worst.html": {
            "found": Fields(rows=rows, joints=["A1"], held_out=True),
            "version": "ver_1", "campaign": "cmp_1",
        },
        "campaign/chosen_part.html": {
            "chosen": Fields(
                campaign=CAMPAIGN, ranges="1-3", version="ver_1", version_name="first", count=3, rows=rows, joints=["A1"]
            ),
        },
        "jobs/evaluate.html": {
            "campaigns": [],
            "result": Fields(
                iso9283={"cmp_1": Fields(
                    metrics={f"AP{k}": Fields(mm=size, n=30, demands=30) for k, size in enumerate(sizes)}, refused=[]
                )},
                warnings=[],
            ),
        },
    }  # fmt: skip
    return environment().get_template(template).render(root="", may=lambda _: True, **shown[template])


@pytest.mark.parametrize("template", ["robot/worst.html", "campaign/chosen_part.html", "jobs/evaluate.html"])
def test_the_rows_of_a_list_have_the_unit_of_the_largest(template: str) -> None:
    told = LENGTH.findall(filled(template, SIZES))
    assert [float(value) for value, _ in told][-3:] == list(SIZES)
    assert {unit for _, unit in told} == {"mm"}
    small = LENGTH.findall(filled(template, SIZES[1:]))
    assert [float(value) for value, _ in small][-2:] == [87.1, 2.1]
    assert {unit for _, unit in small} == {"µm"}


def test_rows_that_look_wrong_have_one_unit_over_all_campaigns() -> None:
    found = [
        Fields(campaign=f"cmp_{k}", name=f"grid {k}", sentence="One row.", count=1, found=[row(1, size)])
        for k, size in enumerate(SIZES)
    ]
    text = (
        environment().from_string('{% import "suspicious.html" as odd %}{{ odd.table("", found) }}').render(found=found)
    )
    assert LENGTH.findall(text) == [("0.310", "mm"), ("0.0871", "mm"), ("0.00210", "mm")]


def test_tables_of_errors_have_one_unit() -> None:
    errors = StageErrors(
        n=40, nominal=Errors(mean_mm=1.2, rms_mm=1.3, p95_mm=2.0, max_mm=2.4),
        identified=Errors(mean_mm=0.02, rms_mm=0.022, p95_mm=0.05, max_mm=0.12),
    )  # fmt: skip
    drawn = before_and_after(errors, "Errors")
    assert drawn is not None
    for _, rows in (stages.table(errors), drawn.table):
        assert [cell.partition(" ")[2] for one in rows for cell in one[1:]] == ["mm"] * 8
        assert rows[1][1:] == ["0.0200 mm", "0.0220 mm", "0.0500 mm", "0.120 mm"]


def test_a_table_of_lengths_has_one_unit() -> None:
    assert in_one_unit([[0.05, 0.31], [None, 0.0021]]) == [["0.0500 mm", "0.310 mm"], ["–", "0.00210 mm"]]
    assert in_one_unit([[0.05, 0.0021], [float("nan"), -0.09]]) == [["50.0 µm", "2.10 µm"], ["–", "-90.0 µm"]]
    assert in_one_unit([[None]]) == [["–"]]
