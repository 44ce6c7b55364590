"""The page on latency says what its samples say."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import latency_page


def test_the_page_has_the_figures_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("explanation", "images"):
        (tmp_path / folder).mkdir()
    page = tmp_path / "explanation" / "corrected-stream.md"
    page.write_text(f"before\n{latency_page.BEGIN}old figures\n{latency_page.END}after\n")
    trips = np.random.default_rng(0).permutation(np.linspace(100.0, 300.0, 2001))
    np.savez(
        tmp_path / "samples.npz", echo_us=trips, corrected_us=1.05 * trips, inside_us=np.linspace(5.0, 15.0, 2003),
        medians_us=[[200.0, 210.0], [220.0, 231.0]],
        lost=[0, 2], rate_hz=1000.0, chunks_per_s=250_000.4, load=0.5,
    )  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["page", str(tmp_path / "samples.npz"), "--docs", str(tmp_path)])
    latency_page.main()
    picture = (tmp_path / "images" / "stream-latency.svg").read_bytes()
    said = " ".join(page.read_text().split())
    assert said.startswith("before ")
    assert said.endswith(" after")
    assert "old figures" not in said
    assert "| bare echo | 200 | 290 | 298 | 300 | 300 |" in said
    assert "**1.050 at the median, 1.050 at 99 %**; 2 of 2 005 were lost" in said
    assert "takes 10 µs at the median and 15 µs at 99 %" in said
    assert "so +5 µs" in said
    assert "corrects 250 000 setpoints a second" in said
    latency_page.main()
    assert (tmp_path / "images" / "stream-latency.svg").read_bytes() == picture
