"""How a campaign is measured: everything that a case may draw, with defaults that make an easy one."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """How a campaign is measured. The defaults are an easy campaign: masses right, repeats stable, full ranges.

    ``approach`` "random" (each joint comes from a random side), "one_sided", or "path" (from where the last pose was).
    ``payload`` "two" (0 or the arm's, at random), "one", "none", or "correlated" (heavy where joint 2 reads high).
    ``temperature`` "constant", "cycling" or "warming" (with time). ``restricted`` joints (from 0) keep within 75 deg of
    the middle of their range. ``foot_m`` is the distance from the tracker (None: 2 to 4 m), ``lean_deg`` how far the
    foot is from level (None: 0.05 deg or so).

    ``revisited`` is the share of poses visited twice, every second of them unchanged. Of those ``spread`` come at any
    time, the others soon after; with ``stays`` the arm does not move between the two. A visit has ``repeats`` readings,
    ``shot_gap_s`` apart. ``outliers``: share of rows that are wrong; ``clustered``: share of visits that are wrong
    alike. ``background`` moves base or instrument slowly (see ``background.py``) so much that repeats pooled over
    the campaign scatter ``overstated`` times as much as they should.

    What the user believes: link masses within ``mass_error`` (a share) and centres of mass within ``com_error_mm`` of
    the true ones, the payload off by the share ``payload_error``; it hangs up to ``payload_offset_mm`` from the tool
    point. ``stated_priors``: the robot document says how far off its masses may be. ``confirmation``: a second
    campaign of the same arm on another day.
    """

    approach: str = "random"
    payload: str = "two"
    temperature: str = "constant"
    sessions: int = 1
    revisited: float = 0.4
    repeats: int = 3
    outliers: float = 0.0
    range_um: float = 5.0
    range_um_per_m: float = 0.5
    angle_urad: float = 3.0
    approach_um: float = 8.0
    restricted: tuple[int, ...] = ()
    foot_m: float | None = None
    lean_deg: float | None = None
    spread: float = 0.0
    stays: bool = False
    shot_gap_s: float = 0.5
    clustered: float = 0.0
    background: str = ""
    overstated: float = 1.0
    mass_error: float = 0.0
    com_error_mm: float = 0.0
    payload_error: float = 0.0
    payload_offset_mm: float = 0.0
    stated_priors: bool = False
    confirmation: bool = False
