"""How controls are drawn: Qt's Fusion with flat buttons and fields, visible outlines, and a ring around the focus."""

from __future__ import annotations

from typing import Any, Final, TypeVar, cast

import pyqtgraph as pg
from PyQt6 import sip
from PyQt6.QtCore import QObject, QPointF, QRect, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QPainter, QPalette, QPen, QPolygonF
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QFocusFrame,
    QProgressBar,
    QProxyStyle,
    QPushButton,
    QStyle,
    QStyleHintReturn,
    QStyleOption,
    QStyleOptionComplex,
    QStyleOptionSlider,
    QStyleOptionSpinBox,
    QToolButton,
    QWidget,
)

from .theme import GRID, ThemeChoice, ThemeName, make_palette, set_theme, theme_colors
from .tooltips import TipWrapper, is_tip

_Primitive = QStyle.PrimitiveElement
_Control = QStyle.ControlElement
_Complex = QStyle.ComplexControl
_Part = QStyle.SubControl
_Metric = QStyle.PixelMetric
_State = QStyle.StateFlag
_Step = QAbstractSpinBox.StepEnabledFlag
_DISABLED: Final = QPalette.ColorGroup.Disabled
_Option = TypeVar("_Option", bound=QStyleOption)
_RADIUS: Final = 4.0
_GROOVE: Final = 4.0

_METRICS: Final = {
    _Metric.PM_LayoutLeftMargin: 2 * GRID,
    _Metric.PM_LayoutTopMargin: 2 * GRID,
    _Metric.PM_LayoutRightMargin: 2 * GRID,
    _Metric.PM_LayoutBottomMargin: 2 * GRID,
    _Metric.PM_LayoutHorizontalSpacing: 2 * GRID,
    _Metric.PM_LayoutVerticalSpacing: 2 * GRID,
    _Metric.PM_ScrollBarExtent: 3 * GRID,
    _Metric.PM_ToolBarItemSpacing: GRID,
    _Metric.PM_ToolBarIconSize: 4 * GRID,
}


def use_style(app: QApplication) -> None:
    """Draw all controls as `ControlStyle` does; before the first widget is made, so that none is styled twice."""
    if app.findChild(FocusRing) is None:
        app.setStyle(ControlStyle())
        FocusRing(app)


def apply_theme(app: QApplication, choice: ThemeChoice) -> ThemeName:
    """Apply a theme to the whole application and return the resolved one.

    Widgets that paint with `theme_colors` repaint on the ``PaletteChange`` event that follows.
    With ``"system"`` the theme follows the desktop, also when that changes later.
    """
    hints = app.styleHints()
    name: ThemeName = cast(ThemeName, choice)
    if choice == "system":
        name = "dark" if hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark else "light"
    app.setProperty("tactune_theme_choice", choice)
    if hints is not None and not app.property("tactune_follows_desktop"):
        app.setProperty("tactune_follows_desktop", True)
        hints.colorSchemeChanged.connect(lambda _: _follow_desktop(app))
    colors = set_theme(name)
    pg.setConfigOptions(background=colors.base, foreground=colors.text)
    use_style(app)
    app.setPalette(make_palette(colors))
    return name


def _follow_desktop(app: QApplication) -> None:
    if app.property("tactune_theme_choice") == "system":
        apply_theme(app, "system")


class ControlStyle(QProxyStyle):
    """Fusion, with the controls that a newcomer meets first drawn in the theme's own colours."""

    def __init__(self) -> None:
        super().__init__("Fusion")
        self._tips = TipWrapper(self)

    def polish(self, target: Any) -> Any:
        """Let tooltips wrap."""
        if isinstance(target, QWidget) and is_tip(target):
            self._tips.watch(target)
        return super().polish(target)

    def pixelMetric(
        self, metric: QStyle.PixelMetric, option: QStyleOption | None = None, widget: QWidget | None = None
    ) -> int:
        """Return spacings on the grid."""
        return _METRICS.get(metric) or super().pixelMetric(metric, option, widget)

    def styleHint(
        self,
        hint: QStyle.StyleHint,
        option: QStyleOption | None = None,
        widget: QWidget | None = None,
        returnData: QStyleHintReturn | None = None,
    ) -> int:
        """Let the focus ring lie over its neighbours; leave out the icons of dialog buttons, unseen in the dark."""
        if hint == QStyle.StyleHint.SH_FocusFrame_AboveWidget:
            return 1
        if hint == QStyle.StyleHint.SH_DialogButtonBox_ButtonsHaveIcons:
            return 0
        if hint == QStyle.StyleHint.SH_Slider_AbsoluteSetButtons:
            return cast(int, Qt.MouseButton.LeftButton.value)  # the handle jumps to a press
        return super().styleHint(hint, option, widget, returnData)

    def drawPrimitive(
        self,
        element: QStyle.PrimitiveElement,
        option: QStyleOption | None,
        painter: QPainter | None,
        widget: QWidget | None = None,
    ) -> None:
        """Draw the panel of a button or field, a box to tick, or a frame."""
        if option is None or painter is None:
            return
        match element:
            case _Primitive.PE_PanelButtonCommand:
                _button(painter, option, widget)
            case _Primitive.PE_PanelButtonTool:
                _tool_button(painter, option, widget)
            case _Primitive.PE_PanelLineEdit if isinstance(widget, QWidget) and _inside_a_box(widget):
                pass
            case _Primitive.PE_PanelLineEdit | _Primitive.PE_FrameLineEdit:
                _field(painter, option)
            case (
                _Primitive.PE_IndicatorCheckBox
                | _Primitive.PE_IndicatorItemViewItemCheck
                | _Primitive.PE_IndicatorRadioButton
            ):
                _tick(painter, option, round_box=element == _Primitive.PE_IndicatorRadioButton)
            case _Primitive.PE_Frame | _Primitive.PE_FrameGroupBox | _Primitive.PE_FrameTabWidget:
                _frame(painter, option)
            case _Primitive.PE_FrameFocusRect if not isinstance(widget, QAbstractItemView):
                pass  # the ring shows the focus
            case _:
                super().drawPrimitive(element, option, painter, widget)

    def drawControl(
        self,
        element: QStyle.ControlElement,
        option: QStyleOption | None,
        painter: QPainter | None,
        widget: QWidget | None = None,
    ) -> None:
        """Draw toolbar, header, tab and progress bar flat, and the words of an accented button in white."""
        if option is None or painter is None:
            return
        match element:
            case _Control.CE_PushButtonLabel | _Control.CE_ToolButtonLabel if _accented(widget):
                option.palette.setColor(QPalette.ColorRole.ButtonText, QColor(theme_colors().on_accent))
                super().drawControl(element, option, painter, widget)
            case _Control.CE_ToolBar:
                painter.fillRect(option.rect, option.palette.window())
            case _Control.CE_HeaderSection:
                _header(painter, option)
            case _Control.CE_TabBarTabShape:
                _tab(painter, option)
            case _Control.CE_ProgressBarGroove:
                _rounded(painter, option.rect, option.palette.base().color(), _outline(option))
            case _Control.CE_ProgressBarContents if _share(widget):
                done = option.rect.adjusted(1, 1, -1, -1)
                done.setWidth(round(done.width() * _share(widget)))
                _rounded(painter, done, QColor(theme_colors().accent), QColor(theme_colors().accent), _RADIUS - 1)
            case _:
                super().drawControl(element, option, painter, widget)

    def drawComplexControl(
        self,
        control: QStyle.ComplexControl,
        option: QStyleOptionComplex | None,
        painter: QPainter | None,
        widget: QWidget | None = None,
    ) -> None:
        """Draw sliders, spin boxes and combo boxes."""
        if option is None or painter is None:
            return
        parts = (_Part.SC_SliderGroove, _Part.SC_SliderHandle)
        match control:
            case _Complex.CC_Slider:
                groove, handle = (self.subControlRect(control, option, part, widget) for part in parts)
                _slider(painter, _as(QStyleOptionSlider, option), groove, handle)
            case _Complex.CC_ScrollBar:
                handle = self.subControlRect(control, option, _Part.SC_ScrollBarSlider, widget)
                _scroll_bar(painter, _as(QStyleOptionSlider, option), handle)
            case _Complex.CC_SpinBox:
                self._spin_box(painter, _as(QStyleOptionSpinBox, option), widget)
            case _Complex.CC_ComboBox:
                editable = isinstance(widget, QComboBox) and widget.isEditable()
                _field(painter, option, fill=None if editable else option.palette.button().color())
                arrow = self.subControlRect(control, option, _Part.SC_ComboBoxArrow, widget)
                _arrow(painter, arrow, option.palette.buttonText().color())
            case _:
                super().drawComplexControl(control, option, painter, widget)

    def sizeFromContents(
        self, kind: QStyle.ContentsType, option: QStyleOption | None, size: QSize, widget: QWidget | None = None
    ) -> QSize:
        """Make lists to choose from wide enough for their texts: Fusion counts on a wider scroll bar."""
        made = super().sizeFromContents(kind, option, size, widget)
        return made + QSize(GRID, 0) if kind is QStyle.ContentsType.CT_ComboBox else made

    def subControlRect(
        self,
        control: QStyle.ComplexControl,
        option: QStyleOptionComplex | None,
        part: QStyle.SubControl,
        widget: QWidget | None = None,
    ) -> QRect:
        """Lay out scroll bars without arrows."""
        if control != _Complex.CC_ScrollBar or option is None:
            return super().subControlRect(control, option, part, widget)
        if part in (_Part.SC_ScrollBarAddLine, _Part.SC_ScrollBarSubLine):
            return QRect()
        option = _as(QStyleOptionSlider, option)
        along = option.orientation == Qt.Orientation.Horizontal
        length = option.rect.width() if along else option.rect.height()
        span = option.maximum - option.minimum
        size = max(6 * GRID, length * option.pageStep // max(1, span + option.pageStep)) if span else length
        start = self.sliderPositionFromValue(
            option.minimum, option.maximum, option.sliderPosition, length - size, option.upsideDown
        )
        first, last = {
            _Part.SC_ScrollBarSlider: (start, start + size),
            _Part.SC_ScrollBarSubPage: (0, start),
            _Part.SC_ScrollBarAddPage: (start + size, length),
        }.get(part, (0, length))
        rect = option.rect
        return QRect(first, 0, last - first, rect.height()) if along else QRect(0, first, rect.width(), last - first)

    def _spin_box(self, painter: QPainter, option: QStyleOptionSpinBox, widget: QWidget | None) -> None:
        if option.frame:
            _field(painter, option)
        if option.buttonSymbols == QAbstractSpinBox.ButtonSymbols.NoButtons:
            return
        enabled = bool(option.state & _State.State_Enabled)
        for part, step, upwards in (
            (_Part.SC_SpinBoxUp, _Step.StepUpEnabled, True),
            (_Part.SC_SpinBoxDown, _Step.StepDownEnabled, False),
        ):
            rect = self.subControlRect(_Complex.CC_SpinBox, option, part, widget)
            if option.activeSubControls & part and option.state & _State.State_MouseOver:
                painter.fillRect(rect.adjusted(1, 1, -1, -1), option.palette.button())
            group = QPalette.ColorGroup.Active if enabled and option.stepEnabled & step else _DISABLED
            _arrow(painter, rect, option.palette.color(group, QPalette.ColorRole.Text), upwards)


class FocusRing(QObject):
    """Draws a frame of 2 px around the widget that has the keyboard's focus, once it came there by a key.

    A click needs no ring: who clicks knows where.
    """

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
        palette.setColor(QPalette.ColorRole.WindowText, QColor(theme_colors().focus))
        self._frame.setPalette(palette)
        self._frame.setWidget(now)


def _as(kind: type[_Option], option: QStyleOption) -> _Option:
    """Return an option as the type that the drawn element has.

    PyQt takes an option for the one that lay at this address before, so its Python type may be that of the other one.
    """
    base = sip.cast(option, cast(Any, QStyleOption))
    return cast(_Option, sip.cast(base, cast(Any, kind)))


def _outline(option: QStyleOption) -> QColor:
    """Return the colour of a control's border."""
    colors = theme_colors()
    if not option.state & _State.State_Enabled:
        return QColor(colors.border)
    return QColor(colors.focus if option.state & _State.State_HasFocus else colors.outline)


def _inside_a_box(field: QWidget) -> bool:
    """Tell whether a field is the inner part of a spin or combo box, which draws the frame."""
    return isinstance(field.parentWidget(), (QAbstractSpinBox, QComboBox))


def _rounded(painter: QPainter, rect: QRect, fill: QColor, outline: QColor, radius: float = _RADIUS) -> None:
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(outline)
    painter.setBrush(fill)
    painter.drawRoundedRect(QRectF(rect).adjusted(0.5, 0.5, -0.5, -0.5), radius, radius)
    painter.restore()


def _accented(widget: QWidget | None) -> bool:
    """Tell whether this is the button that Enter presses, or a checked one."""
    if isinstance(widget, QToolButton):
        return widget.isEnabled() and widget.isChecked() and not widget.autoRaise()
    return isinstance(widget, QPushButton) and widget.isEnabled() and (widget.isDefault() or widget.isChecked())


def _button(painter: QPainter, option: QStyleOption, widget: QWidget | None) -> None:
    colors = theme_colors()
    accented = _accented(widget)
    fill = QColor(colors.accent) if accented else option.palette.button().color()
    if option.state & _State.State_Sunken or (option.state & _State.State_On and not accented):
        fill = fill.darker(120) if accented else _shaded(fill, 2)
    elif option.state & _State.State_MouseOver and option.state & _State.State_Enabled:
        fill = fill.darker(110) if accented else _shaded(fill, 1)
    _rounded(painter, option.rect, fill, fill if accented else _outline(option))


def _tool_button(painter: QPainter, option: QStyleOption, widget: QWidget | None) -> None:
    if not option.state & _State.State_AutoRaise:
        _button(painter, option, widget)
    elif option.state & (_State.State_Sunken | _State.State_On):
        _rounded(painter, option.rect, _shaded(option.palette.button().color(), 1), QColor(theme_colors().outline))
    elif option.state & _State.State_MouseOver and option.state & _State.State_Enabled:
        fill = _shaded(option.palette.button().color(), 1)
        _rounded(painter, option.rect, fill, fill)


def _shaded(color: QColor, steps: int) -> QColor:
    """Return a colour a little nearer to that of the text."""
    return color.lighter(100 + 14 * steps) if color.lightness() < 128 else color.darker(100 + 6 * steps)


def _field(painter: QPainter, option: QStyleOption, fill: QColor | None = None) -> None:
    group = QPalette.ColorGroup.Active if option.state & _State.State_Enabled else _DISABLED
    _rounded(painter, option.rect, fill or option.palette.color(group, QPalette.ColorRole.Base), _outline(option))


def _frame(painter: QPainter, option: QStyleOption) -> None:
    _rounded(painter, option.rect, QColor(Qt.GlobalColor.transparent), QColor(theme_colors().border))


def _tick(painter: QPainter, option: QStyleOption, round_box: bool) -> None:
    side = min(option.rect.width(), option.rect.height())
    box = QRect(0, 0, side, side)
    box.moveCenter(option.rect.center())
    enabled = bool(option.state & _State.State_Enabled)
    on = bool(option.state & (_State.State_On | _State.State_NoChange))
    colors = theme_colors()
    fill = QColor(colors.base if not on else colors.accent if enabled else colors.border)
    _rounded(painter, box, fill, fill if on else _outline(option), side / 2 if round_box else 3.0)
    if not on:
        return
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.translate(QPointF(box.topLeft()))
    painter.scale(side / 14, side / 14)
    painter.setPen(QPen(QColor(colors.on_accent), 2.0, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    if option.state & _State.State_NoChange:
        painter.drawLine(QPointF(4, 7), QPointF(10, 7))
    elif round_box:
        painter.setBrush(QColor(colors.on_accent))
        painter.drawEllipse(QPointF(7, 7), 1.5, 1.5)
    else:
        painter.drawPolyline(QPolygonF([QPointF(3.5, 7.2), QPointF(6, 9.7), QPointF(10.5, 4.5)]))
    painter.restore()


def _arrow(painter: QPainter, rect: QRect, color: QColor, upwards: bool = False) -> None:
    centre = QRectF(rect).center()
    half = min(4.0, rect.width() / 2 - 2, rect.height() - 2)
    rise = half / 2 if upwards else -half / 2
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(QPen(color, 1.5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    left, right = centre + QPointF(-half, rise), centre + QPointF(half, rise)
    painter.drawPolyline(QPolygonF([left, centre - QPointF(0, rise), right]))
    painter.restore()


def _slider(painter: QPainter, option: QStyleOptionSlider, groove: QRect, handle: QRect) -> None:
    """Draw a groove, filled up to the handle, and a round handle."""
    colors = theme_colors()
    enabled = bool(option.state & _State.State_Enabled)
    knob = QRectF(handle).center()
    line = QRectF(groove)
    if option.orientation == Qt.Orientation.Horizontal:
        line = QRectF(line.left(), knob.y() - _GROOVE / 2, line.width(), _GROOVE)
        done = QRectF(line.topLeft(), QPointF(knob.x(), line.bottom()))
        if option.upsideDown:
            done = QRectF(QPointF(knob.x(), line.top()), line.bottomRight())
    else:
        line = QRectF(knob.x() - _GROOVE / 2, line.top(), _GROOVE, line.height())
        done = QRectF(QPointF(line.left(), knob.y()), line.bottomRight())
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(Qt.PenStyle.NoPen)
    for part, color in ((line, colors.outline if enabled else colors.border), (done, colors.accent)):
        if enabled or part is line:
            painter.setBrush(QColor(color))
            painter.drawRoundedRect(part, _GROOVE / 2, _GROOVE / 2)
    lit = enabled and bool(option.state & (_State.State_MouseOver | _State.State_HasFocus | _State.State_Sunken))
    painter.setPen(QPen(QColor(colors.accent if enabled else colors.border), 2.0))
    painter.setBrush(QColor(colors.accent if lit else colors.knob if enabled else colors.button))
    painter.drawEllipse(knob, 6.0, 6.0)
    painter.restore()


def _scroll_bar(painter: QPainter, option: QStyleOptionSlider, handle: QRect) -> None:
    colors = theme_colors()
    lit = bool(option.state & (_State.State_MouseOver | _State.State_Sunken))
    color = QColor(colors.muted if lit else colors.outline)
    painter.fillRect(option.rect, option.palette.window())
    if option.maximum > option.minimum:
        _rounded(painter, handle.adjusted(3, 3, -3, -3), color, color, 3.0)


def _share(widget: QWidget | None) -> float:
    """Return the share of a progress bar that is filled; 0 while it is unknown."""
    if not isinstance(widget, QProgressBar) or widget.maximum() <= widget.minimum():
        return 0.0
    return (widget.value() - widget.minimum()) / (widget.maximum() - widget.minimum())


def _header(painter: QPainter, option: QStyleOption) -> None:
    colors = theme_colors()
    painter.fillRect(option.rect, QColor(colors.alternate))
    painter.save()
    painter.setPen(QColor(colors.border))
    painter.drawLine(option.rect.bottomLeft(), option.rect.bottomRight())
    painter.drawLine(option.rect.topRight(), option.rect.bottomRight())
    painter.restore()


def _tab(painter: QPainter, option: QStyleOption) -> None:
    """Underline the selected tab."""
    colors = theme_colors()
    bottom = QRect(option.rect.left(), option.rect.bottom() - 2, option.rect.width(), 3)
    if option.state & _State.State_Selected:
        painter.fillRect(bottom, QColor(colors.accent))
    elif option.state & _State.State_MouseOver:
        painter.fillRect(bottom, QColor(colors.border))
