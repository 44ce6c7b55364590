"""Rows of kept answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import InstrumentedAttribute

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import ActivationRow, ReplayRow
from kilter_service.ground.version import code_version

BY_ACTIVATION, BY_UPGRADE = "activation", "upgrade"


@dataclass(frozen=True)
class Replay:
    """Task and rules of a correction, ``setpoints`` and ``answers``, as the table has them."""

    rules: dict[str, Any]
    setpoints: bytes
    answers: bytes


def fetch_last_kept(session: Session, what: type[ReplayRow] | InstrumentedAttribute[Any], version_id: str) -> Any:
    """Return what was kept with the last activation of a version, the row or a column of it; None where nothing was."""
    query = select(what).join(ActivationRow, ActivationRow.id == ReplayRow.activation_id)
    query = query.where(ActivationRow.version_id == version_id).order_by(ActivationRow.id.desc()).limit(1)
    return session.execute(query).scalar_one_or_none()


def add(session: Session, activation_id: int, replay: Replay, made_by: str = BY_ACTIVATION) -> None:
    """Keep the answers of a version with its activation; those that are kept already stay."""
    if session.get(ReplayRow, activation_id) is not None:
        return
    session.add(
        ReplayRow(
            activation_id=activation_id,
            rules=replay.rules,
            setpoints=replay.setpoints,
            answers=replay.answers,
            made_by=made_by,
            code_version=code_version(),
        )
    )
    session.flush()


def repeat(session: Session, activation_id: int, version_id: str) -> None:
    """Keep with an activation what was kept with the last one of the version, its task and rules too."""
    before = fetch_last_kept(session, ReplayRow, version_id)
    if before is not None:
        names = ("rules", "setpoints", "answers", "made_by", "code_version")
        session.add(ReplayRow(activation_id=activation_id, **{name: getattr(before, name) for name in names}))
        session.flush()


def kept(session: Session, activation_id: int) -> Replay | None:
    """Return what was kept with an activation; None where nothing was."""
    row = session.get(ReplayRow, activation_id)
    return None if row is None else Replay(row.rules, row.setpoints, row.answers)
