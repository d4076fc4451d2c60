"""One camera of a rig as fields: model, depth unit and lens, typed or taken from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

from PyQt6.QtCore import QPoint, pyqtSignal
from PyQt6.QtWidgets import QComboBox, QFormLayout, QGroupBox, QHBoxLayout, QLabel, QLineEdit, QMenu

from ...core.calibration.lens import MODELS, LensFit, nominal_lens
from ...core.errors import SourceError
from ...core.model.intrinsics import Distortion, Intrinsics
from ...core.sources.cameras.camera import StreamLens
from ...widgets.basics.controls import push_button, wrapped_label
from .chessboard_dialog import ChessboardDialog
from .list_devices import PROGRAM
from .search import CameraSearch, FoundCamera

_NUMBERS = {
    "fx": "Focal length across the image, pixels",
    "fy": "Focal length down the image, pixels",
    "cx": "Column of the principal point, pixels; the centre of the first pixel is 0",
    "cy": "Row of the principal point, pixels; the centre of the first pixel is 0",
}
_NOMINAL = (
    "Nominal values of the {} {} lens, not measured: positions to the side are wrong by a few per cent. Better are a "
    "chessboard or the camera itself."
)
_TYPED = "Typed by hand."
_EMPTY = "Type the lens, or take it from one of the three."


class CameraForm(QGroupBox):
    """Asks for one camera.

    Parameters
    ----------
    title : str
    size : (int, int)
        Width and height of its images, pixels.
    model : str
        Selected at first.
    has_depth : bool
        Whether to ask for the depth unit.
    native_dialogs : bool

    Signals
    -------
    changed()
    failed(sentence: str)
    """

    changed = pyqtSignal()
    failed = pyqtSignal(str)

    def __init__(
        self, title: str, size: tuple[int, int], model: str, *, has_depth: bool = True, native_dialogs: bool = True
    ) -> None:
        super().__init__(f"{title}, {size[0]} x {size[1]}")
        self._size, self._has_depth, self._native = size, has_depth, native_dialogs
        self.chessboard: ChessboardDialog | None = None
        self.search: CameraSearch | None = None
        self.model = QComboBox()
        self.model.setEditable(True)
        self.model.addItems([*MODELS])
        self.model.setCurrentText(model)
        self.model.setToolTip("Model of the camera; type the name of any other one")
        self.unit = QLineEdit()
        self.unit.setToolTip("Length of one count of the depth images, millimetres")
        self.nominal = push_button("&Nominal", "Take the lens that the maker states for the model")
        self.nominal_menu = QMenu(self.nominal)
        self.nominal_menu.setToolTipsVisible(True)
        self.nominal.setMenu(self.nominal_menu)
        self.from_pictures = push_button("C&hessboard…", "Fit the lens to pictures of a chessboard by this camera")
        self.from_camera = push_button("Ca&mera…", "Read the lens from the camera, which must be connected")
        self.entries = {name: QLineEdit() for name in _NUMBERS}
        self.distortion = QComboBox()
        self.distortion.setToolTip("Model of the lens distortion, with librealsense's names")
        for kind in Distortion:
            self.distortion.addItem(kind.value.replace("_", " "), kind)
        self.coefficients = QLineEdit("0 0 0 0 0")
        self.coefficients.setToolTip("Distortion coefficients k1, k2, p1, p2, k3; unused without distortion")
        self.origin = wrapped_label(_EMPTY)
        self._lay_out()
        self._connect()
        self._show_model()

    def values(self) -> dict[str, Any]:
        """Return the camera as ``rig.json`` has it; `parse_rig` checks the ranges.

        Raises
        ------
        SourceError
            A field is empty or no number.
        """
        made: dict[str, Any] = {"width": self._size[0], "height": self._size[1]}
        made |= {name: self._number(name, entry) for name, entry in self.entries.items()}
        made["distortion"] = self.distortion.currentData()
        words = re.split(r"[\s,;]+", self.coefficients.text().strip())
        if made["distortion"] != Distortion.NONE:
            if len(words) != 5:
                raise SourceError(f"{self.title()}: give the five coefficients k1 k2 p1 p2 k3, not {len(words)}")
            made["coefficients"] = [self._parsed("coefficients", word) for word in words]
        if self._has_depth:
            unit_m = 1e-3 * self._number("depth unit", self.unit)
            made |= {"model": self.model.currentText().strip() or "unknown", "depth_unit_m": float(f"{unit_m:.12g}")}
        return made

    def show_lens(self, lens: Intrinsics, origin: str) -> None:
        """Show a lens and where it is from."""
        for name, entry in self.entries.items():
            entry.setText(f"{getattr(lens, name):.8g}")
        self.distortion.setCurrentIndex(self.distortion.findData(lens.distortion))
        self.coefficients.setText(" ".join(f"{value:.8g}" for value in lens.coefficients))
        self.origin.setText(origin)
        self.changed.emit()

    def stop(self) -> None:
        """End what runs."""
        if self.search is not None:
            self.search.stop()
        if self.chessboard is not None:
            self.chessboard.reject()

    def _lay_out(self) -> None:
        form = QFormLayout(self)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.addRow("Model", self.model)
        if self._has_depth:
            form.addRow("Depth unit, mm", self.unit)
        taken = QHBoxLayout()
        for button in (self.nominal, self.from_pictures, self.from_camera):
            taken.addWidget(button)
        form.addRow("Take lens", taken)
        for name, tip in _NUMBERS.items():
            self.entries[name].setToolTip(tip)
            form.addRow(f"{name}, px", self.entries[name])
        form.addRow("Distortion", self.distortion)
        form.addRow("k1 k2 p1 p2 k3", self.coefficients)
        form.addRow(self.origin)
        for field in (self.model, self.unit, *self.entries.values(), self.distortion, self.coefficients):
            label = form.labelForField(field)
            if isinstance(label, QLabel):
                field.setAccessibleName(f"{self.title()}: {label.text()}")

    def _connect(self) -> None:
        self.model.currentTextChanged.connect(self._show_model)
        self.nominal_menu.triggered.connect(lambda entry: entry.data()())
        self.from_pictures.clicked.connect(self._ask_pictures)
        self.from_camera.clicked.connect(self._ask_camera)
        for entry in (*self.entries.values(), self.coefficients):
            entry.textEdited.connect(self._typed)
        self.unit.textEdited.connect(self.changed)
        self.distortion.activated.connect(self._typed)

    def _show_model(self) -> None:
        """Offer what the maker states about the model."""
        name = self.model.currentText()
        model = MODELS.get(name)
        self.nominal_menu.clear()
        self.nominal.setEnabled(model is not None)
        if model is not None:
            self.unit.setText(f"{1e3 * model.depth_unit_m:g}")
            for lens, view in model.views_deg.items():
                entry = self.nominal_menu.addAction(f"{name}, {lens} lens, {view[0]:g}° x {view[1]:g}°")
                assert entry is not None
                entry.setToolTip(f"For images aligned to the {lens} image")
                use: Callable[[], None] = partial(
                    self.show_lens, nominal_lens(*self._size, view), _NOMINAL.format(name, lens)
                )
                entry.setData(use)
        self.changed.emit()

    def _typed(self) -> None:
        self.origin.setText(_TYPED)
        self.changed.emit()

    def _number(self, name: str, entry: QLineEdit) -> float:
        return self._parsed(name, entry.text())

    def _parsed(self, name: str, text: str) -> float:
        try:
            return float(text)
        except ValueError as error:
            found = f"is {text!r}, but it must be a number" if text.strip() else "is empty; enter a number"
            raise SourceError(f"{self.title()}: {name} {found}") from error

    # Lens from pictures

    def _ask_pictures(self) -> None:
        dialog = ChessboardDialog(self._size, self._native, self)
        dialog.chosen.connect(self._use_fit)
        dialog.finished.connect(dialog.deleteLater)
        dialog.finished.connect(lambda _: setattr(self, "chessboard", None))
        self.chessboard = dialog
        dialog.open()

    def _use_fit(self, fit: LensFit) -> None:
        pictures = f"{fit.used} pictures of a chessboard, {fit.rms_px:.2f} px RMS"
        self.show_lens(fit.intrinsics, f"From {pictures}, fx ± {fit.focal_sd_px:.1f} px.")

    # Lens from a connected camera

    def _ask_camera(self) -> None:
        if self.search is None:
            self.search = CameraSearch(self, (*PROGRAM, "--lenses"))
            self.search.found.connect(self._offer_cameras)
            self.search.failed.connect(self._searched)
        self.from_camera.setEnabled(False)
        self.origin.setText("Searching for cameras…")
        self.search.start()

    def _searched(self, sentence: str) -> None:
        self.from_camera.setEnabled(True)
        self.origin.setText(_EMPTY)
        self.failed.emit(sentence)

    def _offer_cameras(self, cameras: list[FoundCamera], _hint: str) -> None:
        """Offer every lens of this size in a menu."""
        sizes = {(lens.intrinsics.width, lens.intrinsics.height) for camera in cameras for lens in camera.lenses}
        offers = [
            (camera, lens)
            for camera in cameras
            for lens in camera.lenses
            if (lens.intrinsics.width, lens.intrinsics.height) == self._size
        ]
        if not offers:
            there = ", ".join(f"{width} x {height}" for width, height in sorted(sizes)) or "none"
            self._searched(f"No connected camera states a lens for {self._size[0]} x {self._size[1]} pixels: {there}.")
            return
        self._searched("")
        menu = QMenu(self)
        for camera, lens in offers:
            entry = menu.addAction(f"{camera.model} (serial {camera.serial}), {lens.kind}")
            assert entry is not None
            entry.triggered.connect(partial(self._use_camera, camera, lens))
        menu.aboutToHide.connect(menu.deleteLater)
        self.camera_menu = menu
        menu.popup(self.from_camera.mapToGlobal(QPoint(0, self.from_camera.height())))

    def _use_camera(self, camera: FoundCamera, lens: StreamLens, _checked: bool = False) -> None:
        self.model.setCurrentText(camera.model)
        self.unit.setText(f"{1e3 * lens.depth_unit_m:g}")
        self.show_lens(lens.intrinsics, f"From the {camera.model} (serial {camera.serial}), {lens.kind} images.")
