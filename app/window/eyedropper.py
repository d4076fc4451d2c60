"""The eyedropper: a click in the colour image sets the mask's colour ranges."""

from __future__ import annotations

from typing import cast

import numpy as np
from PyQt6.QtCore import QObject

from ...core.model.clouds import valid_depth
from ...widgets.basics.gestures import new_gesture
from ...widgets.basics.messages import Severity
from ...widgets.images.eyedropper import EyedropperError, HsvRanges, Mode, pick
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import SOURCE, Context
from ..worker.rendering import aligned_color


class Eyedropper(QObject):
    """Turns a click in the colour image into one undoable change of the mask.

    The eyedropper stays active until it is switched off, so that several clicks can refine a mask.
    """

    def __init__(self, context: Context, panel: ParameterPanel, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._document, self._messages = context, context.document, context.messages
        self._panel = panel
        self._strip = strip
        self._mode = "off"
        panel.eyedropperRequested.connect(self.use)
        strip.clicked.connect(self._clicked)

    @property
    def mode(self) -> str:
        """The active mode: "set", "expand", "shrink" or "off"."""
        return self._mode

    def use(self, mode: str) -> None:
        """Switch to a mode; "off" switches the eyedropper off."""
        self._mode = mode
        self._panel.set_eyedropper(mode)
        self._strip.set_picking(mode != "off")
        self._messages.clear("eyedropper")

    def _clicked(self, pane: str, u: int, v: int, _modifiers: object) -> None:
        result, mask = self._context.result, self._document.preset.mask
        if self._mode == "off" or pane != "color" or result is None:
            return
        counts = result.frame.proximity_depth
        depth_m = counts * np.float32(result.source.rig.proximity.depth_unit_m)
        typical_m = sum(result.rendered.depth_range_m) / 2
        image = aligned_color(result.frame, result.source.rig, depth_m, valid_depth(counts), typical_m)
        present = HsvRanges(mask.hue, mask.saturation, mask.value)
        try:
            ranges = pick(image, u, v, present, cast(Mode, self._mode))
        except EyedropperError as error:
            self._messages.show_message("eyedropper", Severity.WARNING, str(error), subject=SOURCE)
            return
        self._messages.clear("eyedropper")
        picked: dict[str, object] = {
            "mask.hue": ranges.hue,
            "mask.saturation": ranges.saturation,
            "mask.value": ranges.value,
        }
        if not mask.enabled:
            picked = {"mask.enabled": True, **picked}
        self._document.edit_many(picked, new_gesture(), title="" if mask.enabled else "Pick the mask's colour")
