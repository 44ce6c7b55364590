"""One blind run, as pure data: what is hidden, how large, how it is measured, what an honest finder would say."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tests.blind.generator.options import Options
from tests.blind.generator.outside import SMOOTH

WARM = {"thermal_growth", "zero_thermal", "link_growth", "column_bending", "link_lag"}
LOADED = {"tool_sag", "payload_error"}


@dataclass(frozen=True)
class Hidden:
    """An effect by id; ``joints`` from 0, empty for the whole arm (for a coupling: driven joint, driver)."""

    id: str
    joints: tuple[int, ...] = ()


@dataclass(frozen=True)
class Case:
    """One blind run. ``lam`` is the non-centrality of each hidden effect after geometry.

    ``expectation``: "no_gap" (nothing of the arm to name), "named", "outside" (nothing may be confirmed),
    "undecidable" (the effects ``undecidable`` are there, or could be, and no honest finder can tell).
    When ``demanded``, every effect is made large enough to be decided, and where none could be, the next of the
    ``alternatives`` is hidden instead.
    """

    name: str
    robot: str
    hidden: tuple[Hidden, ...]
    lam: tuple[float, ...]
    poses: int
    options: Options
    expectation: str
    seed: int
    undecidable: tuple[Hidden, ...] = field(default=())
    demanded: bool = False
    alternatives: tuple[tuple[Hidden, ...], ...] = field(default=())


def fitting(options: Options, hidden: tuple[Hidden, ...]) -> Options:
    """Conditions under which the hidden effects act at all."""
    ids = {h.id for h in hidden}
    if (ids & WARM or options.background in ("thermal", "column")) and options.temperature == "constant":
        options = replace(options, temperature="cycling")
    if "session_shift" in ids:
        options = replace(options, sessions=2)
    if ids & LOADED:
        options = replace(options, payload="two")
    curved = {h.joints[0] for h in hidden if h.id in SMOOTH}
    return replace(options, restricted=tuple(sorted({*options.restricted, *curved})))
