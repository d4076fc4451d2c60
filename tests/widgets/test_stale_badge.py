"""The badge of a stale image, on both back ends of the cloud view and on images."""

from __future__ import annotations

import pytest
from PyQt6.QtGui import QImage
from PyQt6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from tactune.widgets.basics.stale_badge import BADGE_COLORS
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.basics.theme import ThemeName
from tactune.widgets.clouds.cloud_view import CloudView

TEXT = "Tactile camera D405 (serial 1) is not connected: plug it in. Shown is the last frame, 3 s old."


def shown(qtbot: QtBot, widget: QWidget) -> QWidget:
    widget.resize(420, 360)
    qtbot.addWidget(widget)
    with qtbot.waitExposed(widget):
        widget.show()
    return widget


def colors_of(image: QImage) -> set[str]:
    return {image.pixelColor(x, y).name() for y in range(image.height()) for x in range(0, image.width(), 2)}


@pytest.fixture(params=["light", "dark"])
def theme(request: pytest.FixtureRequest, qapp: QApplication) -> ThemeName:
    name: ThemeName = request.param
    apply_theme(qapp, name)
    return name


def test_a_cloud_view_shows_and_drops_the_mark(qtbot: QtBot, theme: ThemeName) -> None:
    view = CloudView("Tactile")
    shown(qtbot, view)
    plate, _, ink = BADGE_COLORS[theme]
    view.set_badge(TEXT)
    assert view.badge() == view.accessibleDescription() == TEXT
    assert {plate, ink} <= colors_of(view.grab().toImage())
    view.set_badge("")
    assert plate not in colors_of(view.grab().toImage())
