"""The last page: the proximity image over the tactile image by the new alignment or the present one."""

from __future__ import annotations

import cv2
import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QShowEvent
from PyQt6.QtWidgets import QButtonGroup, QLabel, QSlider, QWidget

from ...core.calibration.check import compare_alignments
from ...core.calibration.geometry import Alignment
from ...core.calibration.report import CalibrationReport
from ...core.model.arrays import Uint8Array
from ...widgets.basics.controls import caption, choice_button, wrapped_label
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.images.point_image import PointImage
from ..document.document import Document
from ..worker.jobs import Job
from .correspondence import overlay
from .fitting import Outcome, at_least
from .session import ImageChoice, Session


class CheckPage(QWidget):
    """Both images blended, and the expected errors of both alignments: what to look at before saving."""

    def __init__(self, session: Session, document: Document) -> None:
        super().__init__()
        self._session, self._document = session, document
        self._outcome = Outcome()
        self._images: tuple[Uint8Array, Uint8Array] | None = None
        self._drawn: tuple[object, ...] = ()
        self.job = Job(self, self._show_overlay, self._show_none)
        self.image = PointImage("Proximity image over tactile image", magnifies=False)
        self.errors = wrapped_label()
        self.errors.setToolTip("Over the membrane; both alignments are compared at pairs left out of their fits")
        self.share = QSlider(Qt.Orientation.Horizontal)
        self.share.setRange(0, 100)
        self.share.setValue(50)
        self.share.setToolTip("Share of the tactile image: nothing on the membrane may move as it changes")
        self.which = QButtonGroup(self)
        new = choice_button("Ne&w", "Overlay the images with the new alignment")
        present = choice_button("&Present", "Overlay the images with the preset's present alignment")
        self.which.addButton(new, 0)
        self.which.addButton(present, 1)
        new.setChecked(True)
        tools = hbox(QLabel("Alignment"), new, present, 16, caption("&Tactile image", self.share), (self.share, 1))
        vbox(tools, (self.image, 1), self.errors, within=self, margins=(8, 8, 8, 4))
        self.which.idClicked.connect(self._draw)
        self.share.valueChanged.connect(lambda _: self._compose())
        session.changed.connect(self._draw)
        document.presetChanged.connect(self._draw)
        self.setFocusProxy(self.share)

    def show_outcome(self, outcome: Outcome) -> None:
        self._outcome = outcome
        self._draw()

    def showEvent(self, event: QShowEvent | None) -> None:
        super().showEvent(event)
        self._draw()

    def _draw(self, _: object = None) -> None:
        if not self.isVisible():
            return
        report, preset, snapshot = self._outcome.report, self._document.preset, self._session.state.snapshot
        self.errors.setText("")
        if report is not None:
            new, compared = report.chosen, compare_alignments(report, preset)
            words = f"Expected alignment error: <b>{at_least(new.alignment_px, 'px')}, "
            words += f"{at_least(new.alignment_mm, 'mm')}</b>."
            self.errors.setText(words + ("" if compared is None else f" {compared.sentence}"))
        wanted = report if self.which.checkedId() == 0 else preset.alignment
        if wanted is None:
            self._show_none("No calibration yet: click at least four pairs on the page Points")
        elif snapshot is None:
            self._show_none("Take a snapshot to compare the images")
        elif (snapshot, wanted) != self._drawn:
            self._drawn = (snapshot, wanted)
            rig, frame = self._session.rig, snapshot.frame
            image: ImageChoice = "depth" if frame.tactile_color is None else "color"
            fitted = wanted.chosen.fit.alignment if isinstance(wanted, CalibrationReport) else None
            self.job.start(lambda _: overlay(fitted or Alignment.of_preset(preset.alignment, rig), rig, frame, image))

    def _show_overlay(self, images: tuple[Uint8Array, Uint8Array]) -> None:
        self._images = images
        self._compose()

    def _show_none(self, why: str) -> None:
        self._images, self._drawn = None, ()
        self.image.set_image(None, why)

    def _compose(self) -> None:
        if self._images is not None:
            share = self.share.value() / 100
            mixed = cv2.addWeighted(self._images[0], share, self._images[1], 1.0 - share, 0.0)
            self.image.set_image(np.asarray(mixed, np.uint8))
