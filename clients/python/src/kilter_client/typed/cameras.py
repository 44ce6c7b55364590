"""What the server answers about cameras, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_client.results.record import Record


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ToolScatter(Record):
    """How far off the tool is in views, the noise of the views taken off."""

    high_mm: float
    """Upper end, mm."""
    low_mm: float
    """Lower end of its 95 % interval, mm."""
    orientation_deg: float
    """Root mean square angle, degrees."""
    rms_mm: float
    """Root mean square distance, mm."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PixelsFound(Record):
    """What pixels alone say of their own noise and of the tool."""

    between_views: float
    """Variance between views over what their corners explain: 1 where the model lacks nothing."""
    noise_px: float
    """Standard deviation of a corner, px, from within views: no model enters."""
    train: ToolScatter
    """The tool in the views that were fitted."""
    validation: ToolScatter | None
    """The tool in views held out; None: none, or folds."""
