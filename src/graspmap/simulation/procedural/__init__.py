"""A family of objects without end: what hands meet, drawn by number."""

from graspmap.simulation.procedural.make import FAMILIES, Family, family_of, make_object
from graspmap.simulation.procedural.ranges import ObjectRanges

__all__ = ["FAMILIES", "Family", "ObjectRanges", "family_of", "make_object"]
