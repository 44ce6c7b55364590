"""Robot documents (``robot.json``, mm and degrees) into robots (SI)."""

from kilter_core.arm.documents.document import robot_from_document

__all__ = ["robot_from_document"]
