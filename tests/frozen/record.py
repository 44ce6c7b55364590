"""Write down what the core finds: ``python -m tests.frozen.record FILE [--cases 100]``.

100 blind hunts over every kind of hidden physics, identifications over methods and kinds of measurement, and 10 000
corrected setpoints. Numbers are kept to their last bit, in SI where the core gives them so; documents with promised names
as they are. Two commits that write the same file compute the same. The packages are imported by what they are called at
the commit that runs, so that code may move between the two.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.errors import CoreError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import Folds, IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.procedures.link_encoders import link_joints
from kilter_core.twin import thesis_katana
from tests.blind.generator import Case, cases, generate
from tests.blind.to_core import observations_of, robot_of
from tests.core.campaigns import joints, measured, table_errors
from tests.core.measurement import test_contacts, test_distances
from tests.core.procedures.test_link_encoders import ROBOT as WITH_LINK_ENCODERS
from tests.core.procedures.test_link_encoders import motion
from tests.core.truth import some_pose, ur10

SEED, CASES, SETPOINTS = 5, 100, 10_000
NOISE_M = 2e-5
FULL_TILTING = ("clearance_tilt", "backlash_load", "axial_compliance")
FREE: Any = {"largest_rad": 0.3, "largest_m": 0.1, "farthest_m": 0.1}

Found = dict[str, Any]


def exact(value: Any) -> Any:
    """Return a value as JSON holds it without losing a bit: what ``repr`` of a float says is read back as the same float."""
    if isinstance(value, np.ndarray):
        return exact(value.tolist())
    if isinstance(value, np.generic):
        return exact(value.item())
    if isinstance(value, Mapping):
        return {str(key): exact(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [exact(one) for one in value]
    return value


def of_calibration(calibration: Calibration) -> Found:
    """What a calibration computes with."""
    return {"names": calibration.model.names, "values": calibration.values, "base": calibration.model.T_base,
            "tool": calibration.model.T_tool}  # fmt: skip


def hunted(case: Case) -> Found:
    """A blind campaign and what the hunt says of it."""
    campaign = generate(case)
    try:
        again = None if campaign.confirmation is None else observations_of(campaign.confirmation)
        report = find_gap(
            robot_of(campaign), observations_of(campaign.columns), GapOptions(next_poses=1), confirmation=again
        )
    except CoreError as error:
        return {"error": error.code, "message": error.message}
    return {"report": report.to_document(), "calibration": of_calibration(report.calibration)}


def fitted(options: Mapping[str, Any], see: str = "position", validation: Any = 0.25) -> Callable[[], Found]:
    """A UR10 with errors in its table, measured in one way and identified in one."""

    def run() -> Found:
        rng = np.random.default_rng(3)
        arm = ur10(base=some_pose(rng, 2.0))
        actual = arm.moved(table_errors(arm, rng))
        robot = robot_from_document(ur10().document())
        return identified(
            robot, measured(actual, joints(arm, 70, rng), rng, NOISE_M, see), IdentifyOptions(**options), validation
        )

    return run


def tilted(options: Mapping[str, Any]) -> Callable[[], Found]:
    """The thesis's Katana, whose joints tilt, have play and yield."""

    def run() -> Found:
        rng = np.random.default_rng(4)
        twin = thesis_katana()
        low, high = twin.robot.limits.T
        q = rng.uniform(low, high, (118, twin.robot.n_joints))
        return identified(twin.robot, twin.observe(q, noise_m=NOISE_M), IdentifyOptions(**options), 0.25)

    return run


def contacts() -> Found:
    """A ball in three sockets of known distances."""
    drawn, _, rows = test_contacts.sockets()
    options = IdentifyOptions(base="removed", socket_distances_mm=test_contacts.lengths())
    return identified(robot_from_document(drawn.document()), rows, options, None)


def distances(see: str) -> Callable[[], Found]:
    """Distances between poses, whatever the frame."""

    def run() -> Found:
        robot, train, held = test_distances.campaign(see, rows=70)
        return identified(robot, train, IdentifyOptions(base="removed"), held)

    return run


def encoders() -> Found:
    """Encoders behind the gears, joint by joint."""
    found = link_joints(WITH_LINK_ENCODERS, [motion(1)], [motion(2)])
    return {str(one.joint): [[p.name, p.value, p.sigma] for p in one.parameters] for one in found}


def identified(robot: Any, train: Observations, options: IdentifyOptions, validation: Any) -> Found:
    """An identification to its last bit."""
    found = identify(robot, train, validation, options)
    return {"document": found.to_document(), "calibration": of_calibration(found.calibration),
            "covariance": found.covariance, "residual": [found.fit.residual.points, found.fit.residual.turns]}  # fmt: skip


IDENTIFICATIONS: Mapping[str, Callable[[], Found]] = {
    "positions": fitted({}),
    "positions, level 1": fitted({"level": 1}),
    "poses": fitted({}, "pose"),
    "markers": fitted({}, "markers"),
    "folds": fitted({}, validation=Folds(4)),
    "huber": fitted({"loss": "huber"}),
    "tukey": fitted({"loss": "tukey"}),
    "fixed tool": fitted({"tool": "fixed"}),
    "free and fixed parameters": fitted({"free": ("a_*", "d_*"), "fix": ("d_2",)}),
    "profile": fitted({"intervals": "profile", "level": 1}),
    "bootstrap": fitted({"intervals": "bootstrap", "level": 1}),
    "pose by pose": fitted({"method": "pose_pseudo_inverse"}),
    "influence": fitted({"method": "influence"}),
    "linear": fitted({"method": "linear_least_squares"}),
    "search": fitted({"method": "global_search", "level": 1}),
    "tilting": tilted({"effects": FULL_TILTING}),
    "tilting first": tilted({"effects": FULL_TILTING, "tilt_first": True}),
    "distances of positions": distances("position"),
    "distances of markers": distances("markers"),
    "sockets": contacts,
    "link encoders": encoders,
}


def corrected() -> Found:
    """Setpoints of a path through the tilting Katana's workspace, as rows by themselves and as the stream follows them."""
    twin = thesis_katana()
    program = compile_program(twin.truth, CorrectionOptions(**FREE))
    limits = twin.robot.limits
    t = np.linspace(0.0, 10.0, SETPOINTS // 2)
    middle, half = limits.mean(axis=1), 0.4 * np.ptp(limits, axis=1)
    q = middle + half * np.sin(t[:, None] * np.linspace(0.5, 1.1, limits.shape[0]) + np.arange(limits.shape[0]))
    alone = program.correct_rows(q)
    track = Track(program).follow(q.copy(), 1, np.full(len(q), t[1]))
    return {"alone": [alone.q, alone.status], "followed": list(track)}


def one(job: tuple[str, Any]) -> tuple[str, Any]:
    """Run one part, by its name, in a process of its own."""
    name, case = job
    found = hunted(case) if case is not None else corrected() if name == "setpoints" else IDENTIFICATIONS[name]()
    return name, exact(found)


def main() -> None:
    """Write all of it, one part in a line, in an order of their own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--cases", type=int, default=CASES, help="blind hunts")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    os.environ.update({"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"})
    work: list[tuple[str, Any]] = [(name, None) for name in ("setpoints", *IDENTIFICATIONS)]
    work += [(f"hunt {case.name}", case) for case in cases(SEED, given.cases)]
    found = {}
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        for k, (name, result) in enumerate(pool.imap_unordered(one, work), 1):
            found[name] = result
            print(f"{k}/{len(work)} {name}", file=sys.stderr, flush=True)
    given.file.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps([name, found[name]]) for name, _ in work]
    given.file.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
