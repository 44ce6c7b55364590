"""A version as a program for the C corrector: the file that it loads, or one C file that holds code and program."""

from __future__ import annotations

from pathlib import Path

from kilter_core.correct import CorrectionProgram, compile_program, to_bytes
from kilter_service.ground.core import core_motion
from kilter_service.ground.correction_limits import correction_options, sentence, where_sentences
from kilter_service.ground.errors import ServiceError
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


def torque_source(version: Exportable) -> Written:
    """Write one C file that tells torques: a table of what a log showed, and the code that reads it.

    Raises:
        ServiceError: the version holds no torques.

    """
    held, name = version.document.get("torques"), f"{version.version.id} of {_escape_c_comment(version.version.robot)}"
    if held is None:
        raise ServiceError(
            f"Version {version.version.id} holds no torques: search or fit a log from it (kilter identify ROBOT -c LOG --start "
            "VERSION).",
            code="no_torque_model",
        )
    robot = version.arm.robot()
    table = core_motion.TorqueModel.from_document(robot, held).table()
    rows = [f"    {{{', '.join(map(repr, row))}}}," for row in table.tolist()]
    sizes = {"JOINTS": robot.n_joints, "ELEMENTS": len(table) - robot.n_joints - 1, "COLUMNS": table.shape[1]}
    text = "\n".join(
        (
            f"/* Torques of version {name}. SHA-256 of the version: {version.version.sha256} */",
            *(f"#define KT_{key} {value}" for key, value in sizes.items()),
            f"static const double kt_table[{len(table)}][KT_COLUMNS] = {{",
            *rows,
            "};",
            (_sources() / "kilter_torque.c").read_text(encoding="utf-8"),
        )
    )
    unknown = [str(j + 1) for j in range(robot.n_joints) if j + 1 not in held["joints"]]
    said = (f"The log says nothing of joints {', '.join(unknown)}: they get NAN.",) if unknown else ()
    warm = any(term["id"] == "thermal_friction" for term in held["terms"])
    kept = ("Left out: friction that follows the temperature; it is as at the mean of the log.",) if warm else ()
    return Written(text, (*said, *kept, "Torques are without a payload beyond what the arm carried in the log."))


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
