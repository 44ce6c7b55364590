"""What is shown of a stream, from messages made by hand: rates, conditions, restarts, and who is not believed."""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import Any

import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.fast_path import bin_edges_us
from kilter_service.stream.live import followers
from kilter_service.stream.live.heard import WHY, Heard, bypass
from kilter_service.stream.live.heard import _edges_us as edges_us
from kilter_service.stream.live.session import Place
from kilter_service.stream.signing.masters import load_masters
from kilter_service.stream.signing.sealed import opened_document

KEY = "kilter/@v1/local/arm/stream/main/live"


def message(k: int, received: int, good: int, instance: str = "a", **other: Any) -> dict[str, Any]:
    """A message, ``k`` tenths of a second after the corrector's start."""
    return {
        "instance": instance, "at_ns": 10**18 + k * 10**8, "moment_ns": k * 10**8, "received": received,
        "counters": {"OK": good, "STALE": received - good}, "last_status": "OK" if good == received else "STALE",
        "version_id": "ver_1", "seen_ns": k * 10**8, "signed": True, "joints": ["j1", "z"],
        "joint_kinds": ["revolute", "prismatic"], "by_time": [0, 0, good, received - good], "processing_us": {"max": 9.0},
        "last": {"arrival_ns": k * 10**8, "flags": 0, "wanted": [math.pi, 0.5], "correction": [math.pi / 1800, -2e-4],
                 "tool": [3e-4, 0.0, -4e-4]},
    } | other  # fmt: skip


def heard(*messages: dict[str, Any]) -> Heard:
    stream = Heard()
    for one in messages:
        assert stream.accept_message(one, one["moment_ns"] / 1e9)
    return stream


def test_numbers_are_in_the_units_of_people() -> None:
    shown = heard(*(message(k, 50 * k, 50 * k) for k in range(1, 12))).stream_view("main", 1.1)
    assert shown.rate_hz == pytest.approx(500)
    assert shown.tool_mm == pytest.approx(0.5)
    assert [(joint.unit, joint.wanted, joint.correction) for joint in shown.joints] == [
        ("deg", pytest.approx(180), pytest.approx(0.1)), ("mm", pytest.approx(500), pytest.approx(-0.2)),
    ]  # fmt: skip
    assert (shown.condition, shown.refusals) == ("corrected", {})


def test_what_held_corrections_back_is_said_with_what_is_left() -> None:
    def told(k: int, damped: int, saturated: int = 0, slowed: int = 0) -> dict[str, Any]:
        left = {"lately": 0.3127 if damped else 0.0, "max": 1.2}
        return message(k, 50 * k, 50 * k, damped=damped, saturated=saturated, slowed=slowed, left_mm=left)

    quiet = heard(*(told(k, 0) for k in range(1, 12))).stream_view("main", 1.1)
    assert (quiet.words, quiet.held_back, quiet.left_mm) == ("Every setpoint is corrected.", {}, 0.0)
    damped = heard(*(told(k, 3 * max(0, k - 4), 1 if k > 8 else 0) for k in range(1, 12))).stream_view("main", 1.1)
    assert damped.words == (
        "Every setpoint is corrected. Of the last 500 setpoints 21 were damped near a singularity and 1 was held at the "
        "limits of the version; at most 0.313 mm of the error at the tool was left."
    )
    assert (damped.held_back, damped.left_mm, damped.most_left_mm) == ({"damped": 21, "saturated": 1}, 0.3127, 1.2)
    slowed = heard(*(told(k, 0, 0, k) for k in range(1, 12))).stream_view("main", 1.1)
    assert "10 were held back by the bound on rate and acceleration; less than 0.001 mm" in slowed.words
    later = heard(*(told(k, 9) for k in range(1, 25))).stream_view("main", 2.4)
    assert later.words == "Every setpoint is corrected."  # that was more than a second ago
    assert later.held_back == {"damped": 9}
    assert heard(message(1, 50, 50)).stream_view("main", 0.1).left_mm is None  # an earlier corrector does not say


def test_conditions_follow_the_last_second() -> None:
    good = [message(k, 50 * k, 50 * k) for k in range(1, 12)]
    partly = heard(*good, message(12, 600, 590)).stream_view("main", 1.2)
    assert (partly.condition, partly.refusals) == ("partly", {"STALE": 10})
    refused = heard(*good, *(message(k, 50 * k, 550) for k in range(12, 24))).stream_view("main", 2.3)
    assert refused.condition == "bypass"
    assert WHY["STALE"] in refused.words
    assert "uncorrected" in bypass("connected", "ver_1", [refused])
    silent = heard(*good).stream_view("main", 10.0)
    assert (silent.condition, silent.rate_hz, silent.seen_s) == ("silent", 0.0, 9.0)
    assert bypass("connected", "ver_1", [silent, partly]) == ""
    assert "does not answer" in bypass("away", "ver_1", [])


def test_a_stream_that_stood_still_before_somebody_looked_is_silent() -> None:
    still = message(300, 500, 500, seen_ns=10**8)
    still["last"]["arrival_ns"] = 10**8
    assert heard(still).stream_view("main", 30.0).seen_s == 30


def test_while_the_correction_is_ramped_in_the_tool_is_not_known() -> None:
    ramped = message(1, 5, 5)
    ramped["last"]["flags"] = 0x0200
    assert heard(ramped).stream_view("main", 0.1).tool_mm is None


def test_a_clock_that_is_set_back_hides_nothing() -> None:
    stream = heard(message(1, 100, 100), message(2, 150, 150, at_ns=10**17))
    assert stream.stream_view("main", 0.2).received == 150
    report = message(0, 140, 140, at_ns=10**17 - 10**9)
    stream.take_report(report, 10**17, 1.0)  # older than what was told
    assert stream.stream_view("main", 1.0).received == 150
    stream.take_report(report | {"received": 160, "at_ns": 10**16}, 10**16, 9.0)
    assert stream.stream_view("main", 9.0).received == 160


def test_a_restart_begins_anew_and_old_messages_count_for_nothing() -> None:
    stream = heard(message(1, 1000, 1000), message(2, 1050, 1050))
    assert not stream.accept_message(message(1, 1000, 1000), 0.3)
    assert stream.accept_message(message(3, 10, 10, "b"), 0.3)
    assert stream.accept_message(message(8, 30, 30, "b"), 0.8)
    shown = stream.stream_view("main", 0.8)
    assert (shown.received, shown.rate_hz) == (30, pytest.approx(40))


def test_times_are_of_the_last_minute() -> None:
    stream = heard(*(message(10 * k, 100 * k, 100 * k, by_time=[0, 100 * k, 0, 0]) for k in range(1, 100)))
    times = stream.stream_view("main", 99.0).times
    assert times is not None
    assert times.counts == [0, 6000, 0, 0]
    assert times.p50_us == 2.0


def test_the_bins_are_those_of_the_corrector() -> None:
    assert [pytest.approx(edge, rel=0.06, abs=0.05) for edge in bin_edges_us()] == list(edges_us(len(bin_edges_us())))


@pytest.fixture
def announced(tmp_path: Path) -> tuple[Any, bytes]:
    masters = load_masters(tmp_path / "keys.json")
    return masters, masters.sign_announcement(KEY, "local", "arm", b'{"received": 1}')


def test_only_the_corrector_is_believed(announced: tuple[Any, bytes], tmp_path: Path) -> None:
    masters, data = announced
    assert masters.heard(KEY, "local", "arm", data) == b'{"received": 1}'
    assert masters.with_rotated_secret(60.0).heard(KEY, "local", "arm", data) == b'{"received": 1}'
    stranger = load_masters(tmp_path / "others.json")
    assert stranger.heard(KEY, "local", "arm", data) is None
    assert masters.heard(KEY.replace("main", "left"), "local", "arm", data) is None
    assert masters.heard(KEY, "local", "leg", data) is None
    assert masters.heard(KEY, "local", "arm", data.replace(b"1}", b"2}").replace(b": 1", b": 2")) is None


@pytest.mark.parametrize(
    "data", [b"", b"{}", b'{"a": 1, "signature": "x"}', b'{"a": 1, "signature": "zz:00"}', b"\xff"]
)
def test_what_is_not_signed_is_nothing(data: bytes) -> None:
    assert opened_document(data) is None


class SlowToClose:
    """A session whose end takes a while."""

    is_connected = True
    place = Place("a", "local", "", None, "", "")

    def messages(self) -> list[Any]:
        return []

    def close(self) -> None:
        time.sleep(0.5)


def test_who_comes_while_the_session_is_closed_is_told(
    database: Database, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_masters(settings.stream_keys_file)
    monkeypatch.setattr(followers, "open_or_reuse_session", lambda settings, known: known or SlowToClose())
    viewers = followers.Viewers(database, settings)

    async def look() -> str:
        events = viewers.events("arm")
        await anext(events)
        told = await anext(events)
        await events.aclose()  # type: ignore[attr-defined]
        return told

    async def both() -> None:
        assert "event: live" in await look()
        await asyncio.sleep(0.3)  # the first has left, and its session is being closed
        assert "event: live" in await asyncio.wait_for(look(), 5.0)
        await viewers.close()

    asyncio.run(both())
