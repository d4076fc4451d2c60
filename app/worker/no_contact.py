"""Why there is no contact in a frame, and what to change about it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...core.model.arrays import Uint8Array
from ...core.model.provenance import Provenance

#: By contact test: what drops points that are near the object, and what to change where it drops too many.
_DROPPED = {
    "tolerance": {
        Provenance.MASKED: ("the mask", "right while nothing touches; else narrow its colour ranges"),
        Provenance.OUTLIER: ("the outlier removal", "raise its ratio, or switch it off"),
        Provenance.SMALL_CLUSTER: ("the limit on small clusters", "lower the smallest cluster"),
    },
    "membrane": {
        Provenance.MASKED: ("the mask", "right while nothing touches; else narrow its colour ranges"),
        Provenance.RIM: ("the erosion of the rim", "lower the erosion if something touches"),
        Provenance.NOT_PRESSED: ("the membrane's curvature", "right while nothing presses; else raise the largest one"),
        Provenance.SMALL_CLUSTER: ("the limit on small contacts", "lower the smallest contact"),
    },
}


def why_no_contact(provenance: Uint8Array, contact_test: Literal["tolerance", "membrane"] = "tolerance") -> str:
    """Say which stage dropped the points that were near the object, and what to change about it."""
    stages = _DROPPED[contact_test]
    dropped = {verdict: int(np.count_nonzero(provenance == verdict)) for verdict in stages}
    by = max(dropped, key=lambda verdict: dropped[verdict])
    total = sum(dropped.values())
    if total == 0:
        looser = "raise the tolerance t" if contact_test == "tolerance" else "raise the largest gap"
        return f"No contact yet: press the object into the membrane, or {looser}"
    stage, change = stages[by]
    passed = "passed the contact test" if contact_test == "tolerance" else "came near the object"
    share = f"{dropped[by]:,} of {total:,}" if dropped[by] < total else "all" if total > 1 else "it"
    return f"{total:,} point{'s' if total > 1 else ''} {passed}, but {stage} dropped {share}: {change}"
