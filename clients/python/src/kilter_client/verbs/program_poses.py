"""Poses of a robot program: the nominal joints that each means, and the pose at which the nominal arm has others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from kilter_client.errors import RobotError
from kilter_client.files import files_formats
from kilter_client.requests.calls import robots
from kilter_client.requests.steps import Document, Steps

if TYPE_CHECKING:
    from kilter_files.formats import Branch, Found, JointTarget, PoseTarget, Program, Rigid, Span, Use

ALL_ROUND = (-720.0, 720.0)  # of a joint without limits
BEFORE = "the target before it is left too"
MOST_MISFIT = "most stated configurations of the program fit no posture of the robot"
SAME_DEG = 1e-6
MOST_TRIED = 20  # poses by which other signs are tried


@dataclass(frozen=True)
class ProgramJoints:
    """How joints of a program stand to those of the robot: ``signs``, and whether the robot's third is J2 + J3."""

    signs: Sequence[float]
    coupled: bool = False

    def of_robot(self, program: Sequence[float]) -> list[float]:
        """Return the joints of the robot."""
        q = [*program[:2], program[2] + program[1], *program[3:]] if self.coupled else [*program]
        return [sign * value for sign, value in zip(self.signs, q, strict=True)]

    def of_program(self, robot: Sequence[float]) -> list[float]:
        """Return the joints of the program."""
        q = [sign * value for sign, value in zip(self.signs, robot, strict=True)]
        return [*q[:2], q[2] - q[1], *q[3:]] if self.coupled else q


@dataclass(frozen=True)
class Understood:
    """Joints of the robot, deg, that poses mean, and why the others are left.

    ``suspicion`` says that the robot does not look like the arm of the program; empty: it does.
    """

    joints_deg: Mapping[PoseTarget, tuple[float, ...]]
    left: Mapping[PoseTarget, str]
    branches: Mapping[PoseTarget, Branch] = field(default_factory=dict)
    suspicion: str = ""


def understand(programs: Sequence[Program], robot: Document, joints: ProgramJoints) -> Steps[Understood]:
    """Find the joints that poses mean: one call for the joints that the targets before them have, one for the poses."""
    poses = _in_order(programs)
    if not poses:
        return Understood({}, {})
    if len(robot["joints"]) != 6:
        why = f"the robot has {len(robot['joints'])} joints, its inverse needs six. Give joint targets"
        return Understood({}, dict.fromkeys(poses, why))
    before = {id(use.near): use.near for pose in poses for use in pose.uses if _is_joints(use.near)}
    rows = [joints.of_robot(one.joints_deg) for one in before.values()]  # type: ignore[union-attr]
    name = str(robot["name"])
    try:
        known = (yield from robots.forward(name, rows)) if rows else []
        found = yield from robots.inverse(name, [*known, *(files_formats.to_document(_flange(pose)) for pose in poses)])
    except RobotError as error:
        return Understood({}, dict.fromkeys(poses, error.detail.rstrip(".")))
    return _chosen(poses, found, dict(zip(before, rows, strict=True)), _limits(robot), joints.signs)


def _in_order(programs: Sequence[Program]) -> list[PoseTarget]:
    """The poses whose frames are known, in the order of the moves to them where it is known."""
    visits = [one for program in programs for one in program.visits if isinstance(one, files_formats.PoseTarget)]
    rest = [pose for program in programs for pose in program.cartesian]
    return [pose for pose in dict.fromkeys([*visits, *rest]) if not pose.reason_left_unresolved()]


def _is_joints(near: JointTarget | PoseTarget | None) -> bool:
    return isinstance(near, files_formats.JointTarget)


def _limits(robot: Document) -> list[tuple[float, float]]:
    bounds = [joint.get("limits_deg") or (None, None) for joint in robot["joints"]]
    low, high = ALL_ROUND
    return [(low if lower is None else lower, high if upper is None else upper) for lower, upper in bounds]


def _flange(pose: PoseTarget) -> Rigid:
    """The flange in the frame of the robot's root."""
    bases, tool = pose.frames()
    placed = files_formats.Rigid()
    for base in bases:
        placed = placed.compose_frames(base.pose())
    return placed.compose_frames(pose.notation.pose(pose.numbers)).compose_frames(tool.pose().inverse())


def _chosen(
    poses: Sequence[PoseTarget],
    found: Sequence[robots.Reaching],
    before: Mapping[int, Sequence[float]],
    limits: Sequence[tuple[float, float]],
    signs: Sequence[float],
) -> Understood:
    known: dict[int, Found | str] = {}
    for (near, joints), reaching in zip(before.items(), found, strict=False):
        known[near] = (
            files_formats.find_posture_with_joints(joints, reaching.postures)
            or "the target before it is at a singularity"
        )
    following: dict[PoseTarget, Sequence[Document]] = {}
    for pose, (postures, certain) in zip(poses, found[len(before) :], strict=True):
        if not certain:
            known[id(pose)] = files_formats.NOT_CERTAIN
        elif pose.active_configuration is not None and not any(use.follows for use in pose.uses):
            known[id(pose)] = files_formats.by_configuration(pose.active_configuration, postures, limits, signs)
        else:
            following[pose] = postures
    _follow(following, known, limits, signs)
    joints_deg, left, branches = {}, {}, {}
    for pose in poses:
        one = known[id(pose)]
        if isinstance(one, str):
            left[pose] = one
        else:
            joints_deg[pose], branches[pose] = one.joints_deg, one.branch
    doubtful = _suspicion(poses, dict(zip(poses, found[len(before) :], strict=True)), left, limits, signs)
    if doubtful:  # what fits by chance is another posture
        return Understood({}, {pose: left.get(pose, MOST_MISFIT) for pose in poses}, {}, doubtful)
    return Understood(joints_deg, left, branches)


def _suspicion(
    poses: Sequence[PoseTarget],
    found: Mapping[PoseTarget, robots.Reaching],
    left: Mapping[PoseTarget, str],
    limits: Sequence[tuple[float, float]],
    signs: Sequence[float],
) -> str:
    """Say that most stated configurations fit no posture of the arm, and by which signs they would; empty: they do."""
    stated = [pose for pose in poses if pose.active_configuration is not None]
    misfits = [pose for pose in stated if left.get(pose) == files_formats.NO_SUCH]
    if len(misfits) < 2 or 2 * len(misfits) < len(stated):
        return ""
    sample = [
        (pose.active_configuration, found[pose].postures)
        for pose in misfits[:MOST_TRIED]
        if pose.active_configuration is not None
    ]
    other = files_formats.fitting_signs(sample, limits, signs)
    said = f"{len(misfits)} of {len(stated)} stated configurations fit no posture of the robot. "
    if other is not None:
        return (
            f"{said}They fit with --signs {','.join('+' if sign > 0 else '-' for sign in other)}: check it at the arm."
        )
    return (
        f"{said}Its zero, its limits or the coupling of joint 3 are not the controller's: compare kilter robot check."
    )


def _follow(
    following: Mapping[PoseTarget, Sequence[Document]],
    known: dict[int, Found | str],
    limits: Sequence[tuple[float, float]],
    signs: Sequence[float],
) -> None:
    """Find the joints of poses that follow others: from any move whose start is known, then checked by all moves.

    A path may come back to a pose (approach, work, approach). What one move says holds if each further move confirms it.
    """
    again = True
    while again:
        again = False
        for pose, postures in following.items():
            use = next((use for use in pose.uses if _has_known_posture(pose, use, known)), None)
            if use is not None and id(pose) not in known:
                known[id(pose)] = _by_use(pose, use, postures, known, limits, signs)
                again = True
    again = True
    while again:
        again = False
        for pose, postures in following.items():
            if not isinstance(known.get(id(pose)), str):
                checked = _by_all_uses(pose, postures, known, limits, signs)
                again = again or isinstance(checked, str)
                known[id(pose)] = checked


def _has_known_posture(pose: PoseTarget, use: Use, known: Mapping[int, Found | str]) -> bool:
    """Say whether a move tells the posture: by what the pose states, or by a start that is known."""
    stated = pose.configuration is not None and not use.follows
    return stated or not isinstance(known.get(id(use.near), ""), str)


def _by_use(
    pose: PoseTarget,
    use: Use,
    postures: Sequence[Document],
    known: Mapping[int, Found | str],
    limits: Sequence[tuple[float, float]],
    signs: Sequence[float],
) -> Found | str:
    """The posture that a controller takes by one move."""
    if pose.configuration is not None and not use.follows:
        return files_formats.by_configuration(pose.configuration, postures, limits, signs)
    near = known.get(id(use.near), BEFORE)
    if use.near is None:
        return files_formats.not_followed(use.follows)
    return (
        BEFORE
        if isinstance(near, str)
        else files_formats.select_following_posture(near, postures, limits, straight=use.straight)
    )


def _by_all_uses(
    pose: PoseTarget,
    postures: Sequence[Document],
    known: Mapping[int, Found | str],
    limits: Sequence[tuple[float, float]],
    signs: Sequence[float],
) -> Found | str:
    """The posture that a controller takes by each move to a pose; all moves must come to the same."""
    chosen: list[Found] = []
    for use in pose.uses:
        one = _by_use(pose, use, postures, known, limits, signs)
        if isinstance(one, str):
            return one
        chosen.append(one)
    apart = max(math.dist(one.joints_deg, chosen[0].joints_deg) for one in chosen)
    return chosen[0] if apart < SAME_DEG else files_formats.DIFFERENT


def not_kept(
    robot: str, corrected: Sequence[tuple[PoseTarget, Sequence[float]]], understood: Understood, joints: ProgramJoints
) -> Steps[dict[PoseTarget, str]]:
    """Name the poses at which the controller would not find these corrected joints of the robot (deg) by what is stated."""
    flanges = (yield from robots.forward(robot, [q for _, q in corrected])) if corrected else []
    found = (yield from robots.inverse(robot, flanges)) if flanges else []
    out: dict[PoseTarget, str] = {}
    for (pose, q), reaching in zip(corrected, found, strict=True):
        one, stated = files_formats.find_posture_with_joints(q, reaching.postures), pose.active_configuration
        if one is None:
            out[pose] = "the correction takes it to a singularity"
        elif not (
            one.branch == understood.branches[pose]
            if stated is None
            else stated.keeps(one.branch, joints.of_program(q))
        ):
            out[pose] = "the correction takes it past a singularity, to another configuration"
    return out


def rewritten(
    robot: str,
    places: Sequence[tuple[Program, PoseTarget]],
    joints_deg: Sequence[Sequence[float]],
    joints: ProgramJoints,
) -> Steps[list[dict[Span, str]]]:
    """Write each pose anew, so that the nominal arm has these joints of the robot there: texts by their places."""
    flanges = (yield from robots.forward(robot, joints_deg)) if places else []
    out: list[dict[Span, str]] = []
    for (program, pose), flange, q in zip(places, flanges, joints_deg, strict=True):
        bases, tool = pose.frames()
        placed = files_formats.of_document(flange).compose_frames(tool.pose())
        for base in bases:
            placed = base.pose().inverse().compose_frames(placed)
        numbers = pose.notation.nearest_numbers(placed, pose.numbers)
        moved = [pose.notation.is_number_changed(k, old, numbers[k]) for k, old in enumerate(pose.numbers)]
        decimals = pose.notation.decimals
        new = {
            span: files_formats.written(program.text[slice(*span)], numbers[k], decimals[k])
            for k, span in enumerate(pose.spans)
            if moved[k] or (pose.computed is not None and any(moved))
        }
        new |= (
            dict(pose.active_configuration.edits_for_joints(joints.of_program(q)))
            if pose.active_configuration is not None
            else {}
        )
        out.append(new if pose.computed is None or not new else pose.computed.edits(new))
    return out
