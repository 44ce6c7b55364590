"""The corrector in C inside Octave, as a MEX function, and what MATLAB Coder's code calls: the numbers are Python's."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kilter_core.correct.program import CorrectionProgram, Track
from tests.core.correct.c_corrector import COMPILER, WARNINGS, blob_of
from tests.core.correct.test_c_corrector import path_of, program_of

CLIENTS = Path(__file__).resolve().parents[2] / "clients"
FOLDER = CLIENTS / "matlab" / "corrector"
OCTAVE, MKOCTFILE = shutil.which("octave-cli"), shutil.which("mkoctfile")
STEP_S = 0.008


@pytest.fixture(scope="module")
def program() -> CorrectionProgram:
    return program_of("ur10e", "gear_error", "clearance_tilt")


def followed(program: CorrectionProgram, wanted: np.ndarray) -> np.ndarray:
    done, out, _, _ = Track(program, settled=True).follow(wanted, 1, np.full(len(wanted), STEP_S))
    assert done == len(wanted)
    return np.asarray(out)


@pytest.fixture(scope="module")
def mex(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if OCTAVE is None or MKOCTFILE is None:
        pytest.skip("octave-cli or mkoctfile is not installed (Debian: apt-get install octave octave-dev)")
    folder = tmp_path_factory.mktemp("mex")
    sources = [str(FOLDER / "kilter_corrector_mex.c"), str(CLIENTS / "c" / "kilter_corrector.c")]
    options = ["--mex", "-Wall", "-Wextra", "-Werror", f"-I{CLIENTS / 'c'}"]
    command = [MKOCTFILE, *options, *sources, "-o", "kilter_corrector_mex.mex"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    shutil.copy(FOLDER / "kilter_corrector.m", folder)
    return folder


def octave(folder: Path, script: str) -> None:
    (folder / "script.m").write_text(script)
    command = [str(OCTAVE), "--no-gui", "--quiet", "--norc", "script.m"]
    run = subprocess.run(
        command, cwd=folder, env=os.environ | {"HOME": str(folder)}, capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_a_path_in_octave_is_that_of_python(program: CorrectionProgram, mex: Path) -> None:
    wanted = path_of(program, 200, seed=2, step=STEP_S)
    (mex / "arm.klt").write_bytes(blob_of(program))
    np.savetxt(mex / "wanted.txt", wanted, fmt="%.17g")
    octave(mex, f"""
        c = kilter_corrector('arm.klt');
        wanted = load('wanted.txt');
        out = nan(size(wanted));
        for k = 1:rows(wanted)
          [out(k, :), status, flags, left_m] = c.step(wanted(k, :), {STEP_S});
          assert(status == 0 && isfinite(left_m));
        end
        alone = c.alone(wanted(1, :)');
        assert(isequal(size(alone), [6 1]));
        [q, status] = c.step([99 0 0 0 0 0], {STEP_S});
        assert(all(isnan(q)) && status ~= 0);
        f = fopen('out.txt', 'w'); fprintf(f, [repmat('%.17g ', 1, 6) "\\n"], out'); fclose(f);
        f = fopen('alone.txt', 'w'); fprintf(f, '%.17g ', alone); fclose(f);
    """)  # fmt: skip
    assert np.abs(np.loadtxt(mex / "out.txt") - followed(program, wanted)).max() < 1e-12
    assert np.abs(np.loadtxt(mex / "alone.txt") - program.correct_rows(wanted[:1]).q[0]).max() < 1e-12
    assert np.abs(np.loadtxt(mex / "out.txt") - wanted).max() > 1e-5


def test_what_octave_gives_wrongly_is_refused_in_words(program: CorrectionProgram, mex: Path) -> None:
    content = bytearray(blob_of(program))
    (mex / "arm.klt").write_bytes(content)
    content[300] ^= 4
    (mex / "altered.klt").write_bytes(content)
    octave(mex, """1;
        function refused(identifier, said, varargin)
          try
            feval(varargin{:});
          catch problem
            assert(strcmp(problem.identifier, identifier) && ! isempty(strfind(problem.message, said)), problem.message);
            return
          end
          error('not refused');
        end
        refused('kilter:program', 'load', 'kilter_corrector_mex', 'alone', zeros(1, 6));
        refused('kilter:file', 'cannot be read', 'kilter_corrector', 'nothing.klt');
        c = kilter_corrector('arm.klt');
        refused('kilter:program', 'checksum is wrong', 'kilter_corrector', 'altered.klt');
        assert(all(isfinite(c.alone(zeros(1, 6)))));
        refused('kilter:usage', 'Give 6 joints', 'kilter_corrector_mex', 'alone', zeros(1, 5));
        refused('kilter:usage', 'Say load', 'kilter_corrector_mex', 'jump');
    """)  # fmt: skip


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_what_generated_code_calls_is_that_of_python(program: CorrectionProgram, tmp_path: Path) -> None:
    """The exported C file in one translation unit with the function that coder.ceval names."""
    content = blob_of(program)
    code = (CLIENTS / "c" / "kilter_corrector.c").read_text()
    numbers = ", ".join(map(str, content))
    (tmp_path / "arm.c").write_text(f"{code}\nconst unsigned char kc_program[{len(content)}] = {{{numbers}}};\n")
    made = tmp_path / "coder.so"
    include = [f"-I{tmp_path}", f"-I{CLIENTS / 'c'}", f"-I{FOLDER}"]
    command = [
        str(COMPILER),
        *WARNINGS,
        "-O2",
        "-shared",
        "-fPIC",
        *include,
        "-o",
        str(made),
        str(FOLDER / "kilter_coder.c"),
        "-lm",
    ]
    subprocess.run(command, check=True)
    step = ctypes.CDLL(str(made)).kilter_coder_step
    wanted = path_of(program, 100, seed=4, step=STEP_S)
    out = np.empty_like(wanted)
    pointer = ctypes.POINTER(ctypes.c_double)
    for k in range(len(wanted)):
        given, taken = wanted[k].ctypes.data_as(pointer), out[k].ctypes.data_as(pointer)
        assert step(given, 6, ctypes.c_double(STEP_S), taken) == 0
    assert np.abs(out - followed(program, wanted)).max() < 1e-12
    five = np.zeros(5)
    assert step(five.ctypes.data_as(pointer), 5, ctypes.c_double(STEP_S), five.ctypes.data_as(pointer)) != 0
    assert np.isnan(five).all()
    called = (FOLDER / "kilter_correct_coder.m").read_text()
    assert "coder.ceval('kilter_coder_step', coder.rref(wanted), int32(numel(wanted)), dt, coder.wref(q))" in called
