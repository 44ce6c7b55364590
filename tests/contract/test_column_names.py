"""Readers of files know every column that the service takes: one list of names, told alike by `inspect` and `upload`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from kilter_files.ground.units import column_unit, unit_dimension
from kilter_service.contract.columns import JOINT_UNITS, LOAD_UNITS, PIXEL_UNITS, PIXELS, PLAIN_UNITS, TILT_UNITS, TILTS


def names() -> Iterator[str]:
    """One column of every quantity in each of its units."""
    for what, kinds in JOINT_UNITS.items():
        yield from (f"{what}1_{unit}".rstrip("_") for units in kinds for unit in units)
    yield from (f"{what}_{unit}".rstrip("_") for what, units in PLAIN_UNITS.items() for unit in units)
    yield from (f"{what.removeprefix('pixel_')}12_{unit}" for what in PIXELS for unit in PIXEL_UNITS)
    yield from (f"tilt0{what[-1]}_{unit}" for what in TILTS for unit in TILT_UNITS)
    for what, units in LOAD_UNITS.items():
        yield from (f"load3_{what.removeprefix('load_')}_{unit}".rstrip("_") for unit in units)
    yield "m1x_mm"


@pytest.mark.parametrize("name", sorted(set(names())))
def test_a_column_of_the_service_is_one_of_the_readers(name: str) -> None:
    unit = column_unit(name)
    assert unit is not None
    assert unit == "" or unit_dimension(unit) is not None
