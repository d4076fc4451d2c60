"""The simulator's names as fields: ``cup?press=low&seed=3`` is read, checked and written here only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, get_args
from urllib.parse import parse_qsl

from ...errors import SourceError
from .membranes import MEMBRANES
from .objects import OBJECTS
from .scene_list import DEFAULT_SCENE, MORE_SCENES, SCENE_OPTIONS, SCENES
from .scenes import SPECIAL_SCENES, Light, Move, Press, Side, Variant, read_options, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS
from .sheet import Print

MAX_SEED: Final = 9_999_999_999
MAX_NOISE: Final = 100.0
MAX_GAP_MM: Final = 100.0


@dataclass(frozen=True)
class NameField:
    """One part of a name.

    Attributes
    ----------
    key : str
        ``"scene"`` or one of `SCENE_OPTIONS`.
    title, about : str
        For dialogs.
    default : str
        The value that a name need not state.
    choices : dict of str to str
        Possible values, each with a few words or ""; empty for a number.
    maximum : float
        Of a number; the smallest one is 0.
    decimals : int
        Of a number.
    unit : str
    """

    key: str
    title: str
    about: str
    default: str
    choices: Mapping[str, str] = field(default_factory=dict)
    maximum: float = 0.0
    decimals: int = 0
    unit: str = ""


NAME_FIELDS: Final = (
    NameField(
        "scene",
        "Scene",
        "What presses the membrane: an object, or a scene with any object",
        DEFAULT_SCENE,
        {scene: SPECIAL_SCENES.get(scene, "") for scene in (*SCENES, *MORE_SCENES)}
        | {"tray": "books roll a flat tray that lies 16 mm deep"},
    ),
    NameField("object", "Object", "The object of a scene that takes any", Variant.object, dict.fromkeys(OBJECTS, "")),
    NameField(
        "press",
        "Press",
        "A press that is held. Moving: the object approaches, presses and leaves; none: the untouched membrane",
        "",
        dict.fromkeys(get_args(Press), ""),
    ),
    NameField(
        "move",
        "Move",
        "How an object moves while it presses, for 5 s; the first opening takes a minute",
        "",
        dict.fromkeys(get_args(Move), "")
        | {"slide": "turns and slides across folds", "lift": "so does the cup, half of the time without its handle"},
    ),
    NameField(
        "side", "Side", "Where a high press is, seen by the cameras", Variant.side, dict.fromkeys(get_args(Side), "")
    ),
    NameField("gap", "Gap", "Distance of an object that hovers", f"{Variant.gap_mm:g}", {}, MAX_GAP_MM, 2, "mm"),
    NameField(
        "membrane",
        "Membrane",
        "Size, material and air of the membrane",
        Variant.membrane,
        {name: membrane.about for name, membrane in MEMBRANES.items()},
    ),
    NameField(
        "grid",
        "Print",
        "Pattern printed on the membrane; dots are 10 mm apart",
        Variant.grid,
        dict.fromkeys(get_args(Print), ""),
    ),
    NameField("light", "Light", "Light on the membrane", "normal", dict.fromkeys(get_args(Light), "")),
    NameField(
        "sensor",
        "Sensor",
        "Whose errors the cameras have",
        DEFAULT_SENSOR,
        {name: sensor.about for name, sensor in SENSORS.items()},
    ),
    NameField("seed", "Seed", "Another seed gives other noise with the same statistics", "0", {}, MAX_SEED),
    NameField("noise", "Noise", "Factor on the sensor's errors; 0 gives perfect images", "1", {}, MAX_NOISE, 2, "×"),
)

_DEFAULTS: Final = {each.key: each.default for each in NAME_FIELDS}


def read_name(rest: str) -> dict[str, str]:
    """Return the value of every field of a name, and check that they fit together.

    Parameters
    ----------
    rest : str
        The name after ``sim:``; every part is optional.

    Raises
    ------
    SourceError
        No such scene, option or value, or they do not fit together.
    """
    name = f"sim:{rest}"
    scene, _, query = rest.partition("?")
    scene = scene or DEFAULT_SCENE
    if scene not in (*SCENES, *MORE_SCENES):
        raise SourceError(f"{name}: there is no scene {scene!r}; known are {', '.join((*SCENES, *MORE_SCENES))}")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"{name}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    for key, _ in pairs:
        if key not in SCENE_OPTIONS:
            raise SourceError(f"{name}: the simulator has no option {key!r}; known are {', '.join(SCENE_OPTIONS)}")
        if [given for given, _ in pairs].count(key) > 1:
            raise SourceError(f"{name}: {key} is given twice; keep one")
    values = _DEFAULTS | dict(pairs) | {"scene": scene}
    check_values(values)
    return values


def check_values(values: Mapping[str, str]) -> None:
    """Raise `SourceError` if the values of the fields cannot be opened together."""
    name = write_name(values)
    seed, noise = values["seed"], values["noise"]
    few_digits = len(seed) <= 100  # Python refuses to read numbers of thousands of digits
    if not (seed.isascii() and seed.isdigit() and few_digits and int(seed) <= MAX_SEED):
        raise SourceError(f"{name}: seed is {seed!r}, but it must be a whole number from 0, such as seed=3")
    try:
        times = float(noise)
    except ValueError:
        times = math.nan
    if not 0.0 <= times <= MAX_NOISE:
        raise SourceError(
            f"{name}: noise is {noise!r}, but it must be a number from 0 (none) to 100, such as noise=0.5"
        )
    if values["sensor"] not in SENSORS:
        raise SourceError(f"{name}: there is no sensor {values['sensor']!r}; known are {', '.join(SENSORS)}")
    if values["light"] not in get_args(Light):
        raise SourceError(f"{name}: light is {values['light']!r}; choose one of {', '.join(get_args(Light))}")
    resolve_scene(values["scene"], read_options(name, values)[0])


def write_name(values: Mapping[str, str]) -> str:
    """Return the name of a source; values that are the default are left out."""
    given = [f"{key}={values[key]}" for key in SCENE_OPTIONS if values[key] != _DEFAULTS[key]]
    return f"sim:{values['scene']}" + ("?" + "&".join(given) if given else "")


def changed_values(values: Mapping[str, str], key: str, value: str) -> dict[str, str]:
    """Return the values after one was changed; others that do not go with it take their defaults.

    Raises
    ------
    SourceError
        The new value cannot be opened with any other values of this scene.
    """
    new = _DEFAULTS | {"scene": values["scene"], key: value}
    check_values(new)
    for other in SCENE_OPTIONS:
        if other != key and is_accepted(new | {other: values[other]}):
            new[other] = values[other]
    return new


def is_accepted(values: Mapping[str, str]) -> bool:
    """Return whether the values can be opened together."""
    try:
        check_values(values)
    except SourceError:
        return False
    return True
