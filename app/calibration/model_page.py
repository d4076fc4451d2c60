"""The page that compares both models, where one is chosen."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import (
    QButtonGroup,
    QComboBox,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QRadioButton,
    QWidget,
)

from ...core.calibration import CalibrationReport
from ...core.calibration.depth_advice import DEPTH_WORDS
from ...core.calibration.report import ModelQuality
from ...core.errors import minus
from ...widgets.basics.controls import caption, wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.basics.theme import text_font
from ...widgets.plots.calibration_plots import Residual, ResidualPlot, round_limit
from .fitting import Outcome
from .session import ModelChoice, Session, SessionState

_MODELS = ("homography", "rigid")
_TITLES = {"homography": "Homography", "rigid": "Rigid pose"}
_SUBTITLES = {
    "homography": "Maps one image onto the other; exact for one plane only.",
    "rigid": "Pose of the tactile camera; exact at every depth.",
}
_CHOICES: tuple[tuple[ModelChoice, str, str], ...] = (
    ("auto", "Recommended", "Use the model with the smaller cross-validation error"),
    ("rigid", "Rigid pose", "Always use the rigid pose"),
    ("homography", "Homography", "Always use the homography"),
)


@dataclass(frozen=True)
class _Number:
    title: str
    tip: str
    value: Callable[[ModelQuality], float | None]
    unit: str = "px"
    decimals: int = 2


_NUMBERS = (
    _Number("Residual, RMS", "Root mean square distance of the pairs from the fit, pixels", lambda q: q.rms_px),
    _Number("Residual, RMS", "The same error at each pair's depth, millimetres", lambda q: q.rms_mm, "mm"),
    _Number("Worst residual", "The largest residual of a pair, pixels", lambda q: q.worst_px),
    _Number(
        "Cross-validated residual",
        "Root mean square residual of a region's pairs, a part of the image and of depth, under the fit of the others, "
        "pixels. The best measure of a model's quality",
        lambda q: q.cross_validated_px,
    ),
    _Number(
        "Expected alignment error",
        "Alignment error over the whole membrane due to the clicks' noise and to smooth errors that the pairs show, "
        "such as lens distortion, pixels",
        lambda q: q.alignment_px,
    ),
    _Number("  95 % bound", "The alignment error is smaller than this with 95 % probability, pixels",
            lambda q: q.alignment_bound_95_px),
    _Number("Expected alignment error", "The same error across the line of sight, millimetres",
            lambda q: q.alignment_mm, "mm"),
    _Number("Patch boundary off by", "Expected error of the contact patch's boundary, millimetres",
            lambda q: q.effect.boundary_mm, "mm"),
    _Number("Smallest t (tolerance test)",
            "With a smaller t the tolerance test loses pixels in true contact, per cent of the distance",
            lambda q: 100 * q.effect.supported_tolerance, "%", 2),
    _Number("Condition number", "How unevenly the points constrain the fit (no unit); values in the thousands are bad",
            lambda q: q.condition, "", 1),
)  # fmt: skip


class _ModelColumn(QGroupBox):
    """One model: its numbers and a plot of its residuals."""

    def __init__(self, name: str) -> None:
        super().__init__(_TITLES[name])
        self._name = name
        self.subtitle = wrapped_label(_SUBTITLES[name])
        self.values: list[QLabel] = []
        self.extra = wrapped_label(selectable=True)
        self.plot = ResidualPlot()
        numbers = QGridLayout()
        numbers.setHorizontalSpacing(12)
        numbers.setVerticalSpacing(4)
        for row, number in enumerate(_NUMBERS):
            title, value = QLabel(number.title), QLabel("–")
            value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            for label in (title, value):
                label.setToolTip(number.tip)
            numbers.addWidget(title, row, 0)
            numbers.addWidget(value, row, 1)
            self.values.append(value)
        numbers.setColumnStretch(0, 1)
        vbox(self.subtitle, numbers, self.extra, (self.plot, 1), within=self)

    def show_report(self, report: CalibrationReport | None, limit: float) -> None:
        """Show the model's part of a report."""
        quality = None if report is None else report.quality.get(self._name)
        recommended = report is not None and report.recommended == self._name and quality is not None
        self.setTitle(_TITLES[self._name] + ("  ·  recommended" if recommended else ""))
        self.subtitle.setFont(text_font("body", bold=recommended))
        for number, label in zip(_NUMBERS, self.values, strict=True):
            value = None if quality is None else number.value(quality)
            label.setText(_shown(value, number))
        if report is None or quality is None:
            reason = "" if report is None else report.refused.get(self._name, "")
            self.extra.setText("")
            self.plot.set_residuals(
                [], message=f"Not fitted: {reason}" if reason else "No fit yet: click at least four pairs."
            )
            return
        self.extra.setText(_extra_words(report, quality))
        residuals = [Residual(pair.residual_u, pair.residual_v, pair.id, not pair.used) for pair in quality.pairs]
        message = (
            ""
            if quality.rms_px is not None
            else ("So few points are always fitted exactly, so the residuals mean nothing. Click at least six pairs.")
        )
        self.plot.set_residuals(residuals, limit, message)


class ModelPage(QWidget):
    """Both models side by side, the recommendation with its reason, and the choice between them."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self.reason = wrapped_label()
        self.reason.setFont(text_font("title"))
        self.choices = QButtonGroup(self)
        self.depth_fit = QComboBox()
        self.depth_fit.setAccessibleName("Correction of the tactile depth")
        self.depth_fit.setToolTip(
            "Also fit an offset (mm) and a scale (no unit) of the tactile depth. Points that span depth determine the "
            "offset. The scale needs points clicked in the depth image at contact; without them it rests on the rig's "
            "stated baseline"
        )
        self.depth_fit.addItem("Recommended", "auto")
        for kind, words in DEPTH_WORDS.items():
            self.depth_fit.addItem(words.capitalize(), kind)
        self.depth_reason = wrapped_label()
        self.warnings = wrapped_label()
        self.columns = {name: _ModelColumn(name) for name in _MODELS}
        row = QHBoxLayout()
        row.addWidget(QLabel("Take"))
        for number, (_, title, tip) in enumerate(_CHOICES):
            button = QRadioButton(title)
            button.setToolTip(tip)
            self.choices.addButton(button, number)
            row.addWidget(button)
        row.addSpacing(20)
        row.addWidget(caption("Correct the tactile &depth", self.depth_fit))
        row.addWidget(self.depth_fit)
        row.addStretch(1)
        columns = QHBoxLayout()
        for name in ("rigid", "homography"):
            columns.addWidget(self.columns[name], 1)
        vbox(self.reason, row, self.depth_reason, (columns, 1), self.warnings, within=self, margins=(8, 8, 8, 4))
        self.choices.idClicked.connect(
            lambda number: session.choose(f"Take: {_CHOICES[number][1]}", model=_CHOICES[number][0])
        )
        self.depth_fit.activated.connect(
            lambda _: session.choose(
                f"Correct the depth: {self.depth_fit.currentText()}", depth_fit=self.depth_fit.currentData()
            )
        )
        session.changed.connect(self._show_state)
        self._show_state(session.state)
        self.show_outcome(Outcome())

    def show_outcome(self, outcome: Outcome) -> None:
        """Show a new fit."""
        report = outcome.report
        if report is None:
            self.reason.setText(outcome.sentence or "No pairs yet: click at least four, preferably eight.")
        else:
            self.reason.setText(report.reason)
        self.depth_reason.setText("" if report is None else report.depth_advice.reason)
        self.warnings.setText("" if report is None else " ".join(f"Note: {words}" for words in report.warnings))
        self.warnings.setVisible(bool(self.warnings.text()))
        limit = _common_limit(report)
        for column in self.columns.values():
            column.show_report(report, limit)

    def _show_state(self, state: SessionState) -> None:
        number = next(n for n, (name, _, _) in enumerate(_CHOICES) if name == state.choices.model)
        button = self.choices.button(number)
        assert button is not None
        button.setChecked(True)
        self.depth_fit.setCurrentIndex(self.depth_fit.findData(state.choices.depth_fit))


def _common_limit(report: CalibrationReport | None) -> float:
    """Return a common scale for both plots."""
    if report is None:
        return 1.0
    return max(
        round_limit([Residual(p.residual_u, p.residual_v) for p in quality.pairs if p.used])
        for quality in report.quality.values()
    )


def _extra_words(report: CalibrationReport, quality: ModelQuality) -> str:
    words = []
    if quality.model == "rigid" and report.rigid is not None:
        sigma = report.to_json()["pose_uncertainty"]
        words.append(f"Pose known to {sigma['translation_mm']:.2f} mm and {sigma['rotation_deg']:.2f}°.")
        pose = report.rigid.pose
        if sigma["scale"] is not None:
            words.append(f"Tactile depth × {pose.scale:.4f} ± {sigma['scale']:.4f}.")
        if sigma["offset_mm"] is not None:
            words.append(f"Tactile depth {minus(f'{1e3 * pose.offset_m:+.2f}')} ± {sigma['offset_mm']:.2f} mm.")
    if quality.excluded:
        words.append(f"Rejected, because the others contradict them: {', '.join(quality.excluded[:12])}.")
    return " ".join(words)


def _shown(value: float | None, number: _Number) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{number.decimals}f} {number.unit}".rstrip()
