"""What an effect is: configuration, parameters, and local corrections with exact derivatives. Nothing else."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.errors import OptionError
from core.parameters import Parameter
from core.robot import Robot

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """The conditions of N rows as effects may read them, SI.

    ``wrench (N, n, 6)`` is the load on each joint; ``axial (N, n)`` its part that works on the joint: the moment about
    the axis of a revolute joint (N·m), the force along that of a prismatic one (N). ``end_wrench``, ``base_wrench`` and
    ``tool_point`` are those of :class:`~core.moments.Loads`, ``link_vectors (n + 1, 3)`` those of the chain. An effect declares what it reads in ``needs``; anything not measured is None.
    """

    q: Floats
    wrench: Floats
    axial: Floats
    end_wrench: Floats
    base_wrench: Floats
    tool_point: Floats
    link_vectors: Floats
    direction: Floats | None = None
    qd: Floats | None = None
    qdd: Floats | None = None
    t: Floats | None = None
    temperature_c: Floats | None = None
    payload_kg: Floats | None = None
    session: NDArray[np.int64] | None = None

    @property
    def moment(self) -> Floats:
        """Load moments (N, n, 3) in the joint frames: x and y across the axis, z about it."""
        return self.wrench[:, :, 3:]

    def __len__(self) -> int:
        return int(self.q.shape[0])


BASE, TOOL = -1, -2  # places of a twist besides the joints: right after the base frame, and on the tool


@dataclass(frozen=True)
class Derivative:
    """Change of one local correction by one parameter.

    ``dq (N,)`` and ``xi (N, 6)`` belong to ``joint`` (``xi`` may also sit at :data:`BASE` or :data:`TOOL`);
    ``scale (N,)`` to the measurement.
    """

    parameter: int
    joint: int = BASE
    dq: Floats | None = None
    xi: Floats | None = None
    scale: Floats | None = None


@dataclass(frozen=True)
class Local:
    """Local corrections of N rows.

    ``dq (N, n)`` is added to the joints; ``xi (N, n, 6)`` are small twists (v, w) in the joint frames, ``base (N, 6)``
    in the base frame and ``tool (N, 6)`` in the tool frame; ``scale (N,)`` stretches the measured position about the
    origin of the measurements.
    """

    dq: Floats | None = None
    xi: Floats | None = None
    base: Floats | None = None
    tool: Floats | None = None
    scale: Floats | None = None
    derivatives: tuple[Derivative, ...] = ()


@dataclass(frozen=True)
class Effect(ABC):
    """One physical error source. ``joints`` are the joints it acts on, from 0; None means all."""

    id: ClassVar[str]
    summary: ClassVar[str]
    source: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()
    stage: ClassVar[str] = "joint"  # or "base", or "measurement": an error of the instrument, never corrected on the arm

    joints: tuple[int, ...] | None = None

    @abstractmethod
    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Parameters of the effect on this robot, in the order of ``values``."""

    @abstractmethod
    def local(self, batch: Batch, values: Floats) -> Local:
        """Local corrections and their derivatives at ``values (P,)``."""

    def acting(self, n: int) -> tuple[int, ...]:
        """Joints the effect acts on, for an arm of n joints."""
        return tuple(range(n)) if self.joints is None else self.joints

    def missing(self, available: frozenset[str]) -> frozenset[str]:
        """Columns the effect needs and the data do not have."""
        return self.needs - available

    def to_document(self) -> dict[str, Any]:
        """JSON-able configuration: ``id`` and every field, joints counted from 1."""
        document: dict[str, Any] = {"id": self.id}
        for field in fields(self):
            value = getattr(self, field.name)
            document[field.name] = [j + 1 for j in value] if field.name == "joints" and value is not None else value
        return document

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Effect:
        """Build the effect from :meth:`to_document`.

        Raises:
            OptionError: a field the effect does not have.

        """
        config = {k: v for k, v in document.items() if k != "id"}
        unknown = set(config) - {f.name for f in fields(cls)}
        if unknown:
            raise OptionError(f"Effect {cls.id} has no option {sorted(unknown)[0]!r}.", effect=cls.id)
        joints = config.get("joints")
        if joints is not None:
            config["joints"] = tuple(int(j) - 1 for j in joints)
        return cls(**config)

    def per_joint(self, robot: Robot, stem: str, unit: str, sigma: float, lower: float, upper: float, text: str) -> tuple[Parameter, ...]:
        """One parameter per acting joint, named ``<stem>_<joint>``."""
        joints = self.acting(robot.n_joints)
        outside = [j + 1 for j in joints if not 0 <= j < robot.n_joints]
        if outside:
            raise OptionError(f"Effect {self.id} names joint {outside[0]}; the robot has {robot.n_joints}.", effect=self.id)
        return tuple(Parameter(f"{stem}_{j + 1}", unit, 0.0, sigma, lower, upper, text) for j in joints)

    def joint_angle(self, batch: Batch, values: Floats, signal: Floats) -> Local:
        """Local correction ``dq_j = value_j * signal_j`` of every acting joint; ``signal (N, n)``."""
        dq = np.zeros_like(batch.q)
        derivatives = []
        for k, j in enumerate(self.acting(batch.q.shape[1])):
            dq[:, j] = values[k] * signal[:, j]
            derivatives.append(Derivative(k, j, dq=signal[:, j]))
        return Local(dq=dq, derivatives=tuple(derivatives))


def soft_sign(x: Floats, width: float) -> Floats:
    """sign(x), or tanh(x / width) when ``width`` > 0: a sign read from a noisy moment is not a step."""
    return np.sign(x) if width <= 0.0 else np.tanh(x / width)

