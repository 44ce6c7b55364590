"""Between which links of a URDF the arm is: said by the user, or the only chain that the file holds."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from kilter_files.ground.errors import FileError, UsageError

FREE = ("floating", "planar")  # types of joints that hold nothing


def find_arm_links(path: Path, text: str, base_link: str | None, tip_link: str | None) -> tuple[str, str]:
    """Return the first and the last link of the arm; what was not said is taken where the file leaves no choice.

    A base link is left no choice by the only link that hangs on no other, a tip link by the only one on which none hangs.

    Raises:
        FileError: the file is not XML.
        UsageError: the file leaves a choice; the message lists the links to choose from.

    """
    if base_link and tip_link:  # the server reads the tree and knows more of it
        return base_link, tip_link
    first, last = _ends(path, text)
    asked = [
        f"{option} ({', '.join(links) if links else 'none was found'})"
        for option, said, links in (("--base-link", base_link, first), ("--tip-link", tip_link, last))
        if not said and len(links) != 1
    ]
    if asked:
        raise UsageError(
            f"{path.name} holds more than one chain of links: say which is the arm by {' and '.join(asked)}."
        )
    return base_link or first[0], tip_link or last[0]


def _ends(path: Path, text: str) -> tuple[list[str], list[str]]:
    """Return the links that hang on no other, and those on which none hangs, in the order of the file.

    Floating and planar joints hold nothing, so an arm does not end at a link that only they join to others.
    """
    if "<!DOCTYPE" in text:
        raise FileError(f"{path}: a URDF has no document type: take the <!DOCTYPE> out.", file=str(path))
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without a document type there are no entities
    except ElementTree.ParseError as error:
        remedy = "If it is a .xacro, expand it first: xacro FILE > arm.urdf."
        raise FileError(f"{path}: is not XML ({error}). {remedy}", file=str(path)) from error
    links = [link.get("name", "") for link in root.findall("link")]
    joints = [joint for joint in root.findall("joint") if joint.get("type") not in FREE]
    held = {end.get("link") for joint in joints for end in joint.findall("child")}
    holding = {end.get("link") for joint in joints for end in joint.findall("parent")}
    first = [link for link in links if link in holding and link not in held]
    return first, [link for link in links if link in held and link not in holding]
