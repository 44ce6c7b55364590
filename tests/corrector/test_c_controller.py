"""The example controller in C over zenoh-pico, built and run against a corrector: frames, versions, and their end."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import tarfile
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_client.signing import on_this_machine
from kilter_core.correct.program import Track
from kilter_core.model import Calibration
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules
from tests.corrector.conftest import MemorySource
from tests.corrector.live import ROBOT, open_stream

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "c"
PICO = EXAMPLES.parents[2] / "shared" / "data" / "zenoh-pico" / "zenoh-pico-1.9.0.tar.gz"
COMPILER, CMAKE = shutil.which("cc") or shutil.which("gcc"), shutil.which("cmake")
pytestmark = [
    pytest.mark.skipif(COMPILER is None or CMAKE is None, reason="no C compiler or no CMake on this machine"),
    pytest.mark.skipif(not PICO.is_file(), reason="the source of zenoh-pico is not beside the repository"),
]
JOINTS, CYCLE_US, CYCLES = 5, 10_000, 700
BLOCK, LONGEST = 200, 12000  # cycles that are judged together, and at most waited for
SOME = 20  # answers in time that a busy machine gives as well: how many are late is measured by `make bench`
HOLD, FADE = 20, 200  # cycles, as the controller has them
RATE_RAD_S = 0.0873


@pytest.fixture(scope="module")
def pico(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library of zenoh-pico and its headers, kept under `build` for this archive, this compiler and these options.

    Not optimised: it is compiled in two thirds of the time, and at 100 Hz nobody notices.
    """
    version = subprocess.run([str(COMPILER), "--version"], check=True, capture_output=True).stdout
    plain = ["-DCMAKE_BUILD_TYPE=None", "-DBUILD_SHARED_LIBS=OFF", "-DBUILD_EXAMPLES=OFF", "-DBUILD_TESTING=OFF"]
    key = hashlib.sha256(PICO.read_bytes() + version + " ".join(plain).encode()).hexdigest()[:16]
    kept = EXAMPLES.parents[1] / "build" / f"zenoh-pico-{key}"
    if kept.is_dir():
        return kept
    folder = tmp_path_factory.mktemp("pico")
    with tarfile.open(PICO) as archive:
        archive.extractall(folder, filter="data")
    source, build, made = folder / "zenoh-pico-1.9.0", folder / "build", folder / "made"
    for command in ([str(CMAKE), "-S", source, "-B", build, *plain], [str(CMAKE), "--build", build, "-j2"]):
        subprocess.run(list(map(str, command)), check=True, capture_output=True)
    shutil.copytree(source / "include", made / "include")
    shutil.copytree(build / "include", made / "include", dirs_exist_ok=True)
    shutil.copy(build / "lib" / "libzenohpico.a", made)
    kept.parent.mkdir(exist_ok=True)
    beside = Path(tempfile.mkdtemp(dir=kept.parent))  # moved at once, so that what is there is whole
    shutil.copytree(made, beside, dirs_exist_ok=True)
    with suppress(OSError):  # another process was sooner
        beside.rename(kept)
    shutil.rmtree(beside, ignore_errors=True)
    return kept


@pytest.fixture(scope="module")
def controller(pico: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("controller") / "zenoh_controller"
    warnings = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-O2"]
    includes = [f"-I{EXAMPLES}", "-isystem", str(pico / "include")]
    files = [str(EXAMPLES / "zenoh_controller.c"), str(pico / "libzenohpico.a"), "-lpthread", "-lm"]
    subprocess.run([str(COMPILER), *warnings, *includes, "-o", str(made), *files], check=True)
    return made


class Said(NamedTuple):
    """What the controller printed: status and cycles since the last good one (N,), wanted and sent joints (N, n)."""

    status: NDArray[np.int64]
    since: NDArray[np.int64]
    wanted: NDArray[np.float64]
    sent: NDArray[np.float64]


def begin(controller: Path, corrector: Corrector, stream: str, cycles: int) -> subprocess.Popen[str]:
    session = on_this_machine(corrector.file.parent / "stream-keys.json", "test", ROBOT, stream)
    assert session is not None
    endpoint = corrector.endpoints["stream"]
    command = [endpoint, "test", ROBOT, stream, session.id.hex(), session.key.hex(), JOINTS, cycles, CYCLE_US]
    return subprocess.Popen([str(controller), *map(str, command)], stdout=subprocess.PIPE, text=True)


def ended(running: subprocess.Popen[str]) -> Said:
    out, _ = running.communicate(timeout=60)
    assert running.returncode == 0
    return read(out.splitlines())


def read(lines: list[str]) -> Said:
    table = np.array([line.split() for line in lines], dtype=float)
    joints = table[:, 3:].reshape(len(table), JOINTS, 2)
    return Said(table[:, 1].astype(int), table[:, 2].astype(int), joints[:, :, 0], joints[:, :, 1])


def wait_for(running: subprocess.Popen[str], holds: Callable[[Said], bool]) -> Said:
    """The first BLOCK cycles in a row of which the condition holds; a slow machine only needs more of them."""
    assert running.stdout is not None
    for _ in range(LONGEST // BLOCK):
        said = read(list(islice(running.stdout, BLOCK)))
        if holds(said):
            return said
    raise AssertionError("not once in all its cycles")


def test_its_setpoints_are_corrected_also_after_an_activation(
    controller: Path, corrector: Corrector, source: MemorySource, active_of: Callable[..., Active],
    calibration_of: Callable[..., Calibration], katana: Calibration,
) -> None:  # fmt: skip
    def follows(active: Active) -> Callable[[Said], bool]:
        """Whether what it sends is what this version's own program says, once the change is over."""

        def holds(said: Said) -> bool:
            track, expected = Track(active.program, settled=True), []
            for wanted in said.wanted:
                assert track.step(np.ascontiguousarray(wanted), 1, CYCLE_US * 1e-6) == 0
                expected.append(track.out.copy())
            good = said.status == 0
            off = np.abs(said.sent - expected)[good]
            return bool(good.sum() >= SOME and np.quantile(off, 0.9) < 1e-5)

        return holds

    after = active_of(calibration_of(ROBOT, seed=9), epoch=2, ramp_s=0.05)
    running = begin(controller, corrector, "c1", 2 * LONGEST)
    try:
        before = wait_for(running, lambda said: (said.status == 0).sum() >= SOME)
        assert not follows(after)(before)  # the versions differ
        source.use(after)
        corrector.poll()
        said = wait_for(running, follows(after))
    finally:
        running.kill()
        running.communicate()
        source.use(active_of(katana, epoch=3, ramp_s=0.05))
        corrector.poll()
    assert np.abs(said.sent - said.wanted)[said.status == 0].max() > 1e-4  # and it is a correction


def test_without_a_corrector_it_holds_and_fades_without_a_step(
    controller: Path, source: MemorySource, tmp_path: Path
) -> None:
    own = Corrector(Settings(data=tmp_path, zenoh_listen="tcp/127.0.0.1:0", site="test"), source, Rules())
    own.start()
    try:
        with open_stream(own, "first", connect_timeout_s=60.0):
            pass
        running = begin(controller, own, "c2", CYCLES)
        time.sleep(2.0)
    finally:
        own.stop()
    said = ended(running)
    assert (said.status[:200] == 0).sum() >= SOME
    delta = said.sent - said.wanted
    gone = int(np.flatnonzero(said.status == 0)[-1])
    assert np.abs(np.diff(delta, axis=0)).max() < RATE_RAD_S * CYCLE_US * 1e-6 * (1 + 1e-6)  # as it comes in, too
    assert len(delta) - gone > HOLD + FADE
    assert np.allclose(delta[gone + 1 : gone + 1 + HOLD], delta[gone], rtol=0, atol=1e-12)
    assert np.abs(delta[gone + HOLD + FADE :]).max() < 1e-12
    assert np.abs(np.diff(delta[gone:], axis=0)).max() < 0.02 * np.abs(delta[gone]).max()


def test_what_it_is_given_is_checked(controller: Path) -> None:
    for given, words in ((["x"] * 3, "usage"), (["x"] * 9, "SESSION_ID has 32")):
        done = subprocess.run([str(controller), *given], capture_output=True, text=True, check=False)
        assert (done.returncode, words in done.stderr) == (2, True)
