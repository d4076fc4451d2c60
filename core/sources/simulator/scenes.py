"""The simulator's scenes by name: object, membrane, path of the object, and print.

A scene is a way that an object takes, step by step, and the steps at which pictures are taken.
Everything that a picture depends on is in `Scene`; light and noise come live on top.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np

from ...errors import SourceError
from ...model.arrays import Uint8Array
from .membranes import MEMBRANES, STANDARD
from .mesh import MembraneDesign
from .objects import CUP, OBJECTS, PressedObject
from .sheet import Print

Press = Literal["", "none", "low", "medium", "high"]
Side = Literal["right", "left"]
Move = Literal["", "slide", "lift"]
Light = Literal["normal", "bright", "dim"]

#: Scenes that are named after their object, and scenes that take any object.
OBJECT_SCENES: Final = tuple(OBJECTS)
SPECIAL_SCENES: Final = {"hover": "the object stays gap=1...20 mm away from the membrane"}
SCENES: Final = (*OBJECT_SCENES, *SPECIAL_SCENES)
HELD_OUT: Final = tuple(name for name, pressed in OBJECTS.items() if pressed.held_out)

#: Gaps before and depths after first touch, metres; one frame each, so the approach is 150 mm/s and the
#: press 45 mm/s at 30 frames/s.
HOVER_M: Final = tuple(0.005 * n for n in range(6, 0, -1))
PRESS_STEP_M: Final = 0.0015
PRESS_STEPS: Final = 34
HOLD_FRAMES: Final = 10

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
#: Largest gap of an object that hovers, millimetres.
MAX_GAP_MM: Final = 100.0
#: Gap of an object that is far from the membrane, metres.
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
#: Turn of a lifted cup about its own axis at the end, and the power of the path's share that makes its handle leave the
#: membrane, at 20 degrees, half way. From 85 degrees the handle is hidden behind the cup.
_LIFT_DEG: Final = 100.0
_LIFT_POWER: Final = 2.3
#: The cup's handle, about which it turns, in its own x and y; other objects turn about their origin.
_HANDLE_M: Final = (0.043, 0.0)
#: Cells of the mesh of a still press, which is ground truth, and of a press that resolves the folds.
_FINE_CELLS: Final = (236, 136)
_MOVE_CELLS: Final = (176, 102)
#: Height of the folds across which an object moves, metres.
_FOLD_M: Final = 0.0012


@dataclass(frozen=True)
class Variant:
    """Options of a scene.

    ``press`` holds a press instead of the scene's own motion, "none" shows the untouched membrane. A high press is on
    the ``side`` of the centre that is nearer to the tactile ("right") or to the proximity camera, there turned by 180
    degrees. ``object`` hovers at ``gap_mm``. ``move`` turns and moves an object across a folded membrane; "lift" takes
    the cup's handle off it for half of the time. ``membrane`` is one of `membranes.MEMBRANES`, ``grid`` its print.
    """

    press: Press = ""
    side: Side = "right"
    object: str = "cup"
    gap_mm: float = 5.0
    grid: Print = "droplets"
    membrane: str = STANDARD
    move: Move = ""


class Step(NamedTuple):
    """Where the object is at one solved step of its path.

    Shift from its offset and depth of its origin past first touch, metres (gaps are negative); turns about its origin,
    about x, y and z of the membrane's frame in that order, degrees.
    """

    x_m: float
    y_m: float
    depth_m: float
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Scene:
    """One scene with all its parameters.

    ``name`` holds scene and variant, usable as a file name. ``way`` is where the object goes, one solved step after
    the other, ``drawn`` are the steps that are drawn, and ``frames`` the index into ``drawn`` for each frame; between
    two of them the images are interpolated. ``held_out``: object or membrane is reserved for judging methods.
    ``loaded``: ``drawn`` are the rolls of the tray, among which `tray.carried` chooses by its load.
    """

    name: str
    pressed: PressedObject
    design: MembraneDesign
    print: Print
    way: tuple[Step, ...]
    drawn: tuple[int, ...]
    frames: tuple[float, ...]
    held_out: bool
    loaded: bool = False

    @property
    def key(self) -> str:
        """Text with everything that the images depend on, apart from the rig."""
        return f"{self.pressed} {self.design} {self.print} {self.way} {self.drawn}"


def read_options(name: str, options: Mapping[str, str]) -> tuple[Variant, Light]:
    """Turn the options of a source's name into a variant and a light; `resolve_scene` checks them further."""
    try:
        gap_mm = float(options.get("gap", Variant.gap_mm))
    except ValueError as error:
        raise SourceError(f"{name}: gap is {options['gap']!r}, but it must be millimetres, such as gap=5") from error
    given: dict[str, Any] = {
        key: options[key] for key in ("press", "side", "object", "grid", "membrane", "move") if key in options
    }
    light: Any = options.get("light", "normal")
    return Variant(**given, gap_mm=gap_mm), light


def resolve_scene(name: str, variant: Variant | None = None, cells: tuple[int, int] | None = None) -> Scene:
    """Return a scene by its name."""
    variant = variant or Variant()
    _check(name, variant)
    shape = variant.object if name in SPECIAL_SCENES else name
    press = variant.press
    pressed = OBJECTS[shape]
    if press == "none":
        way = _still(-_AWAY_M)
    elif press:
        pressed, depth = still_press(shape, press, variant.side)
        way = _still(depth)
    elif variant.move:
        about_x, about_y, heading = pressed.rotation_deg
        pressed = replace(pressed, rotation_deg=(about_x, about_y, 0.0))
        way = _move(variant.move, heading, _HANDLE_M if pressed.kind == CUP else (0.0, 0.0))
    elif name == "hover":
        way = _still(-variant.gap_mm / 1e3)
    else:
        way = _roll() if name == "tray" else _approach()
    design = MEMBRANES[variant.membrane].design
    usual = _FINE_CELLS if press not in ("", "none") else _MOVE_CELLS if variant.move else design.cells
    design = replace(design, fold_m=_FOLD_M if variant.move else 0.0, cells=cells or usual)
    title = _title(name, variant, press, design)
    held_out = pressed.held_out or MEMBRANES[variant.membrane].held_out
    return Scene(title, pressed, design, variant.grid, *way, held_out, loaded=name == "tray" and not press)


def _title(name: str, variant: Variant, press: Press, design: MembraneDesign) -> str:
    """Return scene and variant as one word; what is as usual is left out."""
    words = (
        name,
        variant.object if name in SPECIAL_SCENES else "",
        variant.membrane if variant.membrane != STANDARD else "",
        variant.move,
        press,
        variant.side if press == "high" else "",
        f"{variant.gap_mm:g}mm" if name == "hover" else "",
        "dots" if variant.grid == "dots" else "",
        "{}x{}".format(*design.cells),
    )
    return "-".join(word for word in words if word)


def still_press(shape: str, press: Press, side: Side = "right") -> tuple[PressedObject, float]:
    """Return the object of a still press at its place, and its depth past first touch in metres."""
    pressed = OBJECTS[shape]
    if press != "high":
        return pressed, _PRESS_DEPTH_M[press]
    (x, y), depth = _HIGH[shape]
    if side == "right":
        return replace(pressed, offset_m=(x, y)), depth
    about_x, about_y, about_z = pressed.rotation_deg
    return replace(pressed, offset_m=(-x, -y), rotation_deg=(about_x, about_y, about_z + 180.0)), depth


def _check(name: str, variant: Variant) -> None:
    """Raise `SourceError` if the scene does not exist or does not have these options."""
    if name not in SCENES:
        raise SourceError(f"the simulator has no scene {name!r}; choose one of {', '.join(SCENES)}")
    choices: dict[str, tuple[str, ...]] = {
        "membrane": tuple(MEMBRANES),
        "object": tuple(OBJECTS),
        "press": get_args(Press),
        "move": get_args(Move),
        "side": get_args(Side),
        "grid": get_args(Print),
    }
    for option, known in choices.items():
        given = getattr(variant, option)
        if given not in known:
            raise SourceError(f"sim:{name}: {option} is {given!r}; choose one of {', '.join(filter(None, known))}")
    is_pressed, is_object = variant.press not in ("", "none"), name in OBJECTS
    misfits = {
        "object is for hover": variant.object != Variant.object and name != "hover",
        "gap is for hover": variant.gap_mm != Variant.gap_mm and name != "hover",
        "press is for scenes of an object": is_pressed and not is_object,
        "side is for press=high": variant.side != Variant.side and variant.press != "high",
        "move is for scenes of an object": bool(variant.move) and (not is_object or name == "tray"),
        "a press is held, a move is not": bool(variant.move) and is_pressed,
        "only the cup's handle can be lifted": variant.move == "lift" and name != "cup",
        f"on the membrane {variant.membrane} nothing slides": bool(variant.move)
        and MEMBRANES[variant.membrane].design.sticks,
    }
    for sentence, applies in misfits.items():
        if applies:
            raise SourceError(f"sim:{name}: {sentence}; leave out what does not fit")
    if not 0.0 < variant.gap_mm <= MAX_GAP_MM:
        raise SourceError(f"sim:{name}: gap is {variant.gap_mm:g}, but it must be more than 0 and at most 100 mm")


Way = tuple[tuple[Step, ...], tuple[int, ...], tuple[float, ...]]


def _approach() -> Way:
    """Approach, press, hold, leave; pressing and leaving pass through the same states."""
    depths = [-gap for gap in HOVER_M] + [PRESS_STEP_M * (n + 1) for n in range(PRESS_STEPS)]
    inward = list(range(len(depths)))
    frames = inward + [inward[-1]] * HOLD_FRAMES + inward[::-1]
    return tuple(Step(0.0, 0.0, depth) for depth in depths), tuple(inward), tuple(frames)


def _still(depth_m: float) -> Way:
    """Press to a depth, or stay at a gap, and hold."""
    steps = max(int(np.ceil(depth_m / _WAY_STEP_M)), 1)
    way = tuple(Step(0.0, 0.0, depth_m * (n + 1) / steps) for n in range(steps))
    return way, (len(way) - 1,), (0,) * _STILL_FRAMES


def _move(move: Move, heading_deg: float, centre_m: tuple[float, float]) -> Way:
    """Press, then turn about a point of the object while it moves across the membrane, and back the same way."""
    places = [_moved(n / (_MOVE_STATES - 1), move, heading_deg, centre_m) for n in range(_MOVE_STATES)]
    inward, _, _ = _still(_MOVE_DEPTH_M)
    way = [places[0]._replace(depth_m=step.depth_m) for step in inward[:-1]] + places
    there = list(range(_MOVE_STATES))
    return tuple(way), tuple(range(len(inward) - 1, len(way))), tuple(there + there[::-1])


def _moved(time: float, move: Move, heading_deg: float, centre_m: tuple[float, float]) -> Step:
    """Return the place of a moving object at a share of the time there; it starts and ends at rest."""
    share = (1.0 - math.cos(math.pi * time)) / 2
    sway = math.sin(2 * math.pi * share)
    lift_deg = _LIFT_DEG * share**_LIFT_POWER if move == "lift" else 0.0
    turn = _MOVE_TURN_DEG * (share - 0.5)
    before, now = (complex(*centre_m) * cmath.rect(1.0, math.radians(heading_deg + more)) for more in (0.0, turn))
    shift = complex(_MOVE_ACROSS_M * (share - 0.5), _MOVE_SWAY_M * sway) + before - now
    turns = _MOVE_SWAY_DEG * sway, _MOVE_SWAY_DEG * sway - lift_deg, heading_deg + turn
    return Step(shift.real, shift.imag, _MOVE_DEPTH_M, turns)


def _roll() -> Way:
    """Press the tray into the membrane and turn it about x through `TRAY_ROLLS_DEG`."""
    inward, _, _ = _still(_TRAY_DEPTH_M)
    way = [step._replace(turn_deg=(TRAY_ROLLS_DEG[0], 0.0, 0.0)) for step in inward[:-1]]
    way += [Step(0.0, 0.0, _TRAY_DEPTH_M, (roll, 0.0, 0.0)) for roll in TRAY_ROLLS_DEG]
    drawn = tuple(range(len(inward) - 1, len(way)))
    return tuple(way), drawn, tuple(float(n) for n in range(len(drawn)))


def light_table(light: Light) -> Uint8Array | None:
    """Return the lookup table of a change of light for 8-bit colours, shape (256, 3), or None.

    Bright daylight adds exposure and blue and saturates; dim lamps are redder.
    """
    gains: dict[Any, tuple[float, float, float]] = {"bright": (1.75, 1.85, 2.05), "dim": (0.34, 0.30, 0.26)}
    if light not in gains:
        return None
    linear = np.linspace(0.0, 1.0, 256)[:, None] ** 2.2 * gains[light]
    return np.round(255.0 * np.minimum(linear, 1.0) ** (1 / 2.2)).astype(np.uint8)
