"""What an earlier release stored is shown, less what cannot be read any more."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from kilter_service.contract.fits import (
    Metrics,
    NullDirection,
    Parameter,
    metrics_with_earlier_names,
    with_earlier_names,
)
from kilter_service.contract.versions import Details
from kilter_service.contract.wording import Remark, as_written


def test_only_what_was_written_is_shown() -> None:
    document = {"train": {"n": 3, "nominal": {"mean_mm": 1.5}}}
    assert as_written(Metrics, document).model_dump(mode="json") == document


def test_what_an_earlier_release_called_by_another_name_is_read() -> None:
    """One name, `geometry_only`, for two things: it stays as it was written, and beside the names of today."""
    block = {"n": 3, "geometry_only": {"mean_mm": 0.4}}
    read = as_written(Metrics, {"validation": block})
    assert read.model_dump() == {"validation": block}
    assert read.validation is not None
    assert read.validation.best_rigid == read.validation.geometry_only
    now = metrics_with_earlier_names({"train": {"n": 9}, "validation": {"geometry_fitted": {"mean_mm": 0.4}}})
    assert now["train"] == {"n": 9}
    assert now["validation"]["geometry_only"] == now["validation"]["geometry_fitted"] == {"mean_mm": 0.4}
    assert with_earlier_names({"without_effects": {"mean_mm": 0.4}})["geometry_only"] == {"mean_mm": 0.4}
    assert metrics_with_earlier_names({"train": {"n": 9}, "validation": None})["validation"] is None


def test_unknown_parts_are_left_out() -> None:
    assert as_written(Metrics, {"train": {"n": 3, "guess": 1}, "more": {}}).model_dump() == {"train": {"n": 3}}


def test_a_part_of_another_form_is_left_out_and_the_rest_is_shown() -> None:
    odd = {"method": "least_squares", "iterations": 4, "noise": {"residuals_mm": "many", "wrong_rows": 2}}
    assert as_written(Details, odd).model_dump() == {"iterations": 4, "noise": {"wrong_rows": 2}}


def test_an_entry_without_what_it_needs_is_left_out() -> None:
    rows = [{"name": "a", "value": 1.0}, {"value": 2.0}, {"name": "c", "value": [3]}, "d"]
    assert [one.model_dump() for one in as_written(list[Parameter], rows)] == [
        {"name": "a", "value": 1.0},
        {"name": "c"},
    ]
    assert as_written(list[Remark], [{"code": "x"}, {"code": "y", "message": "z"}])[0].code == "y"
    blind = [{"parameters": [{"name": "a"}, {"name": "b", "weight": 1}]}]
    assert as_written(list[NullDirection], blind)[0].model_dump() == {"parameters": [{"name": "b", "weight": 1.0}]}


def test_what_is_no_such_document_at_all_is_an_error() -> None:
    with pytest.raises(ValidationError):
        as_written(Metrics, 3)


def test_the_document_given_stays_as_it_is() -> None:
    odd = {"method": "least_squares"}
    as_written(Details, odd)
    assert odd == {"method": "least_squares"}
