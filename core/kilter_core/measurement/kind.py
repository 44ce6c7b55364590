"""The interface of a kind of measurement: what it leaves of a prediction, how that follows the parameters, and its noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats

Unit = Literal["m", "rad"]

POINTS, TURNS = "points", "turns"  # noise groups of what most kinds measure: where the tool is, and how it is oriented


@dataclass(frozen=True)
class Spanned:
    """Derivatives of rows that follow a few numbers each, such as the six of a pose: ``span (V, R, c)`` by those, zero where
    nothing was measured, and how those follow the parameters, ``inner (V, c, P)``.
    """

    span: Floats
    inner: Floats

    @cached_property
    def short(self) -> tuple[Floats, Floats]:
        """Orthonormal ``Q (V, R, k)`` and derivatives (V, k, P) of as many numbers, which say all that the rows say."""
        Q, R = np.linalg.qr(self.span)
        return Q, R @ self.inner

    def of_short(self, r: Floats) -> Floats:
        """What residuals ``r`` of the rows, zero where nothing was measured, say of these numbers (V, k)."""
        return np.asarray((r.reshape(len(r), 1, -1) @ self.short[0])[:, 0])


@dataclass(frozen=True)
class Block:
    """Residuals ``r (V, k, w)``, measured minus predicted, NaN where nothing was measured.

    ``slopes (V, k, w, P)`` is the derivative of the prediction (minus the residual's), as it is or spanned. A robust loss
    weighs each vector of ``w`` numbers as one. Blocks of one noise ``group`` share a standard deviation, in ``unit``.
    """

    group: str
    r: Floats
    slopes: Floats | Spanned | None = None
    unit: Unit = "m"

    @cached_property
    def J(self) -> Floats | None:
        """The derivative (V, k, w, P)."""
        if not isinstance(self.slopes, Spanned):
            return self.slopes
        return np.asarray((self.slopes.span @ self.slopes.inner).reshape(*self.r.shape, -1))

    def beyond(self, step: Floats) -> Block:
        """The same after a small ``step (P,)`` of the parameters; the Jacobian stays."""
        assert self.slopes is not None
        if isinstance(self.slopes, Spanned):
            change = (self.slopes.span @ (self.slopes.inner @ step)[:, :, None]).reshape(self.r.shape)
        else:
            change = self.slopes @ step
        return Block(self.group, self.r - change, self.slopes, self.unit)


@dataclass(frozen=True)
class Residual:
    """What all kinds leave of their rows, a block for each noise group of a kind; that of the tool's points comes first."""

    blocks: tuple[Block, ...]

    @property
    def points(self) -> Floats:
        """Of points (N, m, 3) m, or of lengths (M, m, 1); NaN where a marker was not seen."""
        return self.blocks[0].r

    @property
    def d_points(self) -> Floats | None:
        """Derivative (..., P) of the predicted points."""
        return self.blocks[0].J

    @property
    def turns(self) -> Floats | None:
        """Of the tool's orientation (N, 3) rad, None where it was not measured by itself."""
        return next((b.r[:, 0] for b in self.blocks if b.group == TURNS), None)

    @property
    def d_turns(self) -> Floats | None:
        """Derivative (N, 3, P) of the predicted orientation."""
        return next((b.J[:, 0] for b in self.blocks if b.group == TURNS and b.J is not None), None)

    def of_points(self) -> Residual:
        """What is left of the points alone."""
        return Residual(self.blocks[:1])

    @cached_property
    def residuals_by_row(self) -> Floats:
        """All residuals (N, R) of each row, where every block has the same rows."""
        parts = [b.r.reshape(len(b.r), -1) for b in self.blocks]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def derivatives(self, columns: int) -> Floats:
        """Derivatives (N, R, columns) of the prediction, as :attr:`residuals_by_row` has the residuals."""
        made = [b.J.reshape(len(b.r), -1, columns) for b in self.blocks if b.J is not None]
        return made[0] if len(made) == 1 else np.concatenate(made, axis=1)

    def by_row(self, flat: Floats, rows: int) -> Floats:
        """Numbers (R, ...) of all residuals, in the order of the blocks, as (N, R / N, ...)."""
        parts, start = [], 0
        for block in self.blocks:
            parts.append(flat[start : start + block.r.size].reshape(rows, -1, *flat.shape[1:]))
            start += block.r.size
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class Rows:
    """What a kind is made from: rows, the known shape of the markers, and how the rows are to be read.

    With ``relative`` only distances between poses count. ``socket_distances`` m are known between pairs of sockets.
    ``anchor`` are the kinds of the rows that say where contacts stand and what encoders read at zero.
    """

    observations: Observations
    marker_points: Floats | None = None
    relative: bool = False
    socket_distances: Mapping[tuple[int, int], float] = field(default_factory=dict)
    anchor: tuple[Kind, ...] = ()


class Kind(ABC):
    """Rows as one kind of measurement reads them. A kind is one file; adding it takes a line in the registry besides."""

    name: ClassVar[str]
    summary: ClassVar[str]
    unit: ClassVar[Unit] = "m"
    group: ClassVar[str] = POINTS  # noise group of its first block, where it tells of the tool
    observes_tool: ClassVar[bool] = False  # tells where the tool is: rows need one such kind, and it comes first
    observes_base: ClassVar[bool] = False  # given in a frame of its own, in which the base has a place

    follows_tool: ClassVar[bool] = (
        False  # its rows follow the tool's pose, beside another kind that tells where the tool is
    )
    places_itself: ClassVar[bool] = False  # has frames of its own in place of those of base and tool
    places_ball: ClassVar[bool] = False  # tells where on the tool its ball is, and not how the tool is rotated
    plain_fits_only: ClassVar[bool] = False  # no method, loss or interval that treats its rows one by one

    observations: Observations

    @classmethod
    @abstractmethod
    def from_rows(cls, rows: Rows) -> Kind | None:
        """Read the rows; None where they hold nothing of this kind."""

    @abstractmethod
    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Residuals of a prediction; with the model's Jacobian ``J (N, R, P)`` also theirs.

        Rows 0-2 of the Jacobian are the tool's position, 3-5 its rotation vector, and the rest, where :attr:`reads_joints`,
        what the joints rotate by: :data:`~kilter_core.model.prediction.JOINT_ROWS` for each, the base last.
        """

    def row_errors(self, calibration: Calibration) -> tuple[Floats, Floats, Floats]:
        """Errors (N, 3) m and (N,) rad of the tool by each row, and their length (N,) in standard deviations.

        Raises:
            ObservationError: rows that tell where the tool is only together.

        """
        raise ObservationError(
            "Contacts and distances tell where the tool is only together, so none of these rows has an error of its own: "
            "evaluate them (kilter version evaluate), or name other campaigns."
        )

    def check(self) -> None:
        """Refuse rows that cannot be of this kind.

        Raises:
            ObservationError, TooFewPosesError: what cannot be, and the remedy.

        """
        return

    def measured_row_mask(self) -> Bools:
        """Rows (N,) in which it measured anything."""
        return np.ones(len(self.observations), dtype=bool)

    @property
    def observes_places(self) -> bool:
        """Whether a row tells by itself where the tool is; it does not where only lengths between rows are known."""
        return self.observes_tool and self.observes_base

    @property
    def observes_orientation(self) -> bool:
        """Whether the tool's orientation was measured, by itself or through markers."""
        return False

    @property
    def needs_turns(self) -> bool:
        """Whether its Jacobian follows that of the tool's orientation."""
        return self.observes_orientation

    @property
    def reads_joints(self) -> bool:
        """Whether the prediction and its Jacobian must tell what each joint rotates by."""
        return False

    @property
    def equations_per_pose(self) -> int:
        """Numbers that one more pose brings."""
        return 3

    @property
    def tells_scale(self) -> bool:
        """Whether it knows a length between rows that a larger arm would contradict; asked of what is beside views."""
        return False

    @property
    def redundancy(self) -> float:
        """How many residuals there are for each number that is independent of the others."""
        return 1.0

    @property
    def relative_tolerance(self) -> float:
        """Share of the loss that a step of a fit must promise to be worth taking, beside rounding."""
        return 0.0

    def numbers(self) -> int:
        """Independent numbers of the distinct poses, repeats not counted."""
        return self.poses * self.equations_per_pose

    @property
    def poses(self) -> int:
        """Distinct poses in which it measured anything."""
        return len(np.unique(self.observations.pose_groups()[self.measured_row_mask()]))

    @abstractmethod
    def scalars(self) -> int:
        """Number of measured scalars that are independent."""

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 3) of points, or (K, 1), and (K,) rad of orientations, in the units of what was measured."""
        blocks = self.blocks(calibration.predict(self.observations))
        points = blocks[0].r.reshape(-1, blocks[0].r.shape[-1])
        turns = next((np.linalg.norm(b.r[:, 0], axis=1) for b in blocks if b.group == TURNS), None)
        return points[~np.isnan(points).any(axis=1)], None if turns is None else turns[~np.isnan(turns)]


class ToolKind(Kind):
    """A kind whose rows tell where the tool is, in one column (N, ..., 3) in the frame of an instrument."""

    observes_tool = True
    observes_base = True
    with_orientation: ClassVar[bool] = False  # a pose's own, or that of several markers, which move together

    @property
    @abstractmethod
    def column(self) -> Floats:
        """What was measured, NaN where nothing was."""

    @property
    def observes_orientation(self) -> bool:
        """Whether the tool's orientation was measured too."""
        return self.with_orientation

    @property
    def equations_per_pose(self) -> int:
        """Three of the position; three more of the orientation, however many markers tell it."""
        return 6 if self.with_orientation else 3

    def measured_row_mask(self) -> Bools:
        """Rows that have any of it."""
        return seen_row_mask(self.column)

    def scalars(self) -> int:
        """Coordinates that were seen."""
        return int(np.count_nonzero(~np.isnan(self.column)))


def find_anchor(name: str, rows: Rows) -> Kind | None:
    """The kind of this name among the rows that hold what it has of its own."""
    return next((kind for kind in rows.anchor if kind.name == name), None)


def seen_row_mask(values: Floats) -> Bools:
    """Rows (N,) that have any of the values (N, ...)."""
    return np.asarray(~np.isnan(values).reshape(len(values), -1).all(axis=1))
