"""Named sensors of the simulator: everything about the errors of one rig's cameras, without their code.

Amplitudes are standard deviations at normal incidence and 0.3 m; `noise` says how they grow from there. Lengths are
pixels of an image 640 pixels wide: the sigma of the Gaussian window through which white noise becomes this noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final


@dataclass(frozen=True)
class SensorModel:
    """The errors of one rig; the defaults are none. A held-out one is reserved for judging methods."""

    name: str
    about: str
    held_out: bool = False
    # Time of flight: noise of each pixel and frame, and noise that neighbours share, a part of which stays.
    tof_white_m: float = 0.0
    tof_correlated_m: float = 0.0
    tof_correlated_px: float = 4.0
    tof_correlated_fixed_share: float = 0.5
    # Constant error, factor on the distance, difference from edge to edge of the image and its direction (90: down).
    tof_offset_m: float = 0.0
    tof_scale: float = 1.0
    tof_slope_m: float = 0.0
    tof_slope_deg: float = 30.0
    # A bias that varies over a quarter of the image, and an error of all pixels that comes and goes.
    tof_slow_bias_m: float = 0.0
    tof_drift_m: float = 0.0
    # Pixels at a step of depth that mix both sides; pixels without depth, anywhere and at grazing incidence.
    tof_flying_share: float = 0.0
    tof_dropout_share: float = 0.0
    tof_grazing_dropout_share: float = 0.0
    # Whether prints on the membrane reflect infrared, so that what is behind them is not seen.
    prints_reflect: bool = True
    # Stereo: noise of the disparity that neighbours share, a part of which stays, and noise of each pixel and frame.
    stereo_correlated_px: float = 0.0
    stereo_length_px: float = 2.4
    stereo_fixed_share: float = 0.5
    stereo_white_px: float = 0.0
    # Pixels without a match and that report 65535; disparities that the matcher tells apart, per pixel, 0: all.
    stereo_hole_share: float = 0.0
    stereo_saturated_share: float = 0.0
    stereo_subpixel_steps: float = 0.0
    # Grain of the colour cameras, 8-bit levels.
    colour_levels: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether the sensor has no error but the quantisation of its depth."""
        return self == SensorModel(self.name, self.about, self.held_out)


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
_AMPLITUDES: Final = (
    *("tof_white_m", "tof_offset_m", "tof_slow_bias_m", "tof_drift_m", "tof_flying_share", "tof_dropout_share"),
    *("tof_grazing_dropout_share", "stereo_correlated_px", "stereo_hole_share", "stereo_saturated_share"),
    "colour_levels",
)
_HALVED: Final[dict[str, Any]] = {name: getattr(_DATASHEET, name) / 2 for name in _AMPLITUDES}
_HALF: Final = replace(_DATASHEET, name="half", about="half the errors of datasheet", **_HALVED)
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


def _sensor(
    name: str, about: str, tof: tuple[float, float, float, float], stereo: tuple[float, float], **more: Any
) -> SensorModel:
    """Return a usual sensor with other noise: white and shared in m, length in px, offset in m; stereo and length."""
    white_m, shared_m, length_px, offset_m = tof
    return replace(
        _USUAL, name=name, about=about, held_out=name.startswith("held-"), tof_white_m=white_m,
        tof_correlated_m=shared_m, tof_correlated_px=length_px, tof_offset_m=offset_m,
        stereo_correlated_px=stereo[0], stereo_length_px=stereo[1], **more,
    )  # fmt: skip


_SHARED: Final = "time-of-flight errors that neighbours share over {} px, and an offset of 0.8 mm"
_ALL: Final = (
    SensorModel("clean", "no error but the quantisation of depth; what noise=0 gives with any sensor"),
    SensorModel("white", "0.6 mm of white time-of-flight noise and nothing else", tof_white_m=0.0006),
    _HALF,
    _DATASHEET,
    _REAL,
    _sensor("bias", _SHARED.format(9), (0.0006, 0.0007, 9.0, 0.0008), (0.05, 5.5)),
    _sensor("wide", _SHARED.format(30), (0.0006, 0.0009, 30.0, 0.0008), (0.05, 5.0)),
    _sensor("stereo", "large stereo errors, 0.12 px", (0.0006, 0.0002, 4.0, 0.0008), (0.12, 5.0)),
    _sensor("offset", "the proximity camera reads 3 mm too far", (0.0005, 0.0003, 4.0, 0.003), (0.06, 5.0)),
    _sensor(
        "far-offset",
        "the proximity camera reads 17 mm and 1 % too far, as a real one did",
        (0.0005, 0.0003, 4.0, 0.017),
        (0.08, 5.0),
        tof_scale=1.01,
    ),
    _sensor("heavy", "large errors of both cameras that neighbours share", (0.0012, 0.0010, 8.0, 0.0012), (0.15, 5.0)),
    _sensor(
        "worn",
        "large errors, a slope of 2 mm over the image, holes, flying pixels, coarse disparities",
        (0.0011, 0.0009, 7.0, 0.0012),
        (0.13, 5.0),
        tof_slope_m=0.002,
        tof_slow_bias_m=0.0006,
        tof_drift_m=0.0003,
        tof_flying_share=1.0,
        tof_dropout_share=0.01,
        stereo_white_px=0.02,
        stereo_hole_share=0.03,
        stereo_saturated_share=0.005,
        stereo_subpixel_steps=8.0,
    ),
    _sensor("held-tof", "time-of-flight errors, white and shared", (0.0009, 0.0005, 14.0, 0.0005), (0.05, 4.0)),
    _sensor("held-stereo", "stereo errors shared over 8 px", (0.0006, 0.0003, 3.0, 0.0006), (0.10, 8.0)),
    _sensor("held-offset", "the proximity camera reads 5 mm too near", (0.0007, 0.0004, 6.0, -0.005), (0.07, 4.0)),
    _sensor(
        "held-mixed",
        "errors of every kind",
        (0.0008, 0.0007, 18.0, -0.0015),
        (0.09, 6.5),
        tof_correlated_fixed_share=0.7,
        tof_scale=0.996,
        tof_slope_m=0.0015,
        tof_slope_deg=200.0,
        tof_slow_bias_m=0.0004,
        tof_flying_share=0.8,
        stereo_fixed_share=0.35,
        stereo_white_px=0.03,
        stereo_hole_share=0.015,
        stereo_subpixel_steps=16.0,
    ),
)

#: All sensors by name: from clean to worn, then those held out.
SENSORS: Final[dict[str, SensorModel]] = {sensor.name: sensor for sensor in _ALL}
DEFAULT_SENSOR: Final = "l515-d405"
