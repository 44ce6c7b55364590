"""Text whose columns are the contract's."""

from __future__ import annotations

import re
from pathlib import Path

from kilter_files.formats.joints.joint_log import describe_log, read_joint_log
from kilter_files.formats.reader import NO_HINTS, UPLOAD, Document, Head, Hints, Reader
from kilter_files.ground.text_layout import TextLayout
from kilter_files.ground.units import JOINT, column_unit
from kilter_files.tables.table import CSV_TYPE, Prepared

# What an instrument reads: a point, markers, encoders and inclinometers on links, what holds the tool, or what a camera saw.
MEASURED = re.compile(r"(?:m\d+)?x_mm?|link\d+_(?:deg|rad)|tilt\d+[xyz]_(?:deg|rad)|(?:socket|plane|bar)_id|u\d+_px")


class Contract(Reader[Prepared]):
    """Rows that are sent as they are."""

    name = "contract-columns"
    title = "contract columns, sent as they are"
    use = UPLOAD
    endings = (".csv",)

    def recognises(self, head: Head) -> bool:
        """Every name of a column is the contract's."""
        return head.layout is not None and all(column_unit(name) is not None for name in _full_names(head.layout))

    def describe(self, head: Head) -> Document:
        """Ranges of the joints; ready when something was measured beside them."""
        assert head.layout is not None  # it was recognised
        shape = {"layout": head.layout.to_document()}
        names = [name for name in _full_names(head.layout) if column_unit(name) is not None]
        if not any(JOINT.fullmatch(name) for name in names):
            return {"columns": [{"name": name} for name in names], "warnings": ["no joints"]} | shape
        found = describe_log(read_joint_log(head.path)) | shape
        if not any(MEASURED.fullmatch(name) for name in names):
            return found
        return found | {"kind": self.name, "notes": ["ready for kilter upload"], "ready": True}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Prepared:
        """Take the bytes as they are, so that their content hash stays what it is."""
        return Prepared(path.read_bytes(), CSV_TYPE, notes=("contract columns, sent as they are",))


def _full_names(layout: TextLayout) -> list[str]:
    """Names with the units that were taken off them, as the contract writes both in one."""
    told = zip(layout.names, layout.units, strict=True)
    return [f"{name}_{(unit or '').lower()}".rstrip("_") for name, unit in told]


READER = Contract()
