"""What to say of a robot's controller when it is given a calibration that Kilter exported."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kilter_service.robots.compensation import objection

if TYPE_CHECKING:
    from kilter_service.robots.store import StoredRobot

INTO_CONTROLLERS = {
    "dh-csv": "enters this table",
    "mdh-csv": "enters this table",
    "ur-yaml": "enters these lengths and angles",
    "corrector": "runs this program",
    "c": "runs this code",
}


def said_of_controller(form: str, robot: StoredRobot) -> tuple[str, ...]:
    """Return what must be said of the controller once it has a file, or that it corrects by itself already."""
    if form not in INTO_CONTROLLERS:
        return ()
    if robot.controller_compensation == "kilter":
        return ()
    found = objection(robot.name, robot.controller_compensation)
    if found is not None:
        return (found.message,)
    return (
        f"A controller that {INTO_CONTROLLERS[form]} corrects by itself: say so then with `kilter robot compensation "
        f"{robot.name} kilter`, so that nothing corrects the arm twice.",
    )
