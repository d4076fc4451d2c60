"""Why each pixel was kept or dropped."""

from __future__ import annotations

from enum import IntEnum


class Provenance(IntEnum):
    """The verdict on one proximity pixel, in the order in which the tests are made.

    RIM, used by the membrane test only, comes last so that the numbers of the others stay the same.
    """

    NO_PROXIMITY_DEPTH = 0
    OUTSIDE_REGION = 1
    OUTSIDE_RANGE = 2
    NO_TACTILE_DEPTH = 3
    OUTSIDE_TOLERANCE = 4
    MASKED = 5
    OUTLIER = 6
    SMALL_CLUSTER = 7
    CONTACT = 8
    RIM = 9

    @property
    def label(self) -> str:
        """A short name for legends."""
        return self.name.replace("_", " ").lower()

    @property
    def explanation(self) -> str:
        """One sentence for the person who asks why."""
        return _EXPLANATIONS[self]


_EXPLANATIONS = {
    Provenance.NO_PROXIMITY_DEPTH: "Dropped: the proximity camera measured no depth here.",
    Provenance.OUTSIDE_REGION: "Dropped: outside the region of interest.",
    Provenance.OUTSIDE_RANGE: "Dropped: the proximity depth is outside the working range.",
    Provenance.NO_TACTILE_DEPTH: "Dropped: the tactile camera has no depth where this point would be.",
    Provenance.OUTSIDE_TOLERANCE: "Dropped: membrane and object are too far apart here.",
    Provenance.MASKED: "Dropped: the colour is that of the membrane's prints, which reflect infrared.",
    Provenance.OUTLIER: "Dropped: the point lies unusually far from its neighbours, or has too few.",
    Provenance.SMALL_CLUSTER: "Dropped: its connected group is smaller than the smallest cluster kept.",
    Provenance.CONTACT: "Kept: the membrane touches the object here.",
    Provenance.RIM: "Dropped: near the object, but a membrane in equilibrium has left it; contact ends further in.",
}
