"""Links that move as one body, merged."""

from __future__ import annotations

from collections.abc import Container, Iterator

import numpy as np

from kilter_core.types import Floats
from kilter_service.robots.importers.urdf_tree import FREE, Body, UrdfTree


def merge_rigid_links(tree: UrdfTree, link: str, cut: Container[str]) -> Body:
    """Return the body of ``link`` and all that hangs on it without a joint of ``cut`` in between, joints at zero."""
    body = tree.bodies[link]
    for T, other in hanging(tree, link, cut):
        body = together(body, in_frame(T, tree.bodies[other]))
    return body


def hanging(tree: UrdfTree, link: str, cut: Container[str]) -> Iterator[tuple[Floats, str]]:
    """Links that hang on ``link`` without a joint of ``cut`` in between, with their poses (4, 4) in it, joints at zero."""
    waiting = [(np.eye(4), joint) for joint in tree.children(link)]
    while waiting:
        T, joint = waiting.pop()
        if joint.name not in cut and joint.kind not in FREE:
            here = T @ joint.origin
            yield here, joint.child
            waiting += [(here, below) for below in tree.children(joint.child)]


def in_frame(T: Floats, body: Body) -> Body:
    """Return the body in the frame in which its own frame has the pose T (4, 4)."""
    R = T[:3, :3]
    return Body(body.mass, R @ body.com + T[:3, 3], R @ body.inertia @ R.T)


def together(a: Body, b: Body) -> Body:
    """Return two bodies of one frame as one (parallel axes)."""
    mass = a.mass + b.mass
    if mass == 0.0:
        return Body(0.0, np.zeros(3), a.inertia + b.inertia)
    com = (a.mass * a.com + b.mass * b.com) / mass
    return Body(mass, com, sum((_about(com, body) for body in (a, b)), np.zeros((3, 3))))


def _about(point: Floats, body: Body) -> Floats:
    d = body.com - point
    return body.inertia + body.mass * (float(d @ d) * np.eye(3) - np.outer(d, d))
