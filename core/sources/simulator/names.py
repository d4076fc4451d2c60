"""The simulator's names as fields: ``cup?press=low&seed=3`` is read, checked and written here only."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, get_args
from urllib.parse import parse_qsl, urlencode

from ...errors import SourceError
from .objects import OBJECTS
from .scenes import MEMBRANES, Move, Press, Side, Variant, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS
from .sheet import Print


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


_PRESS_ABOUT = "A press that is held. Moving: the object approaches, presses and leaves; none: the untouched membrane"
_MOVE_ABOUT = "Slide: it turns and slides across folds for 5 s; the first opening takes a minute"
_MEMBRANE_ABOUT = "Size, material and air of the membrane; the guide's page Sources describes each"

NAME_FIELDS: Final = (
    NameField("scene", "Scene", "What presses the membrane; the tray rolls", dict.fromkeys(OBJECTS, "")),
    NameField("press", "Press", _PRESS_ABOUT, dict.fromkeys(get_args(Press), "")),
    NameField("move", "Move", _MOVE_ABOUT, dict.fromkeys(get_args(Move), "")),
    NameField("side", "Side", "Where a high press is, seen by the cameras", dict.fromkeys(get_args(Side), "")),
    NameField("gap", "Gap", "Distance at which the object is held", maximum=100.0, decimals=2, unit="mm"),
    NameField("membrane", "Membrane", _MEMBRANE_ABOUT, dict.fromkeys(MEMBRANES, "")),
    NameField("grid", "Print", "What is on the membrane; dots are 10 mm apart", dict.fromkeys(get_args(Print), "")),
    NameField("sensor", "Sensor", "Whose errors the cameras have", {name: s.about for name, s in SENSORS.items()}),
    NameField("seed", "Seed", "Another seed gives other noise with the same statistics", maximum=9_999_999_999),
    NameField("noise", "Noise", "Factor on the sensor's errors; 0 gives perfect images", {}, 100.0, 2, "×"),
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
        given = dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError as error:
        raise SourceError(f"sim:{rest}: {query!r} are no options; write them as seed=3&noise=0.5") from error
    for key in given:
        if key not in _DEFAULTS or key == "scene":
            options = ", ".join(option for option in _DEFAULTS if option != "scene")
            raise SourceError(f"sim:{rest}: the simulator has no option {key!r}; known are {options}")
    values = _DEFAULTS | given | {"scene": scene or _DEFAULTS["scene"]}
    source_options(values)
    return values


def source_options(values: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of a `SimulatorSource`; raises a `SourceError` if it cannot be opened with these values."""
    for part in NAME_FIELDS:
        value, name = values[part.key], write_name(values)
        if part.choices and value not in part.choices:
            known = ", ".join(filter(None, part.choices))
            raise SourceError(f"{name}: {part.key} is {value!r}; choose one of {known}")
        if not part.choices and not _is_number(value, part):
            kind = "number" if part.decimals else "whole number"
            raise SourceError(f"{name}: {part.key} is {value!r}; it must be a {kind} from 0 to {part.maximum:,.0f}")
    chosen: dict[str, Any] = {key: values[key] for key in ("press", "move", "side", "membrane", "grid")}
    variant = Variant(gap_mm=float(values["gap"]), **chosen)
    resolve_scene(values["scene"], variant)
    kept = {"scene": values["scene"], "variant": variant, "sensor": values["sensor"]}
    return {**kept, "seed": int(values["seed"]), "noise": float(values["noise"])}


def _is_number(text: str, part: NameField) -> bool:
    with suppress(ValueError):
        return 0.0 <= float(text) <= part.maximum and (part.decimals > 0 or text.isdecimal())
    return False


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
