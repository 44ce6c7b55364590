"""Use what the wheels installed: the commands, a server from an empty folder, a fit through the library.

Run by `make wheels` with the Python of a fresh environment, which has neither the sources nor anything for tests.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distribution
from pathlib import Path

from kilter_client import Kilter

COMMANDS = Path(sys.executable).parent
DISTRIBUTIONS = ("kilter-core", "kilter", "kilter-files", "kilter-client")
TOP_LEVEL = {"kilter_core", "kilter_service", "kilter_files", "kilter", "kilter_client"}
READY_WITHIN_S, FIT_WITHIN_S, STOP_WITHIN_S = 300.0, 300.0, 30.0  # the kernels are compiled on the way
HELD_OUT_BELOW_MM = 0.05


def main() -> None:
    """Try each part in turn; the first that fails ends with its words."""
    measured, held_out = (Path(sys.argv[1], name).resolve() for name in ("measured.csv", "held-out.csv"))
    check_contents()
    with tempfile.TemporaryDirectory(prefix="kilter-wheels-") as folder:
        os.chdir(folder)
        run("kilter", "--help")
        assert "full tilting" in run("kilter", "demo", "--circle-s", "1")
        print(run("kilterd", "migrate", "--data", f"{folder}/data").strip())
        with (
            server(Path(folder, "data")) as url,
            Kilter(url, token=Path(folder, "data/token").read_text().strip()) as k,
        ):
            assert k.health()["status"] == "ready", k.health()
            error_mm = fit(k, measured, held_out)
    assert error_mm < HELD_OUT_BELOW_MM, error_mm
    print(f"The wheels work: a fit through the library leaves {error_mm:.3f} mm on held-out poses.")


def check_contents() -> None:
    """Look at which modules the wheels brought to the top level."""
    found = set()
    for name in DISTRIBUTIONS:
        files = distribution(name).files or []
        tops = {file.parts[0] for file in files if file.suffix == ".py"} - {".."}
        print(f"{name} {distribution(name).version}: {', '.join(sorted(tops))}")
        found |= tops
    assert found == TOP_LEVEL, f"top-level modules: {sorted(found)}, expected {sorted(TOP_LEVEL)}"


def run(command: str, *arguments: str) -> str:
    """Run one of the installed commands and return what it printed."""
    done = subprocess.run([COMMANDS / command, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} {' '.join(arguments)}: {done.stdout}{done.stderr}"
    return done.stdout


@contextmanager
def server(data: Path) -> Iterator[str]:
    """Run `kilterd serve` on free ports of loopback; gives its URL once it is ready."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment |= {"KILTER_DATA": str(data), "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    log = data.parent / "server.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [COMMANDS / "kilterd", "serve", "--port", "0"], env=environment, stdout=out, stderr=out
        )
        try:
            deadline = time.monotonic() + READY_WITHIN_S
            while not (data / "server.json").exists():
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < deadline, f"kilterd is not ready; its log:\n{log.read_text()}"
                time.sleep(0.1)
            yield str(json.loads((data / "server.json").read_text())["url"])
        finally:
            process.terminate()
            process.wait(STOP_WITHIN_S)


def fit(kilter: Kilter, measured: Path, held_out: Path) -> float:
    """Identify the tutorial's arm; returns the mean error in mm on poses that the fit has not seen."""
    kilter.robots.add({"name": "tour", "convention": "preset", "preset": "katana450-chapter5"})
    ids = []
    for role, file in (("train", measured), ("validation", held_out)):
        campaign = str(kilter.campaigns.add("tour", role, device="simulated", role=role)["id"])
        kilter.campaigns.upload(campaign, file)
        ids.append(campaign)
    options = {"effects": ["clearance_tilt", "backlash_load", "axial_compliance"]}
    done = kilter.jobs.run("identify", "tour", [ids[0]], [ids[1]], options, timeout_s=FIT_WITHIN_S)
    return float(done["result"]["metrics"]["validation"]["identified"]["mean_mm"])


if __name__ == "__main__":
    main()
