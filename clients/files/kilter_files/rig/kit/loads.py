"""Which way gravity pulls each joint over the views: where it is always the same way, backlash and zero are one number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kilter_files.ground.arrays import Bools, Floats
from kilter_files.ground.later import np
from kilter_files.rig.kit.examples import Examples, Sought, format_examples
from kilter_files.rig.kit.moments import gravity_moments

LEAST_LOAD_NM = 0.05  # well beyond the friction of a servo: it rests on one flank then
FEWEST_EITHER_WAY = 6  # views
CLEARLY = 0.5  # of the most that gravity can pull so: whoever comes near an example still has the other way


@dataclass(frozen=True)
class Pulled:
    """How many views gravity pulls a joint the one way, and the other; ``wanted`` more of the fewer.

    ``examples_deg`` are readings at which it pulls the fewer way, those near views that are there first; none where none is
    within the limits, or none is wanted. ``shown`` says whether the camera sees the board there; None where the views do not
    say where camera and board stand.
    """

    joint: int
    name: str
    views: int
    more: int
    fewer: int
    wanted: int
    examples_deg: Examples
    shown: bool | None = None

    @property
    def missing(self) -> str | None:
        """What to photograph; None where nothing is missing, or the arm cannot."""
        if not self.examples_deg:
            return None
        sees = (
            "where the camera sees the board"
            if self.shown
            else "rotating the first and the last joint until the camera sees the board: these views do not say where it stands"
        )
        return (
            f"views in which gravity pulls joint {self.joint} ({self.name}) the other way: it does in {self.fewer} of "
            f"{self.views}, take {self.wanted} more, for example near {format_examples(self.examples_deg)}, {sees}"
        )

    @property
    def untold(self) -> str | None:
        """Why backlash of this joint cannot be told; None where it can."""
        if not self.wanted:
            return None
        cannot = "" if self.examples_deg else ", and within the limits of the joints no pose changes that"
        if self.shown is False:
            cannot = (
                ", and at no pose that changes that does the camera see the board: move the camera, or fix the board to "
                "another side of the gripper, and take all views anew"
            )
        return (
            f"the backlash of joint {self.joint} ({self.name}) cannot be told from its zero: gravity pulls it the other way "
            f"in {self.fewer} of {self.views} views only{cannot}"
        )


def gravity_loaded_joints(joints: int) -> range:
    """Joints, from 1, that gravity loads: the first is vertical, the last carries no moment about itself."""
    return range(2, joints)


def count_gravity_directions(sought: Sought, payloads_kg: Sequence[float]) -> list[Pulled]:
    """Count the views by the way in which gravity pulls each joint; nothing where the chain does not tell its loads.

    The views are those ``sought.seen`` (N, n), with ``payloads_kg`` (N,). Examples are poses at which one of its sights shows
    the board, where there are any.
    """
    q = sought.seen
    moments = gravity_moments(sought.chain, q, np.array(payloads_kg, dtype=float))
    if moments is None:
        return []
    lacking, found = dict[int, float](), []
    for joint in gravity_loaded_joints(q.shape[1]):
        up = int(np.sum(moments[:, joint - 1] > LEAST_LOAD_NM))
        down = int(np.sum(moments[:, joint - 1] < -LEAST_LOAD_NM))
        wanted = max(0, FEWEST_EITHER_WAY - min(up, down))
        if wanted:
            lacking[joint] = 1.0 if up < down else -1.0
        name = str(sought.chain["joints"][joint - 1]["name"])
        found.append((joint, name, len(q), max(up, down), min(up, down), wanted))
    examples = _examples(sought, sorted(set(payloads_kg)), lacking) if lacking else {}
    return [Pulled(*one, *examples.get(one[0], ((), None))) for one in found]


def _examples(
    sought: Sought, payloads: Sequence[float], lacking: Mapping[int, float]
) -> dict[int, tuple[Examples, bool | None]]:
    """For each joint poses at which gravity pulls it the way that is lacking, and whether the board is seen there."""
    ends, tried = sorted({payloads[0], payloads[-1]}), sought.grid_poses
    moments = [gravity_moments(sought.chain, tried, np.full(len(tried), kg)) for kg in ends]
    return {
        joint: sought.nearest(_pulls([sign * one[:, joint - 1] for one in moments if one is not None]))
        for joint, sign in lacking.items()
    }


def _pulls(each: Sequence[Floats]) -> Bools:
    """Where gravity pulls clearly, with any payload if it can, else with one of them."""
    weakest, strongest = np.min(each, axis=0), np.max(each, axis=0)
    pull = weakest if weakest.max() > LEAST_LOAD_NM else strongest
    return np.asarray(pull > max(CLEARLY * float(pull.max()), LEAST_LOAD_NM))
