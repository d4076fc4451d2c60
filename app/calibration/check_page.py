"""The last page: the new alignment beside the present one, before it is saved."""

from __future__ import annotations

from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtGui import QHideEvent, QShowEvent
from PyQt6.QtWidgets import (
    QButtonGroup,
    QCheckBox,
    QComboBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QSlider,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from ...core.calibration.recheck import clearly_larger, replacement
from ...core.contact.checks import rig_in_use
from ...core.preset import AlignmentSection, Preset
from ...widgets.basics.controls import AccentButton, push_button
from ...widgets.basics.layouts import hbox, splitter, vbox
from ...widgets.basics.theme import theme_name
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from ...widgets.images.point_image import PointImage
from ..document.document import Document
from ..worker.feed import FrameFeed
from ..worker.jobs import Job
from .fitting import Outcome, at_least
from .overlay import Overlay, OverlayMode, Patch, PatchFinder, alignment_of_preset, make_overlay
from .session import ProximityImage, Session, SessionState

_BLINK_MS = 450
_NO_FIT = "No calibration yet: click at least four pairs on the page Points"
_TIPS = {
    OverlayMode.BLEND: "Both images blended; the slider sets the tactile image's weight",
    OverlayMode.CHECKER: "A checkerboard of both images: lines must continue across the borders",
    OverlayMode.BLINK: "Both images alternating: nothing on the membrane may jump",
    OverlayMode.EDGES: "Edges of the tactile image over the proximity image: they must coincide",
}
_IMAGES: tuple[tuple[ProximityImage, str], ...] = (("color", "Colour"), ("depth", "Depth"))
_WHICH = (("new", "New"), ("present", "Present"))


class CheckPage(QWidget):
    """The tactile image over the proximity image, and the contact patch with each alignment."""

    def __init__(self, session: Session, document: Document, feed: FrameFeed) -> None:
        super().__init__()
        self._session, self._document, self._feed = session, document, feed
        self._outcome = Outcome()
        self._kept: AlignmentSection | None = None
        self._areas = ("–", "–")
        self._overlay: Overlay | None = None
        self._drawn: tuple[object, ...] = ()
        self._blinked = False
        self._finders = {"present": PatchFinder(), "new": PatchFinder()}
        self._overlay_job, self._patch_job = Job(self), Job(self)
        self._blink = QTimer(self)
        self._blink.setInterval(_BLINK_MS)
        self.image = PointImage("Tactile image over proximity image")
        self.image.set_loupe_wanted(False)
        self.clouds = {
            "present": CloudView("Present alignment"),
            "new": CloudView("New alignment"),
        }
        link_cameras(list(self.clouds.values()))
        self.table = _comparison_table()
        self.set_tolerance = QCheckBox()
        self.set_tolerance.setToolTip(
            "Set the tolerance t, per cent of the distance, to the smallest that this calibration supports; the "
            "membrane contact test has no t"
        )
        self.export = push_button(
            "Export report…", "Write verdict, numbers and pictures of the new calibration into one HTML file"
        )
        self._make_controls()
        self._lay_out()
        self._connect()
        self.show_outcome(Outcome())

    def _make_controls(self) -> None:
        self.modes, self.which = QButtonGroup(self), QButtonGroup(self)
        self.share = QSlider(Qt.Orientation.Horizontal)
        self.share.setRange(0, 100)
        self.share.setValue(50)
        self.share.setMinimumWidth(60)
        self.share.setAccessibleName("Share of the tactile image")
        self.share.setToolTip("Share of the tactile image, percent")
        self.pixels = QComboBox()
        self.pixels.setAccessibleName("Images")
        self.pixels.setToolTip("Colour shows the membrane's dots, depth shows the pressed object")
        for key, title in _IMAGES:
            self.pixels.addItem(title, key)

    def _lay_out(self) -> None:
        tools = QHBoxLayout()
        tools.setSpacing(4)
        for number, mode in enumerate(OverlayMode):
            button = AccentButton(mode.value, _TIPS[mode])
            self.modes.addButton(button, number)
            tools.addWidget(button)
        tools.addWidget(self.share, 1)
        tools.addWidget(self.pixels)
        tools.addSpacing(8)
        tools.addWidget(QLabel("Alignment"))
        for number, (_, title) in enumerate(_WHICH):
            button = AccentButton(title, f"Overlay the images with the {title.lower()}")
            self.which.addButton(button, number)
            tools.addWidget(button)
        for group in (self.modes, self.which):
            first = group.button(0)
            assert first is not None
            first.setChecked(True)
        left = QWidget()
        column = vbox(tools, (self.image, 1), self.table, within=left, margins=0)
        last = hbox((self.set_tolerance, 1), self.export)
        column.addLayout(last)
        right = splitter(Qt.Orientation.Vertical, self.clouds["new"], self.clouds["present"])
        across = splitter(Qt.Orientation.Horizontal, (left, 3), (right, 2), sizes=(720, 480))
        vbox(across, within=self, margins=(8, 8, 8, 4))

    def _connect(self) -> None:
        self.modes.idClicked.connect(self._mode_chosen)
        self.which.idClicked.connect(lambda _: self._draw())
        self.pixels.activated.connect(lambda _: self._draw())
        self.share.valueChanged.connect(lambda _: self._compose())
        self._blink.timeout.connect(self._swap)
        self._overlay_job.done.connect(self._show_overlay)
        self._overlay_job.failed.connect(lambda words: self.image.set_image(None, words))
        self._patch_job.done.connect(self._show_patches)
        self.set_tolerance.clicked.connect(
            lambda on: self._session.choose(f"Set t when saving: {'on' if on else 'off'}", set_tolerance=on)
        )
        self._session.changed.connect(self._show_state)
        self._document.presetChanged.connect(self._preset_changed)
        self._document.baselineChanged.connect(self._file_changed)
        self._feed.frameArrived.connect(lambda _: self._find_patches())

    # Display

    def show_outcome(self, outcome: Outcome) -> None:
        """Show a new fit."""
        self._outcome = outcome
        self._areas = ("–", "–")
        self.export.setEnabled(outcome.report is not None)
        self._show_tolerance()
        self._draw()

    def close_jobs(self) -> None:
        """Cancel running jobs."""
        self._blink.stop()
        self._overlay_job.stop()
        self._patch_job.stop()

    def showEvent(self, event: QShowEvent | None) -> None:
        """Redraw what changed while the page was hidden."""
        super().showEvent(event)
        self._draw()
        self._mode_chosen()

    def hideEvent(self, event: QHideEvent | None) -> None:
        """Stop blinking."""
        super().hideEvent(event)
        self._blink.stop()

    @property
    def mode(self) -> OverlayMode:
        """How the images are combined."""
        return list(OverlayMode)[self.modes.checkedId()]

    def new_preset(self) -> Preset | None:
        """Return the document's preset with the new alignment; None without a fit."""
        report = self._outcome.report
        return None if report is None else report.apply_to(self._document.preset)

    def keep_present(self) -> None:
        """Keep showing the present alignment as "Present" after it is replaced, until the preset's file is saved."""
        if self._kept is None:
            self._kept = self._document.preset.alignment

    def present_preset(self) -> Preset:
        """Return the document's preset with the alignment that "Present" shows."""
        preset = self._document.preset
        return preset if self._kept is None else preset.model_copy(update={"alignment": self._kept})

    def _show_state(self, state: SessionState) -> None:
        self.set_tolerance.setChecked(state.choices.set_tolerance)
        self._draw()

    def _show_tolerance(self) -> None:
        report, preset = self._outcome.report, self._document.preset
        used = "tolerance" in preset.test.sections
        use = "" if used else f"; the {preset.contact_test} test does not use it"
        self.set_tolerance.setEnabled(report is not None)
        supported = "" if report is None else f" to {100 * report.chosen.effect.supported_tolerance:.2f} %"
        self.set_tolerance.setText(f"Also set the tolerance t{supported} (now {100 * preset.tolerance.t:.3g} %{use})")

    def _draw(self) -> None:
        if not self.isVisible():
            return
        self._find_patches()
        self._show_comparison()
        snapshot, new = self._session.state.snapshot, self.new_preset()
        frame = snapshot.frame if snapshot is not None else self._feed.frame
        which, image = _WHICH[self.which.checkedId()][0], self.pixels.currentData()
        if new is None and which == "new":
            self._overlay, self._drawn = None, ()
            self.image.set_image(None, _NO_FIT)
            return
        if image == "color" and frame.tactile_color is None:
            self.image.set_image(None, "The tactile camera has no colour image; choose Depth")
            return
        preset = new if which == "new" and new is not None else self.present_preset()
        wanted = (frame, preset.alignment.geometry, image)
        if wanted != self._drawn:
            self._drawn = wanted
            if self._overlay is None:
                self.image.set_image(None, "Drawing both images…")
            section, rig = preset.alignment, rig_in_use(preset, self._session.rig)
            self._overlay_job.start(lambda _: make_overlay(alignment_of_preset(section, rig), rig, frame, image))

    def _find_patches(self) -> None:
        """Find the patches in the newest frame if the page is visible."""
        if not self.isVisible() or (self._patch_job.busy and self._feed.playback.playing):
            return
        frame = self._feed.frame
        presets = {"present": self.present_preset(), "new": self.new_preset()}
        if "–" in self._areas:
            for view in self.clouds.values():
                view.set_message("Finding the patch…")
        rig, theme, finders = self._session.rig, theme_name(), self._finders
        self._patch_job.start(
            lambda _: {
                name: finders[name].find(preset, rig, frame, theme) if preset is not None else Patch(problem=_NO_FIT)
                for name, preset in presets.items()
            }
        )

    def _file_changed(self, _: Preset) -> None:
        self._kept = None
        self._draw()

    def _preset_changed(self, preset: Preset) -> None:
        if preset.alignment == self._kept:  # saving was undone
            self._kept = None
        self._show_tolerance()
        self._draw()

    def _show_overlay(self, overlay: Overlay) -> None:
        self._overlay = overlay
        self._compose()

    def _compose(self) -> None:
        if self._overlay is not None:
            self.image.set_image(self._overlay.composed(self.mode, self.share.value() / 100, self._blinked))

    def _show_patches(self, patches: dict[str, Patch]) -> None:
        for name, patch in patches.items():
            view = self.clouds[name]
            view.set_cloud(patch.cloud)
            empty = "No contact in this frame: press the object" if patch.points == 0 else ""
            view.set_message(patch.problem or empty)
        old, new = patches["present"], patches["new"]
        self._areas = ("–", "–") if new.problem else (_area(new), _area(old))
        self._show_comparison()

    def _show_comparison(self) -> None:
        """Show both alignments in numbers; the smaller error is marked in words."""
        report = self._outcome.report
        errors = None if report is None else replacement(report, self.present_preset())
        cells: list[tuple[str, str]] = [("–", "–")] * len(_ROWS)
        if errors is not None:
            new, present, mm = errors.new, errors.present, errors.mm_per_px
            cells[:4] = [
                _marked(errors.new_px, errors.present_px, "px", 0.1),
                _marked(errors.new_px * mm, errors.present_px * mm, "mm", 0.1 * mm),
                _marked(new.boundary_mm, present.boundary_mm, "mm", 0.1 * mm),
                _marked(100 * new.supported_tolerance, 100 * present.supported_tolerance, "%", 0.05),
            ]
        elif report is not None:
            chosen = report.chosen
            cells[:4] = [
                (at_least(chosen.alignment_px, "px"), "none"),
                (at_least(chosen.alignment_mm, "mm"), "none"),
                (at_least(chosen.effect.boundary_mm, "mm"), "none"),
                (at_least(100 * chosen.effect.supported_tolerance, "%"), "none"),
            ]
        cells[4] = self._areas
        for row, values in enumerate(cells):
            for column, text in enumerate(values):
                item = self.table.item(row, column)
                assert item is not None
                item.setText(text)

    def _mode_chosen(self, _: int = 0) -> None:
        mode = self.mode
        self.share.setEnabled(mode is OverlayMode.BLEND)
        if mode is OverlayMode.BLINK and self.isVisible():
            self._blink.start()
        else:
            self._blink.stop()
        self._compose()

    def _swap(self) -> None:
        self._blinked = not self._blinked
        self._compose()


_ROWS = (
    (
        "Expected alignment error (px)",
        "Over the whole membrane, in proximity pixels; the present one is judged by the pairs",
    ),
    ("Expected alignment error (mm)", "The same error across the line of sight, millimetres"),
    ("Patch boundary off by (mm)", "Expected error of the contact patch's boundary, millimetres"),
    (
        "Smallest t (tolerance test)",
        "With a smaller tolerance t, per cent of the distance, the tolerance test loses pixels in true contact",
    ),
    ("Patch in the present frame (cm²)", "Found by the preset's contact test in the frame that the main window shows"),
)


def _comparison_table() -> QTableWidget:
    """Return an empty table of `_ROWS` with the columns New and Present, as high as its rows."""
    table = QTableWidget(len(_ROWS), 2)
    table.setAccessibleName("New and present alignment")
    table.setToolTip("The new alignment beside the present one")
    table.setHorizontalHeaderLabels(["New", "Present"])
    table.setVerticalHeaderLabels([title for title, _ in _ROWS])
    for row, (_, tip) in enumerate(_ROWS):
        for column in range(2):
            item = QTableWidgetItem("–")
            item.setToolTip(tip)
            item.setTextAlignment(Qt.AlignmentFlag.AlignCenter)
            table.setItem(row, column, item)
        header = table.verticalHeaderItem(row)
        assert header is not None
        header.setToolTip(tip)
    table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
    table.setSelectionMode(QTableWidget.SelectionMode.NoSelection)
    table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    across, down = table.horizontalHeader(), table.verticalHeader()
    assert across is not None and down is not None
    across.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
    down.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    table.setFixedHeight(across.sizeHint().height() + down.length() + 2 * table.frameWidth())
    return table


def _marked(new: float, present: float, unit: str, least: float) -> tuple[str, str]:
    """Return both errors in words; one that is clearly smaller, by ``least`` or more, is marked as better."""
    texts = [at_least(value, unit) for value in (new, present)]
    for number, (error, other) in enumerate(((new, present), (present, new))):
        if clearly_larger(other, error, least):
            texts[number] += "  ✓ better"
    return texts[0], texts[1]


def _area(patch: Patch) -> str:
    return "–" if patch.problem else f"{patch.area_mm2 / 100:.1f} cm²"
