"""A Kalman filter over time for roll and pitch, each with a constant rate between frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ..model.arrays import Float64Array
from .tilt import MAX_SIGMA_RAD, Tilt

#: A measurement this many standard deviations from the prediction is a push, not noise: the angle starts again there,
#: because an object that is hit changes its rate within a frame.
_PUSHED: Final = 4.0
#: Standard deviation of the rate at the start, rad/s.
_START_RATE_RAD_S: Final = 1.0


@dataclass
class _Track:
    """One angle: (angle, rate), their covariance, the variance that time does not average, and when it was measured."""

    state: Float64Array
    covariance: Float64Array
    fixed_rad2: float
    measured_s: float


class TiltFilter:
    """Filters tilts in the order of their time stamps.

    Each angle is a state (angle, rate) driven by white acceleration (Bar-Shalom, Li and Kirubarajan, "Estimation with
    Applications to Tracking and Navigation", 2001, section 6.3.2). Only the part of a measurement's variance that
    changes from frame to frame is averaged; the fixed part stays in the standard deviation of the result.

    Parameters
    ----------
    acceleration_rad_s2 : float
        Standard deviation of the angular acceleration. Larger values follow faster and average less.
    max_gap_s : float
        After this time without a measurement an angle is lost; the next measurement starts it again.
    """

    def __init__(self, acceleration_rad_s2: float = 3.0, max_gap_s: float = 0.5) -> None:
        self.acceleration_rad_s2, self.max_gap_s = acceleration_rad_s2, max_gap_s
        self.restart()

    def restart(self) -> None:
        """Forget all measurements, as after a seek."""
        self._tracks: dict[str, _Track] = {}
        self._time_s = -math.inf

    def update(self, tilt: Tilt) -> Tilt:
        """Return the tilt with filtered angles and with rates.

        An angle that is not determined is predicted for up to ``max_gap_s``. A time stamp that is not later than the
        previous one restarts the filter.
        """
        if tilt.time_s <= self._time_s:
            self.restart()
        dt_s, self._time_s = tilt.time_s - self._time_s, tilt.time_s  # infinite at the start, where nothing moves
        values: dict[str, Any] = {}
        for name in ("roll", "pitch"):
            self._step(name, tilt, dt_s)
            values |= dict.fromkeys(
                (f"{name}_rad", f"{name}_sigma_rad", f"{name}_rate_rad_s", f"{name}_rate_sigma_rad_s")
            )
            if (track := self._tracks.get(name)) is not None:
                sigma = math.sqrt(track.covariance[0, 0] + track.fixed_rad2)
                if sigma <= MAX_SIGMA_RAD:
                    values[f"{name}_rad"], values[f"{name}_sigma_rad"] = float(track.state[0]), sigma
                    values[f"{name}_rate_rad_s"] = float(track.state[1])
                    values[f"{name}_rate_sigma_rad_s"] = math.sqrt(track.covariance[1, 1])
        return replace(tilt, **values)

    def _step(self, name: str, tilt: Tilt, dt_s: float) -> None:
        """Predict one angle and correct it by the measurement, if there is one."""
        track = self._tracks.get(name)
        if track is not None and tilt.time_s - track.measured_s > self.max_gap_s:
            del self._tracks[name]
            track = None
        if track is not None:
            move = np.array([[1.0, dt_s], [0.0, 1.0]])
            push = self.acceleration_rad_s2 * np.array([dt_s**2 / 2, dt_s])
            track.state = move @ track.state
            track.covariance = move @ track.covariance @ move.T + np.outer(push, push)
        angle, sigma = getattr(tilt, f"{name}_rad"), getattr(tilt, f"{name}_sigma_rad")
        if angle is None or sigma is None:
            return
        fixed, noise = tilt.fixed_share * sigma**2, max((1 - tilt.fixed_share) * sigma**2, 1e-12)
        if track is not None:
            residual, total = angle - track.state[0], track.covariance[0, 0] + noise
            if residual**2 <= _PUSHED**2 * total:
                gain = track.covariance[:, 0] / total
                track.state = track.state + gain * residual
                track.covariance = track.covariance - np.outer(gain, track.covariance[0])
                track.fixed_rad2, track.measured_s = fixed, tilt.time_s
                return
        start = np.diag([noise, _START_RATE_RAD_S**2])
        self._tracks[name] = _Track(np.array([angle, 0.0]), start, fixed, tilt.time_s)
