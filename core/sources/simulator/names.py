"""The simulator's names as fields: ``cup?press=low&seed=3`` is read, checked and written here only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, get_args
from urllib.parse import parse_qsl, urlencode

from ...errors import SourceError
from .membranes import MEMBRANES
from .objects import OBJECTS
from .scene_list import DEFAULT_SCENE, MORE_SCENES, SCENE_OPTIONS, SCENES
from .scenes import MAX_GAP_MM, SPECIAL_SCENES, Light, Move, Press, Side, Variant, read_options, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS
from .sheet import Print

MAX_SEED: Final = 9_999_999_999
MAX_NOISE: Final = 100.0


@dataclass(frozen=True)
class NameField:
    """One part of a name, with what a dialog says about it.

    ``choices`` has a few words about each possible value, or "" for none, and is empty for a number, whose least value
    is 0.
    """

    key: str
    title: str
    about: str
    default: str
    choices: Mapping[str, str] = field(default_factory=dict)
    maximum: float = 0.0
    decimals: int = 0
    unit: str = ""


def _named(values: tuple[str, ...], **about: str) -> dict[str, str]:
    return dict.fromkeys(values, "") | about


_SCENES = _named((*SCENES, *MORE_SCENES), tray="books roll a flat tray that lies 16 mm deep", **SPECIAL_SCENES)
_MOVES = _named(
    get_args(Move), slide="turns and slides across folds", lift="so does the cup, half of the time without its handle"
)
_MEMBRANES = {name: membrane.about for name, membrane in MEMBRANES.items()}
_SENSORS = {name: sensor.about for name, sensor in SENSORS.items()}
_PRESS_ABOUT = "A press that is held. Moving: the object approaches, presses and leaves; none: the untouched membrane"
_MOVE_ABOUT = "How an object moves while it presses, for 5 s; the first opening takes a minute"
_PRINT_ABOUT = "Pattern printed on the membrane; dots are 10 mm apart"
_SEED_ABOUT = "Another seed gives other noise with the same statistics"
_NOISE_ABOUT = "Factor on the sensor's errors; 0 gives perfect images"

NAME_FIELDS: Final = (
    NameField("scene", "Scene", "What presses the membrane", DEFAULT_SCENE, _SCENES),
    NameField("object", "Object", "The object that hovers", Variant.object, _named(tuple(OBJECTS))),
    NameField("press", "Press", _PRESS_ABOUT, "", _named(get_args(Press))),
    NameField("move", "Move", _MOVE_ABOUT, "", _MOVES),
    NameField("side", "Side", "Where a high press is, seen by the cameras", Variant.side, _named(get_args(Side))),
    NameField("gap", "Gap", "Distance of an object that hovers", f"{Variant.gap_mm:g}", {}, MAX_GAP_MM, 2, "mm"),
    NameField("membrane", "Membrane", "Size, material and air of the membrane", Variant.membrane, _MEMBRANES),
    NameField("grid", "Print", _PRINT_ABOUT, Variant.grid, _named(get_args(Print))),
    NameField("light", "Light", "Light on the membrane", "normal", _named(get_args(Light))),
    NameField("sensor", "Sensor", "Whose errors the cameras have", DEFAULT_SENSOR, _SENSORS),
    NameField("seed", "Seed", _SEED_ABOUT, "0", {}, MAX_SEED),
    NameField("noise", "Noise", _NOISE_ABOUT, "1", {}, MAX_NOISE, 2, "×"),
)
_DEFAULTS: Final = {each.key: each.default for each in NAME_FIELDS}


def read_name(rest: str) -> dict[str, str]:
    """Return the value of every field of a name, without ``sim:``; `SourceError` if they cannot be opened together."""
    scene, _, query = rest.partition("?")
    try:
        given = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"sim:{rest}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    for key, _ in given:
        if key not in SCENE_OPTIONS:
            raise SourceError(f"sim:{rest}: the simulator has no option {key!r}; known are {', '.join(SCENE_OPTIONS)}")
    if len(dict(given)) < len(given):
        raise SourceError(f"sim:{rest}: an option is given twice; keep one")
    values = _DEFAULTS | dict(given) | {"scene": scene or DEFAULT_SCENE}
    check_values(values)
    return values


def check_values(values: Mapping[str, str]) -> None:
    """Raise `SourceError` if the values of the fields cannot be opened together."""
    name = write_name(values)
    if not (values["seed"].isdecimal() and len(values["seed"]) <= len(str(MAX_SEED))):
        raise SourceError(f"{name}: seed is {values['seed']!r}, but it must be a whole number from 0, such as seed=3")
    try:
        fits = 0.0 <= float(values["noise"]) <= MAX_NOISE
    except ValueError:
        fits = False
    if not fits:
        raise SourceError(
            f"{name}: noise is {values['noise']!r}, but it must be a number from 0 (none) to 100, such as noise=0.5"
        )
    for key, known in (("sensor", tuple(SENSORS)), ("light", get_args(Light))):
        if values[key] not in known:
            raise SourceError(f"{name}: there is no {key} {values[key]!r}; known are {', '.join(known)}")
    resolve_scene(values["scene"], read_options(name, values)[0])


def write_name(values: Mapping[str, str]) -> str:
    """Return the name of a source; values that are the default are left out."""
    query = urlencode({key: values[key] for key in SCENE_OPTIONS if values[key] != _DEFAULTS[key]})
    return f"sim:{values['scene']}" + (f"?{query}" if query else "")


def changed_values(values: Mapping[str, str], key: str, value: str) -> dict[str, str]:
    """Return the values after one was changed; others that do not go with it take their defaults.

    `SourceError` if the new value cannot be opened with any other values of this scene.
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
