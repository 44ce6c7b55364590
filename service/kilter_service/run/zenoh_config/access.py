"""What each role may do on which keys, as zenoh's access control at the corrector; what is not allowed is denied.

Flows are seen from the corrector: ingress is what a role sends to it, egress what it gets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_service.stream.corrector import keys

CORRECTOR, OBSERVER, ROS = "kilter-corrector", "kilter-observer", "kilter-ros"
ANY_ROBOT = ("*",)
SUBSCRIBE = ["declare_subscriber"]
ASK = ["query", "declare_liveliness_subscriber", "liveliness_query"]


def controller_name(name: str) -> str:
    """Common name of a controller's certificate."""
    return f"kilter-controller-{name}"


def access_control(site: str, controllers: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Rules of the corrector; ``controllers`` are the robots of each, ``("*",)`` for all."""
    rules: list[dict[str, Any]] = [_rule("inside", "both", _EVERY_MESSAGE, ["**", "kilter/@v1/**"])]
    rules[0]["key_exprs"] += _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/*", "@alive/*"))
    # The query process meets the stream process in a socket that only their account can reach.
    subjects: list[dict[str, Any]] = [{"id": "inside", "link_protocols": ["unixsock-stream"]}]
    policies: list[dict[str, Any]] = [{"rules": ["inside"], "subjects": ["inside"]}]
    for name, robots in controllers.items():
        made = _controller(name, site, robots)
        rules += made
        subjects.append({"id": name, "cert_common_names": [controller_name(name)]})
        policies.append({"rules": [rule["id"] for rule in made], "subjects": [name]})
    made = _observer(site)
    rules += made
    subjects.append({"id": "observer", "cert_common_names": [OBSERVER]})
    policies.append({"rules": [rule["id"] for rule in made], "subjects": ["observer"]})
    return {
        "enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
    }  # fmt: skip


def ros_access_control(domain: int) -> dict[str, Any]:
    """Rules of a router of ROS: its nodes on the same machine, and the adaptor by its certificate."""
    every = _rule("ros", "both", _EVERY_MESSAGE, [f"{domain}/**", "@ros2_lv/**", "kilter/@v1/**"])
    subjects: list[dict[str, Any]] = [
        {"id": "nodes", "interfaces": ["lo"]}, {"id": "adaptor", "cert_common_names": [ROS]},
    ]  # fmt: skip
    policies = [{"rules": ["ros"], "subjects": ["nodes", "adaptor"]}]
    return {
        "enabled": True, "default_permission": "deny", "rules": [every], "subjects": subjects, "policies": policies,
    }  # fmt: skip


_EVERY_MESSAGE = [
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token",
    "liveliness_query", "declare_liveliness_subscriber",
]  # fmt: skip


def _rule(name: str, flow: str, messages: list[str], key_exprs: list[str]) -> dict[str, Any]:
    flows = ["ingress", "egress"] if flow == "both" else [flow]
    return {"id": name, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": key_exprs}


def _robot_key_expressions(site: str, robots: tuple[str, ...], parts: tuple[str, ...]) -> list[str]:
    return [f"{keys.PREFIX}/{site}/{robot}/{part}" for robot in robots for part in parts]


def _controller(name: str, site: str, robots: tuple[str, ...]) -> list[dict[str, Any]]:
    sends = _robot_key_expressions(site, robots, ("stream/*/in",))
    said = _robot_key_expressions(site, robots, ("stream/*/out", "stream/*/status", "active"))
    answered = _robot_key_expressions(site, robots, ("active", "@rpc/*"))
    alive = _robot_key_expressions(site, robots, ("@alive/*",))
    # The corrector declares once what it takes of all robots. Whoever may not know of that could send nothing at all; what
    # is sent and asked is still judged robot by robot.
    taken = _robot_key_expressions(site, ANY_ROBOT, ("stream/*/in",))
    offered = _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/*"))
    return [
        _rule(f"{name}-sends", "ingress", ["put"], sends),
        _rule(f"{name}-hears-of", "egress", SUBSCRIBE, taken),
        _rule(f"{name}-listens", "ingress", SUBSCRIBE, said),
        _rule(f"{name}-hears", "egress", ["put"], said),
        _rule(f"{name}-asks", "ingress", ["query"], answered),
        _rule(f"{name}-is-offered", "egress", ["declare_queryable"], offered),
        _rule(f"{name}-is-answered", "egress", ["reply"], answered),
        _rule(f"{name}-looks", "ingress", ["declare_liveliness_subscriber", "liveliness_query"], alive),
        _rule(f"{name}-sees", "egress", ["liveliness_token", "reply"], alive),
    ]


def _observer(site: str) -> list[dict[str, Any]]:
    said = _robot_key_expressions(site, ANY_ROBOT, ("stream/*/*", "active"))
    answered = _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/describe"))
    alive = _robot_key_expressions(site, ANY_ROBOT, ("@alive/*",))
    return [
        _rule("observer-listens", "ingress", SUBSCRIBE, said),
        _rule("observer-hears", "egress", ["put"], said),
        _rule("observer-asks", "ingress", ["query"], answered),
        _rule("observer-is-answered", "egress", ["reply", "declare_queryable"], answered),
        _rule("observer-looks", "ingress", ["declare_liveliness_subscriber", "liveliness_query"], alive),
        _rule("observer-sees", "egress", ["liveliness_token", "reply"], alive),
    ]
