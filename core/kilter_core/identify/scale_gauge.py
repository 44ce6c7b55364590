"""Where only cameras measure and the scale of the boards is free, everything may grow together: who is believed.

A board, the distances to the cameras and all lengths of the arm grow by one factor, and no pixel changes. So the factor is
that at which the board's stated scale and the nominal lengths, which a maker holds to half a millimetre, contradict each
other the least.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.views.cameras import Cameras, rig_of, unknown_rig
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.transforms import inverse
from kilter_core.types import Floats

MACHINED_M = 5e-4  # standard deviation of a length as its maker holds it


def free_scale(fit: Fit) -> bool:
    """Whether everything may grow together: pixels and no measured length, boards of free scale, all lengths free.

    A prismatic joint tells the scale too.
    """
    problem = fit.problem
    rig = unknown_rig(problem.model)
    if rig is None or problem.measurement.tells_scale:
        return False
    robot, names = problem.model.robot, set(fit.names)
    lengths = [e for e in robot.chain.elements if not e.axis.rotates]
    fixed = any(e.value != 0.0 and e.name not in names for e in lengths if e.joint is None)
    prismatic = any(joint.kind == "prismatic" for joint in robot.joints)
    return not fixed and not prismatic and all(board.scale_sigma > 0.0 for board in rig.rig.boards)


def with_likeliest_scale(fit: Fit) -> Fit:
    """The fit grown by the likeliest factor; as it is where the factor is known or nothing may grow."""
    if not free_scale(fit):
        return fit
    problem = fit.problem
    model, values = problem.model, fit.values
    rig = rig_of(fit.calibration())
    assert rig is not None
    lengths = [e.name for e in model.robot.chain.elements if e.name in fit.names and not e.axis.rotates]
    places = [model.names.index(str(name)) for name in lengths]
    nominal = np.array([model.parameters[k].value for k in places])
    found = values[places]
    scales = np.array([place.values[0] for place in rig.boards])
    sigmas = np.array([board.scale_sigma for board in rig.rig.boards])
    # (1 + t) times each: stated scales and nominal lengths pull at t.
    pull = np.sum((1.0 + scales) * -scales / sigmas**2) + np.sum(found * (nominal - found)) / MACHINED_M**2
    stiff = np.sum(((1.0 + scales) / sigmas) ** 2) + np.sum(found**2) / MACHINED_M**2
    grown = 1.0 + float(pull / stiff)
    out = values.copy()
    out[places] *= grown
    effect = Cameras(rig=_grown(rig, grown, model.T_base, model.T_tool))
    effects = tuple(effect if isinstance(e, Cameras) else e for e in model.effects)
    at = next(where for e, where in model.placed if isinstance(e, Cameras))
    assert effect.rig is not None
    out[at] = effect.rig.values
    return replace(fit, problem=replace(problem, model=replace(model, effects=effects)), values=out)


def _grown(rig: PlacedRig, by: float, T_base: Floats, T_tool: Floats) -> PlacedRig:
    """The rig with all distances from base and flange, and the boards themselves, ``by`` times as large."""
    seen = rig.moved(base=inverse(T_base), tool=T_tool).settled()
    for place in (*seen.cameras, *seen.boards):
        place.origin[:3, 3] *= by
    boards = tuple(replace(b, values=(1.0 + b.values) * by - 1.0) for b in seen.boards)
    return replace(seen, boards=boards).moved(base=T_base, tool=inverse(T_tool)).settled()
