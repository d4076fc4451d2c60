"""How each method looks: one colour in a theme, chosen so that colour-blind persons tell them apart."""

from __future__ import annotations

from functools import cache
from typing import Final

from PyQt6.QtGui import QColor

from ...core.model.arrays import Uint8Array
from ...widgets.basics.colormaps import Theme, patch_lut

TRUTH: Final = "truth"

#: Okabe and Ito's colours, with brown in place of a purple that is gray to some.
_RGB: dict[str, tuple[int, int, int]] = {
    "fusion-rigid": (213, 94, 0),
    "fusion-homography": (230, 159, 0),
    "fusion-membrane": (0, 158, 115),
    "fusion-averaged": (119, 68, 255),
    "proximity-only": (0, 114, 178),
    "tactile-only": (86, 180, 233),
    "tactile-threshold": (105, 60, 90),
    "mechanics": (110, 40, 0),
}
#: On a dark background brown is hardly seen, and on a light one yellow, for which plum stands.
_DARK_RGB: dict[str, tuple[int, int, int]] = _RGB | {"mechanics": (210, 180, 110), "tactile-threshold": (240, 228, 66)}
_UNKNOWN_RGB = (130, 80, 220)
_TRUTH_RGB: dict[Theme, tuple[int, int, int]] = {"light": (20, 20, 20), "dark": (250, 250, 250)}

#: Pixels that a method and the truth share, that only the method has, and that only the truth has.
RIGHT_RGB: Final = (0, 158, 115)
FALSE_RGB: Final = (213, 94, 0)
MISSED_RGB: Final = (0, 114, 178)

#: Rows of `method_lut` after those of the context; the farthest shade is hidden.
CONTACT_ROW, FALSE_ROW, MISSED_ROW, HIDDEN_ROW = 255, 254, 253, 252

TIPS: dict[str, str] = {
    TRUTH: "The contact as it really is: from the simulator's contact solver, or kept by the recording",
    "fusion-rigid": "Contact where both cameras measure the same distance, aligned by the tactile camera's pose",
    "fusion-homography": "Contact where both cameras measure the same distance, aligned by a homography as published",
    "fusion-membrane": "Both cameras: where the mean of their difference is small and the membrane is pressed",
    "fusion-averaged": "As fusion-membrane, on the mean of up to 15 frames while the membrane keeps still",
    "proximity-only": "Proximity camera: points that are nearer than the untouched membrane was",
    "tactile-only": "Tactile camera: the 60 % of the deformed membrane that moved most",
    "tactile-threshold": "Tactile camera: what moved by more than 5 mm",
    "mechanics": "Tactile camera: where something must press for an elastic membrane to look as it does",
}


def method_rgb(name: str, theme: Theme) -> tuple[int, int, int]:
    """Return the colour of a method, or of the truth."""
    known = _DARK_RGB if theme == "dark" else _RGB
    return _TRUTH_RGB[theme] if name == TRUTH else known.get(name, _UNKNOWN_RGB)


def method_color(name: str, theme: Theme) -> QColor:
    """Return the colour of a method, or of the truth."""
    return QColor(*method_rgb(name, theme))


@cache
def method_lut(name: str, theme: Theme) -> Uint8Array:
    """Return the colours of one method's patch over the relief of the scene: uint8 (256, 4)."""
    return _lut(theme, method_rgb(name, theme))


@cache
def agreement_lut(theme: Theme) -> Uint8Array:
    """Return the colours of a patch that is compared with the truth: uint8 (256, 4)."""
    return _lut(theme, RIGHT_RGB)


def agreement_legend() -> list[tuple[str, QColor]]:
    """Return what the colours of `agreement_lut` mean."""
    return [("right", QColor(*RIGHT_RGB)), ("false", QColor(*FALSE_RGB)), ("missed", QColor(*MISSED_RGB))]


def _lut(theme: Theme, contact: tuple[int, int, int]) -> Uint8Array:
    lut = patch_lut(theme).copy()
    for row, rgb in ((CONTACT_ROW, contact), (FALSE_ROW, FALSE_RGB), (MISSED_ROW, MISSED_RGB)):
        lut[row] = (*rgb, 255)
    lut[HIDDEN_ROW] = 0
    lut.flags.writeable = False
    return lut
