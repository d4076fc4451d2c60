"""The colours and tooltips of the compared methods and of the truth.

The methods state theirs: Okabe and Ito's colours, with changes for the dark theme, which colour-blind people can tell
apart.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from PyQt6.QtGui import QColor

from ...core.methods.registry import method_kinds
from ...core.model.arrays import Uint8Array
from ...widgets.basics.colormaps import Theme, patch_lut

TRUTH: Final = "truth"

_TRUTH_RGB: dict[Theme, tuple[int, int, int]] = {"light": (20, 20, 20), "dark": (250, 250, 250)}

#: Pixels that a method and the truth share, that only the method has, and that only the truth has.
RIGHT_RGB: Final = (0, 158, 115)
FALSE_RGB: Final = (213, 94, 0)
MISSED_RGB: Final = (0, 114, 178)

#: Rows of `method_lut` after those of the context; the farthest shade is hidden.
CONTACT_ROW, FALSE_ROW, MISSED_ROW, HIDDEN_ROW = 255, 254, 253, 252

_TRUTH_TIP: Final = "The true contact: from the simulator's contact solver, or stored in the recording"


def method_tip(name: str) -> str:
    """Return the tooltip of a method, or of the truth."""
    kinds = method_kinds()
    return _TRUTH_TIP if name == TRUTH else kinds[name].tip if name in kinds else ""


def method_rgb(name: str, theme: Theme) -> tuple[int, int, int]:
    """Return the colour of a method, or of the truth."""
    if name == TRUTH:
        return _TRUTH_RGB[theme]
    kind = method_kinds()[name]
    return kind.dark_rgb or kind.rgb if theme == "dark" else kind.rgb


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
