"""Where the fit of another set of effects begins: not where geometry made up for a curve that is taken out."""

from __future__ import annotations

import numpy as np

from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.linear.linearized import nearest, refit
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana

OPTIONS = GapOptions(effects=("encoder_scale", "backlash"))


def test_a_fit_begins_at_geometry_alone_where_what_is_taken_out_was_large() -> None:
    rows = campaign(katana(), [("encoder_scale", (1,), (5e-2,))], seed=5)
    alone = prepare_data(Calibration.nominal(katana()), rows, OPTIONS).problem
    names = [p.name for p in alone.settings.source.model.parameters][-alone.settings.source.n_library :]
    with_it = refit(alone.settings, alone.values, [names.index("encoder_scale_2")])
    starts = with_it.values, alone.values
    assert nearest(alone.settings, starts, [names.index("backlash_1")]) is alone.values
    assert nearest(alone.settings, starts, [names.index("encoder_scale_2")]) is with_it.values
    np.testing.assert_array_equal(nearest(alone.settings, starts[:1], []), with_it.values)


def test_a_fit_that_rests_has_the_same_derivatives() -> None:
    problem = prepare_data(Calibration.nominal(katana()), campaign(katana(), seed=5), OPTIONS).problem
    kept = problem.of_unit([2, 0])
    problem.derivatives.kept = None
    np.testing.assert_allclose(problem.of_unit([2, 0]), kept, rtol=1e-12, atol=1e-12)
    assert problem.derivatives.kept is None
