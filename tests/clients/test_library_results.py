"""Results by themselves: typed from documents, shown as text and in a notebook, as arrays and frames."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import FrozenInstanceError, fields
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

import kilter_client
from kilter_client import MissingPackageError, typed
from kilter_client.cli.reports.results import show_result
from kilter_client.results.corrected import Corrected
from kilter_client.results.record import Record, Records
from kilter_client.results.rows import Rows
from kilter_client.typed.fits import Metrics, Parameter
from kilter_client.typed.identifications import IdentifyResult
from kilter_client.typed.names import JOBS, MODULE_OF
from kilter_client.typed.versions import Version
from tools.contract.interface import promised_interface

INTERFACE = promised_interface()
NAMED = "<b>bold & \"evil\"</b><script>alert('x')</script>"


def errors(mean_mm: float) -> dict[str, Any]:
    return {"mean_mm": mean_mm, "rms_mm": mean_mm * 1.1, "p95_mm": mean_mm * 2, "max_mm": mean_mm * 3}


def stage(*means: float) -> dict[str, Any]:
    return {"n": 20} | dict(zip(("nominal", "registration_only", "identified"), map(errors, means), strict=True))


DOCUMENT: dict[str, Any] = {
    "version_id": "ver_0123456789abcdef",
    "of_the_future": {"a": [1, 2]},
    "metrics": {"train": stage(1.5, 0.9, 0.01), "validation": stage(1.25, 0.835, 0.018)},
    "parameters": [
        {
            "name": "a_2",
            "value": 190.1234567,
            "nominal": 190.0,
            "sigma": 0.0123,
            "unit": "mm",
            "lower": 190.0993,
            "upper": 190.1475,
        },
        {"name": NAMED, "value": 0.5, "sigma": 0.1, "unit": "deg", "identifiable": False, "more": 3},
        {"name": "unseen", "value": None, "reason": "no load", "unit": "deg"},
    ],
    "warnings": [{"code": "no_repeats", "message": f"{NAMED} was measured once."}],
}


def test_fields_and_the_document_behind_them() -> None:
    result = IdentifyResult.read(DOCUMENT)
    assert result.document is DOCUMENT
    assert result["of_the_future"] == {"a": [1, 2]}
    assert "of_the_future" in result
    assert dict(result) == DOCUMENT
    assert result.get("none", 5) == 5
    assert result.metrics is not None
    assert result.metrics.validation is not None
    assert result.metrics.validation.registration_only is not None
    assert result.metrics.validation.registration_only.mean_mm == 0.835
    assert result.parameters["a_2"].change == pytest.approx(0.1234567)
    assert result.parameters[1]["more"] == 3
    assert "a_2" in result.parameters
    assert "a_3" not in result.parameters
    assert result.noise_mm is None
    assert len(result.set_aside) == 0
    with pytest.raises(FrozenInstanceError):
        result.version_id = "other"  # type: ignore[misc]
    with pytest.raises(KeyError, match=r"did you mean .*a_2"):
        result.parameters["a_3"]


@pytest.mark.parametrize(("nominal_mm", "placed"), [(2540.0, True), (1.25, False)])
def test_the_place_of_a_tracker_is_no_error_of_the_nominal_robot(
    nominal_mm: float, placed: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    document = {**DOCUMENT, "metrics": {"train": stage(1.5, 0.9, 0.01), "validation": stage(nominal_mm, 0.835, 0.018)}}
    show_result(document)
    said = capsys.readouterr().out
    shown = repr(IdentifyResult.read(document))
    fitted, held = said.split("validation (20)", 1)
    assert "mostly" not in fitted
    for text in (held, shown):
        assert ("nominal, mostly where instrument, base and tool are" in text) is placed, text


def test_text_says_it_with_units() -> None:
    result = IdentifyResult.read(DOCUMENT)
    assert repr(result) == (
        "version ver_0123456789abcdef: mean error of 20 held-out points: 1.25 mm nominal, 0.835 mm registration only, "
        "0.018 mm identified; 3 parameters; 1 warning"
    )
    assert repr(Metrics.read({})) == "no errors of the tool: none was measured"
    for kind in MODULE_OF:  # nothing that an answer leaves out keeps it from being shown
        empty = getattr(kilter_client, kind).read({})
        assert "\n" not in repr(empty)
        if hasattr(empty, "_repr_html_"):
            Html().feed(empty._repr_html_())


class Html(HTMLParser):
    """Which elements are opened, and the text of all."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.words = ""

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.words += data


def test_a_notebook_shows_tables_and_what_people_named_stays_text() -> None:
    seen = Html()
    seen.feed(IdentifyResult.read(DOCUMENT)._repr_html_())
    assert seen.tags.count("table") == 2
    assert set(seen.tags) <= {"p", "table", "caption", "thead", "tbody", "tr", "th", "td"}
    assert NAMED in seen.words
    assert "190.099 to 190.147" in seen.words or "190.099 to 190.148" in seen.words
    assert "0.123" in seen.words
    assert "0.1234567" not in seen.words  # no digits beyond two of sigma
    assert "held out" in seen.words


def test_the_picture_is_the_first_figure() -> None:
    pytest.importorskip("matplotlib")
    axes = {"title": {"text": "x"}}
    figure = {
        "data": [{"type": "scatter", "mode": "markers", "x": [1, 2], "y": [1, 2]}],
        "layout": {"title": {"text": "Errors<br>of ur5e"}, "xaxis": axes, "yaxis": axes},
    }
    result = IdentifyResult.read(DOCUMENT | {"figures": {"errors": figure}})
    picture = result._repr_png_()
    assert picture is not None
    assert picture.startswith(b"\x89PNG")
    assert "data:image/png;base64," in result._repr_html_()
    assert repr(result.figures["errors"]) == "Figure: Errors"


def test_arrays_and_frames() -> None:
    pandas = pytest.importorskip("pandas")
    parameters = IdentifyResult.read(DOCUMENT).parameters
    array = parameters.to_numpy()
    assert array["name"].tolist() == ["a_2", NAMED, "unseen"]
    np.testing.assert_array_equal(array["value"], [190.1234567, 0.5, np.nan])
    assert np.asarray(parameters).dtype == array.dtype
    frame = parameters.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame["unit"].tolist() == ["mm", "deg", "deg"]
    metrics = IdentifyResult.read(DOCUMENT).metrics.to_pandas()  # type: ignore[union-attr]
    assert metrics[metrics["model"] == "identified"]["mean_mm"].tolist() == [0.01, 0.018]
    assert Records(Parameter, []).to_numpy().shape == (0,)


def test_rows_of_a_file() -> None:
    rows = Rows(b'campaign,row,dx_mm,held_out\n"a, b",1,0.5,\n"c",2,,true\n')
    assert rows.columns == ("campaign", "row", "dx_mm", "held_out")
    assert rows["campaign"].tolist() == ["a, b", "c"]
    assert rows["row"].tolist() == [1, 2]
    np.testing.assert_array_equal(rows["dx_mm"], [0.5, np.nan])
    assert len(Rows(b"")) == 0


def test_a_corrected_trajectory_is_bytes_and_rows() -> None:
    done = Corrected(b"q1_deg,dx_mm,dy_mm,dz_mm,left_mm,status\n1,3,0,4,0.0004,OK\n2,,,,,JOINT_LIMIT\n")
    assert done.startswith(b"q1_deg")
    assert done.status == {"OK": 1, "JOINT_LIMIT": 1}
    assert str(done) == "corrected trajectory: 2 rows (1 OK, 1 JOINT_LIMIT), largest change 5 mm"
    near = Corrected(b"q1_deg,dx_mm,dy_mm,dz_mm,left_mm,status\n1,3,0,4,0.0004,OK\n2,6,0,8,1.25,DAMPED\n")
    assert str(near) == "corrected trajectory: 2 rows (1 OK, 1 DAMPED), largest change 10 mm, most left 1.25 mm"
    document = Corrected(json.dumps({"q1_deg": [1.0], "status": ["OK"]}).encode())
    document.media_type = "application/json"
    assert document.to_dict() == {"q1_deg": [1.0], "status": ["OK"]}


@pytest.mark.parametrize(("ask", "package"), [("to_pandas", "pandas"), ("to_numpy", "numpy")])
def test_what_a_missing_package_is_for(monkeypatch: pytest.MonkeyPatch, ask: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        MissingPackageError, match=f"needs {package}. Install it with: pip install numpy pandas matplotlib, or call"
    ):
        getattr(IdentifyResult.read(DOCUMENT).parameters, ask)()


def answers() -> set[str]:
    """Schemas that answers of the interface are made of; robots and options stay documents, a figure is a ``Figure``."""
    text = json.dumps([m["responses"] for path in INTERFACE["paths"].values() for m in path.values()])
    waiting, found = names_in(text), set[str]()
    while waiting:
        name = waiting.pop()
        if (
            name not in found
            and not name.endswith(("Robot", "Options", "Figures"))
            and name not in ("Folds", "Problem")
        ):
            found.add(name)
            waiting |= names_in(json.dumps(INTERFACE["components"]["schemas"][name]))
    return {name for name in found if not name.endswith("List")}


def names_in(text: str) -> set[str]:
    return {part.partition('"')[0] for part in text.split("#/components/schemas/")[1:]}


def test_every_answer_has_its_type_and_every_field_its_place() -> None:
    assert answers() <= set(MODULE_OF)
    for name, module in MODULE_OF.items():
        kind = getattr(import_module(f"kilter_client.typed.{module}"), name)
        properties = INTERFACE["components"]["schemas"][name]["properties"]
        known = {kind.RENAMED.get(one.name, one.name) for one in fields(kind) if one.name != "document"}
        assert known == set(properties), name
    kinds = {name for name in MODULE_OF if name.endswith("Job")} - {"FleetJob"}  # many jobs, of no kind of its own
    assert set(JOBS.values()) == kinds


def test_the_same_concept_has_one_type() -> None:
    of_version = get_type_hints(Version)["parameters"]
    assert of_version == get_type_hints(IdentifyResult)["parameters"] == Records[Parameter]
    assert Record in Parameter.__mro__


def test_importing_the_library_loads_little_and_no_pydantic() -> None:
    heavy = ("numpy", "pandas", "matplotlib", "pydantic", "httpx", "rich", "kilter_client.typed.fits")
    script = f"import kilter, sys; print(kilter.connect.__name__, *[name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["connect"]


def test_the_short_name_has_everything() -> None:
    import kilter

    assert kilter.__all__ == kilter_client.__all__
    assert all(getattr(kilter, name) is getattr(kilter_client, name) for name in kilter.__all__)
    assert kilter.IdentifyResult is IdentifyResult
    with pytest.raises(AttributeError):
        kilter.Nothing  # noqa: B018


def test_every_module_of_types_is_had_by_its_name() -> None:
    folder = Path(typed.__path__[0])
    modules = {path.stem for path in folder.glob("*.py") if path.stem != "__init__"}
    assert modules <= set(vars(typed))
    assert all(getattr(getattr(typed, module), name) for name, module in MODULE_OF.items())
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        typed.nonsense  # type: ignore[attr-defined]  # noqa: B018
