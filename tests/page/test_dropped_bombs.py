"""Files that are made to hurt: each is refused in words, and the server answers on."""

from __future__ import annotations

import io
import json
import os
import random
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from kilter_service.ground import child_process
from kilter_service.ground.child_process import Limits
from kilter_service.page.drop import routes
from tests.service.conftest import Katana

CASES = int(os.environ.get("KILTER_FUZZ_FILES", "300"))
ZEROS = 1 << 27
Make = Callable[[], bytes]


def zipped(name: str, content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return out.getvalue()


def workbook() -> bytes:
    """A sheet that unpacks to 128 MB of cells."""
    out = io.BytesIO()
    cell = b"<row><c><v>1</v></c></row>"
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "[Content_Types].xml", '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"/>'
        )
        archive.writestr("xl/worksheets/sheet1.xml", b"<worksheet><sheetData>" + cell * (ZEROS // len(cell)))
    return out.getvalue()


def matlab() -> bytes:
    """A variable that unpacks to 128 MB and says it is far larger."""
    out = io.BytesIO()
    savemat(out, {"q": np.zeros((2, 2))})
    packed = zlib.compress(b"\x0e\x00\x00\x00\xf0\xff\xff\xff" + bytes(ZEROS), 9)
    return out.getvalue()[:128] + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed


def columnar() -> bytes:
    """Parquet of 60 million equal numbers: some kB."""
    sink = pa.BufferOutputStream()
    one = pa.table({"q1_deg": pa.array(np.zeros(1 << 20))})
    with parquet.ParquetWriter(sink, one.schema, compression="zstd") as writer:
        for _ in range(60):
            writer.write_table(one)
    return bytes(sink.getvalue())


BOMBS: dict[str, Make] = {
    "bomb.xlsx": workbook,
    "bomb.mat": matlab,
    "bomb.parquet": columnar,
    "bomb.npz": lambda: zipped("q.npy", bytes(ZEROS)),
    "deep.json": lambda: b"[" * 2_000_000,
    "line.csv": lambda: b"q1_deg," * 3_000_000,
    "nul.csv": lambda: b"q1_deg,x_mm\n" + bytes(1 << 20),
    "counts.csv": lambda: b"q1_deg,x_mm,y_mm,z_mm\n" + b"1e400,9" + b"9" * 100_000 + b",1,2\n",
    "bytes.tdms": lambda: b"TDSm" + b"\xff" * 4096,
    "entities.mod": lambda: b"MODULE a\n" + b"CONST jointtarget p:=[[" * 50_000,
}


@pytest.fixture(scope="module")
def robot(server: httpx.Client) -> str:
    server.post("/v1/robots", json=Katana.document).raise_for_status()
    return Katana.name


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_in_words_and_the_server_answers_on(
    server: httpx.Client, robot: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "LIMITS", Limits(seconds=5, memory_mb=768, output_mb=64))
    place = f"/robots/{robot}/campaigns/new/file"
    sent = server.post(place, params={"name": name}, content=BOMBS[name](), timeout=120)
    assert sent.status_code == 201, sent.text
    text = server.get(sent.json()["address"]).raise_for_status().text
    assert "These rows cannot be stored yet." in text or "This file cannot be read." in text, text
    assert "Traceback" not in text
    assert 'name="sha256"' not in text
    assert server.get("/v1/health/live").status_code == 200
    assert server.get(f"/v1/robots/{robot}/campaigns").json()["campaigns"] == []


def test_time_memory_and_output_are_limited(tmp_path: Path) -> None:
    for code, limits, ended in (
        ("while True: pass", Limits(1, 512, 8), lambda end: end.late),
        ("x = bytearray(1 << 31)", Limits(20, 512, 8), lambda end: end.lacked_memory),
        ("open('out', 'wb').write(bytes(64 << 20))", Limits(20, 512, 8), lambda end: end.code != 0),
        ("import subprocess; subprocess.run(['sleep', '60'])", Limits(1, 512, 8), lambda end: end.late),
    ):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        end = child_process.run("timeit", folder, ["-n1", "-r1", "-s", CONFINED, code], limits)
        assert ended(end), (code, end)


def test_nothing_of_the_servers_environment_is_in_reach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KILTER_TOKEN", "a-secret")
    child_process.run(
        "timeit", tmp_path, ["-n1", "-r1", "import os; open('seen', 'w').write(str(dict(os.environ)))"], Limits()
    )
    seen = (tmp_path / "seen").read_text()
    assert "a-secret" not in seen
    assert "KILTER_CHILD_LIMITS" in seen


CONFINED = "from kilter_service.ground.child_process import confine; confine()"


def mutated(random_: random.Random, content: bytes) -> bytes:
    """Some bytes changed, cut, repeated or put in."""
    out = bytearray(content)
    for _ in range(random_.randint(1, 12)):
        place = random_.randrange(len(out) + 1)
        kind = random_.randrange(5)
        if kind == 0:
            out[place : place + 1] = bytes([random_.randrange(256)])
        elif kind == 1:
            del out[place : place + random_.randrange(200)]
        elif kind == 2:
            out[place:place] = out[place : place + random_.randrange(500)] * random_.randint(1, 40)
        elif kind == 3:
            out[place:place] = random_.choice([b"\x00", b"\xff\xfe", b'"', b",,,,", b"\r", b"1e999", b"\n\n", b"nan"])
        else:
            out[place : place + 4] = random_.choice([b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\xff\xff\xff\x7f"])
    return bytes(out)


def seeds() -> dict[str, bytes]:
    columns = {name: np.array(values) for name, values in Katana().columns(30, seed=1).items()}
    text = "\n".join(
        [
            ",".join(columns),
            *(",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns.values()), strict=True)),
        ]
    )
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table(columns), sink)
    mat = io.BytesIO()
    savemat(mat, {"q": np.stack([columns[f"q{k}_deg"] for k in range(1, 6)], axis=1), "xyz": columns["x_mm"]})
    return {
        "a.csv": text.encode(), "a.txt": text.replace(",", ";").replace(".", ",").encode(), "a.parquet": bytes(sink.getvalue()),
        "a.mat": mat.getvalue(), "a.json": json.dumps({k: v.tolist() for k, v in columns.items()}).encode(),
        "a.xlsx": workbook_of(columns),
    }  # fmt: skip


def workbook_of(columns: dict[str, np.ndarray]) -> bytes:
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    assert sheet is not None
    for row in (list(columns), *(list(row) for row in zip(*(c.tolist() for c in columns.values()), strict=True))):
        sheet.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_damaged_files_of_every_kind_are_read_or_refused(tmp_path: Path) -> None:
    """`KILTER_FUZZ_FILES` of them: each ends with an answer, within its limits."""
    random_ = random.Random(20261122)
    whole = seeds()
    refused = 0
    for number in range(CASES):
        name = random_.choice(sorted(whole))
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / name).write_bytes(mutated(random_, whole[name]))
        (folder / "asked.json").write_text(json.dumps({"file": name, "read_as": "auto"}))
        ended = child_process.run(routes.CHILD, folder, [], Limits(30, 1024, 64))
        assert not ended.late, (number, name)
        assert ended.code == 0 or ended.lacked_memory, (number, name, ended)
        if ended.code == 0:
            found = json.loads((folder / "understood.json").read_bytes())
            assert found.get("refusal") or found.get("map") or (folder / "rows").exists(), (number, name, found)
            refused += bool(found.get("refusal"))
            assert "Traceback" not in str(found.get("refusal"))
    assert 0 < refused < CASES
