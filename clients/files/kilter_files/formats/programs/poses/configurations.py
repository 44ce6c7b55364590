"""What each language states of the posture at a pose: KRL's S and T, RAPID's confdata, FANUC's CONFIG."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from kilter_files.formats.programs.one_target import Branch, Span

CONFIG_TURNS = (0, 3, 5)  # FANUC: joints (from 0) whose full turns the three numbers of CONFIG state: J1, J4, J6
EDGE_DEG = 1e-6  # a joint nearer to the edge of a quadrant or of a full turn is on both sides of it


class StatusTurn(NamedTuple):
    """KRL: S says where wrist and elbow are, T of each joint whether it is negative; its third bit of S says no more."""

    status: int
    turn: int
    turn_text: str
    turn_span: Span

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch has this status."""
        return not branch.named or (branch.front != bool(self.status & 1) and branch.elbow_up == bool(self.status & 2))

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether a joint has the sign that T states."""
        return abs(value_deg) < 360.0 and _either(bool(self.turn >> k & 1), lambda q: q < 0.0, value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether wrist and elbow are still where S says; T is written anew."""
        return self.fits(branch)

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return T for these joints, where it is another."""
        turn = sum(1 << k for k, q in enumerate(joints_deg) if q < -0.0) | self.turn >> len(joints_deg) << len(
            joints_deg
        )
        if all(self.fits_joint(k, q) for k, q in enumerate(joints_deg)):
            return {}
        binary = "B" in self.turn_text.upper()
        return {self.turn_span: f"'B {turn:0{max(6, turn.bit_length())}b}'" if binary else str(turn)}


class ConfData(NamedTuple):
    """RAPID: the quadrants of axes 1, 4 and 6, and which of eight branches; the last stays as it is."""

    quadrants: tuple[int, int, int]
    branch: int
    spans: tuple[Span, Span, Span]

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch is the stated one."""
        return not branch.named or (branch.front != bool(self.branch & 4) and branch.elbow_up != bool(self.branch & 2))

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether a joint is in its quadrant, or axis 5 has its sign."""
        if k == 4:
            return _either(bool(self.branch & 1), lambda q: q < 0.0, value_deg)
        stated = dict(zip((0, 3, 5), self.quadrants, strict=True)).get(k)
        return stated is None or _either(stated, lambda q: math.floor(q / 90.0), value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether the branch is still the stated one, and axis 5 on its side; the other numbers are written anew."""
        return self.fits(branch) and _either(bool(self.branch & 1), lambda q: q < 0.0, joints_deg[4])

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return the quadrants for these joints that are others."""
        return {
            span: str(math.floor(joints_deg[k] / 90.0))
            for k, span in zip((0, 3, 5), self.spans, strict=True)
            if not self.fits_joint(k, joints_deg[k])
        }


class Config(NamedTuple):
    """FANUC: flip of the wrist by the sign of J5, elbow up, front, and the full turns of J1, J4 and J6."""

    flip: bool
    up: bool
    front: bool
    turns: tuple[int, int, int]
    spans: tuple[Span, Span, Span]

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch is the stated one."""
        return not branch.named or (branch.front == self.front and branch.elbow_up == self.up)

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether J1, J4 or J6 has its full rotations, or J5 its sign within half a rotation."""
        if k == 4:
            return abs(value_deg) <= 180.0 + EDGE_DEG and _either(self.flip, lambda q: q >= 0.0, value_deg)
        stated = dict(zip(CONFIG_TURNS, self.turns, strict=True)).get(k)
        return stated is None or _either(stated, _turns, value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether the branch is still the stated one, and axis 5 on its side; the other numbers are written anew."""
        return self.fits(branch) and _either(self.flip, lambda q: q >= 0.0, joints_deg[4])

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return the full turns for these joints that are others."""
        return {
            span: str(_turns(joints_deg[k]))
            for k, span in zip(CONFIG_TURNS, self.spans, strict=True)
            if not self.fits_joint(k, joints_deg[k])
        }


def _turns(value_deg: float) -> int:
    return math.floor((value_deg + 180.0) / 360.0)


def _either(stated: int, of: Callable[[float], int], value_deg: float) -> bool:
    """Whether a value, or one that differs by rounding only, is what was stated."""
    return stated in (of(value_deg - EDGE_DEG), of(value_deg + EDGE_DEG))
