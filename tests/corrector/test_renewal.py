"""Sessions that are renewed while setpoints flow, and those that end: over zenoh, with the processes that run."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import pytest

from kilter_client.signing import Session, on_this_machine
from kilter_client.stream import CorrectedStream
from kilter_client.streaming import link
from kilter_service.stream.corrector.process import Corrector
from tests.corrector.live import ROBOT, Q, open_stream, until

PAUSE_S = 0.002
YEAR_S = 365 * 86_400.0


def session_of(stream: CorrectedStream) -> Session:
    assert stream._signer is not None
    return stream._signer.session


def flows(stream: CorrectedStream, condition: Callable[[], bool]) -> int:
    """Send setpoints until the condition holds, and fifty more; each must be corrected."""
    sent, left = 0, 50
    end = time.monotonic() + 20.0
    while left:
        assert stream.correct(Q).source == "corrected"
        assert time.monotonic() < end, "waited too long"
        sent, left = sent + 1, left - int(left < 50 or condition())
        time.sleep(PAUSE_S)
    return sent


def renew(stream: CorrectedStream) -> None:
    """Let the time for the next session come now."""
    stream._sessions.mark_expired()
    stream._ask_again.set()


@pytest.fixture
def rotate(kilterd: Callable[[list[str]], None], corrector: Corrector) -> Callable[[float], None]:
    """Rotate the keys, with so many hours in which the ones before are valid."""
    command = ["stream-keys", "--data", str(corrector.file.parent), "--rotate", "--overlap-h"]

    def rotated(overlap_h: float) -> None:
        kilterd([*command, str(overlap_h)])
        corrector.poll()

    return rotated


def test_a_renewal_and_a_rotation_cost_no_setpoint(corrector: Corrector, rotate: Callable[[float], None]) -> None:
    with open_stream(corrector, "renewed", signed=True) as stream:
        first = session_of(stream)
        renew(stream)
        sent = flows(stream, lambda: session_of(stream).id != first.id)
        second = session_of(stream)
        assert second.master == first.master
        rotate(1.0)
        sent += flows(stream, lambda: True)
        assert session_of(stream) == second  # it is valid until it ends or is renewed
        renew(stream)
        sent += flows(stream, lambda: session_of(stream).master != first.master)
        statistics = stream.statistics
        assert (statistics.sent, statistics.corrected) == (sent, sent)
        assert (statistics.missed, statistics.forged, dict(statistics.refused)) == (0, 0, {})


def test_a_session_that_ended_in_use_is_followed_by_another(corrector: Corrector) -> None:
    """As when the clock of the controller was set back, and the time for the next session never seemed to come."""
    given = on_this_machine(corrector.file.parent / "stream-keys.json", "test", ROBOT, "ended", lifetime_s=2.0)
    with open_stream(corrector, "ended", session=given, signed=True) as stream:
        until(lambda: stream.correct(Q).status == "SESSION_EXPIRED")
        until(lambda: stream.correct(Q).source == "corrected")
        assert session_of(stream) != given


def test_a_session_whose_secret_is_gone_is_followed_by_another(
    corrector: Corrector, rotate: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a rotation without overlap, or a clock that was set forward beyond it: nothing is answered any more."""
    monkeypatch.setattr(link, "UNANSWERED_S", 0.2)
    with open_stream(corrector, "orphaned", signed=True, deadline_s=0.05) as stream:
        first = session_of(stream)
        until(lambda: stream.correct(Q).source == "corrected")
        rotate(0.0)
        os.kill(corrector._children["stream"].pid or 0, signal.SIGKILL)
        until(lambda: not corrector._children["stream"].alive)
        corrector.poll()
        until(lambda: stream.correct(Q).source == "corrected", 30.0)
        assert session_of(stream).master != first.master


def test_of_a_session_that_is_revoked_no_frame_is_taken_any_more(
    corrector: Corrector, kilterd: Callable[[list[str]], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = corrector.file.parent / "stream-keys.json"
    given = on_this_machine(file, "test", ROBOT, "revoked")
    assert given is not None
    with (
        open_stream(corrector, "revoked", session=given, signed=True) as stream,
        open_stream(corrector, "kept", signed=True) as kept,
    ):
        # As a controller that was given its session by hand: it can ask for no other.
        monkeypatch.setattr(stream._sessions, "next_session", lambda: None)
        flows(stream, lambda: True)
        flows(kept, lambda: True)
        kilterd(["stream-keys", "--data", str(file.parent), "--revoke", given.id.hex()])
        corrector.poll()  # as every quarter of a second
        until(lambda: stream.correct(Q).source != "corrected", 1.0)
        assert "corrected" not in {stream.correct(Q).source for _ in range(20)}
        flows(kept, lambda: True)
        # Nor is one where the process of the stream starts anew and knows no session yet.
        os.kill(corrector._children["stream"].pid or 0, signal.SIGKILL)
        until(lambda: not corrector._children["stream"].alive)
        corrector.poll()
        until(lambda: kept.correct(Q).source == "corrected", 30.0)
        assert "corrected" not in {stream.correct(Q).source for _ in range(3)}  # each waits for an answer in vain


@pytest.mark.parametrize("jump_s", [YEAR_S, -YEAR_S, 3600.0, -3600.0])
def test_a_controller_whose_clock_jumps_goes_on(
    corrector: Corrector, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    real = time.time
    with open_stream(corrector, f"jump{jump_s:+.0f}".replace("+", "p").replace("-", "m"), signed=True) as stream:
        flows(stream, lambda: True)
        monkeypatch.setattr(time, "time", lambda: real() + jump_s)
        flows(stream, lambda: True)
        assert not stream._sessions.due()
        monkeypatch.setattr(time, "time", real)
        flows(stream, lambda: True)
        assert not stream._sessions.due()
        assert (stream.statistics.missed, dict(stream.statistics.refused)) == (0, {})
