"""What would raise a verdict: for each gate that was not passed, what to measure or to ask for."""

from __future__ import annotations

from kilter_core.gap.evidence.held_out.holding_out import POSES_TO_SPARE_SOME
from kilter_core.gap.evidence.verdict import Judged

REMEDIES = {
    "physical": "It has a shape and no cause: look for a cause outside the library.",
    "lasts": "Something else is left, or the noise is not known, and its own evidence does not reach: both halves of the "
    "campaign, or a confirmation, must show its name with the same amplitude and be predicted better by it. Repeat ten "
    "poses three times, leaving them in between, or measure more poses.",
    "held_out": "Held-out poses do not clearly gain by it: measure more poses.",
    "unseen_poses": f"No pose judged it that did not choose it: measure {POSES_TO_SPARE_SOME} poses or more (a quarter is "
    "then held out), give `validation`, or measure a `confirmation` campaign on another day.",
    "no_empirical_alias": "A shape without a cause does as well: measure the poses asked for, over more of the joint's range.",
    "plausible": "Its amplitude is not plausible for an arm: check units, masses and payloads.",
    "seen": "No parameter of it differs from zero by itself: measure more poses at its joints.",
    "inclusion": "Other poses of the same kind would not always name it: measure more poses.",
    "negative_control": "Its name comes back where labels are shuffled: vary what it depends on independently of the pose.",
    "sensor": "A sensor at the place does not show it: something else moved, or went with what this follows. Look at "
    "the instrument, and at the sensor's place, sign and unit.",
    "complete_geometry": "The robot's description lacks rotations of axes that explain the rows as well: describe the robot "
    "with a complete chain (convention poe, cpc or mcpc), and search again.",
    "confirmation": "The confirmation shows another amplitude, or errs more with it: look what changed between the campaigns.",
}


def to_confirm(judged: Judged) -> list[str]:
    """What is missing to a higher level, a sentence for each gate that was not passed, and one for those not tested."""
    untested = [name for name, passed in judged.gates.items() if passed is None]
    later = f"Not tested in the time: {', '.join(untested)}. Search again with a larger budget_s."
    failed = [REMEDIES[name] for name, passed in judged.gates.items() if passed is False]
    return [*failed, later] if untested else failed
