"""The live simulator: a membrane pressed by an object, seen by two noisy cameras, with ground truth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from ...errors import SourceError
from ..base import FrameSource, Progress
from ..registry import SourceKind
from .membranes import MEMBRANES
from .sensors import DEFAULT_SENSOR, SENSORS

if TYPE_CHECKING:
    from ...preset import CamerasSection

SCENES = ("cube", "cup", "octopus")
#: Further scenes of the simulator, and the options of all scenes.
MORE_SCENES = ("two", "knobs", "star", "mug", "hand", "hover", "stiff", "wrinkled", "slide")
SCENE_OPTIONS = ("press", "side", "object", "gap", "membrane", "grid", "light", "sensor", "seed", "noise")
_DEFAULT_SCENE = "cup"


def _open(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    """Open ``SCENE?sensor=NAME&seed=N&noise=X``; every part is optional."""
    name = f"sim:{rest}"
    scene, _, query = rest.partition("?")
    scene = scene or _DEFAULT_SCENE
    if scene not in (*SCENES, *MORE_SCENES):
        raise SourceError(f"{name}: there is no scene {scene!r}; known are {', '.join((*SCENES, *MORE_SCENES))}")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"{name}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    options = dict(pairs)
    for key, _ in pairs:
        if key not in SCENE_OPTIONS:
            raise SourceError(f"{name}: the simulator has no option {key!r}; known are {', '.join(SCENE_OPTIONS)}")
        if [given for given, _ in pairs].count(key) > 1:
            raise SourceError(f"{name}: {key} is given twice; keep one")
    seed, noise = _seed(name, options.pop("seed", "0")), _number(name, "noise", options.pop("noise", "1"))
    sensor = options.pop("sensor", DEFAULT_SENSOR)
    if sensor not in SENSORS:
        raise SourceError(f"{name}: there is no sensor {sensor!r}; known are {', '.join(SENSORS)}")
    from .source import SimulatorSource

    if not options:
        return SimulatorSource(scene=scene, seed=seed, noise=noise, progress=progress, sensor=sensor)
    from .scenes import read_options

    variant, light = read_options(name, options)
    return SimulatorSource(
        scene=scene, seed=seed, noise=noise, progress=progress, variant=variant, light=light, sensor=sensor
    )


def _seed(name: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise SourceError(f"{name}: seed is {text!r}, but it must be a whole number from 0, such as seed=3")
    return int(text)


def _number(name: str, key: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 <= number <= 100.0:
        raise SourceError(f"{name}: {key} is {text!r}, but it must be a number from 0 (none) to 100, such as {key}=0.5")
    return number


KIND = SourceKind(
    scheme="sim",
    title="Simulator",
    form="sim:SCENE[?press=medium&membrane=NAME&sensor=NAME&seed=N&noise=X]",
    description=(
        f"A simulated sensor with ground truth, pressed by an object: {', '.join(SCENES)}, two; mug and hand, "
        "held out for judging methods. hover (gap=1...20 mm away), stiff (regions 8 times as stiff), wrinkled "
        "(folds of a twist) and slide take object=cup. press=low, medium or high holds a press, high at "
        "side=right or left, press=none shows the untouched membrane; grid=dots prints dots 10 mm apart; "
        f"membrane={', '.join(MEMBRANES)}; "
        f"light=bright or dim; noise=0, 1 or 2 times the errors of sensor= "
        f"({DEFAULT_SENSOR} by default): {', '.join(SENSORS)}."
    ),
    needs="nothing",
    examples=tuple(f"sim:{scene}" for scene in SCENES),
    open=_open,
    rank=0,
)
