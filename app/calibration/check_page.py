"""The last page: the new alignment beside the present one, before it is saved."""

from __future__ import annotations

from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtGui import QHideEvent, QShowEvent
from PyQt6.QtWidgets import QButtonGroup, QCheckBox, QComboBox, QFormLayout, QHBoxLayout, QLabel, QSlider, QWidget

from ...core.calibration.geometry import Alignment
from ...core.calibration.recheck import present_error_px
from ...core.contact.checks import rig_in_use
from ...core.preset import AlignmentSection, Preset
from ...widgets.basics.controls import AccentButton
from ...widgets.basics.layouts import splitter, vbox
from ...widgets.basics.theme import theme_name
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from ...widgets.images.point_image import PointImage
from ..document.document import Document
from ..worker.feed import FrameFeed
from ..worker.jobs import Job
from .fitting import Outcome, at_least
from .overlay import Overlay, Patch, PatchFinder, make_overlay
from .session import Session, SessionState

_BLINK_MS = 450
_NO_FIT = "No calibration yet: click at least four pairs on the page Points"
_MODES = (
    ("Blend", "Both images blended; the slider sets the tactile image's weight"),
    ("Blink", "Both images alternating: nothing on the membrane may jump"),
)
_WHICH = (("new", "New"), ("present", "Present"))


class CheckPage(QWidget):
    """The tactile image over the proximity image, and the contact patch with each alignment."""

    def __init__(self, session: Session, document: Document, feed: FrameFeed) -> None:
        super().__init__()
        self._session, self._document, self._feed = session, document, feed
        self._outcome = Outcome()
        self._kept: AlignmentSection | None = None
        self._overlay: Overlay | None = None
        self._drawn: tuple[object, ...] = ()
        self._blinked = False
        self._finders = {"present": PatchFinder(), "new": PatchFinder()}
        self._overlay_job, self._patch_job = Job(self), Job(self)
        self._blink = QTimer(self)
        self._blink.setInterval(_BLINK_MS)
        self.image = PointImage("Tactile image over proximity image")
        self.image.set_loupe_wanted(False)
        self.clouds = {"new": CloudView("New alignment"), "present": CloudView("Present alignment")}
        link_cameras(list(self.clouds.values()))
        self.errors, self.areas = QLabel(), QLabel()
        self.set_tolerance = QCheckBox()
        self.set_tolerance.setToolTip(
            "Set the tolerance t, per cent of the distance, to the smallest that this calibration supports; the "
            "membrane contact test has no t"
        )
        self.share = QSlider(Qt.Orientation.Horizontal)
        self.share.setRange(0, 100)
        self.share.setValue(50)
        self.share.setMinimumWidth(60)
        self.share.setAccessibleName("Share of the tactile image")
        self.share.setToolTip("Share of the tactile image, percent")
        self.pixels = QComboBox()
        self.pixels.setAccessibleName("Images")
        self.pixels.setToolTip("Colour shows the membrane's dots, depth shows the pressed object")
        self.pixels.addItem("Colour", "color")
        self.pixels.addItem("Depth", "depth")
        self._lay_out()
        self._connect()
        self.show_outcome(Outcome())

    def _lay_out(self) -> None:
        self.modes, self.which = QButtonGroup(self), QButtonGroup(self)
        tools = QHBoxLayout()
        modes = [AccentButton(title, tip) for title, tip in _MODES]
        which = [AccentButton(title, f"Overlay the images with the {title.lower()} alignment") for _, title in _WHICH]
        for group, buttons in ((self.modes, modes), (self.which, which)):
            for number, button in enumerate(buttons):
                group.addButton(button, number)
            buttons[0].setChecked(True)
        for widget in (*modes, self.share, self.pixels, QLabel("Alignment"), *which):
            tools.addWidget(widget, 1 if widget is self.share else 0)
        self.numbers = QWidget()
        form = QFormLayout(self.numbers)
        form.setContentsMargins(0, 0, 0, 0)
        for title, value, tip in (
            (
                "Expected alignment error",
                self.errors,
                "Over the membrane; the present one is judged by the pairs",
            ),
            ("Patch in the present frame", self.areas, "Found by the preset's contact test in the main window's frame"),
        ):
            value.setToolTip(tip)
            form.addRow(title, value)
        left = QWidget()
        vbox(tools, (self.image, 1), self.numbers, self.set_tolerance, within=left, margins=0)
        right = splitter(Qt.Orientation.Vertical, *self.clouds.values())
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
        self.areas.setText("–")
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
        self._show_errors()
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
            self._overlay_job.start(lambda _: make_overlay(Alignment.of_preset(section, rig), rig, frame, image))

    def _show_errors(self) -> None:
        """Show the expected errors of both alignments."""
        report = self._outcome.report
        present = None if report is None else present_error_px(report, self.present_preset())
        words = "–"
        if report is not None:
            chosen = report.chosen
            words = f"<b>{at_least(chosen.alignment_px, 'px')}, {at_least(chosen.alignment_mm, 'mm')}</b> new"
            words += "" if present is None else f"; {at_least(present, 'px')} present"
        self.errors.setText(words)

    def _find_patches(self) -> None:
        """Find the patches in the newest frame if the page is visible."""
        if not self.isVisible() or (self._patch_job.busy and self._feed.playback.playing):
            return
        frame = self._feed.frame
        presets = {"present": self.present_preset(), "new": self.new_preset()}
        if self.areas.text() == "–":
            for view in self.clouds.values():
                view.set_message("Finding the patch…")
        rig, theme, finders = self._session.rig, theme_name(), self._finders
        self._patch_job.start(
            lambda _: {
                name: finders[name].find(preset, rig, frame, theme) if preset is not None else Patch(problem=_NO_FIT)
                for name, preset in presets.items()
            }
        )

    def _show_patches(self, patches: dict[str, Patch]) -> None:
        words = []
        for name, view in self.clouds.items():
            patch = patches[name]
            view.set_cloud(patch.cloud)
            empty = "No contact in this frame: press the object" if patch.points == 0 else ""
            view.set_message(patch.problem or empty)
            words.append(f"{'–' if patch.problem else f'{patch.area_mm2 / 100:.1f} cm²'} {name}")
        self.areas.setText("–" if patches["new"].problem else "; ".join(words))

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
        overlay = self._overlay
        if overlay is not None and self._blink.isActive():
            self.image.set_image(overlay.tactile if self._blinked else overlay.proximity)
        elif overlay is not None:
            self.image.set_image(overlay.blended(self.share.value() / 100))

    def _mode_chosen(self, _: int = 0) -> None:
        blinks = self.modes.checkedId() == 1
        self.share.setEnabled(not blinks)
        if blinks and self.isVisible():
            self._blink.start()
        else:
            self._blink.stop()
        self._compose()

    def _swap(self) -> None:
        self._blinked = not self._blinked
        self._compose()
