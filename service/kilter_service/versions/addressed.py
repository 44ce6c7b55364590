"""Versions in the address of a request: by id, or as `tour v2`."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends

from kilter_service.ground.db import Database
from kilter_service.ground.references import store as references
from kilter_service.web.state import DatabaseOfApp


def _id_in_address(database: Database, text: str) -> str:
    if " " not in text:
        return text
    with database.reading() as session:
        return references.version_id(session, text)


def _version_id(version: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, version)


def _first_version_id(a: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, a)


def _second_version_id(b: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, b)


AddressedVersion = Annotated[str, Depends(_version_id)]
FirstVersion = Annotated[str, Depends(_first_version_id)]
SecondVersion = Annotated[str, Depends(_second_version_id)]
