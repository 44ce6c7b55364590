"""Lists of the page: the lengths of a column have one unit, that of the largest, in front of whoever compares rows."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from types import SimpleNamespace as Fields
from typing import Any

import pytest

from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.page.answers import environment
from kilter_service.page.figures.plot import lengths
from kilter_service.page.report.sheet import before_and_after
from kilter_service.page.shared import errors_drawn as stages
from kilter_service.page.words import in_columns, in_one_unit

SIZES = (0.31, 0.0871, 0.0021)
HEAD = re.compile(r'<th scope="col" class="number">[^<]*, (mm|µm)</th>')
DAY = datetime(2026, 11, 2, tzinfo=UTC)
CAMPAIGN = Fields(id="cmp_1", robot="arm", name="grid", uploads=["one"], rows=3, measured_at=None, created_at=DAY)


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
                campaign=CAMPAIGN, ranges="1-3", version="ver_1", version_name="first", count=3, rows=rows, joints=["A1"],
                units=["deg"],
            ),
        },
        "jobs/evaluate.html": {
            "campaigns": [], "names": {},
            "result": Fields(
                iso9283={"cmp_1": Fields(
                    metrics={f"AP{k}": Fields(mm=size, n=30, demands=30) for k, size in enumerate(sizes)}, refused=[]
                )},
                warnings=[],
            ),
        },
    }  # fmt: skip
    return environment().get_template(template).render(root="", may=lambda _: True, **shown[template])


def column(text: str) -> tuple[str, list[float]]:
    """The unit in the one head that has one, and the numbers of its column: no cell says a unit."""
    table = text[text.index("<thead") : text.index("</table>")]
    heads = re.findall(r"<th scope=\"col\"[^>]*>[^<]*</th>", table.partition("</thead>")[0])
    (unit,) = HEAD.findall(table)
    place = next(k for k, head in enumerate(heads) if f", {unit}<" in head)
    body = table.partition("</thead>")[2]
    assert not re.search(r"<td[^>]*>-?[0-9.]+ (mm|µm)<", body)
    cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", line) for line in re.findall(r"<tr.*?</tr>", body)]
    return unit, [float(line[place]) for line in cells]


@pytest.mark.parametrize("template", ["robot/worst.html", "campaign/chosen_part.html", "jobs/evaluate.html"])
def test_the_rows_of_a_list_have_the_unit_of_the_largest(template: str) -> None:
    assert column(filled(template, SIZES)) == ("mm", list(SIZES))
    assert column(filled(template, SIZES[1:])) == ("µm", [87.1, 2.1])


def test_rows_that_look_wrong_have_one_unit_over_all_campaigns() -> None:
    found = [
        Fields(campaign=f"cmp_{k}", name=f"grid {k}", sentence="One row.", count=1, found=[row(1, size)])
        for k, size in enumerate(SIZES)
    ]
    text = (
        environment().from_string('{% import "suspicious.html" as odd %}{{ odd.table("", found) }}').render(found=found)
    )
    assert column(text) == ("mm", list(SIZES))


def test_tables_of_errors_have_one_unit() -> None:
    errors = StageErrors(
        n=40, nominal=Errors(mean_mm=1.2, rms_mm=1.3, p95_mm=2.0, max_mm=2.4),
        identified=Errors(mean_mm=0.02, rms_mm=0.022, p95_mm=0.05, max_mm=0.12),
    )  # fmt: skip
    drawn = before_and_after(errors, "Errors")
    assert drawn is not None
    head, rows = stages.table(errors)
    assert head[1:] == ["Mean, mm", "Rms, mm", "95 % are below, mm", "Largest, mm"]
    assert rows[1][1:] == ["0.0200", "0.0220", "0.0500", "0.120"]
    assert list(drawn.table[0][1:]) == ["mean, mm", "rms, mm", "95 %, mm", "largest, mm"]
    assert drawn.table[1][1][1:] == rows[1][1:]  # of the report


def test_an_axis_has_the_unit_of_the_table_below_it() -> None:
    fine, coarse = lengths("error", [0.012, 0.05], zero=True), lengths("error", [0.012, 0.31], zero=True)
    assert (fine.label, coarse.label) == ("error, µm", "error, mm")
    assert [text for _, text in fine.ticks()] == ["0", "10", "20", "30", "40", "50"]
    assert [fine.share(place) for place, _ in fine.ticks()][1] == pytest.approx(0.01 / 0.0525)
    assert [text for _, text in coarse.ticks()][1:3] == ["0.1", "0.2"]
    decades = lengths("error", [0.004, 0.05], log=True)
    assert (decades.label, decades.ticks()) == ("error, µm", [(pytest.approx(0.001), "1"), (0.01, "10"), (0.1, "100")])


def test_a_table_of_lengths_has_one_unit() -> None:
    assert in_one_unit([[0.05, 0.31], [None, 0.0021]]) == [["0.0500 mm", "0.310 mm"], ["–", "0.00210 mm"]]
    assert in_one_unit([[0.05, 0.0021], [float("nan"), -0.09]]) == [["50.0 µm", "2.10 µm"], ["–", "-90.0 µm"]]
    assert in_one_unit([[None]]) == [["–"]]
    assert in_columns([[0.05, 0.0021], [None, -0.09]]) == ("µm", [["50.0", "2.10"], ["–", "-90.0"]])
    assert in_columns([[None]]) == ("mm", [["–"]])
