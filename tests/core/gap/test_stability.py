"""Would other poses give the same names: the linear world with poses weighted anew."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.gap.evidence.similarity.testability import testability as judged
from kilter_core.gap.evidence.stability import FEW, inclusion, reweight_problem
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import with_testable
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.scan import Scorer, null_distribution
from kilter_core.gap.search.select import Selector
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana

OPTIONS = GapOptions(effects=("eccentricity", "encoder_scale", "backlash", "axial_compliance"))


@pytest.fixture(scope="module")
def problem():
    robot = katana()
    return prepare_data(Calibration.nominal(robot), campaign(robot, seed=5), OPTIONS)


def test_weighted_rows_are_a_weighted_fit(problem):
    """The chi-square a candidate takes is that of two weighted least-squares fits, with and without it."""
    w = problem.problem
    weight = np.random.default_rng(0).exponential(size=len(w.settings.used))[w.row_visit]
    gram, root = reweight_problem(w, weight), np.sqrt(weight)

    def left(*columns):
        X = root[:, None] * np.column_stack([w.U, *columns])
        return float(np.sum((root * w.y - X @ np.linalg.lstsq(X, root * w.y, rcond=None)[0]) ** 2))

    for k in np.flatnonzero(np.diag(w.A) > 0.01)[:3]:
        assert gram.reduction([int(k)]) == pytest.approx(left() - left(w.W[:, k]), rel=1e-6, abs=1e-6)
    assert gram.yy == pytest.approx(left(), rel=1e-9)


def chosen(prepared, label, y):
    """A hunt that ended with one name, on data made for it."""
    w = prepared.problem
    scorer = Scorer.from_candidates(with_testable(prepared.library, judged(w, prepared.library).able), True, np.inf)
    selector = Selector(scorer, w.rows, np.full(len(w.A), np.inf))
    (place,) = [k for k, c in enumerate(scorer.candidates) if c.label == label]
    r = y - w.U @ (w.U.T @ y)
    made = type(w)(**{**{f: getattr(w, f) for f in w.__dataclass_fields__}, "y": r, "c": w.W.T @ r})
    return SearchResult(made, selector, (place,), null_distribution(made, scorer, [], 499, 0), 1e-4, ())


def test_a_name_that_rests_on_two_poses_does_not_return(problem):
    """Signs of residuals leave the poses as they are and give it back every time; other poses do not."""
    w = problem.problem
    rng = np.random.default_rng(3)
    column = next(k for k, p in enumerate(problem.library.parameters) if p.name == "backlash_3")
    noise = rng.standard_normal(len(w.y))
    spread = noise + 9.0 * w.W_raw[:, column]
    visit = w.row_visit
    strongest = np.argsort(-np.bincount(visit, w.W_raw[:, column] ** 2))[:2]
    at = np.isin(visit, strongest)
    few = noise + np.where(at, 7.0 * np.sign(w.W_raw[:, column]), 0.0)
    shares = [inclusion(h, {}, h.chosen, 60, 0, lambda f: None)[h.chosen[0]][0] for h in (
        chosen(problem, "backlash j3", y) for y in (spread, few)
    )]  # fmt: skip
    assert shares[0] >= 0.9
    assert shares[1] < 0.8


def test_where_no_verdict_waits_a_few_resamples_tell_enough(problem):
    w = problem.problem
    column = next(k for k, p in enumerate(problem.library.parameters) if p.name == "backlash_3")
    y = np.random.default_rng(3).standard_normal(len(w.y)) + 9.0 * w.W_raw[:, column]
    search, drawn = chosen(problem, "backlash j3", y), []
    (share,) = inclusion(search, {}, (), 60, 0, lambda f: None, lambda: bool(drawn.append(1))).values()
    assert len(drawn) == FEW
    assert share[0] in {k / FEW for k in range(FEW + 1)}
