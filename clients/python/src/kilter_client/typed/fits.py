"""What the server answers about fits, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.results.record import Record, Records
from kilter_client.results.shown import ShownFigure, ShownMetrics, ShownParameter
from kilter_client.typed.budgets import Budget


class Errors(Record):
    """Errors of a model on some rows, measured minus predicted. Every marker that was seen counts as a point."""

    max_mm: float | None
    """Largest error, mm."""
    mean_mm: float
    """Mean size of the errors, mm."""
    orientation_deg: float | None
    """Mean error of the orientation, degrees, where it was measured."""
    p95_mm: float | None
    """Size that 95 % of the errors do not exceed, mm."""
    rms_mm: float | None
    """Root mean square of the sizes, mm."""
    x_mm: float | None
    """Rms along x, mm; not for distances and contacts."""
    y_mm: float | None
    """Rms along y, mm."""
    z_mm: float | None
    """Rms along z, mm."""


class StageErrors(Record):
    """Errors of several models on the same rows."""

    budget: Budget | None
    """What is not known of these rows, with the expanded uncertainty; None: not computed."""
    fitted: int | None
    """Of an evaluation: rows that the version was fitted to, in whatever file; None: not looked for."""
    geometry_fitted: Errors | None
    """Of a version, on rows held out: the geometry fitted to the same rows without effects, the best rigid arm; None: no effects, nothing held out, or not computed."""
    geometry_only: Errors | None
    """Earlier name, of two things: of an identification the same as `geometry_fitted`, of an evaluation as `without_effects`."""
    identified: Errors | None
    """The model that was identified."""
    left_out: int | None
    """Rows that were left out of them, as no measurements; None: not known."""
    n: int | None
    """Points the errors are taken over."""
    nominal: Errors | None
    """The nominal robot, in its own base and tool."""
    registration_only: Errors | None
    """The nominal robot, base and tool fitted."""
    without_effects: Errors | None
    """Of an evaluation: the version with its effects left out and its geometry as it is, as a file of geometry alone has it; None: no effects, or not computed."""


class Metrics(ShownMetrics, Record):
    """Errors of an identification; empty where no tool was measured."""

    train: StageErrors | None
    """On the rows that were fitted."""
    validation: StageErrors | None
    """On the rows that were held out; None: none were."""


class Parameter(ShownParameter, Record):
    """A parameter that was identified, in the unit it is read in."""

    change: float | None
    """Value minus nominal; rotations of base and tool by the smaller angle."""
    from_prior: bool | None
    """Whether the value rests on other robots of the type, since the rows take off less than half of the variance; None: no prior was used."""
    identifiable: bool | None
    """Whether the data could see it."""
    interval_from: str | None
    """What the interval rests on: `bootstrap`, `profile`, or `sigma` where neither could be had."""
    lower: float | None
    """Lower end of the 95 % interval, where `intervals` were asked for."""
    name: str
    """Name of the parameter."""
    nominal: float | None
    """Its nominal value; 0 if the nominal robot does not have it."""
    plausible: bool | None
    """Whether the value is within what is usual."""
    readings: int | None
    """Readings it rests on, in a job of kind `joint_parameters`."""
    reason: str | None
    """Why it has no value, in words."""
    sigma: float | None
    """Standard deviation of the value."""
    stiffness_nm_deg: float | None
    """Stiffness of the joint, the inverse of its compliance, N m/deg."""
    unit: str | None
    """Unit of the numbers: mm, deg, s, 1/K, ...; 1 for none."""
    upper: float | None
    """Upper end of the 95 % interval."""
    value: float | None
    """Its value; None: it could not be measured."""


class Term(Record):
    """A parameter's part in a sum."""

    coefficient: float
    """What it is multiplied by, each in its own unit."""
    name: str
    """Name of the parameter."""


class IdentifiableSum(Record):
    """A sum of parameters that the data know where they do not tell its members."""

    lower: float
    """Lower end of the 95 % interval."""
    parameters: Records[Term]
    """Its terms."""
    sentence: str
    """The same in words."""
    sigma: float
    """Standard deviation."""
    unit: str
    """Unit of the numbers: that of the first parameter."""
    upper: float
    """Upper end of the 95 % interval."""
    value: float
    """Value of the sum."""


class Member(Record):
    """A parameter's part in a direction."""

    name: str
    """Name of the parameter."""
    weight: float
    """Its part, -1 to 1, by what it alone would do to the measurements."""


class NullDirection(Record):
    """A combination of parameters that the data cannot tell."""

    parameters: Records[Member]
    """Its members, the largest first."""
    sentence: str | None
    """The same in words."""
    structural: bool | None
    """Whether no pose at all could tell it."""
    sums: Records[IdentifiableSum]
    """Sums of its members that the data do know."""


class Objection(Record):
    """What speaks against activating a version."""

    code: str
    """Stable name of the objection."""
    message: str
    """What speaks against it, in words."""


class OddMass(Record):
    """A mass or a centre far from what was stated."""

    link: int | None
    """Number of the link, from 1; None: the payload."""
    parameter: str | None
    """`mass`, or a coordinate of the centre such as `com_x`."""
    stated: float | None
    """What was stated."""
    unit: str | None
    """kg or mm."""
    value: float | None
    """What the data say."""


class Remark(Record):
    """A warning: ``code`` is for programs, ``message`` says what is the matter and what helps. The rest goes with the code."""

    angle_deg: float | None
    """Angle it is about, degrees."""
    axis: str | None
    """Axis it is about, such as `z` or `-x`."""
    beyond_chance: bool | None
    """Whether the difference is more than chance explains."""
    budget_s: float | None
    """Time that was given, s."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns it is about."""
    code: str
    """Stable name of the warning."""
    effects: tuple[str, ...]
    """Ids of the effects it is about."""
    elsewhere_mm: float | None
    """Uncertainty of the tool over the joint limits, mm."""
    here_mm: float | None
    """Uncertainty of the tool in the measured poses, mm."""
    identified_deg: float | None
    """Error of the identified model on held-out rows, degrees."""
    identified_mm: float | None
    """Error of the identified model on held-out rows, mm."""
    joint: str | None
    """Name of the joint it is about."""
    left_out: tuple[str, ...]
    """What there was no time for."""
    markers: tuple[int, ...]
    """Numbers of the markers it is about, from 1."""
    masses: Records[OddMass]
    """Masses and centres far from what was stated."""
    message: str
    """What is the matter, and what helps."""
    off_mm: tuple[float, ...]
    """How far each of these rows is off, mm."""
    others_mm: float | None
    """How far the other rows are off at most, but for a quarter of them, mm."""
    quantity: str | None
    """Which errors were compared: `mean by pose` or `rms by pose`."""
    ratio: float | None
    """What is left, in multiples of the noise."""
    row: int | None
    """The row it is about, from 0."""
    rows: tuple[int, ...]
    """Rows it is about, from 1."""
    sigmas: tuple[float, ...]
    """The same of its worst coordinate, in standard deviations of what was expected there."""
    simpler_deg: float | None
    """Error of the simpler model on held-out rows, degrees."""
    simpler_mm: float | None
    """Error of the simpler model on held-out rows, mm."""
    visits: int | None
    """How many visits it is about."""


class Text(Record):
    """A text in a figure."""

    text: str
    """The text; may hold `<br>` and `<sup>`."""


class Axis(Record):
    """An axis."""

    anchor: str | None
    """The axis it belongs to."""
    automargin: bool | None
    """Whether the margin grows with the labels."""
    autorange: bool | str | None
    """`reversed`: the first on top."""
    domain: tuple[float, ...]
    """Share of the figure it takes, 0 to 1."""
    scaleanchor: str | None
    """The axis whose scale it shares."""
    scaleratio: float | None
    """Its scale as a multiple of that one's."""
    tickangle: float | None
    """Rotation of the labels, degrees."""
    title: Text | None
    """What it shows, with its unit."""
    type: str | None
    """`log` or `category`; None: plain numbers."""
    zeroline: bool | None
    """Whether zero has a line."""


class Legend(Record):
    """Where the legend is."""

    itemsizing: str | None
    """`constant`: marks of one size."""
    orientation: str | None
    """`h`: side by side."""
    y: float | None
    """Height as a share of the figure; below 0 under the axes."""
    yanchor: str | None
    """Which edge of it `y` is of."""


class Margin(Record):
    """Room round the axes."""

    t: float | None
    """Above, pixels."""


class Origin(Record):
    """Whose figure it is."""

    campaigns: tuple[str, ...]
    """Names of the campaigns."""
    robot: str
    """Name of the robot."""
    version: str
    """Id of the version."""


class Scene(Record):
    """The axes of a figure in space."""

    aspectmode: str | None
    """`data`: all axes have one scale."""
    xaxis: Axis | None
    """Axis x."""
    yaxis: Axis | None
    """Axis y."""
    zaxis: Axis | None
    """Axis z."""


class Layout(Record):
    """Layout of a figure; further fields are more axes: `xaxis2`, `yaxis2` and so on."""

    barmode: str | None
    """`group`: bars side by side; `overlay`: one over the other."""
    height: float | None
    """Height, pixels."""
    legend: Legend | None
    """Where the legend is."""
    margin: Margin | None
    """Room round the axes."""
    meta: Origin | None
    """Whose figure it is; None: no version was made."""
    scene: Scene | None
    """The axes in space."""
    title: Text | None
    """Title, with robot, version and campaigns below."""
    width: float | None
    """Width, pixels; None: as wide as there is room."""
    xaxis: Axis | None
    """The first x axis."""
    yaxis: Axis | None
    """The first y axis."""


class Figure(ShownFigure, Record):
    """A figure as a Plotly document."""

    data: tuple[Mapping[str, Any], ...]
    """Traces, as Plotly has them."""
    layout: Layout | None
    """Layout, as Plotly has it."""


class Reference(Record):
    """Where the frames that a correction works in come from."""

    base: str | None
    """`robot`: the robot's own base; `registration`: where the nominal robot fits best."""
    tool: str | None
    """The same of the tool."""


class LoadNumber(Record):
    """A mass or a coordinate of a centre, as stated and as the data leave it."""

    link: int | None
    """Number of the link, from 1; None: the payload."""
    parameter: str
    """`mass`, or a coordinate: `com_x` of a link, `shift_x` of the payload."""
    prior_sigma: float | None
    """Standard deviation that was stated."""
    seen: bool | None
    """Whether the data could see it."""
    sigma: float | None
    """Standard deviation of the value."""
    stated: float | None
    """What the robot or the campaign states."""
    unit: str | None
    """kg or mm."""
    value: float | None
    """What the data leave of it."""
