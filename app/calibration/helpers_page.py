"""The page on which helpers find points (boards, dot grids, texture), and the person accepts or refuses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import nan

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QButtonGroup,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QRadioButton,
    QSpinBox,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from ...core.calibration.detect import Detection, detect_charuco, detect_chessboard, detect_circles, match_detections
from ...core.calibration.texture import match_texture
from ...core.errors import CalibrationError
from ...core.model.frames import Rig
from ...widgets.basics.controls import ProgressBar, push_button
from ...widgets.basics.point_table import PointRow, PointTable
from ...widgets.images.marks import Mark, MarkKind
from ..worker.jobs import Job, Progress
from .fitting import Outcome, same_pixels
from .pair_view import PairView
from .pictures import Picture, picture, tactile_depth_at
from .session import SIDES, Choices, PointPair, Session, SessionState, Side, Snapshot


class Helper(StrEnum):
    """What to look for."""

    TEXTURE = "Membrane texture"
    CHESSBOARD = "Chessboard"
    CHARUCO = "ChArUco board"
    CIRCLES = "Asymmetric circles"
    DOTS = "Dot grid"


@dataclass(frozen=True)
class HelperOptions:
    """The target's size; see `tactune.core.calibration.detect`."""

    helper: Helper = Helper.TEXTURE
    columns: int = 9
    rows: int = 6
    marker_share: float = 0.7
    dictionary: str = "DICT_4X4_250"


@dataclass(frozen=True)
class Proposals:
    """What was found and what was not, as a sentence."""

    pairs: tuple[PointPair, ...]
    words: str


def find_proposals(
    options: HelperOptions, snapshots: Sequence[Snapshot], choices: Choices, rig: Rig, progress: Progress
) -> Proposals:
    """Search every snapshot for points.

    Raises
    ------
    CalibrationError
        Nothing was found in any snapshot; the message is the last one's.
    """
    if options.helper is Helper.TEXTURE:
        return _texture(snapshots, rig, progress)
    found: list[PointPair] = []
    problems: list[str] = []
    for number, snapshot in enumerate(snapshots):
        progress(number / len(snapshots), f"Searching {snapshot.name}")
        try:
            found += _pairs(options, snapshot, choices, rig)
        except CalibrationError as error:
            problems.append(f"{snapshot.name}: {error}")
    if not found:
        raise CalibrationError(problems[-1] if problems else "no snapshot yet: take one on the page Frames")
    pairs = tuple(pair.model_copy(update={"key": number + 1}) for number, pair in enumerate(found))
    words = f"{len(pairs)} pairs were found in {_snapshots(len(snapshots))}."
    return Proposals(pairs, " ".join([words, *(f"Not in {problem}." for problem in problems)]))


def _texture(snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> Proposals:
    for snapshot in snapshots:
        if snapshot.frame.tactile_color is None:
            raise CalibrationError(
                f"{snapshot.name}: the tactile camera has no colour image to match; detect a target or click the points"
            )
    progress(0.1, f"Matching droplets in {_snapshots(len(snapshots))}")
    matches = match_texture([snapshot.frame for snapshot in snapshots], rig)
    pairs = tuple(
        PointPair(
            key=number + 1,
            proximity=match.proximity,
            tactile=match.tactile,
            tactile_depth_m=match.tactile_depth_m,
            proximity_image=match.proximity_image,
            snapshot=snapshots[match.snapshot or 0].digest,
            origin=f"texture, correlation {likeness:.2f}",
        )
        for number, (match, likeness) in enumerate(zip(matches.pairs, matches.likeness, strict=True))
    )
    return Proposals(
        pairs,
        f"{len(pairs)} droplets were matched in {_snapshots(len(snapshots))}; together they fit a rigid pose "
        f"to {matches.fit.rms_px:.2f} px.",
    )


def _snapshots(count: int) -> str:
    return "one snapshot" if count == 1 else f"{count} snapshots"


def _pairs(options: HelperOptions, snapshot: Snapshot, choices: Choices, rig: Rig) -> list[PointPair]:
    frame = snapshot.frame
    sides = (
        picture(frame, rig, "proximity", choices.proximity_image, stretch=True),
        picture(frame, rig, "tactile", choices.tactile_image, stretch=True),
    )
    proximity, tactile = (_detect(options, side) for side in sides)
    return [
        PointPair(
            key=0,
            proximity=(float(left[0]), float(left[1])),
            tactile=(float(right[0]), float(right[1])),
            tactile_depth_m=tactile_depth_at(frame, rig, float(right[0]), float(right[1])),
            proximity_image="color" if choices.proximity_image == "color" else "depth",
            snapshot=snapshot.digest,
            origin=f"{options.helper.value.lower()} {name}",
        )
        for name, left, right in match_detections(proximity, tactile)
    ]


def _detect(options: HelperOptions, side: Picture) -> Detection:
    if options.helper is Helper.CHESSBOARD:
        return detect_chessboard(side.gray, options.columns, options.rows)
    if options.helper is Helper.CHARUCO:
        return detect_charuco(side.gray, options.columns, options.rows, options.marker_share, options.dictionary)
    return detect_circles(side.gray, options.columns, options.rows, asymmetric=options.helper is Helper.CIRCLES)


_TIPS = {
    Helper.TEXTURE: "Match the dye droplets on the membrane in both colour images; wrong matches are rejected",
    Helper.CHESSBOARD: "All inner corners of a chessboard that both cameras see completely",
    Helper.CHARUCO: "The corners of a ChArUco board, which may be partly visible",
    Helper.CIRCLES: "The centres of a grid of circles in which every other row is shifted",
    Helper.DOTS: "The centres of a plain grid of dots",
}
_SIZES = {
    Helper.CHESSBOARD: "inner corners",
    Helper.CHARUCO: "squares",
    Helper.CIRCLES: "circles",
    Helper.DOTS: "dots",
}
_DICTIONARIES = ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_ARUCO_ORIGINAL")
_ADVICE = (
    "Click a green ring, or its check mark in the table, to refuse a proposal or restore it. Accept, or the next "
    "page, adds the green ones as pairs."
)
_INTRO = "Press Find; what is found is drawn in green. " + _ADVICE
#: Above this number of rings, their numbers are hidden.
_MAX_LABELS = 120


class HelpersPage(QWidget):
    """Choice of helper at the left, proposals over both images at the right.

    Signals
    -------
    accepted(keys: tuple of int)
        Proposals were added to the session as these pairs.
    """

    accepted = pyqtSignal(object)

    def __init__(self, session: Session, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._pairs: tuple[PointPair, ...] = ()
        self._refused: frozenset[int] = frozenset()
        self._shown: dict[Side, tuple[object, ...]] = {}
        self._job = Job(self)
        self.view = PairView(lambda picture, place: None)
        self.view.set_snapping(False)
        self.view.set_loupe_wanted(False)
        self.table = PointTable()
        self.table.hide_residuals()
        self._make_controls()
        layout = QHBoxLayout(self)
        layout.setContentsMargins(8, 6, 8, 4)
        layout.addWidget(self._control_column())
        split = QSplitter(Qt.Orientation.Vertical)
        split.addWidget(self.view)
        split.addWidget(self.table)
        split.setStretchFactor(0, 1)
        split.setSizes([480, 200])
        split.setChildrenCollapsible(False)
        layout.addWidget(split, 1)
        self.setFocusProxy(self.search)
        self._connect()
        self._helper_chosen()
        self._show_state(session.state)
        self._show_proposals()

    @property
    def proposals(self) -> tuple[PointPair, ...]:
        """The proposals that are not refused."""
        return tuple(pair for pair in self._pairs if pair.key not in self._refused)

    def options(self) -> HelperOptions:
        """Return the options set by the controls."""
        return HelperOptions(
            list(Helper)[self.helpers.checkedId()],
            self.columns.value(),
            self.rows.value(),
            self.share.value(),
            self.dictionary.currentText(),
        )

    def show_outcome(self, outcome: Outcome) -> None:
        """Do nothing: this page does not depend on the fit."""

    def close_jobs(self) -> None:
        """Cancel running jobs."""
        self._job.stop()

    # Building

    def _make_controls(self) -> None:
        self.helpers = QButtonGroup(self)
        self.radios = {helper: QRadioButton(helper.value) for helper in Helper}
        for number, (helper, button) in enumerate(self.radios.items()):
            button.setToolTip(_TIPS[helper])
            self.helpers.addButton(button, number)
        self.radios[Helper.TEXTURE].setChecked(True)
        self.columns, self.rows = QSpinBox(), QSpinBox()
        for box, count in ((self.columns, 9), (self.rows, 6)):
            box.setRange(2, 60)
            box.setValue(count)
        self.share = QDoubleSpinBox()
        self.share.setRange(0.1, 0.95)
        self.share.setSingleStep(0.05)
        self.share.setValue(0.7)
        self.share.setToolTip("Side of a marker divided by the side of a square (no unit)")
        self.dictionary = QComboBox()
        self.dictionary.addItems(_DICTIONARIES)
        self.dictionary.setToolTip("Marker dictionary, by its OpenCV name")
        self.snapshot = QComboBox()
        self.snapshot.setAccessibleName("Snapshot")
        self.snapshot.setToolTip("The snapshot that is shown")
        self.everywhere = QCheckBox("Search all snapshots")
        self.everywhere.setChecked(True)
        self.everywhere.setToolTip("Off: search only the snapshot shown")
        self.search = push_button("Find", "Search for points (Ctrl+F)")
        self.search.setShortcut("Ctrl+F")
        self.cancel = push_button("Cancel", "Stop searching")
        self.progress = ProgressBar()
        self.words = QLabel(_INTRO)
        self.words.setWordWrap(True)
        self.words.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.accept = push_button("Accept", "Add the green proposals as pairs, as one undoable step")
        self.refuse = push_button("Refuse all", "Discard the proposals")

    def _control_column(self) -> QWidget:
        choice = QGroupBox("Look for")
        helpers = QVBoxLayout(choice)
        for button in self.radios.values():
            helpers.addWidget(button)
        self.target = QGroupBox("Target")
        form = QFormLayout(self.target)
        self.target_labels = (QLabel("Columns"), QLabel("Rows"))
        form.addRow(self.target_labels[0], self.columns)
        form.addRow(self.target_labels[1], self.rows)
        self.marker_labels = (QLabel("Marker / square"), QLabel("Dictionary"))
        form.addRow(self.marker_labels[0], self.share)
        form.addRow(self.marker_labels[1], self.dictionary)
        column = QWidget()
        column.setFixedWidth(270)
        layout = QVBoxLayout(column)
        layout.setContentsMargins(0, 0, 0, 0)
        for widget in (choice, self.target, self.snapshot, self.everywhere, self.search, self.progress, self.cancel):
            layout.addWidget(widget)
        layout.addWidget(self.words, 1)
        row = QHBoxLayout()
        row.addWidget(self.accept)
        row.addWidget(self.refuse)
        layout.addLayout(row)
        return column

    def _connect(self) -> None:
        session = self._session
        self.helpers.idClicked.connect(lambda _: self._helper_chosen())
        self.snapshot.activated.connect(lambda _: session.set_display(snapshot=self.snapshot.currentData()))
        self.search.clicked.connect(self.find_points)
        self.cancel.clicked.connect(self._job.cancel)
        self.accept.clicked.connect(self.accept_proposals)
        self.refuse.clicked.connect(lambda: self._take(Proposals((), "Refused; no pairs were added.")))
        for image in self.view.images.values():
            image.pressed.connect(lambda key, _: self.toggle(key))
        self.table.enabledToggled.connect(lambda key, _: self.toggle(key))
        self.table.selectionEdited.connect(lambda _: self._show_proposals())
        session.changed.connect(self._show_state)
        self._job.progress.connect(self._show_progress)
        self._job.done.connect(self._found)
        self._job.failed.connect(self._failed)
        self._job.busyChanged.connect(lambda _: self._show_busy())
        self._show_busy()

    # Actions

    def find_points(self) -> None:
        """Search for points, on another thread."""
        state, rig, options = self._session.state, self._session.rig, self.options()
        chosen = state.snapshots if self.everywhere.isChecked() else tuple(filter(None, [state.snapshot]))
        self._job.start(lambda progress: find_proposals(options, chosen, state.choices, rig, progress))

    def toggle(self, key: int) -> None:
        """Refuse a proposal, or restore it."""
        self._refused = self._refused ^ {key}
        self._show_table()
        self._show_proposals()

    def accept_proposals(self) -> None:
        """Add the proposals that are not refused to the session."""
        accepted = self.proposals
        if accepted:
            self._session.add_pairs(accepted, f"Accept {len(accepted)} proposals")
            self._take(Proposals((), f"{len(accepted)} pairs were added; undo removes them."))
            keys = self._session.selected
            self._session.select(())  # hundreds of selected rings would hide the images
            self.accepted.emit(keys)

    # Display

    def _helper_chosen(self) -> None:
        helper = list(Helper)[self.helpers.checkedId()]
        self.target.setVisible(helper is not Helper.TEXTURE)
        for label, word in zip(self.target_labels, ("Columns", "Rows"), strict=True):
            label.setText(f"{word} of {_SIZES.get(helper, '')}")
        for widget in (*self.marker_labels, self.share, self.dictionary):
            widget.setVisible(helper is Helper.CHARUCO)

    def _show_state(self, state: SessionState) -> None:
        with QSignalBlocker(self.snapshot):
            self.snapshot.clear()
            for each in state.snapshots:
                self.snapshot.addItem(each.name, each.digest)
            self.snapshot.setCurrentIndex(self.snapshot.findData(state.choices.snapshot))
        snapshot, choices = state.snapshot, state.choices
        for side in SIDES:
            choice = choices.proximity_image if side == "proximity" else choices.tactile_image
            key = (choices.snapshot, choice)
            if self._shown.get(side) == key:
                continue
            self._shown[side] = key
            if snapshot is None:
                self.view.set_picture(side, None, "No snapshot yet: take one on the page Frames")
            else:
                self.view.set_picture(side, picture(snapshot.frame, self._session.rig, side, choice, stretch=True))
        self.search.setEnabled(bool(state.snapshots) and not self._job.busy)
        self._show_proposals()

    def _show_proposals(self) -> None:
        state = self._session.state
        here = [
            pair
            for pair in self._pairs
            if pair.snapshot == state.choices.snapshot
            and same_pixels(pair, state.choices.proximity_image, self._session.rig)
        ]
        selected = self.table.selected_keys()
        for side in SIDES:
            marks = []
            for pair in here:
                place = pair.place(side)
                assert place is not None
                kind = MarkKind.OFF if pair.key in self._refused else MarkKind.PROPOSED
                label = str(pair.key) if len(here) <= _MAX_LABELS else ""
                marks.append(Mark(pair.key, *place, label, kind, pair.key in selected))
            self.view.images[side].set_marks(marks)
        count = len(self.proposals)
        self.accept.setText(f"Accept {count}" if count else "Accept")
        self.accept.setEnabled(count > 0)
        self.refuse.setEnabled(bool(self._pairs))

    def _show_progress(self, share: float, words: str) -> None:
        self.progress.show_share(share)
        self.words.setText(f"{words}…")

    def _show_busy(self) -> None:
        busy = self._job.busy
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.search.setEnabled(not busy and bool(self._session.state.snapshots))

    def _found(self, proposals: Proposals) -> None:
        """Propose what the session does not have yet. On another page the proposals are accepted at once."""
        have = {(pair.snapshot, pair.proximity, pair.tactile) for pair in self._session.state.pairs}
        new = tuple(pair for pair in proposals.pairs if (pair.snapshot, pair.proximity, pair.tactile) not in have)
        known = len(proposals.pairs) - len(new)
        self._take(
            Proposals(new, f"{proposals.words} {known} of them are pairs already." if known else proposals.words)
        )
        if not self.isVisible():
            self.accept_proposals()

    def _take(self, proposals: Proposals) -> None:
        self._pairs, self._refused = proposals.pairs, frozenset()
        self.words.setText(f"{proposals.words} {_ADVICE if proposals.pairs else ''}".strip())
        self._show_table()
        self._show_proposals()

    def _show_table(self) -> None:
        self.table.set_rows([self._row(pair) for pair in self._pairs])

    def _row(self, pair: PointPair) -> PointRow:
        nowhere = (nan, nan)
        snapshot = self._session.state.snapshot_of(pair)
        return PointRow(
            key=pair.key,
            enabled=pair.key not in self._refused,
            left=pair.proximity or nowhere,
            right=pair.tactile or nowhere,
            depth_m=nan if pair.tactile_depth_m is None else pair.tactile_depth_m,
            note=f"{pair.origin}, {snapshot.name}" if snapshot is not None else pair.origin,
        )

    def _failed(self, sentence: str) -> None:
        self.words.setText(sentence[:1].upper() + sentence[1:] if sentence else "Cancelled; no pairs were added.")
