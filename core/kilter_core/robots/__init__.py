"""Robot documents (``robot.json``, mm and degrees) into robots (SI), and the presets that ship with Kilter."""

from kilter_core.arm.documents.document import robot_from_document
from kilter_core.arm.presets.presets import preset_document, preset_names

__all__ = ["preset_document", "preset_names", "robot_from_document"]
