"""What a check of the stored data found."""

from __future__ import annotations

from dataclasses import dataclass, field

from kilter_service.ground.texts import plural


@dataclass
class Findings:
    """Sentences about what is damaged or missing, and how much was looked at."""

    damaged: list[str] = field(default_factory=list)
    robots: int = 0
    campaigns: int = 0
    chunks: int = 0
    versions: int = 0
    meshes: int = 0
    every_row: bool = False  # all tables were compared with a backup's manifest, or one was written
    sealed: bool = True  # else it is of a release that sealed no rows
    revision: str | None = None  # of a copy, before it was brought to this one
    other_key: str = ""  # why no seal can be compared: it is sealed with another key than the one in use

    def add(self, sentence: str) -> None:
        """Note one more."""
        self.damaged.append(sentence)

    @property
    def sentences(self) -> list[str]:
        """All that keeps it from being whole."""
        return [*filter(None, [self.other_key]), *self.damaged]

    def headline(self) -> str:
        """Say that it is whole; of what has no seals, no more than what was compared."""
        if self.sealed:
            return f"All is whole: {self.describe_coverage()}; {self.describe_hash_check()}."
        hashes = f"Hashes of rows, chunks and versions fit: {self.describe_coverage()}."
        return f"{hashes} It is of a release without seals, so no seal was compared."

    def describe_coverage(self) -> str:
        """Say how much was looked at."""
        campaigns = f"{plural(self.campaigns, 'campaign')} with {plural(self.chunks, 'chunk')}"
        meshes = [plural(self.meshes, "link shape")] if self.meshes else []
        return ", ".join([plural(self.robots, "robot"), campaigns, plural(self.versions, "version"), *meshes])

    def describe_hash_check(self) -> str:
        """Say which of it was checked by a hash."""
        if self.every_row:
            return "every row of every table has its hash"
        return "every row fits its seal, the audit its chain"
