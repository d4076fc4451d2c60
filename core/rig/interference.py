"""Does the proximity camera's laser disturb the tactile camera? Fill rate and noise with and without it, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..errors import FrameError
from ..model.arrays import Uint16Array
from ..model.frames import DepthCamera
from ..sources.base import CameraOption
from .depth_quality import Rectangle, fill_rate, temporal_noise

#: Frames that each half needs.
LEAST_FRAMES = 10
#: Options by which an emitter is switched, the better one first, with the value that means off.
_SWITCHES = ("emitter_enabled", "laser_power")
#: Changes below these are of no consequence, whatever the statistics say.
_HARMLESS_FILL = 0.005
_HARMLESS_NOISE_RATIO = 1.1
#: A change counts as one from this many standard errors.
_SIGNIFICANT = 3.0
#: Each half is cut into so many parts, whose scatter tells the standard error.
_PARTS = 5


@dataclass(frozen=True)
class Half:
    """One half of the test.

    Attributes
    ----------
    fill_rate, fill_error : float
        Mean over the frames, 0 to 1, and its standard error.
    noise_m, noise_share : float
        Temporal noise, metres and as a share of the distance; nan where too few pixels have a depth.
    noise_error_m : float
        Standard error of ``noise_m``.
    frames : int
    """

    fill_rate: float
    fill_error: float
    noise_m: float
    noise_share: float
    noise_error_m: float
    frames: int


@dataclass(frozen=True)
class Interference:
    """What switching the emitter off changes.

    Attributes
    ----------
    on, off : Half
        The tactile camera's with the emitter on and off.
    fill_lost : float
        Fill rate without minus with the emitter; positive: the emitter costs depths.
    noise_ratio : float
        Temporal noise with over without the emitter; above 1: the emitter adds noise. nan where unknown.
    disturbed : bool
    sentence : str
        The finding.
    remedy : str
        What to do; empty where nothing needs doing.
    """

    on: Half
    off: Half
    fill_lost: float
    noise_ratio: float
    disturbed: bool
    sentence: str
    remedy: str

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON can hold it; what is not known is null."""
        data = asdict(self)
        for part in (data, data["on"], data["off"]):
            part.update({key: None for key, value in part.items() if isinstance(value, float) and np.isnan(value)})
        return data


def emitter_switch(options: Sequence[CameraOption]) -> CameraOption | None:
    """Return the option of the proximity camera that switches its emitter; None where there is none.

    ``emitter_enabled`` is preferred; a ``laser_power`` that can be set to nothing serves as well.
    """
    mine = {option.name: option for option in options if option.camera == "proximity" and not option.read_only}
    for name in _SWITCHES:
        option = mine.get(name)
        if option is not None and option.minimum <= 0.0 < option.maximum:
            return option
    return None


def on_value(switch: CameraOption) -> float:
    """Return the value at which the emitter is on: the present one, or the default where it is off now."""
    for value in (switch.value, switch.default):
        if value > 0.0:
            return value
    return switch.maximum


def measure_interference(
    with_emitter: Sequence[Uint16Array],
    without_emitter: Sequence[Uint16Array],
    camera: DepthCamera,
    region: Rectangle | None = None,
) -> Interference:
    """Compare the tactile camera's depth with the proximity camera's emitter on and off.

    Parameters
    ----------
    with_emitter, without_emitter : sequence of uint16, shape (H, W)
        Raw tactile depth of one scene at rest, at least 10 frames each.
    camera : DepthCamera
        The tactile one.
    region : (int, int, int, int), optional
        Left, top, width, height in its pixels; all by default.

    Raises
    ------
    FrameError
        Too few frames, or the camera sees no depth either way.
    """
    fewest = min(len(with_emitter), len(without_emitter))
    if fewest < LEAST_FRAMES:
        raise FrameError(f"only {fewest} frames came, {LEAST_FRAMES} are needed; let the cameras run and test again")
    left, top, width, height = region or (0, 0, camera.intrinsics.width, camera.intrinsics.height)
    window = slice(top, top + height), slice(left, left + width)
    on = _half(np.stack([image[window] for image in with_emitter]), camera.depth_unit_m)
    off = _half(np.stack([image[window] for image in without_emitter]), camera.depth_unit_m)
    if on.fill_rate == 0.0 and off.fill_rate == 0.0:
        raise FrameError("the tactile camera sees no depth with the emitter on or off; check its light and distance")
    return _judge(on, off)


def _half(stack: Uint16Array, unit_m: float) -> Half:
    fills = np.array([fill_rate(image) for image in stack])
    parts = np.array_split(stack, _PARTS) if len(stack) >= 5 * _PARTS else np.array_split(stack, 2)
    noises = np.array([temporal_noise(part, unit_m)[1] for part in parts])
    share, metres = temporal_noise(stack, unit_m)
    return Half(
        fill_rate=float(fills.mean()),
        fill_error=float(fills.std(ddof=1) / np.sqrt(len(fills))),
        noise_m=metres,
        noise_share=share,
        noise_error_m=float(noises.std(ddof=1) / np.sqrt(len(noises))),
        frames=len(stack),
    )


def _judge(on: Half, off: Half) -> Interference:
    lost = off.fill_rate - on.fill_rate
    ratio = on.noise_m / off.noise_m if off.noise_m > 0 else float("nan")
    fewer = lost > max(_HARMLESS_FILL, _SIGNIFICANT * float(np.hypot(on.fill_error, off.fill_error)))
    more_noise = on.noise_m - off.noise_m
    noisier = ratio > _HARMLESS_NOISE_RATIO and more_noise > _SIGNIFICANT * float(
        np.hypot(on.noise_error_m, off.noise_error_m)
    )
    found = (
        f"fill rate {100 * on.fill_rate:.1f} % with it, {100 * off.fill_rate:.1f} % without; "
        f"temporal noise {_noise(on)} with it, {_noise(off)} without"
    )
    if not (fewer or noisier):
        helped = -lost > max(_HARMLESS_FILL, _SIGNIFICANT * float(np.hypot(on.fill_error, off.fill_error)))
        word = "helps the tactile camera" if helped else "does not disturb the tactile camera"
        return Interference(on, off, lost, ratio, False, f"The proximity camera's laser {word}: {found}.", "")
    effects = []
    if fewer:
        effects.append(f"costs the tactile camera {100 * lost:.1f} % of its pixels")
    if noisier:
        effects.append(f"makes its depth {ratio:.1f} times as noisy")
    remedy = (
        "Lower the laser power as far as the proximity camera's fill rate allows, raise the visible light on the "
        "membrane, and check that the tactile camera has its infrared-cut filter (a D405 has one)."
    )
    sentence = f"The proximity camera's laser {' and '.join(effects)}: {found}."
    return Interference(on, off, lost, ratio, True, sentence, remedy)


def _noise(half: Half) -> str:
    return "unknown" if np.isnan(half.noise_m) else f"{1e3 * half.noise_m:.2f} mm"
