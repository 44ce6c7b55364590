"""The kinds of measurement there are. A new one is a file and a line here."""

from __future__ import annotations

from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.contacts import Contacts
from kilter_core.measurement.kind import Kind
from kilter_core.measurement.markers import Markers
from kilter_core.measurement.poses import Distances, Points, Poses
from kilter_core.measurement.referenced import Inclination, LinkEncoders

KINDS: tuple[type[Kind], ...] = (Contacts, Distances, Markers, Poses, Points, Pixels, LinkEncoders, Inclination)
