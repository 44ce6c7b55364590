"""What docs/explanation/corrected-stream.md says of the stream's latency, from the samples of a run.

    python -m benchmarks.stream --samples 100000 --rounds 10 --save samples.npz
    python -m benchmarks.latency_page samples.npz

The samples hold ``echo_us`` and ``corrected_us`` (round trips, in order), ``inside_us`` (time inside the corrector),
``lost`` (2,), ``rate_hz``, ``load`` of the machine, ``chunks_per_s`` (setpoints per second in chunks), ``medians_us``
(rounds, 2) of both lines.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DOCS = Path(__file__).resolve().parents[1] / "docs"
QUANTILES = {"median": 50.0, "95 %": 95.0, "99 %": 99.0, "99.9 %": 99.9}
NAMES = {"echo_us": "bare echo", "corrected_us": "corrected"}
BEGIN, END = "<!-- benchmarks.latency_page -->\n", "<!-- end -->\n"
COLOURS = {"echo_us": "#1f2933", "corrected_us": "#c2410c"}
STEADY: Any = {
    "svg.hashsalt": "kilter", "svg.fonttype": "none", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3,
    "axes.axisbelow": True,
}  # fmt: skip

PICTURE = (
    "![Round trips of the bare echo and of the corrected stream: how many took how long, and which share took longer]"
    "(../images/stream-latency.svg)"
)
SECTION = """## How late a corrected setpoint is

A controller sends a setpoint over zenoh and waits for the corrected one.
Most of this time is transport; this section says what the correction adds to it.
For comparison an echo that only returns what it receives is measured in the same run, alternating with the corrector,
so that other load of the machine affects both. Both are restarted in each of {rounds} rounds,
because two processes of the same program differ by several per cent, depending on the layout of their memory.

{table}

Corrected to bare: **{p50:.3f} at the median, {p99:.3f} at 99 %**; {lost} of {sent} were lost.
The run sent setpoints of 6 joints, {rate:.0f} a second on each line, one at a time, over TCP on one machine with
{cores} cores ({system}, load {load:.1f}; the run itself makes about 0.5).
Round by round the ratio of the medians was {ratios}.

{picture}

### What the correction adds

- Inside the corrector a setpoint takes {inside50:.0f} µs at the median and {inside99:.0f} µs at 99 %,
  from the arrival of its bytes to the departure of its answer: key, decoding, rules, kernel, encoding.
  The kernel takes 2 µs of this when it is called continuously, and 8 µs when it is called every millisecond and other
  programs used the processor's caches meanwhile.
- Added jitter: the round trips scatter by {echo_jitter:.0f} µs (bare) and {jitter:.0f} µs (corrected) between the
  median and 99 %, so {added:+.0f} µs. From one answer to the next the difference is {echo_step:.0f} and {step:.0f} µs
  at the median.
- In chunks of 200 one stream corrects {chunks} setpoints a second.

The machine causes the slowest of a hundred thousand round trips: a sleep of one millisecond on it is late by as much.
Of everything we tried, `SCHED_FIFO` helped them most; the corrector asks for it where it is allowed to.
On a machine without a real-time kernel a deadline must allow for them; `kilter_client.stream` then holds the last
correction.

### How to repeat it

```
python -m tools.lab bench-stream
```

prints the figures, with `ratio p50=… p99=… lost=…` as its last line. This section and its picture come from

```
python -m benchmarks.stream --samples 100000 --rounds 10 --save samples.npz
python -m benchmarks.latency_page samples.npz
```

on an otherwise idle machine; with 100 000 setpoints on each line this takes about four minutes.
[What the correction costs and why it is built so](../reference/stream.md#rules).
"""


def load(path: Path) -> dict[str, Floats]:
    """Samples of a run."""
    with np.load(path) as stored:
        return {name: np.asarray(stored[name], dtype=np.float64) for name in stored.files}


def draw(samples: Mapping[str, Floats], path: Path) -> None:
    """Histogram and tail of both lines as SVG; the same samples give the same bytes."""
    with rc_context(STEADY):
        figure = Figure(figsize=(8.0, 3.6), layout="constrained")
        counts, tail = figure.subplots(1, 2)
        both = np.concatenate([samples[name] for name in NAMES])
        edges = np.linspace(0.0, np.percentile(both, 97.5), 80)
        for name, label in NAMES.items():
            trips = np.sort(samples[name])
            share = np.full(len(trips), 100.0 / len(trips))
            counts.hist(trips, edges, weights=share, histtype="step", color=COLOURS[name], label=label)
            later = np.geomspace(1.0, 1.0 / len(trips), 200)
            tail.plot(np.quantile(trips, 1.0 - later), later, color=COLOURS[name], label=label)
        counts.set(xlabel="round trip, µs", ylabel="% of setpoints", title="Round trips")
        tail.set(xlabel="round trip, µs", ylabel="share that took longer", xscale="log", yscale="log", title="Tail")
        for axes in (counts, tail):
            axes.legend(fontsize=8)
        figure.savefig(path, metadata={"Date": None})


def table(samples: Mapping[str, Floats]) -> str:
    """Quantiles of both lines and their ratio, Markdown."""
    lines = ["| round trip, µs | " + " | ".join(QUANTILES) + " | longest |", "|---" * (len(QUANTILES) + 2) + "|"]
    rows = {}
    for name, label in NAMES.items():
        rows[label] = np.array([*np.percentile(samples[name], list(QUANTILES.values())), samples[name].max()])
        lines.append(f"| {label} | " + " | ".join(f"{value:.0f}" for value in rows[label]) + " |")
    ratio = rows["corrected"] / rows["bare echo"]
    lines.append("| corrected / bare | " + " | ".join(f"{value:.3f}" for value in ratio[:-1]) + " | – |")
    return "\n".join(lines)


def grouped(number: float) -> str:
    """A whole number in groups of three."""
    return f"{number:,.0f}".replace(",", " ")


def section(samples: Mapping[str, Floats]) -> str:
    """The section's text with the run's figures."""
    echo, ours = samples["echo_us"], samples["corrected_us"]
    (e50, e99), (p50, p99) = (np.percentile(x, [50, 99]) for x in (echo, ours))
    inside50, inside99 = np.percentile(samples["inside_us"], [50, 99])
    sent = len(samples["inside_us"]) + int(samples["lost"][1])
    medians = samples["medians_us"]
    return SECTION.format(
        rounds=len(medians), ratios=", ".join(f"{ratio:.3f}" for ratio in medians[:, 1] / medians[:, 0]),
        table=table(samples), picture=PICTURE, p50=p50 / e50, p99=p99 / e99, lost=int(samples["lost"][1]), sent=grouped(sent),
        rate=float(samples["rate_hz"]), load=float(samples["load"]), cores=os.cpu_count(),
        system=f"{platform.system()} {platform.machine()}", inside50=inside50, inside99=inside99,
        echo_jitter=e99 - e50, jitter=p99 - p50, added=(p99 - p50) - (e99 - e50),
        echo_step=np.median(np.abs(np.diff(echo))), step=np.median(np.abs(np.diff(ours))),
        chunks=grouped(float(samples["chunks_per_s"])),
    )  # fmt: skip


def main() -> None:
    """Write the section and its picture."""
    parser = argparse.ArgumentParser(description="Write the stream's latency into its page from the samples of a run.")
    parser.add_argument("samples", type=Path, help="file that benchmarks.stream --save wrote")
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder of the documentation")
    given = parser.parse_args()
    samples = load(given.samples)
    draw(samples, given.docs / "images" / "stream-latency.svg")
    page = given.docs / "explanation" / "corrected-stream.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}{section(samples)}{END}{after}", encoding="utf-8")
    print(table(samples))


if __name__ == "__main__":
    main()
