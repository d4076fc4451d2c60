"""A Kalman filter over time for roll and pitch, each with a constant rate between frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

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
    """One angle and its rate, with their covariance; no state before the first measurement."""

    state: Float64Array | None = None
    covariance: Float64Array | None = None
    fixed_rad2: float = 0.0
    measured_s: float = 0.0


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
        self._roll, self._pitch = _Track(), _Track()
        self._time_s: float | None = None

    def update(self, tilt: Tilt) -> Tilt:
        """Return the tilt with filtered angles and with rates.

        An angle that is not determined is predicted for up to ``max_gap_s``. A time stamp that is not later than the
        previous one restarts the filter.
        """
        dt_s = 0.0 if self._time_s is None else tilt.time_s - self._time_s
        if self._time_s is not None and dt_s <= 0:
            self.restart()
        self._time_s = tilt.time_s
        changing = 1.0 - tilt.fixed_share
        roll = self._step(self._roll, tilt.roll_rad, tilt.roll_sigma_rad, changing, tilt.time_s, dt_s)
        pitch = self._step(self._pitch, tilt.pitch_rad, tilt.pitch_sigma_rad, changing, tilt.time_s, dt_s)
        covariance = 0.0
        if tilt.roll_pitch_covariance_rad2 and tilt.roll_sigma_rad and tilt.pitch_sigma_rad and roll[1] and pitch[1]:
            correlation = tilt.roll_pitch_covariance_rad2 / (tilt.roll_sigma_rad * tilt.pitch_sigma_rad)
            covariance = correlation * roll[1] * pitch[1]
        return replace(
            tilt,
            roll_rad=roll[0],
            roll_sigma_rad=roll[1],
            roll_rate_rad_s=roll[2],
            roll_rate_sigma_rad_s=roll[3],
            pitch_rad=pitch[0],
            pitch_sigma_rad=pitch[1],
            pitch_rate_rad_s=pitch[2],
            pitch_rate_sigma_rad_s=pitch[3],
            roll_pitch_covariance_rad2=covariance,
        )

    def _step(
        self,
        track: _Track,
        angle_rad: float | None,
        sigma_rad: float | None,
        changing: float,
        time_s: float,
        dt_s: float,
    ) -> tuple[float | None, float | None, float | None, float | None]:
        """Predict one angle, correct it, and return angle, sigma, rate and its sigma; None while it is lost."""
        if track.state is not None and time_s - track.measured_s > self.max_gap_s:
            track.state = None
        if track.state is not None and track.covariance is not None:
            move = np.array([[1.0, dt_s], [0.0, 1.0]])
            push = self.acceleration_rad_s2 * np.array([dt_s**2 / 2, dt_s])
            track.state = move @ track.state
            track.covariance = move @ track.covariance @ move.T + np.outer(push, push)
        if angle_rad is not None and sigma_rad is not None:
            self._correct(track, angle_rad, sigma_rad**2, changing)
            track.measured_s = time_s
        if track.state is None or track.covariance is None:
            return None, None, None, None
        sigma = math.sqrt(track.covariance[0, 0] + track.fixed_rad2)
        if sigma > MAX_SIGMA_RAD:
            return None, None, None, None
        angle, rate = track.state
        return float(angle), sigma, float(rate), math.sqrt(track.covariance[1, 1])

    def _correct(self, track: _Track, angle_rad: float, variance: float, changing: float) -> None:
        track.fixed_rad2 = (1 - changing) * variance
        noise = max(changing * variance, 1e-12)
        if track.state is not None and track.covariance is not None:
            residual, total = angle_rad - track.state[0], track.covariance[0, 0] + noise
            if residual**2 <= _PUSHED**2 * total:
                gain = track.covariance[:, 0] / total
                track.state = track.state + gain * residual
                track.covariance = track.covariance - np.outer(gain, track.covariance[0])
                return
        track.state = np.array([angle_rad, 0.0])
        track.covariance = np.diag([noise, _START_RATE_RAD_S**2])
