"""How controls are drawn: Qt's Fusion with the theme's palette, a style sheet, and a ring around the focus."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from string import Template
from typing import Any, Final, cast

import pyqtgraph as pg
from PyQt6 import sip
from PyQt6.QtCore import QEvent, QObject, QRectF, Qt
from PyQt6.QtGui import QColor, QPainter
from PyQt6.QtWidgets import (
    QApplication,
    QFocusFrame,
    QLabel,
    QProxyStyle,
    QStyle,
    QStyleHintReturn,
    QStyleOption,
    QWidget,
)

from .theme import GRID, THEME, ThemeChoice, ThemeName, make_palette, theme_colors

#: Margins and spacings of layouts.
_SPACINGS: Final = frozenset(metric for metric in QStyle.PixelMetric if metric.name.startswith("PM_Layout"))

#: Largest width of a tooltip: lines of about 60 characters.
_MAX_TIP_PX: Final = 400

_SHEET: Final = Path(__file__).with_name("style.qss")


class _Style(QProxyStyle):
    """Fusion with spacings on the grid, visible frames, wrapped tooltips, and sliders that jump to a press."""

    def __init__(self) -> None:
        super().__init__("Fusion")
        self._tips = _TipWrapper(self)

    def polish(self, target: Any) -> Any:
        if isinstance(target, QWidget) and target.inherits("QTipLabel"):
            target.setMaximumWidth(_MAX_TIP_PX)  # Qt places it by this width
            target.installEventFilter(self._tips)
        return super().polish(target)

    def drawPrimitive(
        self,
        element: QStyle.PrimitiveElement,
        option: QStyleOption | None,
        painter: QPainter | None,
        widget: QWidget | None = None,
    ) -> None:
        if element == QStyle.PrimitiveElement.PE_Frame and option is not None and painter is not None:
            painter.setPen(QColor(theme_colors().border))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(option.rect).adjusted(0.5, 0.5, -0.5, -0.5), 4.0, 4.0)
        else:
            super().drawPrimitive(element, option, painter, widget)

    def pixelMetric(
        self, metric: QStyle.PixelMetric, option: QStyleOption | None = None, widget: QWidget | None = None
    ) -> int:
        return 2 * GRID if metric in _SPACINGS else super().pixelMetric(metric, option, widget)

    def styleHint(
        self,
        hint: QStyle.StyleHint,
        option: QStyleOption | None = None,
        widget: QWidget | None = None,
        returnData: QStyleHintReturn | None = None,
    ) -> int:
        if hint == QStyle.StyleHint.SH_FocusFrame_AboveWidget:
            return 1
        if hint == QStyle.StyleHint.SH_DialogButtonBox_ButtonsHaveIcons:
            return 0  # they are not seen in the dark
        if hint == QStyle.StyleHint.SH_Slider_AbsoluteSetButtons:
            return cast(int, Qt.MouseButton.LeftButton.value)
        return super().styleHint(hint, option, widget, returnData)


class _TipWrapper(QObject):
    """Wraps the text of tooltips: Qt wraps only rich text, and shows the rest in one line of any length.

    Qt makes a new label for almost every tooltip, and the style sees each one before it is shown.
    """

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Give the label the height of its wrapped text, inside the screen."""
        if isinstance(watched, QLabel) and event is not None and event.type() in {QEvent.Type.Show, QEvent.Type.Resize}:
            # The help of the views is rich text; elsewhere a file name may look like markup.
            rich = watched.text().startswith("<p>")
            watched.setTextFormat(Qt.TextFormat.RichText if rich else Qt.TextFormat.PlainText)
            watched.setWordWrap(True)
            height = watched.heightForWidth(watched.width())
            if height != watched.height():
                watched.resize(watched.width(), height)
                screen = watched.screen()
                below = 0 if screen is None else watched.geometry().bottom() - screen.geometry().bottom()
                if below > 0:
                    watched.move(watched.x(), watched.y() - below)
        return False


class _FocusRing(QObject):
    """Draws a frame of 2 px around the widget with the focus, once it came there by a key: who clicks knows where."""

    def __init__(self, application: QApplication) -> None:
        super().__init__(application)
        self._frame: QFocusFrame | None = None
        application.focusChanged.connect(self._follow)

    def _follow(self, _: QWidget | None, now: QWidget | None) -> None:
        if self._frame is not None and not sip.isdeleted(self._frame):
            self._frame.hide()
            self._frame.deleteLater()
        self._frame = None
        window = None if now is None else now.window()
        if window is None or not window.testAttribute(Qt.WidgetAttribute.WA_KeyboardFocusChange):
            return
        self._frame = QFocusFrame(window)  # it dies with the window
        palette = self._frame.palette()
        palette.setColor(palette.ColorRole.WindowText, QColor(theme_colors().focus))
        self._frame.setPalette(palette)
        self._frame.setWidget(now)


def use_style(app: QApplication) -> None:
    """Draw all controls in this style; before the first widget is made, so that none is styled twice."""
    if app.findChild(_FocusRing) is None:
        app.setStyle(_Style())
        _FocusRing(app)
        if (hints := app.styleHints()) is not None:
            hints.colorSchemeChanged.connect(lambda _: apply_theme(app, THEME.choice))


def apply_theme(app: QApplication, choice: ThemeChoice) -> None:
    """Apply a theme to the whole application; "system" follows the desktop."""
    hints = app.styleHints()
    desktop: ThemeName = "dark" if hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark else "light"
    THEME.choice, THEME.name = choice, desktop if choice == "system" else choice
    colors = theme_colors()
    pg.setConfigOptions(background=colors.base, foreground=colors.text)
    icons = (Path(__file__).parents[1] / "icons").as_posix()
    sheet = Template(_SHEET.read_text("utf-8")).substitute(asdict(colors), icons=icons)
    if sheet != app.styleSheet():  # setting it lays out every widget again
        use_style(app)
        app.setPalette(make_palette(colors))
        app.setStyleSheet(sheet)
        THEME.changed.emit()
