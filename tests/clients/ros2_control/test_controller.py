"""The chainable controller of ros2_control, compiled against stand-ins of its headers: what it commands is Python's."""

from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml

from kilter_core.correct.program import CorrectionProgram, Track
from tests.core.correct.c_corrector import COMPILER, CPP, blob_of
from tests.core.correct.test_c_corrector import path_of, program_of

HERE = Path(__file__).parent
CLIENTS = HERE.parents[2] / "clients"
PACKAGE = CLIENTS / "ros2_control"
STEP_S = 0.004

pytestmark = pytest.mark.skipif(COMPILER is None or CPP is None, reason="no compiler for C and C++")


@pytest.fixture(scope="module")
def program() -> CorrectionProgram:
    return program_of("ur10e", "gear_error")


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ros2")
    corrector = folder / "kilter_corrector.o"
    source = str(CLIENTS / "c" / "kilter_corrector.c")
    subprocess.run([str(COMPILER), "-std=c99", "-O2", "-c", source, "-o", str(corrector)], check=True)
    include = [f"-I{HERE / 'stubs'}", f"-I{PACKAGE / 'include'}", f"-I{CLIENTS / 'c'}"]
    sources = [str(PACKAGE / "src" / "kilter_controller.cpp"), str(HERE / "manager.cpp"), str(corrector)]
    warnings = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([str(CPP), *warnings, *include, *sources, "-o", str(folder / "manager")], check=True)
    return folder / "manager"


def run(manager: Path, program: Path, joints: int, wanted: np.ndarray) -> subprocess.CompletedProcess[str]:
    lines = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in wanted) + "\n"
    command = [str(manager), str(program), str(joints), str(STEP_S)]
    return subprocess.run(command, input=lines, capture_output=True, text=True, timeout=60)


def commanded(run: subprocess.CompletedProcess[str]) -> np.ndarray:
    assert run.returncode == 0, run.stderr
    return np.array([[float(word) for word in line.split()] for line in run.stdout.splitlines()])


def test_references_become_corrected_commands(program: CorrectionProgram, manager: Path, tmp_path: Path) -> None:
    (tmp_path / "arm.klt").write_bytes(blob_of(program))
    wanted = path_of(program, 400, seed=3, step=STEP_S)
    done = run(manager, tmp_path / "arm.klt", 6, wanted)
    assert "kilter_controller/joint_1/position" in done.stderr
    _, out, _, _ = Track(program).follow(wanted, 1, np.full(len(wanted), STEP_S))
    assert np.abs(commanded(done) - out).max() < 1e-12
    assert np.abs(commanded(done)[0] - wanted[0]).max() < 1e-5  # the correction ramps in
    assert np.abs(commanded(done)[-1] - wanted[-1]).max() > 1e-4


def test_a_reference_that_is_refused_holds_the_correction_and_then_fades_it(
    program: CorrectionProgram, manager: Path, tmp_path: Path
) -> None:
    (tmp_path / "arm.klt").write_bytes(blob_of(program))
    still = np.tile(path_of(program, 1, seed=3), (1200, 1))
    beyond, missing = still.copy(), still.copy()
    beyond[800:, 5] = 7.0  # outside the limits of the joint
    missing[800:] = np.nan
    out = commanded(run(manager, tmp_path / "arm.klt", 6, beyond))
    assert np.isfinite(out).all()
    off = (out - beyond)[:, :5]
    before = np.abs(off[799]).max()
    assert before > 1e-4
    assert np.abs(off[810] - off[799]).max() < 1e-12  # held
    assert np.abs(np.diff(off[800:], axis=0)).max() < before / 100
    assert np.abs(off[1100:]).max() < 1e-12  # faded out
    last = commanded(run(manager, tmp_path / "arm.klt", 6, missing))
    assert np.abs(last[800:] - last[799]).max() == 0.0


@pytest.mark.parametrize(
    ("name", "joints", "said"),
    [
        ("arm.klt", 5, "joints names 5, the program"),
        ("altered.klt", 6, "its checksum is wrong: export it again"),
        ("nothing.klt", 6, "cannot be read"),
    ],
)
def test_what_cannot_be_configured_is_said(
    program: CorrectionProgram, manager: Path, tmp_path: Path, name: str, joints: int, said: str
) -> None:
    content = bytearray(blob_of(program))
    (tmp_path / "arm.klt").write_bytes(content)
    content[300] ^= 4
    (tmp_path / "altered.klt").write_bytes(content)
    refused = run(manager, tmp_path / name, joints, np.zeros((1, joints)))
    assert refused.returncode == 1
    assert said in refused.stderr


def test_the_package_names_one_plug_in() -> None:
    plugin = ET.parse(PACKAGE / "kilter_controller.xml").getroot()
    build = (PACKAGE / "CMakeLists.txt").read_text()
    assert f"add_library({plugin.attrib['path']} SHARED src/kilter_controller.cpp" in build
    assert "pluginlib_export_plugin_description_file(controller_interface kilter_controller.xml)" in build
    one = plugin.find("class")
    assert one is not None
    assert (
        f"PLUGINLIB_EXPORT_CLASS({one.attrib['type']}, {one.attrib['base_class_type']})"
        in (PACKAGE / "src" / "kilter_controller.cpp").read_text()
    )
    depends = [entry.text for entry in ET.parse(PACKAGE / "package.xml").getroot().findall("depend")]
    assert f"set(DEPENDENCIES {' '.join(map(str, depends))})" in build
    example = yaml.safe_load((PACKAGE / "config" / "controllers.yaml").read_text())
    manager = example["controller_manager"]["ros__parameters"]
    assert manager["kilter_controller"]["type"] == one.attrib["name"]
    joints = example["kilter_controller"]["ros__parameters"]["joints"]
    before = example["arm_controller"]["ros__parameters"]["command_joints"]
    assert before == [f"kilter_controller/{joint}" for joint in joints]
