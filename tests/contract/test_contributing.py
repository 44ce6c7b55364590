"""What CONTRIBUTING.md says of adding an effect, a method, a reader, an option, a kind of job and an export: done in a copy.

Each addition may touch so many files and no more; then the copy is used as it is, in a process of its own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
COPIED = (
    "core", "service", "clients/files", "clients/python", "clients/matlab", "docs", "tests/contract", "migrations", "tools",
)  # fmt: skip
SECONDS = 500
SNAPSHOT = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/contract/test_openapi.py", "-k", "snapshot"]
MAKE_CONTRACT = ["-m", "tools.contract"]
QUICK = ("effect", "kind of measurement")  # what `make test` tries; `python -m tools.lab slow` tries the others too

EFFECT = '''"""Wobble of a joint: an error with the third multiple of its angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_CURVE, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ToyWobble(Effect):
    """dq = w sin 3q."""

    id = "toy_wobble"
    summary = "wobble with three periods a turn"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "a test"
    remedy = "move the joint over its whole range"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitude w per joint, rad."""
        return self.per_joint(robot, "toy_wobble", "rad", 1e-3, -0.02, 0.02, "amplitude of the wobble")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by w."""
        return self.joint_angle(batch, values, np.sin(3.0 * batch.q))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a wave for each joint."""
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.WAVE, value, factor=3.0)
        return True
'''
USE_EFFECT = """
import numpy as np
from kilter_core.effects import make_effect
from kilter_core.gap.search.candidates import build_library
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from tests.contract.test_docs import test_every_effect_is_documented
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.refusals import read_options

test_every_effect_is_documented()
get_job_kind("identify").check(read_options("identify", {"effects": [{"id": "toy_wobble", "joints": [2]}]}))
robot = robot_from_document(preset_document("panda"))
q = np.random.default_rng(0).uniform(*robot.limits.T, (80, 7))
bent = q.copy()
bent[:, 3] += 2e-3 * np.sin(3 * q[:, 3])
seen = Calibration.nominal(robot).predict(Observations(bent))
rows = Observations(q, position=seen.position, rotation=seen.rotation)
found = identify(robot, rows, None, IdentifyOptions.from_document({"effects": [{"id": "toy_wobble", "joints": [4]}]}))
row = next(p for p in found.to_document()["parameters"] if p["name"] == "toy_wobble_4")
assert abs(row["value"] - np.degrees(2e-3)) < 1e-3, row
again = Calibration.from_document(robot, found.calibration.to_document())
assert np.allclose(again.predict(rows).position, found.calibration.predict(rows).position)
assert "toy_wobble" in {c.id for c in build_library(robot, rows).candidates}
from kilter_core.correct.program import compile_program
program = compile_program(again)
assert (program.supported, program.unsupported) == (("toy_wobble",), ()), program.unsupported
"""

METHOD = '''"""Least squares that looks twice: the fit, and again from where it ended."""

from __future__ import annotations

from dataclasses import replace

from kilter_core.identify.estimate import estimate
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.types import Progress


def toy_twice(
    start: Calibration, measurement: Measurement, options: IdentifyOptions, progress: Progress | None = None
) -> Fit:
    """Fit, and fit again."""
    first = estimate(start, measurement, options, progress)
    again = estimate(first.calibration(), measurement, options)
    return replace(again, report={"looks": 2})
'''
USE_METHOD = """
import numpy as np
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.refusals import read_options

get_job_kind("identify").check(read_options("identify", {"method": "toy_twice", "loss": "tukey", "intervals": "profile"}))
robot = robot_from_document(preset_document("panda"))
q = np.random.default_rng(0).uniform(*robot.limits.T, (60, 7))
rows = Observations(q, position=Calibration.nominal(robot).predict(Observations(q + 1e-3)).position)
found = identify(robot, rows, 0.25, IdentifyOptions.from_document({"method": "toy_twice", "level": 1})).to_document()
assert found["method"] == {"name": "toy_twice", "looks": 2}, found["method"]
assert found["metrics"]["validation"]["identified"]["rms_mm"] < 1e-3
"""

MEASUREMENT = '''"""Ranges: how far the tool is from the instrument, as a distance meter reads it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import Block, Kind, Rows
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.types import Floats


@dataclass(frozen=True)
class ToyRange(Kind):
    """Rows with a length and no bar that it could be of."""

    name = "toy_range"
    summary = "distances of the tool from the instrument"

    observations: Observations

    @classmethod
    def from_rows(cls, rows: Rows) -> ToyRange | None:
        """Rows with a length."""
        return cls(rows.observations) if rows.observations.bar_length is not None else None

    def scalars(self) -> int:
        """One a row."""
        return len(self.observations)

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted length (N, 1, 1) m."""
        assert self.observations.bar_length is not None
        size = np.linalg.norm(prediction.position, axis=1)
        left = (self.observations.bar_length - size)[:, None, None]
        slope = None if J is None else np.einsum("ni,nip->np", prediction.position / size[:, None], J[:, :3])
        return (Block("toy_range", left, None if slope is None else slope[:, None, None]),)
'''
USE_MEASUREMENT = """
import numpy as np
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document

robot = robot_from_document(preset_document("panda"))
rng = np.random.default_rng(0)
q = rng.uniform(*robot.limits.T, (80, 7))
true = Calibration.nominal(robot).predict(Observations(q + 1e-3)).position
ranges = np.linalg.norm(true, axis=1) + 1e-6 * rng.normal(size=80)
seen = true + 1e-3 * rng.normal(size=true.shape)
asked = IdentifyOptions(level=1, base="fixed", tool="fixed", reference="robot")
errors = []
for lengths in (None, ranges):
    found = identify(robot, Observations(q, position=seen, bar_length=lengths), None, asked)
    errors.append(np.abs(found.calibration.predict(Observations(q)).position - true).max())
assert abs(np.log(found.fit.problem.weights.others["toy_range"] / 1e-6)) < 0.7, found.fit.problem.weights.others
assert errors[1] < 0.5 * errors[0], errors
"""

READER = '''"""A toy device: joints in degrees and a point in metres, with blanks between."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import DEVICE, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.tables.table import Table


class Toy(Reader[Table]):
    """Rows of two numbers."""

    name = "toy"
    title = "The log of a toy"
    use = DEVICE
    endings = (".toy",)
    is_a = "the log of a toy"
    instead = "Send it with --device toy."

    def recognises(self, head: Head) -> bool:
        """Its ending."""
        return head.ending in self.endings

    def describe(self, head: Head) -> Document:
        """How many rows."""
        return {"rows": len(self.read(head.path)), "ready": True, "device": self.name}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read one file."""
        rows = [[float(cell) for cell in line.split()] for line in path.read_text(encoding="utf-8").splitlines()]
        q1, x = zip(*rows, strict=True)
        return Table({"q1_deg": list(q1), "x_mm": [1e3 * v for v in x]}, list(range(1, len(rows) + 1)))


READER = Toy()
'''
USE_READER = """
import pathlib, tempfile
from kilter_files import prepare
from kilter_client.cli import run

file = pathlib.Path(tempfile.mkdtemp()) / "rows.toy"
file.write_text("10 0.5\\n20 0.25\\n")
made = prepare(file, "toy")
assert made.content.decode().splitlines() == ["q1_deg,x_mm", "10.0,500.0", "20.0,250.0"], made.content
assert run(["upload", "arm", str(file), "--device", "toy", "--dry-run"]) == 0
from kilter_files import DEVICES
from kilter_files.formats.registry import list_formats
from kilter_files.look.drafts import inspect
from kilter_service.page.drop.child import _inspect_file
from kilter_service.page.drop.service import ways
assert (inspect(file)["kind"], inspect(file)["rows"]) == ("toy", 2)
assert _inspect_file(file)["device"] == "toy"
assert ("toy", "The log of a toy") in ways()
assert ("upload --device", "toy", (".toy",), "The log of a toy") in list_formats()
assert "toy" in DEVICES
"""

KIND = '''"""Job kind ``count``: how many rows there are."""

from __future__ import annotations

from kilter_service.contract.jobs.count import COUNT
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, Progress


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Count."""
    progress(0.5, "counting")
    return JobOutput({"rows": {name: -(-len(rows) // job.options.every) for name, rows in job.campaigns.items()}})


KIND = JobKind(COUNT, run)
'''
KIND_CONTRACT = '''"""Jobs of kind ``count``: how many rows there are."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.units import Asked, Stored


class CountOptions(Asked):
    """What can be asked of a count."""

    every: Annotated[int, Field(ge=1, le=1000)] = Field(1, description="Count one row of so many.")


class CountResult(Stored):
    """How many rows there are."""

    rows: dict[str, int] | None = Field(None, description="Rows, by campaign.")


COUNT = JobContract(
    "count",
    noun="count of rows",
    title="Count rows",
    summary="Count the rows of campaigns.",
    options=CountOptions,
    result=CountResult,
    usual=("every",),
    uses={"train": "train"},
)
'''
KIND_PAGE = """## count
How many rows campaigns have, with `kilter count`.

<!-- make contract: options of count -->
<!-- end -->

"""
USE_KIND = """
import json, os, pathlib, shutil, subprocess, sys, tempfile
import httpx, kilter
from playwright.sync_api import sync_playwright
from kilter_client.requests.connection import local_server

folder = pathlib.Path(tempfile.mkdtemp())
(folder / "rows.csv").write_text("\\n".join(
    [",".join(f"q{j}_deg" for j in range(1, 8)) + ",x_mm,y_mm,z_mm"]
    + [",".join(map(str, [k, -20, 10, -90 + k, 5, 100, 30, 400 + k, 10, 500])) for k in range(7)]
))
with local_server(folder / "data") as server:
    os.environ.update(server.environment())
    with kilter.connect(server.url) as k:
        k.add_robot(preset="panda", name="arm")
        campaign = k.upload("arm", folder / "rows.csv").campaign_id
        # The library
        assert k.check("count", "arm", campaign).would_run
        found = k.count("arm", campaign, every=2, progress=False)
        assert type(found).__name__ == "CountResult" and found.rows == {campaign: 4}, found
    # HTTP
    token = (folder / "data/token").read_text().strip()
    asked = {"kind": "count", "robot": "arm", "campaigns": [campaign], "options": {"every": 1001}}
    with httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {token}"}) as client:
        job = client.get("/v1/jobs?robot=arm").json()["jobs"][0]
        refused = client.post("/v1/jobs", json=asked).json()
    assert refused["code"] == "option_invalid" and "options.every is 1001" in refused["detail"], refused
    assert (job["kind"], job["state"]) == ("count", "succeeded"), job
    # The command
    words = [sys.executable, "-m", "kilter_client", "count", "arm", "-c", campaign, "--every", "3", "--json"]
    words[1:3] = ["-c", "import sys; from kilter_client.cli import run; sys.exit(run(sys.argv[1:]))"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["result"] == {"rows": {campaign: 3}}, done.stdout
    # The page
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(base_url=server.url)
        page.goto("/login")
        page.get_by_label("Token").fill(token)
        page.get_by_role("button", name="Log in").click()
        page.wait_for_url("**/")
        page.goto("/robots/arm/jobs")
        page.get_by_role("link", name="Count rows").first.click()
        page.get_by_label("Every").fill("7")
        page.get_by_role("button", name="Check").click()
        page.get_by_text("The check has passed.").wait_for()
        page.get_by_role("button", name="Run").click()
        page.get_by_text(f"Rows {campaign}").wait_for()
        assert page.locator(f"dt:has-text('Rows {campaign}') + dd").inner_text() == "1"
        browser.close()
"""

OPTION = """    toy_width_mm: float | None = option(
        None, "Width of a toy, mm, above 0 and at most 50; null: as wide as it is.", above=0.0, high=50.0
    )
"""
USE_OPTION = """
import contextlib, io, pathlib, tempfile
from kilter_client.cli import run
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions
from kilter_service.contract.jobs.identify import IDENTIFY
from kilter_service.ground.settings import Settings
from kilter_service.jobs.kinds.identify import KIND
from kilter_service.jobs.refusals import read_options
from kilter_service.page.jobs import routes as options
from kilter_service.run.app import create_app

# The core
assert IdentifyOptions(toy_width_mm=3).toy_width_mm == 3
for wrong, said in ((0, "a number above 0.0 and at most 50.0"), ("wide", "a number"), (True, "a number")):
    try:
        IdentifyOptions(toy_width_mm=wrong)
    except OptionError as error:
        assert said in str(error), error
    else:
        raise AssertionError(f"{wrong!r} was not refused")
# HTTP
schema = create_app(Settings(data=pathlib.Path(tempfile.mkdtemp()))).openapi()["components"]["schemas"]
(number, _) = schema["IdentifyOptions"]["properties"]["toy_width_mm"]["anyOf"]
assert number == {"type": "number", "exclusiveMinimum": 0.0, "maximum": 50.0, "x-unit": "mm"}, number
KIND.check(read_options("identify", {"toy_width_mm": 50}))
try:
    read_options("identify", {"toy_width_mm": 51})
except OptionError as error:
    assert str(error).startswith("options.toy_width_mm is 51: give a number"), error
else:
    raise AssertionError("it was not refused")
# The page, the command, the library, MATLAB and the reference
(field,) = (one for one in options.fields("identify")[1] if one.name == "toy_width_mm")
assert (field.form, field.hint[:14]) == ("number", "Width of a toy"), field
with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
    run(["identify", "--help"])
assert "--toy-width-mm" in shown.getvalue(), shown.getvalue()
for page in ("clients/matlab/+kilter/identify.m", "clients/python/src/kilter_client/typed/options.py",
             "docs/reference/cli.md", "docs/reference/job-options.md"):
    text = pathlib.Path(page).read_text(encoding="utf-8")
    assert ("toy-width-mm" if page.endswith("cli.md") else "toy_width_mm") in text, page
"""

EXPORT = '''"""Export as a list of names, one a line."""

from __future__ import annotations

from kilter_service.robots.exporters.exportable import Exportable, Written


def names_txt(version: Exportable) -> Written:
    """Write the names of the parameters."""
    return Written("".join(f"{name}\\n" for name in version.calibration.names))
'''
USE_EXPORT = """
from types import SimpleNamespace
from kilter_core.model import Calibration
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_service.robots.exporters.registry import FORMATS, export

about = SimpleNamespace(robot="arm", id="ver_1")
nominal = Calibration.nominal(robot_from_document(preset_document("panda")))
made = export("names", SimpleNamespace(version=about, calibration=nominal))
assert (made.name, made.media_type, made.text.split()[0]) == ("arm-ver_1.txt", "text/plain", "base_x"), made
"""
USE_CONDITION = """
from dataclasses import dataclass
import numpy as np
import pyarrow as pa
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects.base import Effect
from kilter_core.errors import ObservationError
from kilter_core.model import Calibration
from kilter_core.parameters import Parameter
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns


@dataclass(frozen=True)
class Swelling(Effect):
    id, summary, source, remedy, needs = "swelling", "swells", "a test", "wait for rain", frozenset({"humidity_pct"})

    def parameters(self, robot):
        return self.per_joint(robot, "swelling", "rad", 1e-3, -0.02, 0.02, "per percent")

    def local(self, batch, values):
        damp = self.column(batch, "humidity_pct")
        return self.joint_angle(batch, values, np.tile(damp[:, None], (1, batch.q.shape[1])))


robot = robot_from_document(preset_document("panda"))
cells = {f"q{j + 1}_deg": np.zeros(3) for j in range(7)} | {"humidity_pct": np.array([0.0, 50.0, 100.0])}
columns = read_columns(list(cells), ["revolute"] * 7)
rows = observations(pa.table(cells), columns, {})
assert rows.humidity_pct.tolist() == [0.0, 50.0, 100.0] and rows.select(slice(1)).humidity_pct.tolist() == [0.0]
moved = Calibration.nominal(robot, (Swelling(joints=(0,)),))
base = len(moved.values) - 1
values = moved.values.copy()
values[base] = 1e-3
there, here = moved.model.predict(rows, values).rotation, Calibration.nominal(robot).predict(rows).rotation
turned = np.arccos(np.clip((np.trace(here.transpose(0, 2, 1) @ there, axis1=1, axis2=2) - 1) / 2, -1, 1))
assert np.allclose(turned, [0.0, 0.05, 0.1]), turned
try:
    moved.model.predict(rows.__class__(rows.q), values)
except ObservationError as error:
    assert "upload humidity_pct" in str(error), error
else:
    raise AssertionError("a missing condition was not missed")
"""


def lined(path: str, *lines: tuple[str, str]) -> str:
    """The text of a file with lines put before others."""
    text = (REPOSITORY / path).read_text(encoding="utf-8")
    for before, line in lines:
        assert text.count(before) == 1, (path, before)
        text = text.replace(before, line + before)
    return text


METHODS, EFFECTS = "core/kilter_core/identify/registry.py", "core/kilter_core/effects/registry.py"
MEASUREMENTS = "core/kilter_core/measurement/registry.py"
READERS = "clients/files/kilter_files/formats/registry.py"
KINDS, FORMATS = (
    "service/kilter_service/contract/jobs/registry.py",
    "service/kilter_service/robots/exporters/registry.py",
)
OPTIONS = "core/kilter_core/identify/options.py"
JOB_PAGE = "docs/reference/job-options.md.in"
ROWS, UNITS = "core/kilter_core/observations/rows.py", "service/kilter_service/contract/columns.py"
COLUMNS_PAGE = "docs/reference/columns.md"
PAGE, ROW = "docs/reference/effects.md", "| `toy_wobble` | a test | dq = w sin 3q | `toy_wobble`, deg | |\n"
ADDITIONS: Mapping[str, tuple[int, Mapping[str, str], str]] = {
    "effect": (3, {
        "core/kilter_core/effects/toy_wobble.py": EFFECT,
        EFFECTS: lined(EFFECTS, ("from kilter_core.effects.instrument",
                                  "from kilter_core.effects.toy_wobble import ToyWobble\n"),
                       ("    UnknownSmoothCurve,\n", "    ToyWobble,\n")),
        PAGE: lined(PAGE, ("| `encoder_scale` |", ROW)),
    }, USE_EFFECT),
    "condition": (3, {
        ROWS: lined(ROWS, ('    payload_kg: Annotated',
                           '    humidity_pct: Annotated[Floats | None, "humidity_pct"] = None\n')),
        UNITS: lined(UNITS, ('    "temperature": {', '    "humidity": {"pct": 1.0},\n')),
        COLUMNS_PAGE: lined(COLUMNS_PAGE, ("| `temperature_c` |", "| `humidity_pct` | humidity |\n")),
    }, USE_CONDITION),
    "method": (2, {
        "core/kilter_core/identify/methods/toy_twice.py": METHOD,
        METHODS: lined(METHODS, ('    "kalman": Method',
                                  '    "toy_twice": Method("methods.toy_twice:toy_twice", "twice", True, True),\n')),
    }, USE_METHOD),
    "kind of measurement": (2, {
        "core/kilter_core/measurement/toy_range.py": MEASUREMENT,
        MEASUREMENTS: lined(MEASUREMENTS, ("\nKINDS", "from kilter_core.measurement.toy_range import ToyRange\n"))
        .replace("Inclination)", "Inclination, ToyRange)"),
    }, USE_MEASUREMENT),
    "reader": (2, {
        "clients/files/kilter_files/formats/readers/toy.py": READER,
        READERS: lined(READERS, ('    "ballbar",\n', '    "toy",\n')),
    }, USE_READER),
    "option of an identification or a gap search": (1, {
        OPTIONS: lined(OPTIONS, ("    prior: str | None = option(\n", OPTION)),
    }, USE_OPTION),
    "kind of job": (4, {
        "service/kilter_service/contract/jobs/count.py": KIND_CONTRACT,
        "service/kilter_service/jobs/kinds/count.py": KIND,
        KINDS: lined(KINDS, ("from kilter_service.contract.jobs.drift",
                             "from kilter_service.contract.jobs.count import COUNT\n"))
        .replace("(IDENTIFY, GAP,", "(IDENTIFY, COUNT, GAP,"),
        JOB_PAGE: lined(JOB_PAGE, ("## drift\n", KIND_PAGE)),
    }, USE_KIND),
    "export": (2, {
        "service/kilter_service/robots/exporters/names_txt.py": EXPORT,
        FORMATS: lined(FORMATS, ('    "matlab": Format', '    "names": Format("names_txt.names_txt", "text/plain", "txt"),\n')),
    }, USE_EXPORT),
}  # fmt: skip


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources with what Python made of them, copied; the compiled kernels, which take minutes, are used where they are."""
    root = tmp_path_factory.mktemp("copy")
    for folder in COPIED:
        shutil.copytree(REPOSITORY / folder, root / folder, ignore=shutil.ignore_patterns("kernels"))
    for kernels in (REPOSITORY / "core/kilter_core").glob("*/kernels"):
        (root / kernels.relative_to(REPOSITORY)).symlink_to(kernels, target_is_directory=True)
    shutil.copy(REPOSITORY / "pyproject.toml", root / "pyproject.toml")
    return root


@pytest.mark.parametrize(
    "what", [what if what in QUICK else pytest.param(what, marks=pytest.mark.slow) for what in ADDITIONS]
)
def test_an_addition_touches_no_more_files_than_the_guide_says(what: str, copy: Path) -> None:
    most, changes, use = ADDITIONS[what]
    assert len(changes) <= most
    for path, text in changes.items():
        (copy / path).write_text(text, encoding="utf-8")
    paths = os.pathsep.join(
        str(copy / part) for part in (".", "core", "service", "clients/files", "clients/python/src")
    )
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1", "OPENBLAS_NUM_THREADS": "1"}
    guide = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8").lower()
    section = guide.split(f"## add {'an' if what[0] in 'eo' else 'a'} {what}\n")[1].split("\n## ")[0]
    runs = [MAKE_CONTRACT] * section.count("`make contract`")  # what it writes is no file that anybody edits
    runs += [SNAPSHOT] if runs else []
    used = ["-c", f"import kilter_core as core; assert core.__file__.startswith({str(copy)!r})\n{use}"]
    for arguments in [*runs, used]:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=copy, env=environment, capture_output=True, text=True, timeout=SECONDS,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
    named = [path for path in changes if (REPOSITORY / path).exists()]
    assert all(f"`{path.lower()}`" in section for path in named), named
