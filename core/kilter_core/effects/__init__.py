"""Physical error sources, one per file, each giving only local corrections; the model does the rest."""

from kilter_core.effects.base import BASE, TOOL, Derivative, Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.registry import EFFECTS, effect_from_document, make_effect

__all__ = ["BASE", "EFFECTS", "TOOL", "Batch", "Derivative", "Effect", "Local", "effect_from_document", "make_effect"]
