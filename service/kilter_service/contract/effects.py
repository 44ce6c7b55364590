"""The effects by name and as documents with their options, from `effects.json`: `make contract` writes it from the core's.

So the API process knows what they are without numpy, and an option has here what it says of itself there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, create_model

from kilter_service.contract.columns import option_fields
from kilter_service.contract.units import Asked, JointNumber

Said = Mapping[str, Any]
SAID: list[Said] = json.loads(Path(__file__).with_name("effects.json").read_text(encoding="utf-8"))


def _joints(said: Said) -> Any:
    at_joints = Annotated[list[JointNumber], Field(min_length=1, max_length=32)] | None
    return at_joints if said["at_joints"] else None, Field(None, description=said["joints"])


def _model(said: Said) -> type[Asked]:
    name = Field(description="Id of the effect.")
    fields: Any = {"joints": _joints(said), "id": (Literal[said["id"]], name), **option_fields(said["options"])}
    return create_model(said["model"], __base__=Asked, __module__=__name__, __doc__=said["summary"], **fields)


def _form(given: object) -> str:
    """Whether an effect is told by its id alone or as an object."""
    return "id" if isinstance(given, str) else "effect"


MODELS = [_model(said) for said in SAID]
globals().update({model.__name__: model for model in MODELS})  # where pickle finds them

# An effect by its id alone, with all it can act on, or as an object with its options.
if TYPE_CHECKING:
    AnyEffect = str | Asked
else:
    EffectName = Literal[tuple(said["id"] for said in SAID)]
    EffectDocument = Annotated[reduce(or_, MODELS), Field(discriminator="id")]
    AnyEffect = Annotated[
        Annotated[EffectName, Tag("id")] | Annotated[EffectDocument, Tag("effect")], Discriminator(_form)
    ]
