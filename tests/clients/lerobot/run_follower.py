"""Run by LeRobot's own Python: its follower, its bus and its plug-ins against simulated servos. Prints what came of it."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import draccus
import scservo_sdk
from lerobot.processor import RobotProcessorPipeline
from lerobot.processor.converters import (
    observation_to_transition,
    robot_action_observation_to_transition,
    transition_to_observation,
    transition_to_robot_action,
)
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.utils.import_utils import register_third_party_plugins
from servo_bus import GOAL, PRESENT, Bus, Servo

LONGEST_MS = 60_000.0
STEPS = 90  # of a loop: three seconds, over which a correction comes in


@dataclass
class Command:
    """As the commands of LeRobot are told which robot."""

    robot: RobotConfig


def patient() -> None:
    """Wait for an answer as long as it takes: on a busy machine the servos are late, and none is missing."""
    scservo_sdk.PortHandler.isPacketTimeout = lambda port: port.getCurrentTime() - port.packet_start_time > LONGEST_MS


def servos_of(calibration: dict[str, Any]) -> Bus:
    made = {}
    for one in calibration.values():
        middle = (one["range_min"] + one["range_max"]) // 2
        made[one["id"]] = Servo(one["homing_offset"], one["range_min"], one["range_max"], middle)
    return Bus(made)


def paced(robot: Any) -> None:
    """Time goes on by a cycle with every action, however fast the test runs."""
    now = [0.0]

    def clock() -> float:
        now[0] += 1.0 / 30.0
        return now[0]

    robot.arm._clock = clock


def followed(robot: Any, bus: Bus, actions: list[dict[str, float]]) -> list[dict[str, Any]]:
    seen, last = [], actions[0]
    for action in actions:
        part = [min(1.0, 2.0 * k / STEPS) for k in range(STEPS)]  # on the way for half of the time, then at rest
        way = [{name: last[name] + share * (action[name] - last[name]) for name in action} for share in part]
        sent, last = [robot.send_action(one) for one in way], action
        observed = robot.get_observation()
        goals = {name: bus.servos[motor.id].get(GOAL) for name, motor in robot.bus.motors.items()}
        seen.append({"first": sent[0], "sent": sent[-1], "observed": observed, "goals": goals})
    return seen


def steps(asked: dict[str, Any], observation: dict[str, float]) -> dict[str, Any]:
    """The same by steps of a pipeline, saved and made again from what was saved."""
    from lerobot_robot_kilter import KilterCorrectAction, KilterTrueJoints

    told = {"robot": asked["robot"], "calibration": asked["calibration"], "ramp_s": 0.01, "rate_deg_s": 1000.0}
    correct, true = KilterCorrectAction(**told), KilterTrueJoints(**told)
    again = KilterCorrectAction(**correct.get_config())
    actions = RobotProcessorPipeline(
        steps=[again], to_transition=robot_action_observation_to_transition, to_output=transition_to_robot_action
    )
    observations = RobotProcessorPipeline(
        steps=[true], to_transition=observation_to_transition, to_output=transition_to_observation
    )
    done = {}
    for _ in range(5):
        done = actions((dict(asked["actions"][0]), observation))
    return {"action": done, "observation": observations(observation), "config": correct.get_config()}


def main() -> None:
    asked = json.loads(sys.stdin.read())
    patient()
    bus = servos_of(json.loads(Path(asked["calibration"]).read_text()))
    register_third_party_plugins()
    config = draccus.parse(Command, args=[*asked["options"], f"--robot.port={bus.port}"]).robot
    robot = make_robot_from_config(config)
    try:
        robot.connect()
    except Exception as error:  # the test reads it
        detail = getattr(error, "detail", str(error))
        told = {
            "refused": detail,
            "code": getattr(error, "code", ""),
            "torque": [s.memory[40] for s in bus.servos.values()],
        }
        print(json.dumps(told))
        return
    paced(robot)
    seen = followed(robot, bus, asked["actions"])
    raw = robot.follower.get_observation()
    state = robot.arm.state
    robot.disconnect()
    present = {number: servo.get(PRESENT) for number, servo in bus.servos.items()}
    told = {"seen": seen, "raw": raw, "state": state, "type": config.type, "robot_type": robot.robot_type, "present": present,
            "features": sorted(robot.action_features)}  # fmt: skip
    if asked.get("steps"):
        told["steps"] = steps(asked, raw)
    print(json.dumps(told))


main()
