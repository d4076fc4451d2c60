"""The check of a rig in use: whether alignment and membrane are still those that the preset was made with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..calibration.check import Drift, check_alignment
from ..errors import TactuneError
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .drift import MembraneDrift, compare_with_untouched
from .untouched import load_untouched

_NO_UNTOUCHED = "the preset has no untouched frame; capture one while nothing touches the membrane"


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Drift of the alignment and of the membrane; for each, a sentence instead if it could not be checked."""

    alignment: Drift | str
    membrane: MembraneDrift | str

    @property
    def state(self) -> Literal["good", "drifted", "unknown"]:
        """Whether all is as before; unknown if nothing could be checked, or while something touches the membrane."""
        verdict = "unknown" if isinstance(self.membrane, str) else self.membrane.verdict
        off = isinstance(self.alignment, Drift) and self.alignment.recalibrate
        if off or verdict in ("camera", "inflation"):
            return "drifted"
        return "unknown" if verdict == "touched" or (isinstance(self.alignment, str) and verdict != "fine") else "good"

    @property
    def unchecked(self) -> list[str]:
        """What could not be checked, and why."""
        parts = (("alignment", self.alignment), ("membrane", self.membrane))
        return [f"the {what} was not checked: {found}" for what, found in parts if isinstance(found, str)]

    @property
    def sentence(self) -> str:
        """The state in one line: what was measured, or what moved, by how much, which way, and what mends it."""
        good: list[str] = []
        bad: list[str] = []
        if isinstance(self.alignment, Drift):
            good.append(f"{self.alignment.drift_px:.1f} px")
            if self.alignment.recalibrate:
                bad.append(self.alignment.sentence)
        if isinstance(self.membrane, MembraneDrift):
            good.append(f"membrane moved by {1e3 * self.membrane.largest_m:.1f} mm")
            if self.membrane.verdict != "fine":
                bad.append(self.membrane.sentence)
        if self.state == "unknown":
            return " ".join(bad) or "; ".join(self.unchecked)
        return f"drifted: {' '.join(bad)}" if bad else f"still good: {', '.join(good)}"


def drift_or_reason(preset: Preset, rig: Rig, frame: SensorFrame) -> Drift | str:
    """Return the drift of the alignment, or why it could not be checked."""
    try:
        return check_alignment(preset, rig, frame)
    except TactuneError as error:
        return str(error)


def check_rig(
    preset: Preset, preset_path: Path | None, rig: Rig, frame: SensorFrame, untouched: SensorFrame | None = None
) -> RigCheck:
    """Check a preset on a frame; its untouched frame, unless it is given, lies beside ``preset_path``."""
    membrane: MembraneDrift | str = _NO_UNTOUCHED
    if preset.untouched is not None and preset_path is not None:
        try:
            untouched = untouched or load_untouched(preset.untouched, preset_path)
            membrane = compare_with_untouched(preset, rig, frame, untouched)
        except TactuneError as error:
            membrane = str(error)
    return RigCheck(drift_or_reason(preset, rig, frame), membrane)
