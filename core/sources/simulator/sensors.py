"""Named sensors of the simulator: everything about the errors of one rig's cameras, without their code.

Amplitudes are standard deviations at normal incidence and 0.3 m; `noise` says how they grow from there. Lengths are
pixels of an image 640 pixels wide: the sigma of the Gaussian window through which white noise becomes this noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class SensorModel:
    """The errors of one rig; what most sensors share are the defaults, as the data sheets give it."""

    name: str
    about: str
    # Time of flight: noise of each pixel and frame, noise that neighbours share and its length, constant error.
    tof_white_m: float = 0.0
    tof_correlated_m: float = 0.0
    tof_correlated_px: float = 4.0
    tof_offset_m: float = 0.0
    # Stereo: noise of the disparity that neighbours share, and its length.
    stereo_correlated_px: float = 0.0
    stereo_length_px: float = 5.0
    # Shares of both that stay from frame to frame.
    tof_correlated_fixed_share: float = 0.5
    stereo_fixed_share: float = 0.5
    # Factor on the distance, difference from edge to edge of the image and its direction (90: down).
    tof_scale: float = 1.0
    tof_slope_m: float = 0.0
    tof_slope_deg: float = 30.0
    # A bias that varies over a quarter of the image, and an error of all pixels that comes and goes.
    tof_slow_bias_m: float = 0.0
    tof_drift_m: float = 0.0
    # Pixels at a step of depth that mix both sides; pixels without depth, anywhere and at grazing incidence.
    tof_flying_share: float = 0.6
    tof_dropout_share: float = 0.0025
    tof_grazing_dropout_share: float = 0.5
    # Noise of the disparity of each pixel and frame; disparities that the matcher tells apart, per pixel.
    stereo_white_px: float = 0.0
    stereo_subpixel_steps: float = 32.0
    # Pixels without a match, and that report 65535.
    stereo_hole_share: float = 0.006
    stereo_saturated_share: float = 0.001
    # Grain of the colour cameras, 8-bit levels.
    colour_levels: float = 2.2

    @property
    def exact(self) -> bool:
        """Whether the sensor has no error but the quantisation of its depth."""
        return self.name == "clean"

    @property
    def held_out(self) -> bool:
        """Whether it is reserved for judging methods."""
        return self.name.startswith("held-")


_SLOW: Final = {"tof_slow_bias_m": 0.0006, "tof_drift_m": 0.0003}
_WORN: Final = {
    "tof_slope_m": 0.002,
    "tof_flying_share": 1.0,
    "tof_dropout_share": 0.01,
    "stereo_white_px": 0.02,
    "stereo_subpixel_steps": 8.0,
    "stereo_hole_share": 0.03,
    "stereo_saturated_share": 0.005,
}
_MIXED: Final = {
    "tof_correlated_fixed_share": 0.7,
    "stereo_fixed_share": 0.35,
    "tof_scale": 0.996,
    "tof_slope_m": 0.0015,
    "tof_slope_deg": 200.0,
    "tof_slow_bias_m": 0.0004,
    "tof_flying_share": 0.8,
    "stereo_white_px": 0.03,
    "stereo_subpixel_steps": 16.0,
    "stereo_hole_share": 0.015,
}
_WIDE_ABOUT: Final = "time-of-flight errors that neighbours share over 30 px, and an offset of 0.8 mm"
_REAL_ABOUT: Final = "the noise of a real L515 and a real D405, which neighbouring pixels share"
_FAR_ABOUT: Final = "the proximity camera reads 17 mm and 1 % too far, as a real one did"
_WORN_ABOUT: Final = "large errors, a slope of 2 mm over the image, holes, flying pixels, coarse disparities"
# Time of flight: white, shared, its length, offset; stereo: shared, its length.
_ALL: Final = (
    SensorModel("clean", "no error but the quantisation of depth; what noise=0 gives with any sensor"),
    SensorModel("datasheet", "what the data sheets say", 0.0010, 0.0, 4.0, 0.0004, 0.03 * 2**0.5, 2.4, **_SLOW),
    SensorModel("l515-d405", _REAL_ABOUT, 0.0001, 0.00086, 2.0, 0.0004, 0.09, stereo_white_px=0.02, **_SLOW),
    SensorModel("wide", _WIDE_ABOUT, 0.0006, 0.0009, 30.0, 0.0008, 0.05),
    SensorModel("far-offset", _FAR_ABOUT, 0.0005, 0.0003, 4.0, 0.017, 0.08, tof_scale=1.01),
    SensorModel("heavy", "large errors of both cameras that neighbours share", 0.0012, 0.0010, 8.0, 0.0012, 0.15),
    SensorModel("worn", _WORN_ABOUT, 0.0011, 0.0009, 7.0, 0.0012, 0.13, **_WORN, **_SLOW),
    SensorModel("held-offset", "the proximity camera reads 5 mm too near", 0.0007, 0.0004, 6.0, -0.005, 0.07, 4.0),
    SensorModel("held-mixed", "errors of every kind", 0.0008, 0.0007, 18.0, -0.0015, 0.09, 6.5, **_MIXED),
)

#: All sensors by name: from clean to worn, then those held out.
SENSORS: Final[dict[str, SensorModel]] = {sensor.name: sensor for sensor in _ALL}
DEFAULT_SENSOR: Final = "l515-d405"
