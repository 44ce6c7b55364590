"""XML text into elements, counted while it is read: no entities, and no more than a robot needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import TreeBuilder

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from kilter_core.errors import RobotError
from kilter_service.ground.limits import MAX_XML_ATTRIBUTES, MAX_XML_DEPTH, MAX_XML_TAGS, MAX_XML_VALUE

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

PIECE = 1 << 16


def read_xml(text: str, *, comments: bool = False) -> Element:
    """Read the root element of a URDF, with its comments where they are asked for.

    Raises:
        RobotError: not XML, xacro, entities or a DTD, or too many, too deep or too long elements.

    """
    _refuse_xacro(text)
    parser = DefusedXMLParser(target=_Counted(insert_comments=comments))
    try:
        for start in range(0, len(text), PIECE):
            parser.feed(text[start : start + PIECE])
        root: Element = parser.close()
    except ParseError as error:
        raise RobotError(f"The URDF is not XML: {error}.", field="urdf") from error
    except DefusedXmlException as error:
        raise RobotError("The URDF declares XML entities or a DTD: remove them.", field="urdf") from error
    return root


def _refuse_xacro(text: str) -> None:
    bare = _without_comments(text)
    if "<xacro:" in bare or "${" in bare:
        raise RobotError(
            "This is xacro, not URDF: run `xacro robot.urdf.xacro > robot.urdf` and give the result.", field="urdf"
        )


def _without_comments(text: str) -> str:
    """Real URDF files carry the macros they came from in comments (TALOS does). Each character is looked at once."""
    parts, at = [], 0
    while (start := text.find("<!--", at)) >= 0 and (end := text.find("-->", start + 4)) >= 0:
        parts.append(text[at:start])
        at = end + 3
    return "".join([*parts, text[at:]])


class _Counted(TreeBuilder):
    """Builds elements and refuses when there are too many."""

    def __init__(self, *, insert_comments: bool) -> None:
        super().__init__(insert_comments=insert_comments)
        self._tags = self._depth = 0

    def start(self, tag: str, attributes: Any, /) -> Any:
        """Begin an element."""
        self._tags, self._depth = self._tags + 1, self._depth + 1
        longest = max((len(value) for value in attributes.values()), default=0)
        for size, most, what in (
            (self._tags, MAX_XML_TAGS, "elements"),
            (self._depth, MAX_XML_DEPTH, "elements inside each other"),
            (len(attributes), MAX_XML_ATTRIBUTES, "attributes in one element"),
            (max(len(tag), longest), MAX_XML_VALUE, "characters in one name or value"),
        ):
            if size > most:
                raise RobotError(
                    f"The URDF has more than {most} {what}: leave out what is not part of the arm.", field="urdf"
                )
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> Any:
        """End an element."""
        self._depth -= 1
        return super().end(tag)
