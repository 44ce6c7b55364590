"""A bridge on the page, in `kilter server status` and in the library: what it does, since when, and that it is gone."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import KilterError
from tests.clients.bridges.rsi_peer import RsiPeer
from tests.clients.bridges.running_bridge import add_arm, bridging
from tests.clients.bridges.udp_peer import Floats

PACE = ["--cycle-ms", "12", "--rate-deg-s", "2", "--ramp-s", "0.5", "--gone-after-s", "2", "--port", "0"]
NEWS = {
    "kind": "egm", "state": "correcting", "version_id": "ver_x", "cycle_ms": 4.0, "cycles": 7, "late": 0, "lost": 1,
    "refused": 0, "offset_deg": 0.1, "largest_offset_deg": 0.2,
}  # fmt: skip


def path(t_s: float) -> Floats:
    return np.array([20 * np.sin(0.4 * t_s), 30.0, 20.0, 0.0, 0.0, 0.0])


def newest(kilter: Kilter, robot: str) -> dict[str, Any]:
    """The bridge of the robot that was heard last."""
    found: list[dict[str, Any]] = kilter.robots.bridges(robot)["bridges"]
    return max(found, key=lambda one: one["heard_at"]) if found else {}


def until(condition: Callable[[], bool], seconds: float) -> None:
    """Wait for something."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < seconds, "it did not come"
        time.sleep(0.05)


def companion_of(pid: int) -> int:
    """The process that a bridge has beside it."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def test_a_bridge_is_shown_with_what_it_does_and_that_it_was_killed(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    version = add_arm(kilter, "shown", tmp_path)
    assert kilter.robots.bridges("shown") == {"bridges": []}
    with bridging("rsi", "shown", *PACE) as bridge:
        bridge.heard("waiting")
        until(lambda: newest(kilter, "shown").get("state") == "waiting", 20)
        peer = RsiPeer(bridge.port, path).start()
        try:
            bridge.heard("correcting")
            until(lambda: newest(kilter, "shown")["state"] == "correcting", 20)
            until(lambda: newest(kilter, "shown")["cycles"] > 50, 20)
            seen = newest(kilter, "shown")
            assert (seen["kind"], seen["version_id"], seen["gone"], seen["other_version"]) == (
                "rsi", version, False, False,
            )  # fmt: skip
            assert seen["largest_offset_deg"] == pytest.approx(np.abs(peer.offsets()).max(), abs=0.02)
            assert seen["sentence"] == f"The rsi bridge (KUKA) corrects the arm with version {version}."
            capsys.readouterr()
            assert run(["status", "shown"]) == 0
            assert seen["sentence"].replace(version, "shown v1") in capsys.readouterr().out
            overview = httpx.get(f"{kilter.url}/robots/shown").text
            assert "by a bridge" in overview
            stream = httpx.get(f"{kilter.url}/robots/shown/stream").text
            assert "The rsi bridge (KUKA) corrects the arm with version" in stream
            assert f'data-bridge="{seen["id"]}"' in stream
            bridge.process.send_signal(signal.SIGKILL)
            until(lambda: newest(kilter, "shown")["gone"], 10)
        finally:
            peer.stop()
    lost = newest(kilter, "shown")
    assert (lost["id"], lost["state"], lost["since"]) == (seen["id"], "killed", seen["since"])
    assert "was killed" in lost["sentence"]
    part = httpx.get(f"{kilter.url}/robots/shown/bridges", headers={"HX-Request": "true"}).text
    assert "was killed" in part
    assert "rsi: killed" in part
    assert "bridge gone" in httpx.get(f"{kilter.url}/robots/shown").text


def test_a_bridge_whose_machine_dies_is_gone_after_its_silence_and_one_that_ends_says_so(
    kilter: Kilter, tmp_path: Path
) -> None:
    add_arm(kilter, "silent", tmp_path)
    with bridging("rsi", "silent", *PACE) as bridge:
        until(lambda: bool(newest(kilter, "silent")), 20)
        os.kill(companion_of(bridge.process.pid), signal.SIGKILL)
        bridge.process.send_signal(signal.SIGKILL)
        until(lambda: newest(kilter, "silent")["gone"], 20)
    dead = newest(kilter, "silent")
    assert dead["silent_s"] >= 6.0
    assert "was last heard" in dead["sentence"]
    with bridging("rsi", "silent", *PACE) as bridge:
        bridge.heard("waiting")
        until(lambda: len(kilter.robots.bridges("silent")["bridges"]) == 2, 20)
        assert [one["gone"] for one in kilter.robots.bridges("silent")["bridges"]] == [False, True]
        bridge.ended()
    until(lambda: newest(kilter, "silent")["state"] == "ended", 10)
    assert newest(kilter, "silent")["gone"]


def test_what_cannot_be_news_of_a_bridge_is_refused_and_an_old_version_is_named(kilter: Kilter, tmp_path: Path) -> None:
    version = add_arm(kilter, "told", tmp_path)
    one = "0123456789abcdef"
    found = kilter.robots.announce_bridge("told", one, NEWS)
    assert found["other_version"]
    assert found["sentence"].endswith("with version ver_x; that is not the active version.")
    kilter.robots.announce_bridge("told", one, NEWS | {"version_id": version, "state": "off", "why": "retired"})
    said = f"The egm bridge (ABB) does not correct with version {version}: retired."
    assert newest(kilter, "told")["sentence"] == said
    for wrong in ({"state": "dancing"}, {"cycles": -1}, {"offset_deg": 1e9}, {"kind": "usb"}, {"more": 1}):
        with pytest.raises(KilterError):
            kilter.robots.announce_bridge("told", one, NEWS | wrong)
    with pytest.raises(KilterError):
        kilter.robots.announce_bridge("told", "short", NEWS)
    assert httpx.put(f"{kilter.url}/v1/robots/told/bridges/{one}", json=NEWS).status_code == 401
    for k in range(25):
        kilter.robots.announce_bridge("told", f"{k:016x}", NEWS | {"state": "ended"})
    assert len(kilter.robots.bridges("told")["bridges"]) == 20
