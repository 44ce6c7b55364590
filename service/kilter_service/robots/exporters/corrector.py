"""A version as a program for the C corrector: the file that it loads, or one C file that holds code and program."""

from __future__ import annotations

from pathlib import Path

from kilter_core.correct import CorrectionProgram, compile_program, to_bytes
from kilter_service.ground.correction_limits import correction_options, sentence, where_sentences
from kilter_service.robots.exporters.exportable import Exportable, Written

PACKAGE = Path(__file__).resolve().parents[2]
BYTES_A_LINE = 20


def corrector(version: Exportable) -> Written:
    """Write the program that ``kc_load`` takes.

    Raises:
        OptionError: the arm cannot hold the rows of the task.

    """
    program = _program(version)
    return Written(_file(version, program), _notes(program))


def c_source(version: Exportable) -> Written:
    """Write one C file that compiles alone: header, corrector, and the program as ``kc_program``."""
    program = _program(version)
    content = _file(version, program)
    sources = _sources()
    header = (sources / "kilter_corrector.h").read_text(encoding="utf-8")
    code = (sources / "kilter_corrector.c").read_text(encoding="utf-8")
    lines = [", ".join(map(str, content[at : at + BYTES_A_LINE])) for at in range(0, len(content), BYTES_A_LINE)]
    text = "\n".join(
        (
            f"/* Version {version.version.id} of {_escape_c_comment(version.version.robot)}, with the code that "
            "corrects by it. Load it:",
            " *     kc_load(&corrector, kc_program, sizeof kc_program, memory, doubles, 0);",
            " * Other files that call it take kilter_corrector.h, which is the first part of this one. */",
            header,
            code.replace('#include "kilter_corrector.h"\n', ""),
            "/* The program: what kilter version export --format corrector writes. */",
            "extern const unsigned char kc_program[];",
            f"const unsigned char kc_program[{len(content)}] = {{",
            *(f"    {line}," for line in lines),
            "};",
            "",
        )
    )
    return Written(text, _notes(program))


def _program(version: Exportable) -> CorrectionProgram:
    # Nobody states the arm's temperature in a file: thermal growth is named in the notes instead.
    return compile_program(version.calibration, correction_options(version.version.limits, None, rules=version.rules))


def _file(version: Exportable, program: CorrectionProgram) -> bytes:
    number = int(version.version.sha256[:16], 16)  # as the messages of a stream carry it
    return to_bytes(program, version_id=version.version.id, number=number, robot=version.version.robot)


def _notes(program: CorrectionProgram) -> tuple[str, ...]:
    """What the program leaves out: nobody states a temperature or a tilt to it, so all that follows them as well."""
    if not program.unsupported:
        return ()
    never = sentence(program.unsupported, {}, "by this file")
    return (never, *(f"`kilter correct` does more. {where}" for where in where_sentences(program.where_stated)))


def _escape_c_comment(text: str) -> str:
    """A name within a comment of C."""
    return text.replace("*/", "* /").replace("\n", " ")


def _sources() -> Path:
    """The folder of the C files: inside an installed package, among the clients beside the sources else."""
    installed = PACKAGE / "robots" / "exporters" / "c"
    return installed if installed.is_dir() else PACKAGE.parents[1] / "clients" / "c"
