"""Named sensors of the simulator: everything about the errors of one rig's cameras, without their code.

Amplitudes hold at normal incidence and 0.3 m; `noise` says how they grow from there. Lengths are in pixels of an
image 640 pixels wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from ...errors import SourceError


@dataclass(frozen=True)
class SensorModel:
    """The errors of one rig. The defaults are a rig without errors.

    Attributes
    ----------
    name : str
    about : str
        What is particular about it, in a few words.
    held_out : bool
        Whether it is reserved for judging methods, not for developing them.
    tof_white_m : float
        Time of flight: standard deviation of the noise that differs from pixel to pixel and from frame to frame.
    tof_correlated_m : float
        Standard deviation of the noise that neighbouring pixels share.
    tof_correlated_px : float
        Its length: the sigma of the Gaussian window through which white noise becomes this noise.
    tof_correlated_fixed_share : float
        Share of its variance that stays from frame to frame, 0 to 1.
    tof_incidence_share : float
        Share of both standard deviations that grows with 1 / cosine of incidence, 0 to 1.
    tof_distance_share : float
        Share of both standard deviations that grows with the distance, 0 to 1.
    tof_offset_m, tof_scale : float
        Constant error, and the factor on the true distance.
    tof_slope_m, tof_slope_deg : float
        Difference of the error between the left and the right edge of the image, and the direction in which the
        error rises: 0 to the right, 90 down.
    tof_slow_bias_m : float
        Standard deviation of a bias that varies over about a quarter of the image and differs from seed to seed.
    tof_drift_m, tof_drift_frames : float
        Amplitude and period of an error that all pixels share.
    tof_flying_share : float
        Share of pixels at a step of depth that mix both sides.
    tof_dropout_share, tof_grazing_dropout_share : float
        Share of pixels without depth: anywhere, and in addition at grazing incidence.
    stereo_correlated_px : float
        Stereo: standard deviation of the disparity noise that neighbouring pixels share, pixels.
    stereo_length_px : float
        Its length, as ``tof_correlated_px``. It stands for half the matching window.
    stereo_fixed_share : float
        Share of its variance that stays from frame to frame, 0 to 1.
    stereo_white_px : float
        Standard deviation of the disparity noise that differs from pixel to pixel and from frame to frame.
    stereo_hole_share, stereo_saturated_share : float
        Share of pixels without a match, and share of pixels that report 65535.
    stereo_hole_px : float
        Size of the holes, as ``tof_correlated_px``.
    stereo_subpixel_steps : float
        Disparities that the matcher tells apart, per pixel; 0: all.
    stereo_baseline_m : float
        Distance of the two imagers.
    colour_levels : float
        Standard deviation of the colour cameras' grain, 8-bit levels.
    """

    name: str
    about: str
    held_out: bool = False
    tof_white_m: float = 0.0
    tof_correlated_m: float = 0.0
    tof_correlated_px: float = 4.0
    tof_correlated_fixed_share: float = 0.5
    tof_incidence_share: float = 0.35
    tof_distance_share: float = 0.5
    tof_offset_m: float = 0.0
    tof_scale: float = 1.0
    tof_slope_m: float = 0.0
    tof_slope_deg: float = 30.0
    tof_slow_bias_m: float = 0.0
    tof_drift_m: float = 0.0
    tof_drift_frames: float = 151.0
    tof_flying_share: float = 0.0
    tof_dropout_share: float = 0.0
    tof_grazing_dropout_share: float = 0.0
    stereo_correlated_px: float = 0.0
    stereo_length_px: float = 2.4
    stereo_fixed_share: float = 0.5
    stereo_white_px: float = 0.0
    stereo_hole_share: float = 0.0
    stereo_saturated_share: float = 0.0
    stereo_hole_px: float = 4.8
    stereo_subpixel_steps: float = 0.0
    stereo_baseline_m: float = 0.018
    colour_levels: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether the sensor has no error but the quantisation of its depth."""
        return self == SensorModel(self.name, self.about, self.held_out, stereo_baseline_m=self.stereo_baseline_m)


_CLEAN: Final = SensorModel("clean", "no error but the quantisation of depth; what noise=0 gives with any sensor")

#: What most sensors share: flying pixels, drop-outs, holes and grain as the data sheets give them.
_USUAL: Final = SensorModel(
    "usual",
    "",
    tof_flying_share=0.6,
    tof_dropout_share=0.0025,
    tof_grazing_dropout_share=0.5,
    stereo_length_px=5.0,
    stereo_hole_share=0.006,
    stereo_saturated_share=0.001,
    stereo_subpixel_steps=32.0,
    colour_levels=2.2,
)

_DATASHEET: Final = replace(
    _USUAL,
    name="datasheet",
    about="the amplitudes of the cameras' data sheets, time-of-flight noise that neighbours do not share",
    tof_white_m=0.0010,
    tof_offset_m=0.0004,
    tof_slow_bias_m=0.0006,
    tof_drift_m=0.0003,
    stereo_correlated_px=0.03 * 2**0.5,
    stereo_length_px=2.4,
)

_ALL: Final = (
    _CLEAN,
    SensorModel("white", "0.6 mm of white time-of-flight noise and nothing else", tof_white_m=0.0006),
    replace(
        _DATASHEET,
        name="half",
        about="half the errors of datasheet",
        tof_white_m=0.0005,
        tof_offset_m=0.0002,
        tof_slow_bias_m=0.0003,
        tof_drift_m=0.00015,
        tof_flying_share=0.3,
        tof_dropout_share=0.00125,
        tof_grazing_dropout_share=0.25,
        stereo_correlated_px=0.015 * 2**0.5,
        stereo_hole_share=0.003,
        stereo_saturated_share=0.0005,
        colour_levels=1.1,
    ),
    _DATASHEET,
    replace(
        _DATASHEET,
        name="l515-d405",
        about="the noise of a real L515 and a real D405, which neighbouring pixels share",
        tof_white_m=0.0001,
        tof_correlated_m=0.00086,
        tof_correlated_px=2.0,
        stereo_correlated_px=0.09,
        stereo_length_px=5.0,
        stereo_white_px=0.02,
    ),
    replace(
        _USUAL,
        name="bias",
        about="time-of-flight errors that neighbours share over 9 px, and an offset of 0.8 mm",
        tof_white_m=0.0006,
        tof_correlated_m=0.0007,
        tof_correlated_px=9.0,
        tof_offset_m=0.0008,
        stereo_correlated_px=0.05,
        stereo_length_px=5.5,
    ),
    replace(
        _USUAL,
        name="wide",
        about="time-of-flight errors that neighbours share over 30 px, and an offset of 0.8 mm",
        tof_white_m=0.0006,
        tof_correlated_m=0.0009,
        tof_correlated_px=30.0,
        tof_offset_m=0.0008,
        stereo_correlated_px=0.05,
    ),
    replace(
        _USUAL,
        name="stereo",
        about="large stereo errors, 0.12 px",
        tof_white_m=0.0006,
        tof_correlated_m=0.0002,
        tof_offset_m=0.0008,
        stereo_correlated_px=0.12,
    ),
    replace(
        _USUAL,
        name="offset",
        about="the proximity camera reads 3 mm too far",
        tof_white_m=0.0005,
        tof_correlated_m=0.0003,
        tof_offset_m=0.003,
        stereo_correlated_px=0.06,
    ),
    replace(
        _USUAL,
        name="far-offset",
        about="the proximity camera reads 17 mm and 1 % too far, as a real one did",
        tof_white_m=0.0005,
        tof_correlated_m=0.0003,
        tof_offset_m=0.017,
        tof_scale=1.01,
        stereo_correlated_px=0.08,
    ),
    replace(
        _USUAL,
        name="heavy",
        about="large errors of both cameras that neighbours share",
        tof_white_m=0.0012,
        tof_correlated_m=0.0010,
        tof_correlated_px=8.0,
        tof_offset_m=0.0012,
        stereo_correlated_px=0.15,
    ),
    replace(
        _USUAL,
        name="worn",
        about="large errors, a slope of 2 mm over the image, holes, flying pixels, coarse disparities",
        tof_white_m=0.0011,
        tof_correlated_m=0.0009,
        tof_correlated_px=7.0,
        tof_offset_m=0.0012,
        tof_slope_m=0.002,
        tof_slow_bias_m=0.0006,
        tof_drift_m=0.0003,
        tof_flying_share=1.0,
        tof_dropout_share=0.01,
        stereo_correlated_px=0.13,
        stereo_white_px=0.02,
        stereo_hole_share=0.03,
        stereo_saturated_share=0.005,
        stereo_subpixel_steps=8.0,
    ),
    replace(
        _USUAL,
        name="held-tof",
        about="time-of-flight errors, white and shared",
        held_out=True,
        tof_white_m=0.0009,
        tof_correlated_m=0.0005,
        tof_correlated_px=14.0,
        tof_offset_m=0.0005,
        stereo_correlated_px=0.05,
        stereo_length_px=4.0,
    ),
    replace(
        _USUAL,
        name="held-stereo",
        about="stereo errors that neighbours share over 8 px",
        held_out=True,
        tof_white_m=0.0006,
        tof_correlated_m=0.0003,
        tof_correlated_px=3.0,
        tof_offset_m=0.0006,
        stereo_correlated_px=0.10,
        stereo_length_px=8.0,
    ),
    replace(
        _USUAL,
        name="held-offset",
        about="the proximity camera reads 5 mm too near",
        held_out=True,
        tof_white_m=0.0007,
        tof_correlated_m=0.0004,
        tof_correlated_px=6.0,
        tof_offset_m=-0.005,
        stereo_correlated_px=0.07,
        stereo_length_px=4.0,
    ),
    replace(
        _USUAL,
        name="held-mixed",
        about="errors of every kind",
        held_out=True,
        tof_white_m=0.0008,
        tof_correlated_m=0.0007,
        tof_correlated_px=18.0,
        tof_correlated_fixed_share=0.7,
        tof_offset_m=-0.0015,
        tof_scale=0.996,
        tof_slope_m=0.0015,
        tof_slope_deg=200.0,
        tof_slow_bias_m=0.0004,
        tof_flying_share=0.8,
        stereo_correlated_px=0.09,
        stereo_length_px=6.5,
        stereo_fixed_share=0.35,
        stereo_white_px=0.03,
        stereo_hole_share=0.015,
        stereo_subpixel_steps=16.0,
    ),
)

#: All sensors by name: from clean to worn, then those held out.
SENSORS: Final[dict[str, SensorModel]] = {sensor.name: sensor for sensor in _ALL}
DEFAULT_SENSOR: Final = "l515-d405"


def find_sensor(name: str) -> SensorModel:
    """Return a sensor by its name.

    Raises
    ------
    SourceError
        No such sensor.
    """
    if name not in SENSORS:
        raise SourceError(f"sim: there is no sensor {name!r}; choose one of {', '.join(SENSORS)}")
    return SENSORS[name]
