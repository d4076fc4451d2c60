"""The tilt of a contact patch: its plane as two angles, and the direction of its long axis in the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

TiltMethod = Literal["pca", "noise"]


@dataclass(frozen=True)
class Tilt:
    r"""The plane of a contact patch at one moment.

    All vectors are in the proximity depth frame: x right, y down, z forward, away from the camera. The patch's normal
    points away from the camera. ``roll`` turns about x, ``pitch`` about y, both right-handed, in ROS's order (first
    roll, then pitch, about the camera's axes)::

        normal = R_y(pitch) R_x(roll) (0, 0, 1) = (sin(pitch) cos(roll), -sin(roll), cos(pitch) cos(roll))

        roll > 0: seen from +x           pitch > 0: seen from +y, from below

             z (forward)                      z (forward)
             |      / patch                   | \ patch
             |    /                           |   \
             |  /                             |     \
             +--------- y (down)              +--------- x (right)

    So the lower edge of the image is farther with a positive roll, the right edge is nearer with a positive pitch. Both
    are 0 where the patch faces the camera.

    Attributes
    ----------
    sequence : int
        Number of the frame.
    time_s : float
        Time stamp of the proximity image, seconds.
    method : {"pca", "noise"}
    points : int
        Number of points of the patch.
    centroid_m : (float, float, float) or None
        Mean of the points, metres; None without contact.
    roll_rad, pitch_rad : float or None
        Radians, -pi/2 to pi/2; None if not determined: no contact, or the patch is a line or a dot.
    roll_sigma_rad, pitch_sigma_rad : float or None
        Their standard deviations, radians; None where the angle is.
    roll_pitch_covariance_rad2 : float
        Covariance of roll and pitch; 0 unless both are determined.
    axis_rad : float or None
        Direction of the long axis in the image, radians, -pi/2 to pi/2, from +u (right) towards +v (down); None for a
        patch that is about as wide as long.
    axis_sigma_rad : float or None
    roll_rate_rad_s, pitch_rate_rad_s : float or None
        Rates, radians per second; None unless the tilt was filtered over time.
    roll_rate_sigma_rad_s, pitch_rate_sigma_rad_s : float or None
    """

    sequence: int
    time_s: float
    method: TiltMethod
    points: int
    centroid_m: tuple[float, float, float] | None = None
    roll_rad: float | None = None
    roll_sigma_rad: float | None = None
    pitch_rad: float | None = None
    pitch_sigma_rad: float | None = None
    roll_pitch_covariance_rad2: float = 0.0
    axis_rad: float | None = None
    axis_sigma_rad: float | None = None
    roll_rate_rad_s: float | None = None
    roll_rate_sigma_rad_s: float | None = None
    pitch_rate_rad_s: float | None = None
    pitch_rate_sigma_rad_s: float | None = None

    def record(self) -> dict[str, Any]:
        """Return the angles and their standard deviations as JSON values, None where not determined."""
        names = [f"{angle}{sigma}_rad" for angle in ("roll", "pitch", "axis") for sigma in ("", "_sigma")]
        if self.roll_rate_rad_s is not None or self.pitch_rate_rad_s is not None:
            names += [f"{angle}_rate{sigma}_rad_s" for angle in ("roll", "pitch") for sigma in ("", "_sigma")]
        return {name: getattr(self, name) for name in names}
