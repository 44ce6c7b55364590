"""Contract columns as JSON."""

from __future__ import annotations

import json
from pathlib import Path

from kilter_files.formats.reader import NO_HINTS, UPLOAD, Document, Head, Hints, Reader
from kilter_files.ground.errors import fault
from kilter_files.ground.units import column_unit
from kilter_files.tables.table import JSON_TYPE, Prepared


class JsonColumns(Reader[Prepared]):
    """An object with a list of numbers for each column."""

    name = "json-columns"
    title = "contract columns as a JSON object of lists"
    use = UPLOAD
    endings = (".json",)

    def recognises(self, head: Head) -> bool:
        """An object that is called JSON."""
        return head.ending in self.endings and head.start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")

    def describe(self, head: Head) -> Document:
        """Names and rows of the columns."""
        try:
            found = json.loads(head.path.read_bytes())
        except ValueError as error:
            raise fault(head.path, f"is not JSON ({error})", "Write it again.") from error
        lists = {name: values for name, values in found.items() if isinstance(values, list)}
        odd = [name for name in found if name not in lists or column_unit(name) is None]
        return {
            "rows": max(map(len, lists.values()), default=0),
            "columns": [{"name": name, "unit": column_unit(name)} for name in lists],
            "warnings": [f"no contract columns: {', '.join(odd[:12])}"] if odd else [],
            "ready": not odd,
        }

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Prepared:
        """Take the bytes as they are."""
        return Prepared(path.read_bytes(), JSON_TYPE, notes=("contract columns, sent as they are",))


READER = JsonColumns()
