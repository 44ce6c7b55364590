"""Recordings and joint logs that are read besides tables: what they are for people, and the endings they are known by."""

from __future__ import annotations

from collections.abc import Mapping

Titled = tuple[str, tuple[str, ...]]

# kind -> title, endings; `kilter_files.formats.recordings.opening` tells them by their first bytes
RECORDINGS: Mapping[str, Titled] = {
    "c3d": ("C3D recording of markers (Vicon, Qualisys, Motive, Optotrak)", (".c3d",)),
    "n3d": ("NDI's floating-point recording (Optotrak)", (".n3d",)),
    "text": ("text export of markers or tools, one frame in a line", (".csv", ".tsv", ".txt")),
}
JOINT_LOGS: Mapping[str, Titled] = {
    "bag": ("ROS 2 bag with joint states", (".db3", ".mcap")),
}
