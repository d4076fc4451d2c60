"""The tab Ground truth: a painted scan's contact compared with the patch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QDragEnterEvent, QDropEvent, QKeyEvent
from PyQt6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QMenu,
    QSlider,
    QWidget,
)

from ...core.errors import TactuneError
from ...core.evaluation.scan.scan import SUFFIXES
from ...core.model.units import UNITS_M
from ...core.preset import Preset
from ...core.preset.file import shipped_presets
from ...core.sources.presets import load_preset
from ...widgets.basics.controls import ProgressBar, caption, push_button, wrapped_label
from ...widgets.basics.dialogs import local_files
from ...widgets.basics.layouts import STRETCH, hbox, scrolling, splitter, vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import Context
from ..worker.results import Result
from .tab import AnalysisTab, undo_buttons
from .truth_flow import TruthFlow, next_step
from .truth_panels import AlignPanel, PaintPanel, ResultPanel
from .truth_state import TruthState
from .truth_views import TruthViews

_SCAN_FILTER = f"Painted scans ({' '.join(f'*{suffix}' for suffix in SUFFIXES)})"
_TRANSFORM_FILTERS = ["Transforms (*.json)"]
_UNIT, _RECENT, _FOLDER, _POINT_SIZE = "scan/unit", "scans", "folder/scan", "scan/point_size"
_USUAL_POINT_PX, _LARGEST_POINT_PX = 3, 8
_PANEL_WIDTH = 380
_DROPPING = {
    "set": "Eyedropper: click touched paint on the scan; press Pick again to stop.",
    "expand": "Eyedropper: click touched paint that is missing; press + again to stop.",
    "shrink": "Eyedropper: click other paint; press − again to stop.",
}
#: Number of vertices nearest to the click that an eyedropper uses.
_DROP = 25


class TruthTab(AnalysisTab):
    """Both views and the panels, wired to `TruthFlow`, which does the work."""

    def __init__(self, context: Context) -> None:
        super().__init__()
        self._document, self._settings, self._dialogs = context.document, context.settings, context.dialogs
        self._asked: Path | None = None
        self._named: tuple[Preset | None, str] = None, ""
        self.flow = TruthFlow(context.data_folder / "scans", self._preset_name, self)
        self.views = TruthViews(self.flow, context.cloud_backend)
        self.paint, self.align, self.result = PaintPanel(), AlignPanel(), ResultPanel()
        self.messages = Messages(self)
        self.open_button = push_button(
            "&Open scan…", "Open the object's painted scan: PLY or OBJ with colours (or drop it here)"
        )
        self.recent, self.unit = push_button("Recent", "Recently opened scans"), QComboBox()
        self.progress, self.cancel = ProgressBar(), push_button("Cancel", "Cancel reading the scan")
        self.guide = wrapped_label(verdict=True)
        self._framed: object = None
        self._lay_out()
        self._connect()
        self._show_load_progress(1.0, "")
        self._show_state(self.flow.state)
        self.setAcceptDrops(True)

    def show_result(self, result: Result) -> None:
        """Show a frame of the main window, until alignment begins."""
        self.flow.show_result(result)

    def shut_down(self) -> None:
        """Save the work and stop all threads."""
        self.flow.shut_down()

    # Building

    def _lay_out(self) -> None:
        panels = QWidget()
        vbox(self.paint, self.align, self.result, STRETCH, within=panels, margins=(0, 0, 4, 0))
        across = splitter(Qt.Orientation.Horizontal, (self.views, 1), scrolling(panels, _PANEL_WIDTH))
        vbox(self._top(), self.guide, (across, 1), within=self, margins=0)

    def _top(self) -> QHBoxLayout:
        self.recent.setMenu(QMenu(self.recent))
        self.unit.addItems(list(UNITS_M))
        self.unit.setCurrentText(self._settings.text(_UNIT, "m"))
        self.unit.setToolTip("Length unit of the scan's coordinates; an open scan is read again")
        unit = caption("&Unit", self.unit)
        self.progress.setMaximumWidth(320)
        return hbox(
            self.open_button,
            self.recent,
            unit,
            self.unit,
            self.progress,
            self.cancel,
            STRETCH,
            self._point_size(),
            *undo_buttons(self, self.flow.session.undo_stack),
        )

    def _point_size(self) -> QHBoxLayout:
        size = QSlider(Qt.Orientation.Horizontal)
        size.setRange(1, _LARGEST_POINT_PX)
        size.setFixedWidth(90)
        size.setToolTip("Point size in pixels")
        size.setAccessibleName("Point size")
        size.valueChanged.connect(self.views.set_point_size)
        size.valueChanged.connect(lambda pixels: self._settings.set(_POINT_SIZE, pixels))
        size.setValue(round(self._settings.number(_POINT_SIZE, _USUAL_POINT_PX)))
        return hbox(caption("Point si&ze", size), size)

    def _connect(self) -> None:
        flow, session, views = self.flow, self.flow.session, self.views
        session.changed.connect(self._show_state)
        flow.scanChanged.connect(self._show_scan)
        flow.patchChanged.connect(self._show_patch)
        flow.scoresChanged.connect(self._show_scores)
        flow.refinedChanged.connect(lambda: self.align.show_refinement(flow.refinement))
        flow.message.connect(self.messages.state)
        flow.loadProgress.connect(self._show_load_progress)
        flow.refineProgress.connect(self._show_refine_progress)
        self.open_button.clicked.connect(self._ask_scan)
        self.cancel.clicked.connect(flow.cancel_loading)
        self.unit.activated.connect(self._unit_chosen)
        menu = self.recent.menu()
        assert menu is not None
        menu.aboutToShow.connect(self._fill_recent)
        views.scan.pointClicked.connect(self._scan_clicked)
        views.patch.pointClicked.connect(lambda _, place: flow.click("patch", place))
        views.patch.nudged.connect(lambda change, gesture: session.nudge(change, flow.patch, gesture))
        views.present.clicked.connect(flow.take_present)
        views.follow.clicked.connect(lambda: session.freeze(None))
        self.paint.edited.connect(session.set_paint)
        self.paint.highlight.toggled.connect(views.set_highlight)
        self.paint.eyedropperChanged.connect(lambda mode: views.set_dropper(mode != "off"))
        self.paint.eyedropperChanged.connect(self._show_guide)
        self._connect_panels()

    def _connect_panels(self) -> None:
        flow, session, align = self.flow, self.flow.session, self.align
        align.selectionChanged.connect(self.views.set_selected)
        align.removeRequested.connect(session.remove)
        align.clear.clicked.connect(session.remove_all)
        align.center.clicked.connect(flow.center_on_patch)
        align.poseEdited.connect(
            lambda pose, gesture: session.set_pose(pose, "hand", "Type the scan's path", flow.patch, gesture)
        )
        align.refineRequested.connect(flow.refine)
        align.cancel.clicked.connect(flow.cancel_refining)
        self.result.save.clicked.connect(self._ask_save)
        self.result.load.clicked.connect(self._ask_load)
        self.result.copied.connect(flow.keeper.flush)

    # Opening

    def open_scan(self, path: Path) -> None:
        """Read a scan in the chosen unit."""
        self._asked = path
        self._settings.add_recent(_RECENT, str(path))
        self._settings.set(_FOLDER, str(path.parent))
        self.flow.open_scan(path, self.unit.currentText())
        self._show_guide()

    def _ask_scan(self) -> None:
        self._dialogs.over(self.window() or self).open_file(
            "Open a painted scan", self._folder(), _SCAN_FILTER, self.open_scan
        )

    def _folder(self) -> Path:
        remembered = Path(self._settings.text(_FOLDER, str(Path.home())))
        return remembered if remembered.is_dir() else Path.home()

    def _unit_chosen(self) -> None:
        self._settings.set(_UNIT, self.unit.currentText())
        if path := self._asked or (self.flow.loaded and self.flow.loaded.path):
            self.open_scan(path)

    def _fill_recent(self) -> None:
        menu = self.recent.menu()
        assert menu is not None
        menu.clear()
        paths = self._settings.recent(_RECENT)
        for text in paths:
            action = menu.addAction(text)
            assert action is not None
            action.triggered.connect(lambda _, path=Path(text): self.open_scan(path))
        if not paths:
            nothing = menu.addAction("No scan was opened yet")
            assert nothing is not None
            nothing.setEnabled(False)

    def dragEnterEvent(self, event: QDragEnterEvent | None) -> None:
        """Accept one scan."""
        if event is not None and any(_is_scan(path) for path in local_files(event.mimeData())):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent | None) -> None:
        """Open the dropped scan."""
        if event is not None:
            path = next(path for path in local_files(event.mimeData()) if _is_scan(path))
            event.acceptProposedAction()
            self.open_scan(path)

    # Actions

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """On Esc, deactivate the eyedropper or remove the pending click."""
        pending = self.flow.state.pending is not None
        if event is not None and event.key() == Qt.Key.Key_Escape and (pending or self.paint.eyedropper != "off"):
            if self.paint.eyedropper != "off":
                self.paint.put_away()
            else:
                self.flow.session.remove(len(self.flow.state.pairs) - 1)
            return
        super().keyPressEvent(event)

    def _scan_clicked(self, pixel: int, place: tuple[float, float, float]) -> None:
        loaded = self.flow.loaded
        if loaded is None:
            return
        if self.paint.eyedropper == "off":
            self.flow.click("scan", place)
            return
        apart = np.linalg.norm(loaded.scan.vertices_m - np.array(place), axis=1)
        nearest = np.argpartition(apart, min(_DROP, len(apart) - 1))[:_DROP]
        try:
            self.paint.pick(loaded.scan.colors[nearest])
        except TactuneError as error:
            self.messages.show_message("paint", Severity.WARNING, f"{error}.")

    def _preset_name(self) -> str:
        """Return the preset for ``--preset``; empty if it is not saved."""
        document = self._document
        if document.path is not None:
            return "" if document.dirty else str(document.path)
        if document.preset is not self._named[0]:
            self._named = document.preset, shipped_name(document.preset)
        return self._named[1]

    def _ask_save(self) -> None:
        loaded = self.flow.loaded
        if loaded is not None:
            suggestion = loaded.path.with_suffix(".transform.json")
            self._dialogs.over(self.window() or self).save_file(
                "Save the transform", suggestion, _TRANSFORM_FILTERS, self.flow.save_transform
            )

    def _ask_load(self) -> None:
        self._dialogs.over(self.window() or self).open_file(
            "Load a transform", self._folder(), _TRANSFORM_FILTERS[0], self.flow.load_transform
        )

    # Display

    def _show_scan(self) -> None:
        flow = self.flow
        another = flow.loaded is not self._framed
        self._framed = flow.loaded
        self.views.show_scan(another)
        if flow.contact is not None:
            count = int(np.count_nonzero(flow.contact.vertices))
            self.paint.show_readout(count, flow.contact.area_mm2, len(flow.contact.vertices))
        self._show_state(flow.state)

    def _show_patch(self) -> None:
        self.views.show_patch()
        self._show_guide()

    def _show_state(self, state: TruthState) -> None:
        self.paint.show_paint(state.paint)
        self.paint.setEnabled(self.flow.loaded is not None)
        self.align.setEnabled(self.flow.loaded is not None)
        self.align.show_pairs(state.pairs, self.flow.residuals_mm())
        self.align.show_pose(state.pose, self.flow.pivot())
        self.views.show_patch()
        self.views.show_marks()
        if self.flow.loaded is None:
            self.paint.show_text("Open a scan first.")
        self._show_scores()
        self._show_guide()

    def _show_scores(self) -> None:
        flow = self.flow
        self.result.show_scores(flow.scores)
        self.result.load.setEnabled(flow.loaded is not None)
        self.result.show_command(flow.command(), _note(flow))
        self.result.save.setEnabled(flow.state.pose is not None)

    def _show_guide(self) -> None:
        dropper = self.paint.eyedropper
        self.guide.setText(_DROPPING[dropper] if dropper in _DROPPING else next_step(self.flow))

    def _show_load_progress(self, share: float, words: str) -> None:
        busy = share < 1
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.progress.show_share(share, words)
        self._show_guide()

    def _show_refine_progress(self, share: float, words: str) -> None:
        self.align.show_progress(share, words)
        self._show_guide()


def shipped_name(preset: Preset) -> str:
    """Return the name of the shipped preset that equals this one except for name and dates, or an empty string."""
    own = {"name": preset.name, "created": preset.created, "modified": preset.modified}
    return next((name for name in shipped_presets() if load_preset(name).model_copy(update=own) == preset), "")


def _note(flow: TruthFlow) -> str:
    """Return why the command line may give other numbers."""
    patch, result = flow.patch, flow.result
    if patch is None or flow.state.pose is None:
        return ""
    if result is not None and result.source.name == patch.source and result.source.length is None:
        return "The source is live: to repeat this, record it and give the recording to --source."
    return "" if patch.preset else "The preset is not saved: to repeat this, save it and add --preset."


def _is_scan(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES
