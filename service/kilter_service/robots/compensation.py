"""What a controller that corrects by itself means for Kilter's corrections: applied on top of it, they move the arm wrongly.

What to say of a robot's controller when it is given a calibration that Kilter exported.
"""

from __future__ import annotations

from typing import get_args

from kilter_service.contract.units import ControllerCompensation
from kilter_service.contract.versions import Objection
from kilter_service.ground.errors import ServiceError

TWICE, UNKNOWN = "corrected_twice", "compensation_unknown"
VALUES: tuple[ControllerCompensation, ...] = get_args(ControllerCompensation)
CORRECTS: frozenset[str] = frozenset({"factory", "kilter"})
WORDS: dict[str, str] = {
    "none": "does not correct by itself",
    "factory": "corrects by its maker's calibration",
    "kilter": "corrects by a calibration that Kilter exported",
    "unknown": "whether it corrects by itself is not known",
}
_REMEDY = {
    "factory": "Switch that off in the controller",
    "kilter": "Take that calibration out of the controller",
}


def parse_compensation(text: str) -> ControllerCompensation:
    """Read what is stored; what a later release wrote is unknown here."""
    return next((value for value in VALUES if value == text), "unknown")


def objection(robot: str, compensation: str) -> Objection | None:
    """What speaks against correcting a robot: its controller does so already."""
    if compensation not in CORRECTS:
        return None
    message = (
        f"The controller of {robot} {WORDS[compensation]}: a correction by Kilter would come on top of it, and the arm would "
        f"be corrected twice. {_REMEDY[compensation]} and say so with `kilter robot compensation {robot} none`, or leave the "
        "correction to the controller."
    )
    return Objection(code=TWICE, message=message)


def twice(robot: str, compensation: str) -> str:
    """Say that something corrects a robot whose controller does so already, and what ends it."""
    return (
        f"The controller of {robot} {WORDS[compensation]} too, so the arm is corrected twice. Stop the bridge; or: "
        f"{_REMEDY[compensation]} and say so with `kilter robot compensation {robot} none`."
    )


def perhaps_twice(robot: str, compensation: str) -> str:
    """Say the same of what is no longer heard, and may go on."""
    return (
        f"The controller of {robot} {WORDS[compensation]}: if the bridge still offsets the joints, the arm is corrected twice. "
        "Look where it ran, and stop it there."
    )


def remark(robot: str, compensation: str) -> Objection | None:
    """A warning where nobody said whether the controller corrects by itself."""
    if compensation != "unknown":
        return None
    message = (
        f"Check once whether {robot}'s controller corrects by itself (absolute accuracy, factory calibration); then the arm "
        f"would be corrected twice. Say it: `kilter robot compensation {robot} none`, factory or kilter."
    )
    return Objection(code=UNKNOWN, message=message)


def refuse(robot: str, compensation: str) -> None:
    """Refuse to correct a robot whose controller does so already.

    Raises:
        ServiceError: it does.

    """
    found = objection(robot, compensation)
    if found is not None:
        raise ServiceError(found.message, code=TWICE, robot=robot, controller_compensation=compensation)


def statement(robot: str, compensation: str) -> str:
    """Say what the controller does, whatever that is."""
    return sentence(robot, compensation) or f"The controller of {robot} {WORDS[compensation]}."


def sentence(robot: str, compensation: str) -> str:
    """Say what the controller does, and what follows; empty where nothing does."""
    found = objection(robot, compensation) or remark(robot, compensation)
    return "" if found is None else found.message


INTO_CONTROLLERS = {
    "dh-csv": "enters this table",
    "mdh-csv": "enters this table",
    "ur-yaml": "enters these lengths and angles",
    "corrector": "runs this program",
    "c": "runs this code",
}


def said_of_controller(form: str, robot: str, compensation: str) -> tuple[str, ...]:
    """Return what must be said of the controller once it has a file, or that it corrects by itself already."""
    if form not in INTO_CONTROLLERS:
        return ()
    if compensation == "kilter":
        return ()
    found = objection(robot, compensation)
    if found is not None:
        return (found.message,)
    return (
        f"A controller that {INTO_CONTROLLERS[form]} corrects by itself: say so then with `kilter robot compensation "
        f"{robot} kilter`, so that nothing corrects the arm twice.",
    )
