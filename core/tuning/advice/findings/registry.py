"""All checks, and the object that runs them on a frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ....contact.pipeline import ContactPipeline
from ....errors import TactuneError
from ....model.frames import Rig, SensorFrame
from ....model.patch import ContactPatch
from ....preset import Preset
from ..proposal import Finding
from . import bulge, covering_mask, false_contact, no_depth, peak, prints, small_tolerance, unknown_bias
from .situation import Situation

#: The checks in the order in which their findings are shown: causes before consequences. To add one, write a file like
#: `bulge` and add it here.
CHECKS: Final[tuple[Callable[[Situation], Finding | None], ...]] = (
    no_depth.find,
    covering_mask.find,
    peak.find,
    prints.find,
    small_tolerance.find,
    unknown_bias.find,
    bulge.find,
    false_contact.find,
)


class Examiner:
    """Runs all checks on frames of one rig. For one thread at a time.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._pipeline: ContactPipeline | None = None

    def findings(
        self, frame: SensorFrame, patch: ContactPatch, preset: Preset, untouched: SensorFrame | None = None
    ) -> tuple[Finding, ...]:
        """Return what is wrong with a frame and a preset.

        Parameters
        ----------
        patch : ContactPatch
            That of the frame and preset.
        untouched : SensorFrame, optional
            The stored untouched frame. The preset is applied to it again only after a change of either.
        """
        before = None if untouched is None else self._untouched_patch(untouched, preset)
        situation = Situation(frame, patch, preset, self._rig, untouched, before)
        found = (check(situation) for check in CHECKS)
        return tuple(finding for finding in found if finding is not None)

    def _untouched_patch(self, untouched: SensorFrame, preset: Preset) -> ContactPatch | None:
        """Return the preset's patch in the untouched frame; None if it does not fit the rig."""
        try:
            if self._pipeline is None:
                self._pipeline = ContactPipeline(preset, self._rig)
            elif self._pipeline.preset is not preset:
                self._pipeline.update(preset)
            return self._pipeline.process(untouched)
        except TactuneError:
            self._pipeline = None
            return None
