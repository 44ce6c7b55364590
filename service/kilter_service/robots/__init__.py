"""Robots: as posted and as resolved, their instruments and shapes, and the formats of other tools."""
