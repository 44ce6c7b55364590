"""What rows measured: the stack of the kinds whose columns they have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.kind import Block, Kind, Residual, Rows
from kilter_core.measurement.markers import resolve_marker_shape
from kilter_core.measurement.registry import KINDS
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.types import Floats


@dataclass(frozen=True)
class Measurement:
    """Rows as the kinds of measurement read them: of the tool first, then what was measured beside it.

    ``marker_points (m, 3)`` m are in the tool frame. With ``relative`` only distances between poses count.
    ``socket_distances`` m are known between pairs of sockets; ``anchor`` are the rows that say where contacts stand and
    what encoders and inclinometers read at zero, the rows' own when None. Without ``beside`` the tool alone counts.
    """

    observations: Observations
    marker_points: Floats | None = None
    relative: bool = False
    socket_distances: Mapping[tuple[int, int], float] = field(default_factory=dict)
    anchor: Measurement | None = None
    beside: bool = True

    @staticmethod
    def from_observations(
        observations: Observations,
        marker_points: Floats | None = None,
        *,
        relative: bool = False,
        held: bool = False,
        socket_distances: Mapping[tuple[int, int], float] | None = None,
        anchor: Measurement | None = None,
    ) -> Measurement:
        """Wrap observations; the markers' shape is taken from them unless given. Contacts are taken with ``held`` only.

        Raises:
            ObservationError: the rows say nothing of the tool, or what they say cannot be.
            TooFewPosesError: distances between fewer than five poses.

        """
        shape = resolve_marker_shape(observations, marker_points)
        made = Measurement(observations, shape, relative, dict(socket_distances or {}), anchor)
        if not made.kinds or not (made.tool.observes_places or relative or (held and made.tool.observes_tool)):
            raise ObservationError(
                "The observations hold no measured position: upload x_mm, y_mm, z_mm, or markers m1x_mm and so on. "
                "A log of joint torques alone is searched by `kilter gap`."
            )
        for kind in made.kinds:
            kind.check()
        return made

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds these rows have, that of the tool first."""
        anchor = () if self.anchor is None else self.anchor.kinds
        rows = Rows(self.observations, self.marker_points, self.relative, self.socket_distances, anchor)
        found = [kind for kind in (made.from_rows(rows) for made in KINDS) if kind is not None]
        tool = [kind for kind in found if kind.observes_tool][:1]
        return (*tool, *(kind for kind in found if not kind.observes_tool and self.beside))

    @property
    def tool(self) -> Kind:
        """What was measured of the tool."""
        return self.kinds[0]

    @property
    def pixels(self) -> Pixels | None:
        """What cameras saw, alone or beside the tool."""
        return next((cast("Pixels", kind) for kind in self.kinds if kind.name == Pixels.name), None)

    def of_tool(self) -> Measurement:
        """The same of the tool alone, in the rows that measured it."""
        seen = self.tool.measured_row_mask()
        alone = self if len(self.kinds) == 1 else replace(self, beside=False)
        return alone if seen.all() else replace(alone, observations=self.observations.select(seen))

    @property
    def observes_orientation(self) -> bool:
        """Whether the tool's orientation was measured, by itself or through markers."""
        return self.tool.observes_orientation

    @property
    def needs_turns(self) -> bool:
        """Whether a prediction must tell how the tool rotates with the parameters."""
        return any(kind.needs_turns for kind in self.kinds)

    @property
    def observes_base(self) -> bool:
        """Whether the rows are given in a frame of their own, so that the base has a place in it."""
        return self.tool.observes_base

    @property
    def observes_places(self) -> bool:
        """Whether a row tells by itself where the tool is: distances and contacts are between rows."""
        return self.tool.observes_places

    @property
    def reads_joints(self) -> bool:
        """Whether a prediction must tell what each joint rotates by."""
        return any(kind.reads_joints for kind in self.kinds)

    @property
    def fits_tool(self) -> bool:
        """Whether the tool has a place that is fitted: with views alone the places of boards and cameras take its part."""
        return not self.tool.places_itself or any(kind.places_ball for kind in self.kinds)

    @property
    def tells_scale(self) -> bool:
        """Whether lengths were measured, so that not everything may grow together."""
        return not self.tool.places_itself or any(kind.tells_scale for kind in self.kinds)

    @property
    def redundancy(self) -> float:
        """How many residuals of the tool there are for each number that is independent of the others."""
        return self.tool.redundancy

    def group_redundancy(self, group: str) -> float:
        """The same of a noise group."""
        return next((kind.redundancy for kind in self.kinds if kind.group == group), 1.0)

    @property
    def relative_tolerance(self) -> float:
        """Share of the loss that a step of a fit must promise to be worth taking, beside rounding."""
        return max(kind.relative_tolerance for kind in self.kinds)

    @property
    def equations_per_pose(self) -> int:
        """Numbers that one more pose brings."""
        return self.tool.equations_per_pose

    @property
    def poses(self) -> int:
        """Distinct poses in which the tool was measured."""
        return self.tool.poses

    def numbers(self) -> int:
        """Independent numbers of the tool in the distinct poses, repeats not counted."""
        return self.tool.numbers() + sum(kind.numbers() for kind in self.kinds if kind.follows_tool)

    def scalars(self) -> int:
        """Number of measured scalars that are independent."""
        return sum(kind.scalars() for kind in self.kinds)

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors of the tool by a calibration, (K, 3) m and rad (K,), in the units of what was measured."""
        return self.tool.errors(calibration)

    def residual(self, prediction: Prediction, J: Floats | None = None) -> Residual:
        """Residuals of a prediction; with the model's Jacobian ``J (N, 6, P)``, longer for joints, also theirs."""
        blocks: tuple[Block, ...] = ()
        for kind in self.kinds:
            blocks += kind.blocks(prediction, J)
        return Residual(blocks)
