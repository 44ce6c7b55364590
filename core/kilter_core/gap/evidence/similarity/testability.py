"""What these data can show before anything is tested (E4): visibility, smallest detectable amplitude, aliases."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.gap.evidence.similarity.similarity import correlations
from kilter_core.gap.search.candidates import FAMILY, Candidate, Library, Untestable
from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.observations import CONDITIONS, Observations
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Bools, Floats

DETECTED = 30.0  # post-geometry non-centrality that a 1 % family-wise test finds in 95 % of cases
BARELY = 1e-4  # share of a signature left off geometry below which errors of the geometry itself decide
NEVER = 1e6  # times the plausible: what would show only there is a signature of rounding errors
ALIASED = 0.9
SHOWN = 24
ABSORBED = "another kind of measurement: geometry imitates it"
TOO_SMALL = "more poses, or less noise: a plausible size would not show"


@dataclass(frozen=True)
class Testability:
    """Per library column (Q,): ``visible`` share, ``smallest`` detectable amplitude (SI), whether it is ``able``."""

    visible: Floats
    smallest: Floats
    able: Bools


def testability(problem: LinearizedProblem, library: Library) -> Testability:
    """Judge every column by the linearised problem at the geometry-only fit."""
    visible = np.clip(np.diag(problem.A), 0.0, 1.0)
    seen = (visible > max(BARELY, VISIBLE)) & (problem.scale > 0.0)
    with np.errstate(divide="ignore"):
        smallest = np.where(seen, np.sqrt(DETECTED / np.where(seen, visible, 1.0)) * problem.scale, np.inf)
    limit = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    return Testability(visible, smallest, seen & (smallest <= limit))


def through_loads(judged: Testability, found: Testability, library: Library) -> Testability:
    """What changes loads judged at the fit ``found``: it shows through effects of the load that were named by then."""
    late = _load_change_mask(library)
    visible, smallest = np.where(late, found.visible, judged.visible), np.where(late, found.smallest, judged.smallest)
    return Testability(visible, smallest, np.where(late, found.able, judged.able))


def to_search(judged: Testability, library: Library) -> Bools:
    """Columns (Q,) to search: the able ones, and those that may become so when an effect of the load is named."""
    return np.asarray(judged.able | _load_change_mask(library))


def _load_change_mask(library: Library) -> Bools:
    late = np.zeros(len(library.parameters), dtype=bool)
    late[[k for c in library.candidates if c.effects[0].changes_loads for k in c.columns]] = True
    return late


def untestable(
    library: Library, judged: Testability, problem: LinearizedProblem, rows: Observations
) -> tuple[Untestable, ...]:
    """Candidates that cannot be tested, one entry per effect and reason, with the remedy."""
    grouped: dict[tuple[str, str, str, str], list[int]] = {}
    whole: dict[tuple[str, str, str, str], None] = {}
    for c in library.candidates:
        if c.level == FAMILY or c.empirical or all(judged.able[k] for k in c.columns):
            continue
        if c.joints is None and any(judged.able[k] for k in c.columns):
            continue
        reason, missing = _reason(c, judged, problem, rows, library)
        key = (c.id, reason, c.effects[0].remedy, missing)
        if c.joints is None:
            whole[key] = None
        else:
            grouped.setdefault(key, []).extend(c.joints)
    made = [Untestable(i, tuple(sorted(set(j))), *rest) for (i, *rest), j in grouped.items()]
    return (*library.refused, *made, *(Untestable(i, None, *rest) for i, *rest in whole))


@dataclass(frozen=True)
class Visible:
    """A parameter that can be tested: its ``smallest`` amplitude that would be seen, in the SI ``unit``."""

    id: str
    parameter: str
    unit: str
    smallest: float
    visibility: float


def visible(library: Library, judged: Testability) -> Iterator[Visible]:
    """Every testable parameter."""
    for c in library.candidates:
        if c.level == FAMILY or c.empirical:
            continue
        for k in c.columns:
            if judged.able[k]:
                p = library.parameters[k]
                yield Visible(c.id, p.name, p.unit, float(judged.smallest[k]), float(judged.visible[k]))


def smallest_rows(library: Library, judged: Testability) -> list[dict[str, Any]]:
    """Smallest detectable amplitude of every testable parameter, in wire units."""
    out = []
    for seen in visible(library, judged):
        unit, scale = display_unit_and_scale(seen.unit)
        out.append(
            {
                "id": seen.id,
                "parameter": seen.parameter,
                "unit": unit,
                "smallest_detectable": seen.smallest * scale,
                "visibility": seen.visibility,
            }
        )
    return out


def alias_matrix(problem: LinearizedProblem, candidates: Sequence[Candidate], first: Sequence[int]) -> dict[str, Any]:
    """Correlations after geometry: a matrix over the chosen and their nearest, and every close pair of the library."""
    tested = [c for c in candidates if c.level != FAMILY]
    single = [c for c in tested if not c.empirical]
    C = correlations(problem.A, [c.columns for c in single])
    np.fill_diagonal(C, 1.0)
    pairs = [
        {
            "first": single[i].id_and_joints(),
            "second": single[j].id_and_joints(),
            "correlation": round(float(C[i, j]), 4),
        }
        for i, j in zip(*np.where(np.triu(C, 1) > ALIASED), strict=True)
    ]
    pairs.sort(key=lambda p: -float(p["correlation"]))
    shown = _select_matrix_candidates(single, C, [candidates[k] for k in first])
    return {
        "labels": [single[i].label for i in shown],
        "values": [[round(float(C[i, j]), 4) for j in shown] for i in shown],
        "pairs": pairs,
    }


def _select_matrix_candidates(single: Sequence[Candidate], C: Floats, chosen: Sequence[Candidate]) -> list[int]:
    columns = {k for c in chosen for k in c.columns}
    own = [i for i, c in enumerate(single) if columns & set(c.columns)]
    if not own:
        near = np.argsort(-np.sum(C > ALIASED, axis=1), kind="stable") if len(C) else np.zeros(0, dtype=int)
        return sorted(int(i) for i in near[:SHOWN])
    closest = np.argsort(-C[own].max(axis=0), kind="stable")
    return own + [int(i) for i in closest if int(i) not in own][: max(SHOWN - len(own), 0)]


def _reason(
    c: Candidate, judged: Testability, problem: LinearizedProblem, rows: Observations, library: Library
) -> tuple[str, str]:
    """Why a candidate cannot be tested, and what is missing for it in words that others share."""
    columns = list(c.columns)
    if c.effects[0].changes_loads and not np.all(judged.smallest[columns] < np.inf):
        return "It shows through effects of the load only, and none was named that shows it.", "an effect of the load"
    if np.all(problem.scale[columns] == 0.0):
        if "moments" in c.effects[0].needs:
            why = "No load moment acts there: gravity and payload put none on it, or the masses are not known."
            return why, "a load moment on the joint"
        return "It moves nothing in these observations: what it needs is constant zero.", "values other than zero"
    constant = _constant(c, rows)
    varied = f"variety: {constant}" if constant else ""
    if np.all(judged.visible[columns] <= BARELY):
        why = f" ({constant})" if constant else ""
        return f"The geometric parameters absorb it completely{why}.", varied or ABSORBED
    worst = int(columns[int(np.argmax(judged.smallest[columns]))])
    p = library.parameters[worst]
    plausible = max(abs(p.lower), abs(p.upper))
    if not judged.smallest[worst] < NEVER * plausible:
        why = f"{p.name} would show at no size: the geometric parameters absorb it, or nothing measured moves with it."
        return why, varied or ABSORBED
    unit, scale = display_unit_and_scale(p.unit)
    size = f"{judged.smallest[worst] * scale:.3g} {unit}".removesuffix(" 1")
    why = f"Only {p.name} above {size} would show, more than the plausible {plausible * scale:.3g}."
    return why, varied or TOO_SMALL


def _constant(c: Candidate, rows: Observations) -> str:
    needs = c.effects[0].needs
    if "direction" in needs and rows.direction is not None:
        own = rows.direction if c.joints is None else rows.direction[:, list(c.joints)]
        if np.all(np.ptp(own, axis=0) == 0.0):
            return "every pose was approached from one side"
    if "temperature_c" in needs and rows.temperature_c is not None and np.ptp(rows.temperature_c) < 0.1:
        return "the temperature was constant"
    one_payload = rows.payload_kg is None or math.isclose(float(np.ptp(rows.payload_kg)), 0.0)
    if "moments" in needs and one_payload and not rows.loads_on_links_vary:
        return "one load only"
    if "session" in needs and rows.session is not None and np.ptp(rows.session) == 0:
        return "one session only"
    if "qd" in needs and rows.qd is not None and not np.any(rows.qd):
        return "nothing moved"
    for name in sorted(needs & CONDITIONS.keys()):
        values = getattr(rows, name)
        if values is not None and not np.any(np.ptp(values, axis=0)):
            return f"{CONDITIONS[name]} was constant"
    return ""
