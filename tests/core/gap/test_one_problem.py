"""A search whitens, linearises and steps as an identification does: by the one piece that both have below them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import kilter_core
from kilter_core.arm.documents import robot_from_document
from kilter_core.gap.noise.from_repeats import stated_noise
from kilter_core.gap.noise.visits import average_visits
from kilter_core.gap.search.linear.linearized import SearchProblem
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.identify.fit.least_squares import Problem, Weights
from kilter_core.measurement import Measurement
from kilter_core.model import RobotModel
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import small_pose, ur10

NOISE = 1e-3  # so large that the floor below any noise does not show
STEPPING = {"derivatives", "slope", "bend"}  # what a descent consists of
CORE = {str(p): p.read_text(encoding="utf-8") for p in sorted(Path(kilter_core.__file__).parent.rglob("*.py"))}


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
def test_a_search_steps_as_an_identification_does(see: str) -> None:
    rng = np.random.default_rng(3)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    true = nominal.moved(table_errors(nominal, rng))
    model = RobotModel(robot_from_document(nominal.document()))
    measurement = Measurement.from_observations(measured(true, joints(true, 30, rng), rng, NOISE, see))
    free, values = np.arange(6, model.n_geometric - 6), model.values0()
    identified = Problem(model, measurement, free, Weights(NOISE, NOISE))

    visits, source = average_visits(measurement.observations), ToolSource.from_model(model, measurement, free, 0)
    noise = stated_noise(NOISE, visits, source.residual(values).shape[1])
    searched = SearchProblem(ProblemSettings(source, noise, np.ones(len(visits), dtype=bool), visits.pose), [])

    one, other = identified.evaluate(values), searched.evaluate(values)
    assert other.loss == pytest.approx(one.loss, rel=1e-6)
    step = identified.whole_step(values, one)
    np.testing.assert_allclose(searched.whole_step(values, other), step, rtol=0.0, atol=1e-6 * np.abs(step).max())
    there = identified.apply_step(values, step)
    np.testing.assert_array_equal(searched.apply_step(values, step), there)
    assert searched.evaluate(there).loss == pytest.approx(identified.evaluate(there).loss, rel=1e-6)


def test_a_descent_is_written_once() -> None:
    owners = [
        node.name
        for source in CORE.values()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef) and {f.name for f in node.body if isinstance(f, ast.FunctionDef)} >= STEPPING
    ]
    assert sorted(owners) == ["LeastSquares", "Objective"]  # the second is what a solver asks for


def test_visits_are_whitened_in_one_place() -> None:
    product = re.compile(r"(einsum|matmul)\([^()]*whitener")
    assert [name for name, source in CORE.items() if product.search(source)] == []
