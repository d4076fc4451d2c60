"""More scenes for development: rotated shapes, so that edges, corners and backs touch the membrane.

Import this module before any module that uses the simulator's scenes. Rotated shapes have the presses low and medium.
"""

from __future__ import annotations

from tactune.core.sources.simulator.objects import BALL, CUBE, CUP, KNOBS, OBJECTS, OCTOPUS, PAIR, STAR, PressedObject

_COLOUR = (0.9, 0.5, 0.2)

TURNED = {
    "ball": PressedObject(BALL, (0, 0, 0), (0.010, -0.008), _COLOUR),
    "cube on an edge": PressedObject(CUBE, (45, 0, 20), (-0.010, 0.006), _COLOUR),
    "cube tilted": PressedObject(CUBE, (10, 6, 50), (0.012, 0.0), _COLOUR),
    "cup on its side": PressedObject(CUP, (0, 120, 35), (0.0, -0.004), _COLOUR),
    "cup on its end": PressedObject(CUP, (83, 4, 15), (0.008, 0.006), _COLOUR),
    "octopus by its head": PressedObject(OCTOPUS, (176, 5, 20), (-0.006, 0.002), _COLOUR),
    "octopus tilted": PressedObject(OCTOPUS, (14, -9, 40), (0.004, 0.0), _COLOUR),
    "star by its back": PressedObject(STAR, (178, 3, 5), (0.0, 0.006), _COLOUR),
    "star tilted": PressedObject(STAR, (9, -8, 50), (0.006, -0.004), _COLOUR),
    "knobs by their plate": PressedObject(KNOBS, (176, -3, 10), (0.006, 0.0), _COLOUR),
    "knobs tilted": PressedObject(KNOBS, (8, 7, 40), (-0.004, -0.006), _COLOUR),
    "two tilted": PressedObject(PAIR, (5, 6, 70), (0.0, 0.0), _COLOUR),
}
OBJECTS.update(TURNED)
