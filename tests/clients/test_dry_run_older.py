"""`kilter upload --dry-run` beside a server that checks rows alone: what it leaves to the upload is said, not refused."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_client import Kilter, PayloadError
from kilter_client.verbs import campaigns
from kilter_client.verbs.inputs import prepare_rows

JOINTS = [{"name": f"q{k}", "limits_deg": [-180.0, 180.0]} for k in range(1, 7)]
FORM = "Content-Type multipart/form-data is not read: send text/csv, application/vnd.apache.parquet, application/json."
TAKES_NONE = "is not a parameter of this address; it takes none"
ROWS: dict[str, Any] = {f"q{k}_deg": [0.0, 10.0] for k in range(1, 7)}
POINTS = ROWS | {f"{axis}_mm": [100.0, 200.0] for axis in "xyz"}
VIEWS = ROWS | {"u1_px": [5.0, 6.0], "v1_px": [7.0, 8.0]}


def refusal(status: int, code: str, detail: str, context: dict[str, Any]) -> httpx.Response:
    return httpx.Response(status, json={"code": code, "detail": detail, "context": context, "status": status})


def older(request: httpx.Request) -> httpx.Response:
    """Answers of a server of 27 November 2026, as they came."""
    path = request.url.path
    if path.endswith("/observations/check"):
        if request.headers["content-type"].startswith("multipart/form-data"):
            return refusal(415, "media_type_unsupported", FORM, {})
        if "campaign" in request.url.params:
            error = {"place": "query.campaign", "message": TAKES_NONE, "type": "value_error"}
            return refusal(422, "payload_invalid", f"query.campaign {TAKES_NONE}.", {"errors": [error]})
        if b"200.5" in request.content:
            return refusal(422, "observations_invalid", "Row 2, column 'x_mm' cannot be.", {})
        return httpx.Response(200, json={"rows": 2, "columns": [], "warnings": [{"code": "odd", "message": "Odd."}]})
    if path.endswith("/campaigns"):
        return httpx.Response(200, json={"campaigns": [], "next": None})
    return httpx.Response(200, json={"name": "arm", "joints": JOINTS})


def told(rows: dict[str, Any], into: str | None = None) -> dict[str, Any]:
    with Kilter("http://kilter.test", "secret", httpx.MockTransport(older)) as k:
        return dict(k.run(campaigns.checked_rows("arm", prepare_rows(rows), {"name": "rows", "conditions": {}}, into)))


@pytest.mark.parametrize(
    ("rows", "into", "left"),
    [
        (POINTS, None, "name, conditions and instrument, which"),
        (VIEWS, None, "name, conditions, instrument and what its cameras and boards can show, which"),
        (POINTS, "cmp_1", "columns of the campaign, which"),
        (VIEWS, "cmp_1", "columns of the campaign and what its cameras and boards can show, which"),
    ],
)
def test_what_an_older_server_does_not_look_at_is_said(rows: dict[str, Any], into: str | None, left: str) -> None:
    found = told(rows, into)
    assert found["refused"] == []
    assert found["odd"] == ["Odd."]
    assert found["not_checked"].startswith(left)


@pytest.mark.parametrize("into", [None, "cmp_1"])
def test_rows_that_it_refuses_are_refused(into: str | None) -> None:
    found = told(POINTS | {"x_mm": [100.0, 200.5]}, into)
    assert found["refused"] == ["Row 2, column 'x_mm' cannot be."]


def test_a_campaign_that_is_described_wrongly_is_no_older_server(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = PayloadError("conditions.cameras.0.fx_px is missing.", code="payload_invalid")
    wrong.context = {"errors": [{"place": "body.conditions.cameras.0.fx_px"}]}

    def refused(*_: object) -> Any:
        raise wrong
        yield

    monkeypatch.setattr(campaigns.campaign_calls, "check", refused)
    assert told(VIEWS)["refused"] == [wrong.detail]
