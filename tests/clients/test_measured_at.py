"""When a campaign was measured, as people write it."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta

import pytest

from kilter_client.errors import UsageError
from kilter_client.verbs.inputs import parse_time


def test_a_time_is_sent_with_its_zone() -> None:
    assert parse_time("2026-11-02T14:30+02:00") == "2026-11-02T14:30:00+02:00"
    for given in ("2026-11-02", date(2026, 11, 2), "2026-11-02T12:00", datetime(2026, 11, 2, 12)):
        sent = datetime.fromisoformat(str(parse_time(given)))
        assert sent == datetime(2026, 11, 2, 12).astimezone()
        assert sent.tzinfo is not None
    assert parse_time(None) is None


def test_today_is_not_in_the_future() -> None:
    sent = datetime.fromisoformat(str(parse_time(datetime.now().astimezone().date())))
    assert sent <= datetime.now(UTC) + timedelta(seconds=1)


@pytest.mark.parametrize("given", ["yesterday", "02.11.2026", ""])
def test_what_is_no_time_is_refused(given: str) -> None:
    with pytest.raises(UsageError, match="2026-11-02"):
        parse_time(given)
