"""Whether tables, columns, indexes and triggers are those of the revision: a trigger that is gone lets the audit be changed.

What the revision has is in schema.json, as each database describes it; a test compares it with the migrations.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import Connection, bindparam, text

from kilter_service.ground.db.row import Row

FILE = Path(__file__).with_name("schema.json")
Definitions = dict[str, list[str]]  # by kind and name: the parts of the definition, sorted
# Whoever writes the schema itself may take names like SQLite's own. What ANALYZE counts does not belong to it.
_SQLITE = text(
    "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL "
    "AND NOT (type = 'table' AND name IN ('sqlite_stat1', 'sqlite_stat4'))"
)
# Of Kilter's tables alone: others may share a PostgreSQL database.
_POSTGRESQL = text(
    """
    WITH ours AS (SELECT oid, relname, relpersistence, relrowsecurity OR relforcerowsecurity AS hides
      FROM pg_class WHERE relname IN :tables AND relnamespace = current_schema()::regnamespace AND relkind IN ('r', 'p'))
    SELECT 'table ' || relname, concat_ws(' ', attname, format_type(atttypid, atttypmod),
           CASE WHEN attnotnull THEN 'NOT NULL' END, attgenerated, pg_get_expr(adbin, adrelid),
           CASE WHEN attcollation <> typcollation THEN attcollation::regcollation::text END)
    FROM ours JOIN pg_attribute ON attrelid = ours.oid AND attnum > 0 AND NOT attisdropped
         JOIN pg_type ON pg_type.oid = atttypid LEFT JOIN pg_attrdef ON adrelid = ours.oid AND adnum = attnum
    UNION ALL SELECT 'table ' || relname, conname || ' ' || pg_get_constraintdef(pg_constraint.oid, true)
    FROM ours JOIN pg_constraint ON conrelid = ours.oid AND contype IN ('c', 'f', 'p', 'u', 'x')
    UNION ALL SELECT 'table ' || relname, 'not in the log, a crash empties it' FROM ours WHERE relpersistence <> 'p'
    UNION ALL SELECT 'table ' || relname, 'rows hidden by policies' FROM ours WHERE hides
    UNION ALL SELECT DISTINCT 'table ' || relname, 'keys not enforced' FROM ours JOIN pg_trigger ON tgrelid = ours.oid
         AND tgisinternal AND tgenabled <> 'O'
    UNION ALL SELECT 'index ' || indexrelid::regclass::text, concat_ws(' ', pg_get_indexdef(indexrelid, 0, true),
           CASE WHEN NOT (indisvalid AND indisready AND indislive) THEN 'not valid' END)
    FROM ours JOIN pg_index ON indrelid = ours.oid
    UNION ALL SELECT 'trigger ' || tgname, concat_ws(' ', tgenabled, pg_get_triggerdef(pg_trigger.oid, true), prosrc,
           CASE WHEN prosecdef THEN 'SECURITY DEFINER' END, array_to_string(proconfig, ' '))
    FROM ours JOIN pg_trigger ON tgrelid = ours.oid AND NOT tgisinternal JOIN pg_proc ON pg_proc.oid = tgfoid
    UNION ALL SELECT 'rule ' || rulename, pg_get_ruledef(pg_rewrite.oid, true) FROM ours JOIN pg_rewrite ON ev_class = ours.oid
    """
).bindparams(bindparam("tables", (*Row.metadata.tables, "alembic_version"), expanding=True))


def schema_altered(connection: Connection) -> Iterator[str]:
    """Sentences about tables, indexes, triggers and rules that are not those of the revision."""
    expected: Definitions = json.loads(FILE.read_text(encoding="utf-8"))[connection.dialect.name]
    found = definitions(connection)
    for name in sorted(expected.keys() | found.keys()):
        if name not in found:
            yield f"The {name} is missing from the database."
        elif name not in expected:
            yield f"The {name} was put into the database past Kilter."
        elif found[name] != expected[name]:
            parts = sorted({*found[name]} ^ {*expected[name]})
            yield f"The {name} is not defined as Kilter does it: {'; '.join(parts)[:200]}"


def definitions(connection: Connection) -> Definitions:
    """Return how the database defines its tables, indexes, triggers and rules."""
    found: Definitions = {}
    if connection.dialect.name == "sqlite":
        for kind, name, sql in connection.execute(_SQLITE):
            parts = _parts(sql) if kind == "table" else [" ".join(sql.split())]
            found.setdefault(f"{kind} {name}", []).extend(parts)
    else:
        for name, part in connection.execute(_POSTGRESQL):
            found.setdefault(name, []).append(" ".join(part.split()))
    return {name: sorted(parts) for name, parts in found.items()}


def _parts(sql: str) -> list[str]:
    """Columns and constraints of a table's definition, sorted: a migration that copies a table may change their order."""
    body, depth, parts = " ".join(sql.split()).partition("(")[2].rpartition(")"), 0, [""]
    for character in body[0]:
        depth += (character == "(") - (character == ")")
        if character == "," and not depth:
            parts.append("")
        else:
            parts[-1] += character
    return sorted(part.strip() for part in (*parts, body[2]) if part.strip())
