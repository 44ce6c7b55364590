"""What a posted robot is from now on: its chain in plain numbers, and the hashes of chain and source."""

from __future__ import annotations

import hashlib
import json
from typing import Any, NamedTuple

from kilter_service.ground.core import core_arm
from kilter_service.robots.documents import core_document


class Resolved(NamedTuple):
    """A robot's chain (SI), its hash, the hash of what was posted, and what of that the chain leaves out."""

    chain: dict[str, Any]
    sha256: str
    source_sha256: str
    notes: list[str]


def resolve(posted: dict[str, Any]) -> Resolved:
    """Resolve a posted document (as stored, without nulls) to its chain.

    Raises:
        RobotError: the document cannot be an arm.

    """
    understood = core_document(posted)
    chain = core_arm.resolved_document(core_arm.robot_from_document(understood.document))
    return Resolved(chain, hash_canonical_json(chain), source_sha256(posted), understood.notes)


def source_sha256(posted: dict[str, Any]) -> str:
    """Hash what was posted: the text of a URDF, else the document."""
    if posted.get("convention") == "urdf":
        return hashlib.sha256(posted["urdf"].encode()).hexdigest()
    return hash_canonical_json(posted)


def hash_canonical_json(document: Any) -> str:
    """Hash a document by its canonical JSON: sorted keys, no spaces, numbers with all their digits."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
