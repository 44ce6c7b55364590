"""Robots, versions and a running corrector for these tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.active import Active, version_number
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules
from tests.corrector.live import open_stream
from tests.service.forked import fork_those_of_correctors

EFFECTS = ("clearance_tilt", "backlash_load", "axial_compliance", "backlash")


def calibration_of(
    preset: str, effects: tuple[str, ...] = EFFECTS, seed: int = 0, softening_nm: float = 0.0
) -> Calibration:
    """A preset with geometric errors of 0.1 mm and 0.02 deg, tilt, backlash and compliance of the thesis's size."""
    robot = robot_from_document({"convention": "preset", "preset": preset, "name": preset})
    soft = {"clearance_tilt", "backlash_load"}
    made = tuple(make_effect(e, **({"softening_nm": softening_nm} if e in soft else {})) for e in effects)
    model = RobotModel(robot, made)
    values = model.values0()
    rng = np.random.default_rng(seed)
    for k, name in enumerate(model.names):
        p = model.parameter(name)
        if name.startswith("clearance"):
            values[k] = math.radians(0.02)
        elif name.startswith("backlash"):
            values[k] = math.radians(0.05)
        elif name.startswith("compliance"):
            values[k] = 2e-5
        elif not name.startswith(("base", "tool")):
            values[k] += rng.normal() * (1e-4 if p.unit == "m" else math.radians(0.02))
    return Calibration(model, values)


def active_of(calibration: Calibration, epoch: int = 1, **options: float | str) -> Active:
    """A version as the processes pass it around."""
    program = compile_program(calibration, CorrectionOptions(**options))  # type: ignore[arg-type]
    joints = calibration.robot.joints
    return Active(
        calibration.robot.name, f"ver_{epoch}", version_number(program.digest), epoch, program,
        joint_names=tuple(joint.name for joint in joints), joint_kinds=tuple(joint.kind for joint in joints),
    )  # fmt: skip


class MemorySource:
    """Versions in use, set by the test."""

    def __init__(self) -> None:
        self.versions: dict[str, Active] = {}
        self.fails = False
        self._stamp = 0

    def use(self, active: Active) -> None:
        self.versions = {**self.versions, active.robot: active}
        self._stamp += 1

    def withdraw(self, robot: str) -> None:
        self.versions = {name: active for name, active in self.versions.items() if name != robot}
        self._stamp += 1

    def stamp(self) -> Hashable:
        if self.fails:
            raise RuntimeError("the database is away")
        return self._stamp

    def load(self) -> Mapping[str, Active]:
        return self.versions

    def close(self) -> None:
        pass


@pytest.fixture(scope="session", name="calibration_of")
def calibration_maker() -> Callable[..., Calibration]:
    return calibration_of


@pytest.fixture(scope="session", name="active_of")
def active_maker() -> Callable[..., Active]:
    return active_of


@pytest.fixture(scope="session", autouse=True)
def forks() -> None:
    """The correctors of these tests have their processes forked by what has imported already."""
    fork_those_of_correctors()


@pytest.fixture(scope="session")
def katana() -> Calibration:
    return calibration_of("katana450-chapter4")


@pytest.fixture(scope="session")
def ur10() -> Calibration:
    return calibration_of("ur10")


@pytest.fixture(scope="module")
def source(katana: Calibration) -> MemorySource:
    made = MemorySource()
    made.use(active_of(katana, ramp_s=0.05))
    return made


@pytest.fixture(scope="module")
def max_age_s() -> float:
    """How old a setpoint may be here: a loaded test machine may take its time, and most tests ask for something else."""
    return 5.0


@pytest.fixture(scope="module")
def corrector(source: MemorySource, max_age_s: float, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Corrector]:
    folder: Path = tmp_path_factory.mktemp("data")
    settings = Settings(data=folder, zenoh_listen="tcp/127.0.0.1:0", site="test")
    running = Corrector(settings, source, Rules(max_age_ns=round(max_age_s * 1e9)))
    running.start()
    with open_stream(running, "first", connect_timeout_s=60.0):
        pass  # opened once the version is known: frames that come before are answered NO_VERSION
    yield running
    running.stop()
