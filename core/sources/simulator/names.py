"""The simulator's names: ``cup?press=low&seed=3`` is read, checked and written here only."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any, Final, get_args
from urllib.parse import parse_qsl, urlencode

from ...errors import SourceError
from .objects import OBJECTS
from .scenes import MEMBRANES, Move, Press, Side, Variant, resolve_scene
from .sensors import DEFAULT_SENSOR, SENSORS
from .sheet import Print

#: What each part of a name may be: one of a few words, or a number up to a largest one.
_CHOICES: Final[dict[str, Collection[str]]] = {
    "scene": OBJECTS, "press": get_args(Press), "move": get_args(Move), "side": get_args(Side),
    "membrane": MEMBRANES, "grid": get_args(Print), "sensor": SENSORS,
    "cameras": ("two", "tactile"),
}  # fmt: skip
_LARGEST: Final = {"gap": 100.0, "seed": 9_999_999_999, "noise": 100.0}


def name_values(
    scene: str, variant: Variant, sensor: str, seed: int, noise: float, cameras: str = "two"
) -> dict[str, str]:
    """Return the value of each field as text."""
    return {
        "scene": scene, "press": variant.press, "move": variant.move, "side": variant.side,
        "gap": f"{variant.gap_mm:g}", "membrane": variant.membrane, "grid": variant.grid,
        "sensor": sensor, "seed": str(seed), "noise": f"{noise:g}", "cameras": cameras,
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
    name = write_name(values)
    for key, choices in _CHOICES.items():
        if values[key] not in choices:
            known = ", ".join(filter(None, choices))
            raise SourceError(f"{name}: {key} is {values[key]!r}; choose one of {known}")
    for key, largest in _LARGEST.items():
        if not _is_number(values[key], largest, whole=key == "seed"):
            kind = "whole number" if key == "seed" else "number"
            raise SourceError(f"{name}: {key} is {values[key]!r}; it must be a {kind} from 0 to {largest:,.0f}")
    chosen: dict[str, Any] = {key: values[key] for key in ("press", "move", "side", "membrane", "grid")}
    variant = Variant(gap_mm=float(values["gap"]), **chosen)
    resolve_scene(values["scene"], variant)
    kept = {"scene": values["scene"], "variant": variant, "sensor": values["sensor"], "cameras": values["cameras"]}
    return {**kept, "seed": int(values["seed"]), "noise": float(values["noise"])}


def _is_number(text: str, largest: float, *, whole: bool) -> bool:
    with suppress(ValueError):
        return 0.0 <= float(text) <= largest and (not whole or text.isdecimal())
    return False


def write_name(values: Mapping[str, str]) -> str:
    """Return the name of a source; values that are the default are left out."""
    query = urlencode({key: values[key] for key in _DEFAULTS if key != "scene" and values[key] != _DEFAULTS[key]})
    return f"sim:{values['scene']}" + (f"?{query}" if query else "")
