"""The figures of a job's result: Plotly documents of the few kinds of traces that Kilter draws, each figure by its name.

What a named effect does to a joint, over the quantity that it follows: the numbers of a picture.

Poses that a search proposes to measure, and whether they tell two effects apart.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from kilter_service.contract.gap_details import AtJoints
from kilter_service.contract.units import Deg, Kg, PointMm, Stored

Numbers = list[float | None]
Places = list[float | str | None]
Share = tuple[float, float]

X, Y = "Values along x; null: a gap.", "Values along y; null: a gap."
SHORT_X, SHORT_Y = "Along x: values, or labels of vertical bars.", "Along y: values, or labels of horizontal bars."


class Text(Stored):
    """A text in a figure."""

    text: str = Field(description="The text; may hold `<br>` and `<sup>`.")


class ColorBar(Stored):
    """The legend of a colour scale."""

    title: Text | None = Field(None, description="What the colours say.")


class Marker(Stored):
    """How points or bars are drawn."""

    color: str | list[str] | Numbers | None = Field(
        None, description="Colour, one for each, or the numbers that `colorscale` turns into colours."
    )
    size: float | None = Field(None, description="Size of a point, pixels.")
    symbol: str | None = Field(None, description="Form of a point; null: a disc.")
    colorscale: str | None = Field(None, description="Name of the colour scale of numbers.")
    cmin: float | None = Field(None, description="Number at the lower end of the colour scale.")
    cmax: float | None = Field(None, description="Number at its upper end.")
    colorbar: ColorBar | None = Field(None, description="Legend of the colour scale; null: none.")


class Line(Stored):
    """How a line is drawn."""

    color: str | None = Field(None, description="Colour.")
    width: float | None = Field(None, description="Width, pixels.")
    shape: str | None = Field(None, description="`hv`: steps; null: straight from point to point.")


class ErrorBars(Stored):
    """Intervals beside bars."""

    type: Literal["data"] = Field(description="Lengths are given for each bar.")
    array: Numbers = Field(description="Length above each value, or on both sides.")
    arrayminus: Numbers | None = Field(None, description="Length below each value; null: as above.")
    symmetric: bool | None = Field(None, description="Whether both sides are the same; null: they are.")
    thickness: float | None = Field(None, description="Width of the line, pixels.")
    color: str | None = Field(None, description="Colour.")


class _Trace(Stored):
    name: str | None = Field(None, description="What it shows, for the legend.")
    showlegend: bool | None = Field(None, description="Whether the legend has it.")
    legendgroup: str | None = Field(None, description="Traces of one group are switched on and off together.")
    xaxis: str | None = Field(None, description="Its x axis, such as `x2`; null: the first.")
    yaxis: str | None = Field(None, description="Its y axis, such as `y2`; null: the first.")
    marker: Marker | None = Field(None, description="How its points or bars are drawn.")


class Bars(_Trace):
    """Bars, with their intervals."""

    type: Literal["bar"] = Field(description="Kind of the trace.")
    orientation: str | None = Field(None, description="`h`: horizontal bars; null: vertical bars.")
    x: Places = Field(description=SHORT_X)
    y: Places = Field(description=SHORT_Y)
    error_x: ErrorBars | None = Field(None, description="Intervals along x.")
    error_y: ErrorBars | None = Field(None, description="Intervals along y.")
    hovertext: list[str] | None = Field(None, description="What is said of each bar under the pointer.")


class Scatter(_Trace):
    """Points or a line in a plane."""

    type: Literal["scatter"] = Field(description="Kind of the trace.")
    mode: str | None = Field(None, description="`markers`, or `lines`.")
    x: Places = Field(description=X)
    y: Numbers = Field(description=Y)
    line: Line | None = Field(None, description="How its line is drawn.")
    fill: str | None = Field(
        None, description="`tozeroy`: filled down to zero; `toself`: the area it encloses; null: not filled."
    )


class Scatter3d(_Trace):
    """Points or a line in space."""

    type: Literal["scatter3d"] = Field(description="Kind of the trace.")
    mode: str | None = Field(None, description="`markers`, or `lines`.")
    x: Numbers = Field(description=X)
    y: Numbers = Field(description=Y)
    z: Numbers = Field(description="Values along z; null: a gap.")
    line: Line | None = Field(None, description="How its line is drawn.")


class Heatmap(_Trace):
    """A table of numbers as colours."""

    type: Literal["heatmap"] = Field(description="Kind of the trace.")
    x: list[str] = Field(description="Labels of the columns.")
    y: list[str] = Field(description="Labels of the rows.")
    z: list[Numbers] = Field(description="Numbers, row by row.")
    zmin: float | None = Field(None, description="Number at the lower end of the colour scale.")
    zmax: float | None = Field(None, description="Number at its upper end.")
    colorscale: str | None = Field(None, description="Name of the colour scale.")


Trace = Annotated[Bars | Scatter | Scatter3d | Heatmap, Field(discriminator="type")]


class Axis(Stored):
    """An axis."""

    title: Text | None = Field(None, description="What it shows, with its unit.")
    type: str | None = Field(None, description="`log` or `category`; null: plain numbers.")
    autorange: bool | str | None = Field(None, description="`reversed`: the first on top.")
    automargin: bool | None = Field(None, description="Whether the margin grows with the labels.")
    tickangle: float | None = Field(None, description="Rotation of the labels, degrees.")
    domain: Share | None = Field(None, description="Share of the figure it takes, 0 to 1.")
    anchor: str | None = Field(None, description="The axis it belongs to.")
    scaleanchor: str | None = Field(None, description="The axis whose scale it shares.")
    scaleratio: float | None = Field(None, description="Its scale as a multiple of that one's.")
    zeroline: bool | None = Field(None, description="Whether zero has a line.")


class Scene(Stored):
    """The axes of a figure in space."""

    xaxis: Axis | None = Field(None, description="Axis x.")
    yaxis: Axis | None = Field(None, description="Axis y.")
    zaxis: Axis | None = Field(None, description="Axis z.")
    aspectmode: str | None = Field(None, description="`data`: all axes have one scale.")


class Margin(Stored):
    """Room round the axes."""

    t: float | None = Field(None, description="Above, pixels.")


class Legend(Stored):
    """Where the legend is."""

    orientation: str | None = Field(None, description="`h`: side by side.")
    yanchor: str | None = Field(None, description="Which edge of it `y` is of.")
    y: float | None = Field(None, description="Height as a share of the figure; below 0 under the axes.")
    itemsizing: str | None = Field(None, description="`constant`: marks of one size.")


class Origin(Stored):
    """Whose figure it is."""

    robot: str = Field(description="Name of the robot.")
    campaigns: list[str] = Field(description="Names of the campaigns.")
    version: str = Field(description="Id of the version.")


class Layout(Stored):
    """Layout of a figure; further fields are more axes: `xaxis2`, `yaxis2` and so on."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Axis]

    title: Text | None = Field(None, description="Title, with robot, version and campaigns below.")
    xaxis: Axis | None = Field(None, description="The first x axis.")
    yaxis: Axis | None = Field(None, description="The first y axis.")
    scene: Scene | None = Field(None, description="The axes in space.")
    width: float | None = Field(None, description="Width, pixels; null: as wide as there is room.")
    height: float | None = Field(None, description="Height, pixels.")
    margin: Margin | None = Field(None, description="Room round the axes.")
    legend: Legend | None = Field(None, description="Where the legend is.")
    barmode: str | None = Field(None, description="`group`: bars side by side; `overlay`: one over the other.")
    meta: Origin | None = Field(None, description="Whose figure it is; null: no version was made.")


class _Figure(Stored):
    layout: Layout | None = Field(None, description="Layout, as Plotly has it.")


class Figure(_Figure):
    """A figure as a Plotly document."""

    data: list[Trace] | None = Field(None, description="Traces, as Plotly has them.")


class BarFigure(_Figure):
    """Bars as a Plotly document."""

    data: list[Bars] | None = Field(None, description="Bars, as Plotly has them.")


class PlaneFigure(_Figure):
    """Points and lines as a Plotly document."""

    data: list[Scatter] | None = Field(None, description="Points and lines, as Plotly has them.")


class SpaceFigure(_Figure):
    """Points and lines in space as a Plotly document."""

    data: list[Scatter3d] | None = Field(None, description="Points and lines, as Plotly has them.")


class TableFigure(_Figure):
    """A table as colours as a Plotly document."""

    data: list[Heatmap] | None = Field(None, description="The table, as Plotly has it.")


class IdentifyFigures(Stored):
    """Figures of an identification; those that its rows do not give are not there."""

    held_out_errors: PlaneFigure | None = Field(
        None, description="Errors of held-out rows before, with registration only, and identified."
    )
    fitted_errors: PlaneFigure | None = Field(None, description="The same of fitted rows, where none were held out.")
    residual_arrows: PlaneFigure | None = Field(None, description="Residuals as arrows from three sides.")
    residual_arrows_3d: SpaceFigure | None = Field(None, description="Residuals as arrows in space.")
    worst_rows: BarFigure | None = Field(None, description="Rows with the largest errors, by campaign and number.")
    parameter_changes: BarFigure | None = Field(None, description="Changes of parameters with 95 % intervals.")
    predicted_error: PlaneFigure | None = Field(None, description="What the fit does not know, over the workspace.")


class GapFigures(Stored):
    """Figures of a gap search.

    Further fields are `residual_joint_1` and so on, the residual along what each joint moves, and
    `effect_curve_backlash_joint_2` and so on, each named effect over the quantity that it follows.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Figure]

    gap_bar: BarFigure | None = Field(None, description="The error after each effect, on fitted and held-out rows.")
    residual_by_direction: BarFigure | None = Field(None, description="Residual by the direction of the last motion.")
    residual_by_load: BarFigure | None = Field(None, description="Residual by payload.")
    contribution: BarFigure | None = Field(None, description="How far each named effect moves the tool.")
    alias_matrix: TableFigure | None = Field(None, description="How well signatures correlate after the geometry.")


class CurveSide(Stored):
    """A curve over the quantity that an effect follows."""

    direction: float | None = Field(None, description="Direction of the last motion, 1 or -1; null: it does not count.")
    x: list[float] = Field(description="Values of the quantity, in `x_unit`.")
    y: list[float] = Field(description="What the joint rotates or moves by, in `unit`.")
    low: list[float] | None = Field(None, description="Lower end of the 95 % band; null: it has none.")
    high: list[float] | None = Field(None, description="Upper end of the 95 % band; null: it has none.")


class CurveVisits(Stored):
    """What each visit says that an effect does: the curve and what is left, as motion of the joint."""

    x: list[float] = Field(description="Values of the quantity, in `x_unit`.")
    y: list[float] = Field(description="What the visit says, in `unit`.")
    half: list[float] = Field(description="Half of its 95 % interval, in `unit`.")
    curve: list[float] = Field(description="What the curve says there, in `unit`.")
    direction: list[float] | None = Field(None, description="Direction of the last motion; null: it does not count.")
    faint: int = Field(description="Visits that say too little of this joint to be drawn: the tool is near its axis.")
    of: int = Field(description="Visits that the search used.")


class CurveRival(AtJoints):
    """The refused effect that comes nearest to the visits, with a zero of its own."""

    times: float = Field(
        description="Squares that it leaves at the visits, as a multiple of those that the curve leaves."
    )
    sides: list[CurveSide] = Field(description="Its curve, or one for each direction.")


class CurveDistance(Stored):
    """How far the curves of both directions are apart, on average, in `unit`."""

    value: float = Field(description="The one of direction 1 less the one of -1.")
    low: float = Field(description="Lower end of the 95 % interval.")
    high: float = Field(description="Upper end of the 95 % interval.")


class EffectCurve(AtJoints):
    """What a named effect does to one of its joints, over the quantity that it follows; no lever arm is in it."""

    joint: int = Field(description="The joint, from 1.")
    follows: str = Field(
        description="The quantity: `q` (of the joint), `axial` (load about or along it), `t` (from the first visit on) or "
        "`temperature_c`."
    )
    x_unit: str = Field(description="Unit of the quantity.")
    unit: str = Field(description="Unit of what the joint rotates or moves by.")
    sides: list[CurveSide] = Field(description="The curve, or one for each direction of the last motion.")
    visits: CurveVisits = Field(description="What the visits say, at most 400 of them.")
    distance: CurveDistance | None = Field(None, description="How far both directions are apart; null: there is one.")
    rival: CurveRival | None = Field(
        None, description="What was refused; null: nothing that follows the same quantity."
    )


class NextPose(Stored):
    """A pose to measure next."""

    kind: str | None = Field(None, description="`new`, or what is done again.")
    change: str | None = Field(None, description="What to change before it, in words; null: nothing.")
    q_deg: list[Deg] | None = Field(None, description="All joints, degrees; mm for prismatic ones.")
    payload_kg: Kg | None = Field(None, description="Load to carry, kg; null: any.")
    payload_com_mm: PointMm | None = Field(None, description="Its centre in the tool frame, mm; null: the tool point.")
    direction: list[int] | None = Field(None, description="Direction to reach each joint from, -1 or 1; null: any.")
    separates: list[str] | None = Field(None, description="The two that it tells apart.")
    information_factor: float | None = Field(
        None, description="How much more is known after it and all before it, as a factor."
    )


class ToldApart(Stored):
    """Whether proposed poses tell two effects apart, and what does where they do not."""

    separates: list[str] | None = Field(None, description="The two in question.")
    poses: int | None = Field(None, description="How many poses are proposed for it.")
    information_factor: float | None = Field(
        None, description="How much more is known after all of them, as a factor; near 1: nothing."
    )
    enough: bool | None = Field(None, description="Whether they tell the two apart, but for one case in a thousand.")
    poses_needed: int | None = Field(None, description="How many such poses would; null: more than 1000.")
    instead: list[str] | None = Field(None, description="What to do instead, in words, the quickest first.")
    sentence: str | None = Field(None, description="All of it in words.")
