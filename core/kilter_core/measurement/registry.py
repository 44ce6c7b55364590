"""The kinds of measurement there are. A new one is a file and a line here."""

from __future__ import annotations

from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.contacts import Contacts
from kilter_core.measurement.distances import Distances
from kilter_core.measurement.inclination import Inclination
from kilter_core.measurement.kind import Kind
from kilter_core.measurement.link_encoders import LinkEncoders
from kilter_core.measurement.markers import Markers
from kilter_core.measurement.points import Points
from kilter_core.measurement.poses import Poses

KINDS: tuple[type[Kind], ...] = (Contacts, Distances, Markers, Poses, Points, Pixels, LinkEncoders, Inclination)
