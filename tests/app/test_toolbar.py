"""What the toolbar does with actions that find no room."""

from __future__ import annotations

import pytest
from PyQt6.QtWidgets import QToolButton

from tactune.widgets.basics.theme import contrast_ratio, theme_colors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_arrow_to_actions_without_room_is_seen_and_named(make_window, qtbot, theme):
    window = make_window(size=(1000, 700))
    window.toolbar.show_source("folder:/home/somebody/recordings/cup")
    window.toolbar.show_preset("a preset with a long name", None)
    window.set_theme(theme, remember=False)
    arrow = window.toolbar.findChild(QToolButton, "qt_toolbar_ext_button")
    qtbot.waitUntil(arrow.isVisible)
    for expanded in (False, True):
        arrow.setChecked(expanded)
        image = window.toolbar.grab(arrow.geometry()).toImage()
        middle = {image.pixelColor(x, image.height() // 2).name() for x in range(3, image.width() - 3)}
        contrasts = [contrast_ratio(pixel, theme_colors().window) for pixel in middle]
        assert max(contrasts) > 4.5 and min(contrasts) < 2
    assert arrow.toolTip() == arrow.accessibleName() == "More actions"
