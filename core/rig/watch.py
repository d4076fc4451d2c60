"""The drift watchdog: a look every ten seconds tells whether a camera moved, the pressure changed or a lens is dirty.

No single frame decides. A change is told once its median over 3, 6, 12 or 24 looks exceeds what is harmless by 4
standard deviations of that median, so a large change is told after two looks and a small one later. It is withdrawn
when it is harmless again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ..calibration.recheck import RECALIBRATE_PX, Drift, recheck
from ..errors import CalibrationError, RigMismatchError
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .change import FAR_M, Change, ChangeMeter

#: Seconds from one look to the next.
INTERVAL_S: Final = 10.0

Subject = Literal["tactile", "proximity", "pressure", "depth", "alignment", "tactile_lens", "proximity_lens"]
#: What is watched, in the order in which it is told: "depth" and "alignment" may follow from those before them.
SUBJECTS: Final[tuple[Subject, ...]] = (
    "tactile",
    "proximity",
    "tactile_lens",
    "proximity_lens",
    "pressure",
    "depth",
    "alignment",
)
#: Harmless change, and its least standard deviation in one look; metres, for a lens the share of lost texture.
_HARMLESS: Final[dict[Subject, float]] = {
    "tactile": 0.00025,
    "proximity": 0.00025,
    "pressure": 0.00015,
    "depth": 0.0007,
    "alignment": 0.0004,
    "tactile_lens": 0.05,
    "proximity_lens": 0.05,
}
_SIGMA: Final[dict[Subject, float]] = {
    "tactile": 0.00002,
    "proximity": 0.00002,
    "pressure": 0.0001,
    "depth": 0.0001,
    "alignment": 0.00005,
    "tactile_lens": 0.01,
    "proximity_lens": 0.01,
}
#: Numbers of looks over which the median is taken, and the certainty that it needs, in its standard deviations.
_SPANS: Final = (3, 6, 12, 24)
_CERTAIN: Final = 4.0
#: Standard deviation of a median of n normal values: this times that of their mean.
_MEDIAN: Final = 1.2533
#: A change of the apex moves the texture sideways as a camera does that moves by at most this share of it.
_LOOKS_MOVED: Final = 0.06
#: While something touches, the alignment is checked at every fifth look only: it takes ten times as long.
_ALIGNMENT_EVERY: Final = 5


@dataclass(frozen=True)
class WatchReport:
    """Something that changed, or that is as before again.

    Attributes
    ----------
    subject : Subject
    state : {"told", "withdrawn"}
    time_s : float
        When it was decided, by the time given to `Watchdog.look`.
    value : float
        Median change: metres (signed for "pressure"), for a lens the share of texture that is lost.
    sentence : str
        One line with the number.
    """

    subject: Subject
    state: Literal["told", "withdrawn"]
    time_s: float
    value: float
    sentence: str


class Watchdog:
    """Watches a rig while it is used.

    The cameras, the pressure and the lenses are compared with the untouched frame whenever nothing touches the
    membrane. While something touches, and without an untouched frame, the alignment is compared with both colour
    images, which finds a camera that moved against the other one.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    untouched : SensorFrame or None
        The preset's untouched frame.

    Raises
    ------
    CalibrationError
        There is no untouched frame and no stored calibration, or the untouched frame shows too little.
    FrameError
        The untouched frame is of another rig.
    """

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame | None) -> None:
        if untouched is None and preset.alignment.calibration is None:
            raise CalibrationError(
                "the preset has neither an untouched frame nor a calibration to compare with; capture an untouched "
                "frame, or calibrate"
            )
        self._preset, self._rig = preset, rig
        self._meter = None if untouched is None else ChangeMeter(preset, rig, untouched)
        self._aligned = None if untouched is None else self._alignment(untouched)
        self._values: dict[Subject, deque[float]] = {subject: deque(maxlen=_SPANS[-1]) for subject in SUBJECTS}
        self._pressure_sigma_m = 0.0
        self._bulge_m = 0.0
        self._pixel_m = 0.0
        self._told: set[Subject] = set()
        self._next_s = -np.inf
        self._skipped = _ALIGNMENT_EVERY
        self.readings: dict[Subject, float] = {}

    def due(self, time_s: float) -> bool:
        """Return whether the next look is due; also after time was set back."""
        return time_s >= self._next_s or time_s < self._next_s - INTERVAL_S

    def look(self, frame: SensorFrame, time_s: float) -> WatchReport | None:
        """Measure one frame and return what it decides; a second decision of the same look follows with the next one.

        `readings` holds what this look measured, by subject.

        Parameters
        ----------
        frame : SensorFrame
        time_s : float
            Time of the frame, by any clock.

        Raises
        ------
        FrameError
            The frame is of another rig.
        """
        self._next_s = time_s + INTERVAL_S
        frame.check_against(self._rig)
        self.readings = self._measure(frame)
        for subject, value in self.readings.items():
            self._values[subject].append(value)
        for subject in SUBJECTS:
            report = self._decide(subject, time_s)
            if report is not None:
                return report
        return None

    @property
    def told(self) -> list[Subject]:
        """What has been told and not withdrawn."""
        return [subject for subject in SUBJECTS if subject in self._told]

    def _measure(self, frame: SensorFrame) -> dict[Subject, float]:
        self._skipped += 1
        if self._meter is not None:
            change = self._meter.compare(frame)
            if not change.touched:
                return self._kept(change)
        if self._skipped < _ALIGNMENT_EVERY:
            return {}
        self._skipped = 0
        drift = self._alignment(frame)
        if drift is None:
            return {}
        self._pixel_m = drift.drift_mm / 1e3 / drift.drift_px if drift.drift_px else 0.0
        before_m = 0.0 if self._aligned is None else self._aligned.drift_mm / 1e3
        return {"alignment": float(np.sqrt(max((drift.drift_mm / 1e3) ** 2 - before_m**2, 0.0)))}

    def _kept(self, change: Change) -> dict[Subject, float]:
        self._pressure_sigma_m, self._bulge_m = change.inflation_sigma_m, change.bulge_m
        by_pressure_m = _LOOKS_MOVED * abs(change.inflation_m or 0.0)
        tactile_m, proximity_m = (
            moved_m if moved_m is None or moved_m >= FAR_M else max(moved_m - by_pressure_m, 0.0)
            for moved_m in (change.tactile_m, change.proximity_m)
        )
        measured: dict[Subject, float | None] = {
            "tactile": tactile_m,
            "proximity": proximity_m,
            "pressure": change.inflation_m,
            "depth": change.depth_m,
            "tactile_lens": change.tactile_lost,
            "proximity_lens": change.proximity_lost,
        }
        return {subject: value for subject, value in measured.items() if value is not None}

    def _alignment(self, frame: SensorFrame) -> Drift | None:
        try:
            return recheck(self._preset, self._rig, frame)
        except (CalibrationError, RigMismatchError):  # too little texture, or no pose: nothing to compare
            return None

    def _decide(self, subject: Subject, time_s: float) -> WatchReport | None:
        values = self._values[subject]
        if subject not in self.readings or len(values) < _SPANS[0]:
            return None
        if subject in self._told:
            return self._withdraw(subject, time_s)
        return None if self._explained(subject) else self._tell(subject, time_s)

    def _withdraw(self, subject: Subject, time_s: float) -> WatchReport | None:
        """Report that a subject is as before, if its latest values are all harmless."""
        values = self._values[subject]
        latest = list(values)[-_SPANS[0] :]
        if max(map(abs, latest)) > self._harmless(subject):
            return None
        median = float(np.median(latest))
        self._told.discard(subject)
        while len(values) > _SPANS[0]:  # those of the time before must not tell it again
            values.popleft()
        return WatchReport(subject, "withdrawn", time_s, median, _withdrawn(subject, median))

    def _tell(self, subject: Subject, time_s: float) -> WatchReport | None:
        """Report a change, if a median over the latest values exceeds what is harmless by more than its noise.

        A large change shows in few values, a small one takes more: the standard error falls with 1 / sqrt(span).
        """
        values = self._values[subject]
        sigma = max(_SIGMA[subject], self._pressure_sigma_m if subject == "pressure" else 0.0)
        for span in _SPANS:
            if len(values) < span:
                break
            median = float(np.median(list(values)[-span:]))
            # Depth noise that changes slowly looks like pressure, so over a short time twice as much is harmless.
            factor = 2 if subject == "pressure" and span < _SPANS[2] else 1
            if abs(median) > factor * self._harmless(subject) + _CERTAIN * _MEDIAN * sigma / np.sqrt(span):
                self._told.add(subject)
                return WatchReport(subject, "told", time_s, median, self._sentence(subject, median))
        return None

    def _harmless(self, subject: Subject) -> float:
        if subject != "alignment" or self._meter is not None:
            return _HARMLESS[subject]
        record = self._preset.alignment.calibration
        limit_px = max(RECALIBRATE_PX, record.quality.alignment_bound_95_px if record else 0.0)
        return limit_px * self._pixel_m

    def _explained(self, subject: Subject) -> bool:
        """Return whether a change follows from one that was told, as that of the alignment from a camera that moved."""
        causes: tuple[Subject, ...] = ("tactile", "proximity")
        if subject == "depth":
            causes = ("tactile", "pressure", "tactile_lens")
        return subject in ("alignment", "depth") and any(cause in self._told for cause in causes)

    def _sentence(self, subject: Subject, value: float) -> str:
        if subject == "pressure":
            way = "risen: the membrane's apex stands" if value > 0 else "fallen: the membrane's apex stands"
            where = "farther out" if value > 0 else "farther in"
            share = f" ({100 * abs(value) / self._bulge_m:.1f} % of its height)" if self._bulge_m else ""
            return f"The pressure has {way} {1e3 * abs(value):.1f} mm{share} {where} than in the untouched frame."
        if subject in ("tactile_lens", "proximity_lens"):
            camera = subject.partition("_")[0]
            return (
                f"The lens of the {camera} camera is dirty or out of focus: {100 * value:.0f} % of the membrane's "
                "texture is lost."
            )
        if subject == "depth":
            return f"The tactile camera's depth has drifted by {1e3 * value:.1f} mm since the untouched frame."
        if subject == "alignment":
            return f"The cameras have moved against each other: the alignment is off by {1e3 * value:.1f} mm."
        size = f"{1e3 * value:.1f} mm" if value < FAR_M else f"{1e3 * FAR_M:.0f} mm or more"
        return f"The {subject} camera has moved by {size} since the untouched frame."


def _withdrawn(subject: Subject, value: float) -> str:
    name = {
        "tactile": "The tactile camera",
        "proximity": "The proximity camera",
        "pressure": "The pressure",
        "depth": "The tactile camera's depth",
        "alignment": "The alignment",
        "tactile_lens": "The lens of the tactile camera",
        "proximity_lens": "The lens of the proximity camera",
    }[subject]
    number = f"{100 * value:.0f} % lost" if subject.endswith("_lens") else f"{1e3 * abs(value):.1f} mm"
    return f"{name} is as before again ({number})."
