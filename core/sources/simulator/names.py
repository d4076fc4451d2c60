"""The simulator's names as fields: ``cup?press=low&seed=3`` is read, checked and written here only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, get_args
from urllib.parse import parse_qsl, urlencode

from ...errors import SourceError
from .objects import OBJECTS
from .scenes import MAX_GAP_MM, MEMBRANES, Move, Press, Side, Variant, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS, find_sensor
from .sheet import Print

_MAX_SEED: Final = 9_999_999_999
_MAX_NOISE: Final = 100.0


@dataclass(frozen=True)
class NameField:
    """One part of a name, with what a dialog says about it: a choice with a few words about each, or a number."""

    key: str
    title: str
    about: str
    choices: Mapping[str, str] = field(default_factory=dict)
    maximum: float = 0.0
    decimals: int = 0
    unit: str = ""


def _named(values: Any, **about: str) -> dict[str, str]:
    return dict.fromkeys(values, "") | about


_SCENES = _named(OBJECTS, tray="a flat tray, 16 mm deep, that rolls")
_PRESS_ABOUT = "A press that is held. Moving: the object approaches, presses and leaves; none: the untouched membrane"
_MOVES = _named(
    get_args(Move), slide="turns and slides across folds", lift="so does the cup, half of the time without its handle"
)
_MOVE_ABOUT = "How an object moves while it presses, for 5 s; the first opening takes a minute"
_MEMBRANES = {name: membrane.about for name, membrane in MEMBRANES.items()}
_SENSORS = {name: sensor.about for name, sensor in SENSORS.items()}
_PRINT_ABOUT = "Pattern printed on the membrane; dots are 10 mm apart"
_SEED_ABOUT = "Another seed gives other noise with the same statistics"
_NOISE_ABOUT = "Factor on the sensor's errors; 0 gives perfect images"

NAME_FIELDS: Final = (
    NameField("scene", "Scene", "What presses the membrane", _SCENES),
    NameField("press", "Press", _PRESS_ABOUT, _named(get_args(Press))),
    NameField("move", "Move", _MOVE_ABOUT, _MOVES),
    NameField("side", "Side", "Where a high press is, seen by the cameras", _named(get_args(Side))),
    NameField("gap", "Gap", "Distance at which the object is held", {}, MAX_GAP_MM, 2, "mm"),
    NameField("membrane", "Membrane", "Size, material and air of the membrane", _MEMBRANES),
    NameField("grid", "Print", _PRINT_ABOUT, _named(get_args(Print))),
    NameField("sensor", "Sensor", "Whose errors the cameras have", _SENSORS),
    NameField("seed", "Seed", _SEED_ABOUT, {}, _MAX_SEED),
    NameField("noise", "Noise", _NOISE_ABOUT, {}, _MAX_NOISE, 2, "×"),
)


def name_values(scene: str, variant: Variant, sensor: str, seed: int, noise: float) -> dict[str, str]:
    """Return the value of each field as text."""
    return {
        "scene": scene, "press": variant.press, "move": variant.move, "side": variant.side,
        "gap": f"{variant.gap_mm:g}", "membrane": variant.membrane, "grid": variant.grid,
        "sensor": sensor, "seed": str(seed), "noise": f"{noise:g}",
    }  # fmt: skip


_DEFAULTS: Final = name_values("cup", Variant(), DEFAULT_SENSOR, 0, 1.0)


def read_name(rest: str) -> dict[str, str]:
    """Return the value of every field of a name, without ``sim:``; `SourceError` if they cannot be opened together."""
    scene, _, query = rest.partition("?")
    try:
        given = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"sim:{rest}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    options = tuple(key for key in _DEFAULTS if key != "scene")
    for key, _ in given:
        if key not in options:
            raise SourceError(f"sim:{rest}: the simulator has no option {key!r}; known are {', '.join(options)}")
    if len(dict(given)) < len(given):
        raise SourceError(f"sim:{rest}: an option is given twice; keep one")
    values = _DEFAULTS | dict(given) | {"scene": scene or _DEFAULTS["scene"]}
    source_options(values)
    return values


def source_options(values: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of a `SimulatorSource`; raises a `SourceError` if it cannot be opened with these values."""
    name = write_name(values)
    numbers = {}
    for key, maximum in (("gap", MAX_GAP_MM), ("seed", _MAX_SEED), ("noise", _MAX_NOISE)):
        try:
            numbers[key] = float(values[key])
            fits = 0.0 <= numbers[key] <= maximum and (key != "seed" or values[key].isdecimal())
        except ValueError:
            fits = False
        if not fits:
            kind = "whole number" if key == "seed" else "number"
            raise SourceError(f"{name}: {key} is {values[key]!r}; it must be a {kind} from 0 to {maximum:,.0f}")
    chosen: dict[str, Any] = {key: values[key] for key in ("press", "move", "side", "membrane", "grid")}
    variant = Variant(gap_mm=numbers["gap"], **chosen)
    resolve_scene(values["scene"], variant)
    find_sensor(values["sensor"])
    kept = {"scene": values["scene"], "variant": variant, "sensor": values["sensor"]}
    return {**kept, "seed": int(values["seed"]), "noise": numbers["noise"]}


def write_name(values: Mapping[str, str]) -> str:
    """Return the name of a source; values that are the default are left out."""
    query = urlencode({key: values[key] for key in _DEFAULTS if key != "scene" and values[key] != _DEFAULTS[key]})
    return f"sim:{values['scene']}" + (f"?{query}" if query else "")


def changed_values(values: Mapping[str, str], key: str, value: str) -> dict[str, str]:
    """Return the values after one was changed; others that do not go with it take their defaults.

    `SourceError` if the new value cannot be opened with any other values of this scene.
    """
    new = _DEFAULTS | {"scene": values["scene"], key: value}
    source_options(new)
    for other in _DEFAULTS:
        if other not in ("scene", key) and is_accepted(new | {other: values[other]}):
            new[other] = values[other]
    return new


def is_accepted(values: Mapping[str, str]) -> bool:
    """Return whether the values can be opened together."""
    try:
        source_options(values)
    except SourceError:
        return False
    return True
