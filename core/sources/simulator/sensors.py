"""Named sensors of the simulator: everything about the errors of one rig's cameras, without their code.

Amplitudes hold at normal incidence and 0.3 m; `noise` says how they grow from there. Lengths are in pixels of an
image 640 pixels wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

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
_HALF: Final = replace(
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
)
_REAL: Final = replace(
    _DATASHEET,
    name="l515-d405",
    about="the noise of a real L515 and a real D405, which neighbouring pixels share",
    tof_white_m=0.0001,
    tof_correlated_m=0.00086,
    tof_correlated_px=2.0,
    stereo_correlated_px=0.09,
    stereo_length_px=5.0,
    stereo_white_px=0.02,
)

#: The other sensors differ from the usual one by these columns: time of flight white and shared noise in m, its length
#: in px, offset in m; stereo noise and its length in px.
_COLUMNS: Final = (
    *("tof_white_m", "tof_correlated_m", "tof_correlated_px", "tof_offset_m"),
    *("stereo_correlated_px", "stereo_length_px"),
)
_TABLE: Final[dict[str, tuple[tuple[float, ...], str]]] = {
    "bias": (
        (0.0006, 0.0007, 9.0, 0.0008, 0.05, 5.5),
        "time-of-flight errors that neighbours share over 9 px, and an offset of 0.8 mm",
    ),
    "wide": (
        (0.0006, 0.0009, 30.0, 0.0008, 0.05, 5.0),
        "time-of-flight errors that neighbours share over 30 px, and an offset of 0.8 mm",
    ),
    "stereo": ((0.0006, 0.0002, 4.0, 0.0008, 0.12, 5.0), "large stereo errors, 0.12 px"),
    "offset": ((0.0005, 0.0003, 4.0, 0.003, 0.06, 5.0), "the proximity camera reads 3 mm too far"),
    "far-offset": (
        (0.0005, 0.0003, 4.0, 0.017, 0.08, 5.0),
        "the proximity camera reads 17 mm and 1 % too far, as a real one did",
    ),
    "heavy": ((0.0012, 0.0010, 8.0, 0.0012, 0.15, 5.0), "large errors of both cameras that neighbours share"),
    "worn": (
        (0.0011, 0.0009, 7.0, 0.0012, 0.13, 5.0),
        "large errors, a slope of 2 mm over the image, holes, flying pixels, coarse disparities",
    ),
    "held-tof": ((0.0009, 0.0005, 14.0, 0.0005, 0.05, 4.0), "time-of-flight errors, white and shared"),
    "held-stereo": ((0.0006, 0.0003, 3.0, 0.0006, 0.10, 8.0), "stereo errors that neighbours share over 8 px"),
    "held-offset": ((0.0007, 0.0004, 6.0, -0.005, 0.07, 4.0), "the proximity camera reads 5 mm too near"),
    "held-mixed": ((0.0008, 0.0007, 18.0, -0.0015, 0.09, 6.5), "errors of every kind"),
}
#: What further differs.
_MORE: Final[dict[str, dict[str, float]]] = {
    "far-offset": {"tof_scale": 1.01},
    "worn": {
        "tof_slope_m": 0.002,
        "tof_slow_bias_m": 0.0006,
        "tof_drift_m": 0.0003,
        "tof_flying_share": 1.0,
        "tof_dropout_share": 0.01,
        "stereo_white_px": 0.02,
        "stereo_hole_share": 0.03,
        "stereo_saturated_share": 0.005,
        "stereo_subpixel_steps": 8.0,
    },
    "held-mixed": {
        "tof_correlated_fixed_share": 0.7,
        "tof_scale": 0.996,
        "tof_slope_m": 0.0015,
        "tof_slope_deg": 200.0,
        "tof_slow_bias_m": 0.0004,
        "tof_flying_share": 0.8,
        "stereo_fixed_share": 0.35,
        "stereo_white_px": 0.03,
        "stereo_hole_share": 0.015,
        "stereo_subpixel_steps": 16.0,
    },
}


def _of_table(name: str) -> SensorModel:
    numbers, about = _TABLE[name]
    columns: dict[str, Any] = dict(zip(_COLUMNS, numbers, strict=True)) | _MORE.get(name, {})
    return replace(_USUAL, name=name, about=about, held_out=name.startswith("held-"), **columns)


_ALL: Final = (
    _CLEAN,
    SensorModel("white", "0.6 mm of white time-of-flight noise and nothing else", tof_white_m=0.0006),
    _HALF,
    _DATASHEET,
    _REAL,
    *map(_of_table, _TABLE),
)

#: All sensors by name: from clean to worn, then those held out.
SENSORS: Final[dict[str, SensorModel]] = {sensor.name: sensor for sensor in _ALL}
DEFAULT_SENSOR: Final = "l515-d405"


def find_sensor(name: str) -> SensorModel:
    """Return a sensor by its name; `SourceError` if there is none."""
    if name not in SENSORS:
        raise SourceError(f"sim: there is no sensor {name!r}; choose one of {', '.join(SENSORS)}")
    return SENSORS[name]
