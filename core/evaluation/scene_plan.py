"""Which simulated scenes the table compares methods on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from ..errors import TactuneError
from ..sources.simulator.scenes import HELD_OUT

Group = Literal["main", "extra", "hover"]

PRESSES: Final = ("low", "medium", "high")
OBJECTS: Final = ("octopus", "cup", "cube")
#: How far the object of the false-positive test stays away from the membrane.
GAPS_MM: Final = (1, 2, 3, 5, 10, 20)
#: Held-out seeds begin here, so that no seed of development is among them.
FIRST_HELD_OUT_SEED: Final = 100


@dataclass(frozen=True)
class PlannedScene:
    """One scene of the table.

    Attributes
    ----------
    name : str
        The simulator's scene.
    object : str
        What is pressed in.
    press : str
        ``low``, ``medium``, ``high``; a gap in millimetres for ``hover``.
    side : str
        ``left`` or ``right`` for high presses, which are off the middle; else empty.
    group : {"main", "extra", "hover"}
        Whether it is one of the paper's cells, a scene beyond them, or one without contact.
    """

    name: str
    object: str
    press: str
    side: str = ""
    group: Group = "main"

    @property
    def row(self) -> str:
        """What the table calls it, the press apart: the object, or the special scene."""
        return self.object if self.name == self.object else self.name

    @property
    def source(self) -> str:
        """The source's name without a seed, as `open_source` takes it."""
        options = [f"gap={self.press}" if self.group == "hover" else f"press={self.press}"]
        options += [f"side={self.side}"] * bool(self.side) + [f"object={self.object}"] * (self.name != self.object)
        return f"sim:{self.name}?{'&'.join(options)}"


def plan_scenes(
    objects: Sequence[str] = OBJECTS, presses: Sequence[str] = PRESSES, *, extra: bool = True, held_out: bool = False
) -> list[PlannedScene]:
    """List the scenes of a table.

    Parameters
    ----------
    objects, presses : sequence of str
        The paper's are the default.
    extra : bool
        Also a membrane of varied stiffness, a wrinkled one, two objects at once, and objects that hover.
    held_out : bool
        The objects are held out of development: they may be planned, and no other.

    Raises
    ------
    TactuneError
        An object or press that there is not, or a held-out object where none is wanted.
    """
    known = HELD_OUT if held_out else (*OBJECTS, "two")
    for what, names, allowed in (("object", objects, known), ("press", presses, PRESSES)):
        for name in names:
            if name not in allowed:
                hint = "; it is kept for --held-out" if name in HELD_OUT else ""
                raise TactuneError(f"the table has no {what} {name!r}{hint}; choose of {', '.join(allowed)}")
    scenes = [scene for name in dict.fromkeys(objects) for press in dict.fromkeys(presses)
              for scene in _still(name, press)]  # fmt: skip
    if extra:
        pressed = objects[0] if held_out else "cup"
        scenes += [PlannedScene(name, pressed, "medium", group="extra") for name in ("stiff", "wrinkled")]
        if not held_out and "two" not in objects:
            scenes += [scene for press in ("medium", "high") for scene in _still("two", press, "extra")]
        scenes += [PlannedScene("hover", pressed, str(gap), group="hover") for gap in GAPS_MM]
    return scenes


def _still(name: str, press: str, group: Group = "main") -> list[PlannedScene]:
    sides = ("right", "left") if press == "high" else ("",)
    return [PlannedScene(name, name, press, side, group) for side in sides]
