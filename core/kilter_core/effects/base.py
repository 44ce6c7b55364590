"""What an effect is: configuration, parameters, and local corrections with exact derivatives. Nothing else."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.load_slopes import LoadSlopes
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import PhysicalClass, Separator
from kilter_core.errors import ObservationError, OptionError
from kilter_core.observations import CONDITIONS, Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

PRISMATIC_LEVER_M = 0.1  # what the prior of a radian becomes at a prismatic joint
_PRISMATIC_UNITS = {
    "rad": "m",
    "rad/(N m)": "m/N",
    "rad/(N m)2": "m/N2",
    "rad/s": "m/s",
    "rad/K": "m/K",
}

SHORTEST_M = 1e-6  # of a link that has a length
BASE, TOOL = -1, -2  # places of a twist besides the joints: right after the base frame, and on the tool
# Places of a twist of a frame, with their units.
TWIST = (("x", "m"), ("y", "m"), ("z", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad"))


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


def linear(batch: Batch, values: Floats, derivatives: Iterable[Derivative]) -> Local:
    """Local corrections of an effect that is linear in its parameters: the sum of value times derivative."""
    rows, n = batch.q.shape
    derivatives = tuple(derivatives)
    shapes = {"dq": (rows, n), "xi": (rows, n, 6), "base": (rows, 6), "tool": (rows, 6), "scale": (rows,)}
    sums: dict[str, Floats] = {}

    def total(name: str) -> Floats:
        return sums.setdefault(name, np.zeros(shapes[name]))

    for d in derivatives:
        value = values[d.parameter]
        at_end = {BASE: "base", TOOL: "tool"}.get(d.joint)
        for name, amount in (("dq", d.dq), (at_end or "xi", d.xi), ("scale", d.scale)):
            if amount is None:
                continue
            whole = total(name)
            if value != 0.0:
                here = whole[:, d.joint] if name in ("dq", "xi") else whole
                here += value * amount
    return Local(**sums, derivatives=derivatives)


SOFTENING = "Half-width over which the sign of the load changes, N m, 0 or more; one for all joints, or one for each."


def option(default: Any, text: str, **limits: Any) -> Any:
    """Declare an option: its default, its sentence, and its range: ``low``, ``above``, ``high``, ``below``, or ``choices``."""
    return field(default=default, metadata={"text": text, **limits})


@dataclass(frozen=True)
class Effect(ABC):
    """One physical error source. ``joints`` are the joints it acts on, from 0; None means all it can act on.

    The class says what a search for missing effects must know: the ``physical`` class it belongs to, what its name is
    ``separated_by`` from the others of that class (empty: by its rivals alone), ``needs`` (columns), ``stage``,
    ``signs`` ("positive" when physics fixes the sign of the parameters), ``aliases`` (ids whose signatures come nearest),
    ``remedy`` (what to measure so that it can be tested or distinguished), ``empirical`` (a shape without a cause),
    ``at_joints`` (whether
    ``joints`` choose where it acts), ``learned`` (never searched; kept only if it predicts held-out poses better),
    ``supple`` (imitates many others, so that holding their shape says nothing), and ``nuisance`` (never searched; carried
    beside the others with its prior). One that ``changes_loads`` moves nothing of its own: the others read the loads that
    it leaves. ``glances`` are columns that it reads where they are there and can do without. An ``event`` is placed by the
    search itself, at the row where it explains most. ``reads`` names the loads of the batch that an effect reads and
    their components; what it does at a joint follows that joint's loads alone. A ``sided`` one has a side, by the sign of the
    load or of the motion. ``clock`` is the column of the slow clock that it follows and nothing else: "t", "temperature_c",
    or none. ``rarer`` says how many times less common it is than other causes that move an arm alike: among
    explanations as good as one another the common one is named, and this one beside it.
    """

    id: ClassVar[str]
    summary: ClassVar[str]
    source: ClassVar[str]
    physical: ClassVar[PhysicalClass]
    separated_by: ClassVar[tuple[Separator, ...]] = ()
    needs: ClassVar[frozenset[str]] = frozenset()
    stage: ClassVar[str] = (
        "joint"  # or "base", or "measurement": an error of the instrument, never corrected on the arm
    )
    signs: ClassVar[str] = "any"
    aliases: ClassVar[tuple[str, ...]] = ()
    remedy: ClassVar[str] = ""
    empirical: ClassVar[bool] = False
    at_joints: ClassVar[bool] = True
    learned: ClassVar[bool] = False
    supple: ClassVar[bool] = False
    nuisance: ClassVar[bool] = False
    changes_loads: ClassVar[bool] = False
    glances: ClassVar[frozenset[str]] = frozenset()
    event: ClassVar[bool] = False
    sided: ClassVar[bool] = False
    clock: ClassVar[str] = ""
    rarer: ClassVar[float] = 1.0
    reads: ClassVar[tuple[tuple[str, tuple[int, ...]], ...]] = ()
    counted: ClassVar[tuple[str, ...]] = ("joints",)  # options that hold joints: from 0 here, from 1 in documents
    in_part: ClassVar[bool] = (
        False  # whether at a joint it may be named where the data show only some of its parameters
    )
    alone: ClassVar[bool] = True  # whether each configuration that is tried at a joint is a candidate by itself

    joints: tuple[int, ...] | None = option(None, "Joints it acts on, from 1; null: all that it can act on.")

    @property
    def informative_row_share(self) -> float:
        """Share of the rows that tell one of its parameters, at most 1: a piece of a curve has those of its own stretch."""
        return 1.0

    def __post_init__(self) -> None:
        if self.joints is None:
            return
        if not self.at_joints:
            raise OptionError(f"{self.id} does not act at joints: leave joints out.", effect=self.id)
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise OptionError(f"{self.id} needs different joints, or none named for all.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Configurations in which a search for missing effects tries it: the one that nothing is said of."""
        return ({},)

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """Of what is ``tried`` at one joint, which are one candidate together, beside each by itself; none."""
        return ()

    @abstractmethod
    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Parameters of the effect on this robot, in the order of ``values``."""

    @property
    def instrument(self) -> Any:
        """The cameras and boards whose unknowns its parameters are; None of other effects."""
        return None

    @abstractmethod
    def local(self, batch: Batch, values: Floats) -> Local:
        """Local corrections and their derivatives at ``values (P,)``."""

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add what the effect does to a moving arm to ``form``; False where the correction cannot make up for it."""
        return False

    def load_columns(self, slopes: LoadSlopes) -> tuple[int, ...]:
        """Which load errors its parameters are, one each, of an effect that ``changes_loads``; -1 for none of these rows."""
        return ()

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """What blurred loads leave open: independent corrections of one standard deviation each."""
        return ()

    def with_softened_signs(self, batch: Batch) -> Self:
        """The effect as it is in this batch: what a blur softens is soft without it too."""
        return self

    def smooth_over(self, load_nm: float) -> bool:
        """Whether what it does follows the load without steps that are narrower than this."""
        return True

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Fill in what the configuration leaves open, from the robot and, where given, the rows to identify it on.

        A model does this with its robot. Doing it twice changes nothing.

        Raises:
            OptionError: the effect cannot act on this robot.

        """
        return self

    def physical_class(self, robot: Robot) -> PhysicalClass:
        """The physical class it belongs to on this robot."""
        return self.physical

    def separators(self, robot: Robot) -> tuple[Separator, ...]:
        """Evidence that separates it from the others of its class on this robot."""
        return self.separated_by

    def joint_frequencies(self, n: int) -> tuple[tuple[int, float], ...]:
        """Joints whose values its shape follows, each with how often the shape repeats within one revolution."""
        return tuple((j, 1.0) for j in self.acting(n))

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """When a law of time begins and ends, s; None of an effect that follows no time, or where nobody said when."""
        return None

    def acting(self, n: int) -> tuple[int, ...]:
        """Joints the effect acts on, for an arm of n joints."""
        return tuple(range(n)) if self.joints is None else self.joints

    def missing(self, available: frozenset[str]) -> frozenset[str]:
        """Columns the effect needs and the data do not have."""
        return self.needs - available

    def to_document(self) -> dict[str, Any]:
        """JSON-able configuration: ``id`` and every field, joints counted from 1."""
        own = {f.name: _to_document_value(getattr(self, f.name), int(f.name in self.counted)) for f in fields(self)}
        return {"id": self.id, **own}

    def as_stored(self, robot: Robot, document: Mapping[str, Any]) -> Self:
        """An effect of a stored version: what its ``document`` does not state yet is what it was when it was stored."""
        return self

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """Build the effect from :meth:`to_document`.

        Raises:
            OptionError: a field the effect does not have, or a value it cannot take.

        """
        try:
            return cls.from_options(**{k: _frozen(v, -int(k in cls.counted)) for k, v in document.items() if k != "id"})
        except (TypeError, ValueError) as error:
            raise OptionError(f"Effect {cls.id} cannot be made of {dict(document)}: {error}", effect=cls.id) from error

    @classmethod
    def from_options(cls, **config: Any) -> Self:
        """Make the effect with these options, joints from 0; an unknown one raises :class:`OptionError`."""
        known = [f.name for f in fields(cls)]
        for name in config:
            if name not in known:
                raise OptionError(f"Effect {cls.id} has no option {name!r}. It has: {', '.join(known)}.", effect=cls.id)
        return cls(**{name: _frozen(value, 0) for name, value in config.items()})

    def per_joint(
        self,
        robot: Robot,
        stem: str,
        unit: str,
        sigma: float,
        lower: float,
        upper: float,
        text: str,
        rotates: bool = False,
    ) -> tuple[Parameter, ...]:
        """One parameter per acting joint, named ``<stem>_<joint>``.

        At a prismatic joint a unit of rad becomes one of m, unless the correction ``rotates`` whatever the joint.
        """
        joints = self.acting(robot.n_joints)
        self.refuse_unknown(robot, joints)
        made = []
        for j in joints:
            prismatic = robot.joints[j].kind == "prismatic" and not rotates and unit in _PRISMATIC_UNITS
            scale = PRISMATIC_LEVER_M if prismatic else 1.0
            unit_here = _PRISMATIC_UNITS[unit] if prismatic else unit
            made.append(Parameter(f"{stem}_{j + 1}", unit_here, 0.0, sigma * scale, lower * scale, upper * scale, text))
        return tuple(made)

    def refuse_unknown(self, robot: Robot, joints: Iterable[int]) -> None:
        """Raise :class:`OptionError` for a joint the robot does not have."""
        for j in joints:
            if not 0 <= j < robot.n_joints:
                raise OptionError(
                    f"Effect {self.id} names joint {j + 1}; the robot has {robot.n_joints}.", effect=self.id
                )

    def restrict_to_joints(self, robot: Robot, possible: Collection[int], why: str) -> Self:
        """Act on the ``possible`` joints only.

        Raises:
            OptionError: a named joint is not among them, or there are none; the message says ``why``.

        """
        self.refuse_unknown(robot, self.joints or ())
        refused = [j + 1 for j in self.joints or () if j not in possible]
        if refused or not possible:
            place = f"joint {refused[0]}" if refused else "any joint of this robot"
            raise OptionError(f"{self.id} cannot act at {place}: {why}", effect=self.id)
        if self.joints is not None or len(possible) == robot.n_joints:
            return self
        return replace(self, joints=tuple(possible))

    def revolute(self, robot: Robot, because: str = "it is periodic in an angle") -> Self:
        """Act on revolute joints only, ``because`` the effect is of an angle."""
        revolute = [j for j, joint in enumerate(robot.joints) if joint.kind == "revolute"]
        return self.restrict_to_joints(robot, revolute, f"{because}, and the joint is prismatic. Name revolute joints.")

    def column(self, batch: Batch, name: str) -> NDArray[Any]:
        """Return a measured column of the batch; a missing one raises :class:`ObservationError`."""
        found: NDArray[Any] | None = getattr(batch, name)
        if found is None:
            raise ObservationError(
                f"{self.id} needs {name}: upload {CONDITIONS[name]}.", effect=self.id, missing=[name]
            )
        return found

    def restrict_to_long_links(self, robot: Robot) -> Self:
        """The effect at the joints before links that have a length.

        Raises:
            OptionError: a joint is named whose link has none.

        """
        lengths = np.linalg.norm(robot.chain.link_vectors[:-1], axis=1)
        long = [int(j) for j in np.flatnonzero(lengths > SHORTEST_M)]
        return self.restrict_to_joints(robot, long, "its link has no length. Name the joint before a long link.")

    def along_links(self, batch: Batch, values: Floats, course: Floats) -> Local:
        """Local correction that shifts the frame of each joint by ``course (N,)`` of its link, by one parameter for each."""
        joints = list(self.acting(batch.q.shape[1]))
        slopes = np.zeros((len(batch), len(joints), 6))
        slopes[:, :, :3] = course[:, None, None] * batch.link_vectors[joints]
        return linear(batch, values, joint_twists(joints, slopes))

    def joint_angle(self, batch: Batch, values: Floats, *signals: Floats) -> Local:
        """Local correction ``dq_j = value * signal_j`` summed over ``signals (N, n)``; values signal by signal."""
        acting = self.acting(batch.q.shape[1])
        places = [(signal, j) for signal in signals for j in acting]
        return linear(batch, values, [Derivative(k, j, dq=signal[:, j]) for k, (signal, j) in enumerate(places)])


def frame_twists(batch: Batch, values: Floats, place: int, moved: Iterable[Floats]) -> Local:
    """Local corrections of a frame, :data:`BASE` or :data:`TOOL`, by twists ``moved (N, 6)``, one for each parameter."""
    return linear(batch, values, [Derivative(k, place, xi=xi) for k, xi in enumerate(moved)])


def frame_rates(stem: str, per: str, sigma: float, wide: float) -> tuple[Parameter, ...]:
    """Rates of the base's frame ``per`` second or kelvin: along x, y, z, then about them."""
    return tuple(
        Parameter(f"{stem}_{k}", f"{unit}/{per}", 0.0, sigma, -wide, wide, f"rate of the base's {k}")
        for k, unit in TWIST
    )


def joint_twists(joints: Sequence[int], slopes: Floats) -> tuple[Derivative, ...]:
    """Derivatives of twists ``slopes (N, A, 6)``, by one parameter for each of the ``joints (A)``."""
    return tuple(Derivative(k, j, xi=slopes[:, k]) for k, j in enumerate(joints))


def soft_sign(x: Floats, width: Floats) -> Floats:
    """sign(x), or tanh(x / width) where ``width`` > 0: a sign read from a noisy moment is not a step."""
    soft = width > 0.0
    return np.where(soft, np.tanh(x / np.where(soft, width, 1.0)), np.sign(x)) if np.any(soft) else np.sign(x)


# A tanh of this width, in standard deviations, rises through zero as the expectation of the sign does, erf(x / √2 σ).
BLUR_WIDTH = math.sqrt(math.pi / 2.0)


class SignedByLoad(Effect):
    """An effect with the sign of a load: of the moment about the axis, or of those across it; soft over ``softening_nm``.

    It is one number, or one for each joint the effect acts on.
    """

    about: ClassVar[bool]
    softening_nm: float | tuple[float, ...]

    def soft_signs(self, batch: Batch, loads: Floats) -> Floats:
        """Signs of ``loads (N, A)`` on the joints the effect acts on."""
        return soft_sign(loads, self.sign_half_widths(batch))

    def sign_half_widths(self, batch: Batch) -> Floats:
        """Half-widths (A,) N·m of the signs: those of the configuration, or of the batch's blur where it is wider."""
        joints = self.acting(batch.q.shape[1])
        own = np.broadcast_to(np.asarray(self.softening_nm, dtype=np.float64), len(joints))
        return own if batch.blur is None else np.maximum(own, BLUR_WIDTH * batch.blur[list(joints), int(self.about)])

    def smooth_over(self, load_nm: float) -> bool:
        """Whether every sign changes over more than this."""
        return float(np.min(self.softening_nm)) > load_nm

    def with_softened_signs(self, batch: Batch) -> Self:
        """The sign as soft as it is in this batch."""
        if batch.blur is None:
            return self
        widths: dict[str, Any] = {"softening_nm": tuple(self.sign_half_widths(batch).tolist())}
        return replace(self, **widths)


def _to_document_value(value: Any, shift: int) -> Any:
    """Convert tuples to lists, and count joints from ``shift``."""
    if isinstance(value, tuple):
        return [_to_document_value(v, shift) for v in value]
    return value + shift if shift and value is not None else value


def _frozen(value: Any, shift: int) -> Any:
    """Undo :func:`_to_document_value`."""
    if isinstance(value, (list, tuple)):
        return tuple(_frozen(v, shift) for v in value)
    return int(value) + shift if shift and value is not None else value
