"""The document of a finding: what is stored and sent of it."""

from __future__ import annotations

import copy
import json
from dataclasses import asdict, dataclass

from kilter_core.errors import Finding, FindingDocument

MOVED = Finding("moved", {"joint": 2, "by_deg": 0.5}, {"name": "elbow"})
SENTENCES = {"moved": lambda said: f"Joint {said['joint']} ({said['name']}) moved by {said['by_deg']} deg."}


@dataclass(frozen=True)
class Report:
    """What holds documents of findings."""

    warnings: tuple[FindingDocument, ...]


def test_a_document_has_the_code_first_and_the_sentence_last() -> None:
    document = MOVED.to_document(SENTENCES)
    assert [*document] == ["code", "joint", "by_deg", "message"]
    assert document["message"] == "Joint 2 (elbow) moved by 0.5 deg."
    assert json.loads(json.dumps(document)) == document


def test_a_document_is_copied_and_taken_apart_as_a_dict_is() -> None:
    document = FindingDocument.make("moved", "It moved.", rows=[1, 2])
    assert asdict(Report((document,)))["warnings"] == (document,)
    again = copy.deepcopy(document)  # as pickle does it between processes
    assert again == document
    assert type(again) is FindingDocument
