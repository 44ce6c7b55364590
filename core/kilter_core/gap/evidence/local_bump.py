"""Bumps at places that no candidate has: a dent, a worn tooth, a loose cable at one angle of one joint.

With an effect outside the library the nearest physical name fits it in part. Before a curve of a joint angle is called
by a physical name, local bumps of the same joint are tried in its place; one that does as well takes the name away.
"""

from __future__ import annotations

import numpy as np

from kilter_core.effects.local_bump import LocalBump
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.sources.source import Source
from kilter_core.types import Floats

CENTRES = 12
FAIR = 2.0  # price of a parameter, Akaike: taking a name away needs less proof than giving one
WIDTHS = (0.06, 0.12, 0.25)  # of the joint's range, as standard deviations


def local_bump_test(search: SearchResult, place: int, rows_q: Floats) -> bool:
    """Whether a local bump of the candidate's joint, at its best centre and width, does as well in its place."""
    candidate = search.selector.scorer.candidates[place]
    source = search.problem.settings.source
    if not _is_curve(candidate) or candidate.id == LocalBump.id or not source.observes_tool:
        return False
    problem, selector = search.problem, search.selector
    rest = selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    r = residual_given(problem, rest)
    variance = selector.variance(problem.gram, search.chosen)
    S = problem.gram.reduction(selector.columns(search.chosen)) - problem.gram.reduction(rest)
    own = S / variance - FAIR * len(candidate.columns)
    (joint,) = candidate.joints or (0,)
    columns = problem.soft(_columns(search, source, joint, rows_q[:, joint]))
    columns = columns - basis @ (basis.T @ columns)
    size = np.sum(columns**2, axis=0)
    seen = size > 1e-6 * size.max(initial=1e-300)
    taken = (columns[:, seen].T @ r) ** 2 / size[seen]
    # Centre and width are chosen too: they are parameters like the height.
    return bool(taken.max(initial=0.0) / variance - 3.0 * FAIR > own)


def _is_curve(candidate: Candidate) -> bool:
    """Whether it is a function of one joint's own angle, and nothing else."""
    return len(candidate.joints or ()) == 1 and not candidate.effects[0].needs and not candidate.empirical


def _columns(search: SearchResult, source: Source, joint: int, q: Floats) -> Floats:
    """Whitened effect (R, B) of rotating the joint by a bump of one radian, for all bumps."""
    rotated = source.joint_columns(search.problem.values)(joint)
    along = search.problem.settings.whitening.residual(rotated)
    span = float(np.ptp(q))
    centres = np.linspace(q.min(), q.max(), CENTRES)
    shapes = [np.exp(-0.5 * ((q - c) / (w * span)) ** 2) for c in centres for w in WIDTHS]
    return np.stack([(along * shape[:, None]).reshape(-1) for shape in shapes], axis=1)
