"""The one list of dialects of robot programs; a new one is one more line and a module that states it."""

from __future__ import annotations

from kilter_files.formats.programs import fanuc, krl, rapid, table, urscript
from kilter_files.formats.programs.found import Dialect

# in the order in which a text is tried
DIALECTS: dict[str, Dialect] = {
    dialect.name: dialect for dialect in (rapid.DIALECT, fanuc.DIALECT, krl.DIALECT, urscript.DIALECT, table.DIALECT)
}
