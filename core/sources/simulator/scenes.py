"""The simulator's scenes by name: object, membrane, path of the object, and print; and names of sources.

A scene is a way that an object takes, step by step, and the steps at which pictures are taken.
Everything that a picture depends on is in `Scene`; noise comes live on top.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, get_args
from urllib.parse import parse_qsl, urlencode

import numpy as np

from ...errors import SourceError, foreign
from .membrane import MembraneDesign
from .objects import CUP, OBJECTS, PressedObject
from .render import Print
from .sensors import DEFAULT_SENSOR, SENSORS

Press = Literal["", "none", "low", "medium", "high"]
Side = Literal["right", "left"]
Move = Literal["", "slide"]

STANDARD: Final = "standard"
#: Membranes by name; the one held out is reserved for judging methods.
MEMBRANES: Final[dict[str, MembraneDesign]] = {
    STANDARD: MembraneDesign(),
    "soft": MembraneDesign(apex_m=0.050, stiffness_n_m=150.0, stiffening=0.05, prestretch=1.03),
    "taut": MembraneDesign(apex_m=0.052, stiffness_n_m=300.0, stiffening=0.12, prestretch=1.12),
    "tall": MembraneDesign(apex_m=0.080),
    "uneven": MembraneDesign(stiffness_slope=0.6, centre_stiffness=0.75),
    "sticky": MembraneDesign(sticks=True),
    "held-membrane": MembraneDesign(
        apex_m=0.067, dead_volume_m3=0.0060, stiffness_n_m=260.0, stiffening=0.08, prestretch=1.08,
        stiffness_slope=-0.4, centre_stiffness=1.35,
    ),
}  # fmt: skip

#: Gaps before and depths after first touch, metres; one frame each, so the approach is 150 mm/s and the
#: press 45 mm/s at 30 frames/s.
_APPROACH_M: Final = tuple(0.005 * n for n in range(6, 0, -1))
_PRESS_STEP_M: Final = 0.0015
_PRESS_STEPS: Final = 34
_HOLD_FRAMES: Final = 10

#: Frames of a scene in which nothing moves, and the step towards its pose, metres.
_STILL_FRAMES: Final = 30
_WAY_STEP_M: Final = 0.003
_PRESS_DEPTH_M: Final = {"low": 0.004, "medium": 0.024}
#: Deep presses away from the centre, so that the free part bulges: where (x, y) and how deep, metres.
_HIGH: Final = {
    "cube": ((0.060, 0.020), 0.105),
    "cup": ((0.060, 0.020), 0.105),
    "octopus": ((0.060, 0.020), 0.105),
    "tray": ((0.050, 0.005), 0.040),
    "mug": ((0.060, 0.010), 0.095),
    "hand": ((0.065, -0.005), 0.080),
}
#: Gap of an object that is far away, metres.
_AWAY_M: Final = 0.060
#: How deep the tray's roll axis is, metres, and the rolls at which its scene is solved, degrees.
_TRAY_DEPTH_M: Final = 0.016
TRAY_ROLLS_DEG: Final = tuple(0.5 * n for n in range(-16, 17))
#: A move presses this deep. From its start to its end: shift along x and turn about z; sway in between along y, and
#: about x and y. It passes through its states there and back, in 5 s.
_MOVE_DEPTH_M: Final = 0.030
_MOVE_ACROSS_M: Final = 0.040
_MOVE_TURN_DEG: Final = 44.0
_MOVE_SWAY_M: Final = 0.012
_MOVE_SWAY_DEG: Final = 4.0
_MOVE_STATES: Final = 75
#: The cup's handle, about which it turns, in its own x and y; other objects turn about their origin.
_HANDLE_M: Final = (0.043, 0.0)
#: Cells of the mesh of a still press, which is ground truth, and of a press that resolves the folds.
_FINE_CELLS: Final = (236, 136)
_MOVE_CELLS: Final = (176, 102)
#: Height of the folds across which an object moves, metres.
_FOLD_M: Final = 0.0012


@dataclass(frozen=True)
class Variant:
    """Options of a scene; without any the object approaches, presses and leaves.

    ``press`` holds a press, "none" shows the untouched membrane. A high press is on the ``side`` of the centre that is
    nearer to the tactile ("right") or to the proximity camera, there turned by 180 degrees. ``gap_mm`` above 0 holds
    the object off the membrane. ``move`` turns and moves it across a folded membrane. ``membrane`` is one of
    `MEMBRANES`, ``grid`` its print.
    """

    press: Press = ""
    side: Side = "right"
    gap_mm: float = 0.0
    grid: Print = "droplets"
    membrane: str = STANDARD
    move: Move = ""


class Step(NamedTuple):
    """Where the object is: shift from its offset, depth past first touch, turns about x, y and z in that order."""

    x_m: float
    y_m: float
    depth_m: float
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Scene:
    """One scene with all its parameters; ``name`` holds scene and variant, usable as a file name."""

    name: str
    pressed: PressedObject
    design: MembraneDesign
    print: Print
    #: Where the object goes, the steps of it that are drawn, and for each frame the index into ``drawn``.
    way: tuple[Step, ...]
    drawn: tuple[int, ...]
    frames: tuple[int, ...]

    @property
    def key(self) -> str:
        """Text with everything that the images depend on, apart from the rig."""
        return f"{self.pressed} {self.design} {self.print} {self.way} {self.drawn}"


def resolve_scene(name: str, variant: Variant | None = None, cells: tuple[int, int] | None = None) -> Scene:
    """Return a scene by its name; raises a `SourceError` if it does not have these options."""
    variant = variant or Variant()
    _check(name, variant)
    press, pressed, design = variant.press, OBJECTS[name], MEMBRANES[variant.membrane]
    if press == "none":
        way = _still(-_AWAY_M)
    elif press:
        pressed, depth = _still_press(name, press, variant.side)
        way = _still(depth)
    elif variant.gap_mm:
        way = _still(-variant.gap_mm / 1e3)
    elif variant.move:
        about_x, about_y, heading = pressed.rotation_deg
        pressed = replace(pressed, rotation_deg=(about_x, about_y, 0.0))
        centre_m = _HANDLE_M if pressed.kind == CUP else (0.0, 0.0)
        places = [_place(n / (_MOVE_STATES - 1), heading, centre_m) for n in range(_MOVE_STATES)]
        way = _there_and_back(_MOVE_DEPTH_M, places)
    elif name == "tray":
        way = _there_and_back(
            _TRAY_DEPTH_M, [Step(0.0, 0.0, _TRAY_DEPTH_M, (roll, 0.0, 0.0)) for roll in TRAY_ROLLS_DEG]
        )
    else:
        way = _approach()
    usual = _FINE_CELLS if press not in ("", "none") else _MOVE_CELLS if variant.move else design.cells
    design = replace(design, fold_m=_FOLD_M if variant.move else 0.0, cells=cells or usual)
    words = (
        name,
        variant.membrane if variant.membrane != STANDARD else "",
        variant.move,
        press,
        variant.side if press == "high" else "",
        f"{variant.gap_mm:g}mm" if variant.gap_mm else "",
        "dots" if variant.grid == "dots" else "",
        "{}x{}".format(*design.cells),
    )
    title = "-".join(word for word in words if word)
    return Scene(title, pressed, design, variant.grid, *way)


def _still_press(shape: str, press: Press, side: Side) -> tuple[PressedObject, float]:
    """Return the object of a still press at its place, and its depth past first touch."""
    pressed = OBJECTS[shape]
    if press != "high":
        return pressed, _PRESS_DEPTH_M[press]
    (x, y), depth = _HIGH[shape]
    if side == "right":
        return replace(pressed, offset_m=(x, y)), depth
    about_x, about_y, about_z = pressed.rotation_deg
    return replace(pressed, offset_m=(-x, -y), rotation_deg=(about_x, about_y, about_z + 180.0)), depth


def _check(name: str, variant: Variant) -> None:
    pressed = variant.press not in ("", "none")
    misfits = {
        "press, gap and move exclude each other": sum((pressed, variant.gap_mm > 0, variant.move != "")) > 1,
        "side is for press=high": variant.side != Variant.side and variant.press != "high",
        "the tray rolls, it has no move": bool(variant.move) and name == "tray",
        f"on the membrane {variant.membrane} nothing slides": bool(variant.move) and MEMBRANES[variant.membrane].sticks,
    }
    for sentence, applies in misfits.items():
        if applies:
            raise SourceError(f"sim:{name}: {sentence}; leave out what does not fit")


Way = tuple[tuple[Step, ...], tuple[int, ...], tuple[int, ...]]


def _approach() -> Way:
    """Approach, press, hold, leave; pressing and leaving pass through the same states."""
    depths = [-gap for gap in _APPROACH_M] + [_PRESS_STEP_M * (n + 1) for n in range(_PRESS_STEPS)]
    inward = list(range(len(depths)))
    frames = inward + [inward[-1]] * _HOLD_FRAMES + inward[::-1]
    return tuple(Step(0.0, 0.0, depth) for depth in depths), tuple(inward), tuple(frames)


def _still(depth_m: float) -> Way:
    """Press to a depth, or stay at a gap, and hold."""
    steps = max(int(np.ceil(depth_m / _WAY_STEP_M)), 1)
    way = tuple(Step(0.0, 0.0, depth_m * (n + 1) / steps) for n in range(steps))
    return way, (len(way) - 1,), (0,) * _STILL_FRAMES


def _there_and_back(depth_m: float, places: list[Step]) -> Way:
    """Press at the first place to a depth, then pass through all of them and back."""
    inward = _still(depth_m)[0]
    way = [places[0]._replace(depth_m=step.depth_m) for step in inward[:-1]] + places
    there = list(range(len(places)))
    return tuple(way), tuple(range(len(inward) - 1, len(way))), tuple(there + there[::-1])


def _place(time: float, heading_deg: float, centre_m: tuple[float, float]) -> Step:
    """Return the place of a moving object at a share of the time there; it starts and ends at rest."""
    share = (1.0 - math.cos(math.pi * time)) / 2
    sway = math.sin(2 * math.pi * share)
    turn = _MOVE_TURN_DEG * (share - 0.5)
    before, now = (complex(*centre_m) * cmath.rect(1.0, math.radians(heading_deg + more)) for more in (0.0, turn))
    shift = complex(_MOVE_ACROSS_M * (share - 0.5), _MOVE_SWAY_M * sway) + before - now
    turns = _MOVE_SWAY_DEG * sway, _MOVE_SWAY_DEG * sway, heading_deg + turn
    return Step(shift.real, shift.imag, _MOVE_DEPTH_M, turns)


# Names of sources, such as ``cup?press=low&seed=3``: read, checked and written here only

#: What each part of a name may be: one of a few words, or a number up to a largest one.
_CHOICES: Final[dict[str, Collection[str]]] = {
    "scene": OBJECTS, "press": get_args(Press), "move": get_args(Move), "side": get_args(Side),
    "membrane": MEMBRANES, "grid": get_args(Print), "sensor": SENSORS,
    "cameras": ("two", "tactile"),
}  # fmt: skip
_LARGEST: Final = {"gap": 100.0, "seed": 9_999_999_999, "noise": 100.0}


_DEFAULTS: Final[dict[str, Any]] = {
    "press": "", "move": "", "side": "right", "gap": 0.0, "membrane": STANDARD, "grid": "droplets",
    "sensor": DEFAULT_SENSOR, "seed": 0, "noise": 1.0, "cameras": "two",
}  # fmt: skip


def write_name(scene: str, variant: Variant, sensor: str, seed: int, noise: float, cameras: str) -> str:
    """Return the name of a source; values that are the default are left out."""
    others = {"gap": variant.gap_mm, "sensor": sensor, "seed": seed, "noise": noise, "cameras": cameras}
    changed = {key: value for key, value in (vars(variant) | others).items() if value != _DEFAULTS.get(key, value)}
    texts = {key: f"{value:g}" if isinstance(value, float) else value for key, value in changed.items()}
    return f"sim:{scene}" + (f"?{urlencode(texts)}" if texts else "")


def read_name(rest: str) -> dict[str, Any]:
    """Return the arguments of a `SimulatorSource` by its name without ``sim:``; `SourceError` if it has none."""
    name, (scene, _, query) = foreign(f"sim:{rest}", 80), rest.partition("?")
    try:
        options = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise SourceError(f"{name}: {foreign(query, 80)!r} are no options; write them as seed=3&noise=0.5") from error
    if len(given := dict(options)) < len(options):
        raise SourceError(f"{name}: an option is named twice; name each once, as in seed=3&noise=0.5")
    for key in given:
        if key not in _DEFAULTS:
            known = ", ".join(_DEFAULTS)
            raise SourceError(f"{name}: the simulator has no option {foreign(key, 80)!r}; known are {known}")
    values: dict[str, Any] = _DEFAULTS | given | {"scene": scene or "cup"}
    for key, choices in _CHOICES.items():
        if values[key] not in choices or given.get(key) == "":
            known = ", ".join(filter(None, choices))
            raise SourceError(f"{name}: {key} is {foreign(values[key], 80)!r}; choose one of {known}")
    for key, largest in _LARGEST.items():
        kind, text = type(_DEFAULTS[key]), values[key]
        try:
            values[key] = kind(text)
        except ValueError:
            values[key] = math.nan
        if not 0 <= values[key] <= largest:
            number = "whole number" if kind is int else "number"
            raise SourceError(f"{name}: {key} is {foreign(text, 80)!r}; it must be a {number} from 0 to {largest:,.0f}")
    variant = Variant(gap_mm=values.pop("gap"), **{key: values.pop(key) for key in vars(Variant()) if key in values})
    resolve_scene(values["scene"], variant)
    return values | {"variant": variant}
