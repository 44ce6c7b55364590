"""What one job computes in parallel: independent parts, on processes of the worker or on a Dask cluster."""

from __future__ import annotations

from kilter_service.jobs.fan_out.spread import DaskCluster, FanOut, LocalProcesses

__all__ = ["FanOut", "fan_out"]


def fan_out(processes: int, scheduler: str | None = None) -> FanOut:
    """Compute parts on the cluster of a Dask ``scheduler`` (its address), or else in up to so many processes.

    Raises:
        ServiceError: the package for Dask is missing.

    """
    return FanOut(LocalProcesses(processes) if scheduler is None else DaskCluster(scheduler))
