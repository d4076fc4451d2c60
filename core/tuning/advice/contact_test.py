"""The contact test: the membrane test wherever it can work."""

from __future__ import annotations

from typing import Final

import numpy as np

from ...contact.membrane.tension import LIMITS_PER_M, free_curvature_per_m
from ...errors import AdviceError
from ...model.clouds import valid_depth
from ...sources.base import Progress
from .disagreement import difference_peak
from .proposal import Evidence, Proposal

#: Smallest share of the tactile image with depth that tells whether a membrane is there.
_MIN_SEEN: Final = 0.1


def suggest_contact_test(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the membrane test where an inflated membrane is seen, else the tolerance test.

    Raises
    ------
    AdviceError
        The alignment is a homography, or the tactile camera measures hardly any depth.
    """
    preset, rig, frame = evidence.preset, evidence.rig, evidence.untouched or evidence.frame
    if preset.alignment.model != "rigid":
        raise AdviceError(
            "contact test: the membrane test needs the rigid alignment, and this preset uses a homography; choose "
            "rigid, or calibrate it"
        )
    progress(0.2, "Looking for the membrane")
    seen = float(np.mean(valid_depth(frame.tactile_depth)))
    if seen < _MIN_SEEN:
        raise AdviceError(
            f"contact test: the tactile camera measures depth in {100 * seen:.0f} % of its image only, so nothing "
            "tells whether a membrane is there; check the camera"
        )
    peak = difference_peak(frame, preset, rig)
    curvature_per_m = free_curvature_per_m(frame, preset.alignment, rig)
    if peak is not None and peak.same_scene:
        return _proposal(
            evidence,
            "tolerance",
            f"Both cameras see the same surface in {100 * peak.share:.0f} % of the pixels, so there is no membrane.",
            "Pixels count as contact where both depths agree within t.",
        )
    if curvature_per_m <= LIMITS_PER_M[0]:
        return _proposal(
            evidence,
            "tolerance",
            "The tactile camera sees no inflated membrane: twice the mean curvature is at most "
            f"{LIMITS_PER_M[0]:g} per metre.",
            "Pixels count as contact where both depths agree within t.",
        )
    return _proposal(
        evidence,
        "membrane",
        "The pose of the cameras is known, and the tactile camera sees an inflated membrane (twice its mean curvature "
        f"is {curvature_per_m:.1f} per metre), so its equilibrium tells contact from a gap.",
        "Contact ends where a membrane in equilibrium leaves the object; tolerance and outliers are ignored.",
    )


def _proposal(evidence: Evidence, test: str, sentence: str, expected: str) -> Proposal:
    if evidence.preset.contact_test == test:
        return Proposal("contact_test", {}, f"Keep the {test} test", sentence, "Nothing changes.")
    return Proposal("contact_test", {"contact_test": test}, f"Contact test: {test}", sentence, expected)
