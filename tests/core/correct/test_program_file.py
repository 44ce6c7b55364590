"""Reading a program that was written as a file."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kilter_core.correct import file
from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram, Track
from kilter_core.errors import OptionError
from tests.core.correct.c_corrector import blob_of
from tests.core.correct.test_c_corrector import altered_programs, path_of, program_of


@pytest.fixture(scope="module")
def program() -> CorrectionProgram:
    return program_of("ur10", "clearance_tilt", "gear_error", "link_bending")


def test_what_is_read_corrects_as_what_was_written(program: CorrectionProgram) -> None:
    content = file.to_bytes(program, version_id="ver_7", number=2**63 + 5, robot="cell 7, größer")
    read = file.from_bytes(content)
    assert (read.version_id, read.number, read.robot) == ("ver_7", 2**63 + 5, "cell 7, größer")
    q = path_of(program, 50, seed=3)
    corrected = []
    for one in (program, read.program):
        done, out, _, _ = Track(one, settled=True).follow(q, 1, np.full(len(q), 0.01))
        assert done == len(q)
        corrected.append(out)
    assert np.array_equal(*corrected)
    assert np.abs(corrected[0] - q).max() > 1e-5


def test_what_is_no_whole_program_is_refused_with_its_reason(program: CorrectionProgram) -> None:
    content = blob_of(program)
    wrong = {
        "cut off": [content[:cut] for cut in (0, 127, 128, len(content) - 1)] + [content + b"\0"],
        "is none": [b"NOPE" + content[4:]],
        "another release": [
            content[:4] + b"\2\0\0\0" + content[8:],
            content[:12] + bytes(4) + content[16:],
            content[:20] + b"\x31" + content[21:],
        ],
        "numbers of no arm": [content[:24] + bytes(4) + content[28:]],
        "checksum": [content[:40] + b"x" + content[41:], content[:-1] + bytes([content[-1] ^ 1])],
    }
    for said, programs in wrong.items():
        for one in programs:
            with pytest.raises(OptionError, match=f"{said}.*export the version again"):
                file.from_bytes(one)


def test_no_altered_number_leads_out_of_the_program() -> None:
    found: list[CorrectionProgram] = []
    for content in altered_programs(200, 5):
        try:
            found.append(file.from_bytes(content).program)
        except OptionError:
            continue
    assert 1 <= len(found) < 200
    for one in found:
        scalars = one.array[-1]
        assert scalars[layout.N] == one.n_joints
        assert one.moves + 1 + one.n_joints + scalars[layout.CURVES] + 2 * scalars[layout.BENDINGS] < len(one.array)
        assert not np.isnan(one.array).any()
        assert all(math.isfinite(number) for number in one.array[: one.moves, layout.JOINT])
