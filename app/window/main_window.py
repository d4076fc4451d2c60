"""The main window: its layout, and the connections between its parts."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import cast

from PyQt6.QtCore import QEvent, QSignalBlocker, QSize, Qt
from PyQt6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent, QKeyEvent, QResizeEvent
from PyQt6.QtWidgets import QApplication, QMainWindow, QWidget

from ...core.preset import Preset
from ...core.preset.file import shipped_presets
from ...core.sources.registry import open_source
from ...core.tuning.advice.suggest import SECTIONS
from ...widgets.basics.controls import ProgressCard, free_space_bar
from ...widgets.basics.dialogs import Dialogs, bring_up, local_files, room_on
from ...widgets.basics.layouts import hbox, holding, scrolling, splitter, vbox
from ...widgets.basics.messages import Messages, Offer, Severity
from ...widgets.basics.style import apply_theme
from ...widgets.basics.theme import THEME, ThemeChoice
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ...widgets.plots.time_strip import TimeStrip
from ..advice.window import ALL, SuggestControl
from ..analysis.window import AnalysisLauncher
from ..calibration.wizard import CalibrationLauncher
from ..context import SOURCE, TASK, Context
from ..document.document import Document
from ..document.recovery import Autosave
from ..rig.force_window import ForceWindow
from ..rig.set_up_panel import SetUpPanel, StepRow
from ..rig.untouched import UntouchedKeeper
from ..rig.watch_control import WatchControl
from ..settings import Settings
from ..sources.camera_settings import CameraPanel
from ..sources.cameras_page import CAMERAS
from ..sources.opening import OpenControl
from ..sources.pages import RECENT
from ..sources.topics import WITHOUT_TOPICS, TopicsControl
from ..timeline.control import Timeline
from ..worker.errors import ErrorHook
from ..worker.reading import SourceRequest
from ..worker.results import Result, SourceInfo, Wanted
from ..worker.worker import Worker
from .actions import THEMES, Actions, Menus, plain_text
from .comparison import ComparisonPanel
from .export import Export
from .files import FileFlows
from .findings import LOW_PX, RAIL_PX, FindingsControl, FindingsRail
from .frame_presenter import FramePresenter
from .help import open_guide, show_about
from .modes import COLUMN_PX, Mode, ModeColumn, RunPanel
from .pointing import Eyedropper, Pointing
from .publishing import PublishControl
from .recording import RecordingBar
from .search import Entry, Search, of_action
from .status import FrameStatus
from .toolbar import ModeBar, Transport, fill_on_opening
from .view_area import ViewArea

#: Size of the first window, pixels, at least.
DEFAULT_SIZE = QSize(1280, 800)

_OPENING = "Preparing the first frame…"
_NO_SOURCE = "No source is open: open one (Ctrl+O), or drop a recording here"
#: The actions whose state is remembered between starts.
_TOGGLES = ("watch_drift", "show_strip", "show_panel", "show_proximity", "show_tactile", "show_patch")
#: The actions whose keys work in the analysis window too.
_SHARED_ACTIONS = ("undo", "redo", "capture_untouched", "measure_noise", "previous", "next", "first", "loop")
_COLLAPSED_AT_FIRST = "alignment,range,region"


class MainWindow(QMainWindow):
    """Shows both sensors and the patch live. It computes nothing: the `Worker` does, and draws what is visible."""

    def __init__(self, preset: Preset, settings: Settings, data_folder: Path, native_dialogs: bool = True) -> None:
        super().__init__()
        self.settings = settings
        self.document = Document(preset, self)
        self.worker = Worker(preset, self)
        self.autosave = Autosave(self.document, data_folder, self)
        self.error_hook = ErrorHook(self)
        self.actions_ = Actions(self, self.document.undo_stack)
        self.opening = ProgressCard("Progress of opening", "Cancel opening; the present source stays")
        self.export_bar = ProgressCard("Progress of the export", "Cancel the export")
        self.strip = ImageStrip()
        self.views = ViewArea(self.actions_, self.strip)
        self.beside = QWidget()
        self.messages = Messages(self.beside, room_px=RAIL_PX)
        self.worker.opened.connect(self._forget_source)  # before the parts below speak of the new one
        self.time_strip = TimeStrip()
        self.panel = ParameterPanel(suggestible=SECTIONS)
        self.transport = Transport(self.actions_)
        self.status = FrameStatus()
        self.dialogs = Dialogs(self, settings, native_dialogs)
        self.context = Context(self.document, self.worker, self.messages, self.dialogs, settings, data_folder, self)
        self.file_flows = FileFlows(self.context, self.autosave, self.actions_)
        self.presenter = FramePresenter(self.context, self.views, self.strip, self.panel, self.transport, self.status)
        self.comparison = ComparisonPanel(self.context, self.actions_, self.presenter)
        self.rail = FindingsRail()
        self.findings = FindingsControl(self.context, self.actions_, panel=self.panel, views=self.views, rail=self.rail)
        self.eyedropper = Eyedropper(self.context, self.panel, self.strip)
        self.recording = RecordingBar(self.context, self.actions_.record)
        self.timeline = Timeline(self.context, self.time_strip)
        self.export = Export(self.context, self.export_bar, self.views)
        self.calibration = CalibrationLauncher(self.context)
        self.cameras = CameraPanel(self.context)
        self.sources = OpenControl(self.context)
        self.topics = TopicsControl(self, self.dialogs, self.open_named, self._open_failed)
        self.untouched = UntouchedKeeper(self.context)
        self.watch = WatchControl(
            self.context,
            self.actions_.watch_drift,
            calibrate=self.calibration.open_wizard,
            capture=self.actions_.capture_untouched.trigger,
        )
        self.suggest = SuggestControl(self.context)
        shared = [getattr(self.actions_, name) for name in _SHARED_ACTIONS]
        self.analysis = AnalysisLauncher(self.context, self.actions_.play, shared)
        self._given_up: Preset | None = None  # unsaved, and may be lost
        self._lay_out()
        self._connect()
        self.restore_layout()
        self._show_document()
        self.panel.set_preset(preset)
        self.panel.set_baseline(preset)
        self._enable_measuring(False)
        self.views.show_message(_NO_SOURCE)
        self.views.setFocus()
        self._send_wanted()
        self.worker.start()

    @property
    def result(self) -> Result | None:
        """The frame on the screen; None before the first one of a source."""
        return self.context.result

    def _lay_out(self) -> None:
        bar = self.menuBar()
        assert bar is not None
        self.menus = Menus(bar, self.actions_, list(self.analysis.actions.values()))
        self.pointing = Pointing(self.context, self.views, self.strip)
        self.force = ForceWindow(self.context)
        self.publishing = PublishControl(self.context, self.status.publishing)
        self.set_up = SetUpPanel(self.context, self.actions_.by_name())
        run = RunPanel(self.context, self.actions_, self.recording, self.publishing.panel, self.status.details)
        self.worker.opened.connect(run.show_source)
        panels = {Mode.SET_UP: scrolling(self.set_up), Mode.TUNE: self.panel, Mode.RUN: scrolling(run)}
        self.modes = ModeColumn(self.context, self.actions_, panels)
        self._compared = scrolling(self.comparison)
        self.comparison.hide()
        self._compared.hide()
        # no box layout, which would take as much from the fields that differ as from the longer column
        column = splitter(Qt.Orientation.Vertical, (self._compared, 2), (self.modes, 1), sizes=(20_000, 10_000))
        vbox((column, 4), (self.rail, 1), within=self.beside, margins=0, spacing=4)
        self.beside.setFixedWidth(COLUMN_PX)
        self.search = Search(self._found_by_name, self.views.setFocus)
        self.mode_bar = ModeBar(self.actions_, self.menus.preset, self.search)
        playback = hbox(self.transport, (self.time_strip, 1), margins=(4, 0, 4, 0), spacing=4)
        left = vbox((self.views, 1), playback, margins=0, spacing=4)
        across = hbox((left, 1), self.beside, margins=(4, 0, 4, 0), spacing=8)
        self.setCentralWidget(holding(vbox(self.mode_bar, (across, 1), margins=0, spacing=0)))
        for part in (self.opening, self.export_bar):
            self.messages.pin(part)
        self.messages.covers.connect(self.rail.leave_free)
        self.setStatusBar(self.status)
        self.setAcceptDrops(True)
        self.setMinimumSize(960, 500)

    def _found_by_name(self) -> list[Entry]:
        """Return what the search finds: the actions of menus and analyses, and the parameters."""
        actions = [*self.actions_.by_name().values(), *self.analysis.actions.values()]
        chosen = [("Theme: ", self.menus.themes), ("Speed: ", self.menus.speeds)]
        found = [of_action(plain_text(action), action) for action in actions]
        found += [of_action(before + plain_text(entry), entry) for before, group in chosen for entry in group.actions()]
        for path, row in self.panel.rows.items():
            section = self.panel.sections[path.partition(".")[0]].button.text()
            found.append((f"{section}: {row.spec.title}", "parameter", partial(self._show_parameter, path)))
        found += [(f"Export: {kind}", "", partial(self.export.ask, kind)) for kind in self.export.kinds()]
        return found

    def _show_parameter(self, path: str) -> None:
        self.actions_.show_panel.setChecked(True)
        self.actions_.tune.trigger()
        self.panel.go_to(path)

    def _connect(self) -> None:
        document, panel, worker, transport = self.document, self.panel, self.worker, self.transport
        # The document
        document.presetChanged.connect(lambda preset: self.worker.set_preset(preset, document.untouched_home))
        document.presetChanged.connect(panel.set_preset)
        document.presetChanged.connect(self._show_document)
        document.presetChanged.connect(lambda _: self.messages.clear("refused"))
        document.fileChanged.connect(self._show_document)
        document.baselineChanged.connect(panel.set_baseline)
        document.refused.connect(self._refused)
        panel.valueEdited.connect(document.edit)
        panel.valuesEdited.connect(document.edit_many)
        panel.suggestRequested.connect(self.suggest.open)
        self.autosave.failed.connect(partial(self.messages.show_message, "autosave", Severity.WARNING))
        self.error_hook.raised.connect(
            lambda sentence, details: self.messages.show_message("defect", Severity.ERROR, sentence, details=details)
        )

        # The worker
        worker.resultReady.connect(self._show_newest)
        worker.opening.connect(self._show_opening)
        worker.opened.connect(self._opened)
        worker.openFailed.connect(self._open_failed)
        worker.failed.connect(partial(self.messages.show_message, "worker", Severity.ERROR, subject=SOURCE))
        worker.recovered.connect(partial(self.messages.clear, "worker"))
        worker.playbackChanged.connect(transport.show_change)
        worker.playbackChanged.connect(self.status.show_playback)
        self.actions_.record.toggled.connect(self.status.show_recording)
        worker.stateChanged.connect(self.presenter.show_state)
        transport.position.valueChanged.connect(worker.seek)
        self.opening.cancel.clicked.connect(worker.cancel_open)
        for name in ("mark_in", "mark_out", "clear_marks"):
            action, act = self.actions_.by_name()[name], getattr(self.timeline, name)
            action.triggered.connect(lambda _, act=act: act())
            self.timeline.availableChanged.connect(action.setEnabled)
            action.setEnabled(False)

        # What is visible
        self.views.wantedChanged.connect(self._send_wanted)
        self.comparison.runningChanged.connect(self._show_beside)
        self.views.wipeDragged.connect(self.comparison.move_wipe)
        self.strip.wipeDragged.connect(self.comparison.move_wipe)
        self.strip.wantedChanged.connect(self._send_wanted)
        self.strip.regionEdited.connect(partial(self.document.edit, "region.rectangle"))
        self.panel.show_mask.clicked.connect(self._send_wanted)
        THEME.changed.connect(self._send_wanted)  # also the desktop's
        self.eyedropper.started.connect(self._show_color_image)
        for path in panel.histograms:
            panel.sections[path.partition(".")[0]].button.folded.connect(self._send_wanted)
        self._connect_actions()

    def _connect_actions(self) -> None:
        actions, worker, flows = self.actions_, self.worker, self.file_flows
        actions.play.triggered.connect(lambda: worker.pause() if self.transport.state.playing else worker.play())
        actions.previous.triggered.connect(lambda: worker.step(-1))
        actions.next.triggered.connect(lambda: worker.step(1))
        actions.first.triggered.connect(lambda: worker.seek(0))
        actions.loop.triggered.connect(worker.set_loop)
        actions.export.triggered.connect(lambda _: self.export.ask())
        actions.calibrate.triggered.connect(self.calibration.open_wizard)
        actions.check_drift.triggered.connect(self.watch.open)
        actions.calibrate_force.triggered.connect(partial(bring_up, self.force))
        actions.measure_noise.triggered.connect(lambda: self._come_to(self.set_up.noise))
        actions.findings.triggered.connect(self.rail.focus_first)
        actions.publish.triggered.connect(self._show_publishing)
        actions.search.triggered.connect(self.search.begin)
        self.status.publishing.clicked.connect(self._show_publishing)
        self.status.state.clicked.connect(actions.run.trigger)
        self.modes.modeChanged.connect(self._send_wanted)
        actions.open_source.triggered.connect(self.sources.open)
        actions.cameras.triggered.connect(self.sources.open_cameras)
        actions.camera_settings.triggered.connect(partial(bring_up, self.cameras))
        actions.capture_untouched.triggered.connect(lambda: self._come_to(self.set_up.untouched))
        actions.suggest_all.triggered.connect(lambda: self.suggest.open(ALL))
        actions.recordings_folder.triggered.connect(
            lambda: self.dialogs.open_folder("recordings", "Folder for recordings", self.recording.use_folder)
        )
        self.context.sourceRequested.connect(self.open_source)
        actions.quit.triggered.connect(self.close)
        actions.show_panel.toggled.connect(self._show_beside)
        actions.messages.setEnabled(False)
        actions.messages.triggered.connect(self.messages.focus_newest)
        self.messages.covers.connect(lambda _: actions.messages.setEnabled(bool(self.messages.by_key)))
        actions.shortcuts.triggered.connect(lambda: open_guide(self.messages, "keys"))
        actions.documentation.triggered.connect(lambda: open_guide(self.messages))
        actions.about.triggered.connect(lambda: show_about(self))
        menus = self.menus
        menus.themes.triggered.connect(lambda entry: self.set_theme(entry.data()))
        menus.speeds.triggered.connect(lambda entry: worker.set_speed(entry.data()))
        for entry in menus.speeds.actions():
            entry.setChecked(entry.data() == 1.0)
        fill_on_opening(menus.shipped_presets, shipped_presets, flows.new)
        fill_on_opening(
            menus.recent_presets, partial(self.settings.recent, "presets"), lambda path: flows.open_preset(Path(path))
        )

    def open_source(self, name: str) -> None:
        """Open a source by its name, after its topics were asked for if it is a recording of another program."""
        if name.partition(":")[0] in WITHOUT_TOPICS:
            self.open_named(name)
        else:
            self.topics.open(name)

    def open_named(self, name: str) -> None:
        """Open a source; the present one stays open until that has succeeded."""
        cameras = self.document.preset.cameras
        exclusive = name.startswith(CAMERAS)
        self.open_request(SourceRequest(name, lambda progress: open_source(name, progress, cameras), exclusive))

    def open_request(self, request: SourceRequest) -> None:
        self.messages.clear_subject(TASK)
        if self.result is None:
            self.views.show_message(_OPENING)
        self.worker.open(request)

    def _forget_source(self, info: SourceInfo) -> None:
        """Discard what is shown of the former source, unless a frame of the new one has arrived first."""
        if self.result is None or self.result.source is not info:
            self.messages.clear_subject(SOURCE)
            self.panel.clear_errors()
            self.presenter.forget()
            self.actions_.export.setEnabled(False)
            self.views.show_message(_OPENING)

    def _show_opening(self, name: str, share: float, words: str) -> None:
        self.opening.show_share(share, f"Opening {name}{': ' + words if words else '…'}")

    def _enable_measuring(self, enabled: bool) -> None:
        actions = self.actions_
        for action in (actions.calibrate, actions.check_drift, actions.suggest_all):
            action.setEnabled(enabled)
        if not enabled:
            actions.export.setEnabled(False)  # enabled with the first frame
        self.panel.enable_measuring(enabled)

    def _opened(self, info: SourceInfo) -> None:
        self.opening.hide()
        self._enable_measuring(True)
        two = info.rig.has_proximity  # else what needs two cameras is hidden or disabled
        for part in (self.views, self.strip, self.panel, self.actions_):
            part.set_two_cameras(two)
        self.settings.add_recent(RECENT, info.name)
        self.mode_bar.show_source(info)
        self.file_flows.offer_preset(info.preset)

    def _open_failed(self, name: str, sentence: str) -> None:
        self.opening.hide()
        if sentence and not self.sources.take_failure(name, sentence):
            offers: list[Offer] = [("Try again", partial(self.open_source, name)), ("Open…", self.sources.open)]
            self.messages.show_message("source", Severity.ERROR, sentence, offers, subject=TASK)
        if self.result is None:
            self.views.show_message(_NO_SOURCE)

    def _show_newest(self) -> None:
        result = self.worker.take()
        assert result is not None
        self.presenter.show(result)
        self.actions_.export.setEnabled(True)
        self.context.frameShown.emit()

    def _send_wanted(self) -> None:
        """Tell the worker what is visible; nothing else is drawn."""
        panel = not self.panel.isHidden() and not self.beside.isHidden()
        self.worker.set_wanted(
            Wanted(
                clouds=self.views.visible_clouds(),
                color_by=self.views.colors,
                images=frozenset() if self.strip.isHidden() else frozenset(self.strip.shown_images()),
                strip_width=self.strip.width_hint(),
                shows_mask=self.panel.show_mask.isChecked(),
                histograms=self.panel.open_histograms() if panel else frozenset(),
                dark=THEME.name == "dark",
            )
        )

    def _come_to(self, step: StepRow) -> None:
        bring_up(self)  # the analysis window has these actions, too
        self.actions_.show_panel.setChecked(True)
        self.modes.choose(Mode.SET_UP)
        self.set_up.choose(step)

    def _show_color_image(self) -> None:
        if self.views.large is not self.strip.panes["color"]:
            self.views.back()
        self.actions_.show_strip.setChecked(True)
        self.strip.choose("color")

    def _show_beside(self) -> None:
        """Give the views the whole width while controls are hidden; messages stand over them meanwhile."""
        shown = self.actions_.show_panel.isChecked() or not self.comparison.isHidden()
        self.beside.setVisible(shown)
        self._compared.setVisible(not self.comparison.isHidden())
        self.messages.move_over(self.beside if shown else self.views)
        self._send_wanted()

    def _show_publishing(self) -> None:
        self.actions_.show_panel.setChecked(True)
        self.actions_.run.trigger()
        self.publishing.panel.foxglove.setFocus(Qt.FocusReason.ShortcutFocusReason)

    def _show_document(self) -> None:
        preset = self.document.preset
        self.strip.set_region(preset.region.rectangle if preset.region.enabled else None)
        self.setWindowTitle(f"{preset.name}[*]")
        self.setWindowModified(self.document.dirty)
        self.mode_bar.show_preset(self.document.title, self.document.path)

    def _refused(self, path: str, sentence: str) -> None:
        if path in self.panel.rows:
            self.panel.show_error(path, sentence)
        else:
            self.messages.show_message("refused", Severity.ERROR, sentence, subject=TASK)

    def set_theme(self, choice: ThemeChoice, remember: bool = True) -> None:
        application = QApplication.instance()
        assert isinstance(application, QApplication)
        apply_theme(application, choice)
        if remember:
            self.settings.set("theme", choice)
        with QSignalBlocker(self.menus.themes):
            for entry in self.menus.themes.actions():
                entry.setChecked(entry.data() == choice)

    def restore_layout(self) -> None:
        """Restore the layout of the last start; missing or unusable values take their defaults."""
        settings = self.settings
        if not self.restoreGeometry(settings.blob("window/geometry")):
            screen = self.screen()  # on a large one the first window takes five sixths of each side
            room = room_on(screen).size() if screen is not None else QSize()
            size = (room * 5 / 6).expandedTo(DEFAULT_SIZE)
            self.resize(size if QApplication.platformName() == "offscreen" else size.boundedTo(room))
        self.views.share_room()
        for name, parts in self.views.splitters.items():
            parts.restoreState(settings.blob(name))
        self.modes.choose(settings.text("window/mode"))
        self.panel.set_collapsed_sections(settings.text("window/collapsed", _COLLAPSED_AT_FIRST).split(","))
        self.views.restore(settings.text("view/point_size"), settings.text("view/color_by"))
        hidden = settings.text("window/hidden").split(",")
        for name in _TOGGLES:
            getattr(self.actions_, name).setChecked(name not in hidden)
        theme = settings.text("theme", "system")
        self.set_theme(cast(ThemeChoice, theme if theme in THEMES else "system"), remember=False)

    def remember_layout(self) -> None:
        self.views.back()
        settings = self.settings
        settings.set("window/geometry", self.saveGeometry())
        for name, parts in self.views.splitters.items():
            settings.set(name, parts.saveState())
        settings.set("window/mode", self.modes.mode.value)
        settings.set("window/collapsed", ",".join(self.panel.collapsed_sections()))
        settings.set("view/point_size", self.views.point_size.value())
        settings.set("view/color_by", self.views.colors.value)
        hidden = [name for name in _TOGGLES if not getattr(self.actions_, name).isChecked()]
        settings.set("window/hidden", ",".join(hidden))

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        super().resizeEvent(event)
        self.rail.show_low(self.height() < LOW_PX)

    def event(self, event: QEvent | None) -> bool:
        free_space_bar(self, event)
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Space plays or pauses; Esc dismisses a message, clears a distance, goes back or ends a comparison."""
        if event is not None and event.key() == Qt.Key.Key_Escape:
            if not (self.messages.dismiss_newest() or self.views.back()):
                self.context.comparison.end()
            return
        if event is not None and event.key() == Qt.Key.Key_Space and not event.isAutoRepeat():
            self.actions_.play.trigger()
            return
        super().keyPressEvent(event)

    def dragEnterEvent(self, event: QDragEnterEvent | None) -> None:
        if event is not None and local_files(event.mimeData()):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent | None) -> None:
        paths = local_files(event.mimeData() if event is not None else None)
        if event is not None and paths:
            event.acceptProposedAction()
            self.file_flows.open_dropped(paths)

    def closeEvent(self, event: QCloseEvent | None) -> None:
        """Ask about unsaved changes and finish a recording; then remember the layout and stop the worker."""
        assert event is not None
        if self.document.dirty and self.document.preset is not self._given_up:
            event.ignore()
            self._given_up = None
            self.file_flows.guarded(self.close_without_asking)
            return
        if self.recording.running:
            event.ignore()
            self.recording.finish(self.close)
            return
        self.remember_layout()
        self.shut_down()
        self.settings.sync()
        self.autosave.close()
        self.error_hook.remove()
        event.accept()

    def shut_down(self) -> None:
        self.context.blockSignals(True)  # a frame that is on its way starts nothing
        showing = (self.watch, self.publishing, self.suggest, self.timeline, self.export, self.set_up)
        opening = (self.cameras, self.topics, self.sources, self.analysis, self.untouched, self.calibration)
        for part in (*showing, *opening):
            part.close()
        self.worker.shut_down()

    def close_without_asking(self) -> None:
        self._given_up = self.document.preset
        self.close()
