"""*Find points*: the search for point pairs on the membrane's texture or on printed targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtWidgets import QComboBox, QDoubleSpinBox, QSpinBox, QWidget

from ...core.calibration.detect import Detection, detect_charuco, detect_chessboard, detect_circles, match_detections
from ...core.calibration.texture import match_texture
from ...core.errors import CalibrationError, counted
from ...core.model.frames import Rig
from ...widgets.basics.controls import ElidedLabel, ProgressBar, caption, push_button
from ...widgets.basics.gestures import GestureClock
from ...widgets.basics.layouts import hbox
from ..worker.jobs import Job, Progress
from .pictures import Picture, picture, tactile_depth_at
from .session import Choices, PointPair, Session, SessionState, Snapshot, Target

_TARGETS: dict[Target, tuple[str, str]] = {
    "texture": (
        "Membrane texture",
        "Match the dye droplets on the membrane in both colour images; wrong matches are rejected",
    ),
    "chessboard": ("Chessboard", "All inner corners of a chessboard that both cameras see completely"),
    "charuco": ("ChArUco board", "The corners of a ChArUco board, which may be partly visible"),
    "circles": ("Asymmetric circles", "The centres of a grid of circles in which every other row is shifted"),
    "dots": ("Dot grid", "The centres of a plain grid of dots"),
}
#: What the columns and rows of a target count.
_UNITS = {"chessboard": "inner corners", "charuco": "squares", "circles": "circles", "dots": "dots"}
_DICTIONARIES = ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_ARUCO_ORIGINAL")


@dataclass(frozen=True)
class Found:
    """The pairs of a search, and what was found and what was not, in words."""

    pairs: tuple[PointPair, ...]
    words: str


def find_pairs(choices: Choices, snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> Found:
    """Search every snapshot for points.

    Raises
    ------
    CalibrationError
        Nothing was found in any snapshot; the message is the last one's.
    """
    if choices.target == "texture":
        return _texture(snapshots, rig, progress)
    found: list[PointPair] = []
    problems: list[str] = []
    for number, snapshot in enumerate(snapshots):
        progress(number / len(snapshots), f"Searching {snapshot.name}")
        try:
            found += _pairs(snapshot, choices, rig)
        except CalibrationError as error:
            problems.append(f"{snapshot.name}: {error}")
    if not found:
        raise CalibrationError(problems[-1] if problems else "no snapshot yet: take one on the page Snapshots")
    words = f"{counted(len(found), 'pair')} found in {counted(len(snapshots), 'snapshot')}."
    return Found(tuple(found), " ".join([words, *(f"Not in {problem}." for problem in problems)]))


def _texture(snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> Found:
    for snapshot in snapshots:
        if snapshot.frame.tactile_color is None:
            raise CalibrationError(
                f"{snapshot.name}: the tactile camera has no colour image to match; detect a target or click the points"
            )
    progress(0.1, f"Matching droplets in {counted(len(snapshots), 'snapshot')}")
    try:
        matches = match_texture([snapshot.frame for snapshot in snapshots], rig)
    except CalibrationError as error:
        why = str(error).partition(";")[0]  # what follows is advice on clicked pairs
        raise CalibrationError(f"nothing reliable was found, click at least four dots in both images: {why}") from error
    progress(1.0, "Matched")
    pairs = tuple(
        PointPair(
            key=0,
            proximity=match.proximity,
            tactile=match.tactile,
            tactile_depth_m=match.tactile_depth_m,
            proximity_image=match.proximity_image,
            snapshot=snapshots[match.snapshot or 0].digest,
            origin=f"texture, correlation {likeness:.2f}",
        )
        for match, likeness in zip(matches.pairs, matches.likeness, strict=True)
    )
    return Found(
        pairs,
        f"{counted(len(pairs), 'pair')} found in {counted(len(snapshots), 'snapshot')}; together they fit a rigid pose "
        f"to {matches.fit.rms_px:.2f} px.",
    )


def _pairs(snapshot: Snapshot, choices: Choices, rig: Rig) -> list[PointPair]:
    frame = snapshot.frame
    proximity = _detect(choices, picture(frame, rig, "proximity", choices.proximity_image, stretch=True))
    tactile = _detect(choices, picture(frame, rig, "tactile", choices.tactile_image, stretch=True))
    return [
        PointPair(
            key=0,
            proximity=(float(left[0]), float(left[1])),
            tactile=(float(right[0]), float(right[1])),
            tactile_depth_m=tactile_depth_at(frame, rig, float(right[0]), float(right[1])),
            proximity_image="color" if choices.proximity_image == "color" else "depth",
            snapshot=snapshot.digest,
            origin=f"{_TARGETS[choices.target][0].lower()} {name}",
        )
        for name, left, right in match_detections(proximity, tactile)
    ]


def _detect(choices: Choices, side: Picture) -> Detection:
    if choices.target == "chessboard":
        return detect_chessboard(side.gray, choices.columns, choices.rows)
    if choices.target == "charuco":
        return detect_charuco(side.gray, choices.columns, choices.rows, choices.marker_share, choices.dictionary)
    return detect_circles(side.gray, choices.columns, choices.rows, asymmetric=choices.target == "circles")


class Finder(QWidget):
    """One row: the target and its size, progress, and the result. Found pairs are added as one undoable step.

    Attributes
    ----------
    search : QPushButton
        Starts the search; the wizard places it.
    """

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._gestures = GestureClock()
        self._job = Job(self)
        self.search = push_button(
            "Find points", "Find points automatically in all snapshots and add them as pairs (Ctrl+F)", "Ctrl+F"
        )
        self._make_controls()
        settings = (self.target, self.columns, self.rows, self.share, self.dictionary)
        row = (caption("&Find", self.target), *settings, self.progress, self.cancel, (self.words, 1))
        hbox(*row, within=self, margins=0, spacing=8)
        self._connect()
        self._show_state(session.state)
        self._show_busy()

    def _make_controls(self) -> None:
        self.target = QComboBox()
        self.target.setAccessibleName("What to find")
        for number, (target, (title, tip)) in enumerate(_TARGETS.items()):
            self.target.addItem(title, target)
            self.target.setItemData(number, tip, Qt.ItemDataRole.ToolTipRole)
        self.columns, self.rows = QSpinBox(), QSpinBox()
        for box, name in ((self.columns, "columns"), (self.rows, "rows")):
            box.setRange(2, 60)
            box.setSuffix(f" {name}")
            box.setAccessibleName(f"Number of {name}")
        self.share = QDoubleSpinBox()
        self.share.setRange(0.1, 0.95)
        self.share.setSingleStep(0.05)
        self.share.setPrefix("marker ")
        self.share.setAccessibleName("Marker size")
        self.share.setToolTip("Side of a marker divided by the side of a square (no unit)")
        self.dictionary = QComboBox()
        self.dictionary.addItems(_DICTIONARIES)
        self.dictionary.setAccessibleName("Marker dictionary")
        self.dictionary.setToolTip("Marker dictionary, by its OpenCV name")
        self.cancel = push_button("Cancel", "Stop searching")
        self.progress = ProgressBar()
        self.words = ElidedLabel()

    def _connect(self) -> None:
        self.search.clicked.connect(self.find_points)
        self.cancel.clicked.connect(self._job.cancel)
        self.target.activated.connect(
            lambda _: self._choose(f"Look for: {self.target.currentText()}", target=self.target.currentData())
        )
        self.columns.valueChanged.connect(lambda count: self._choose("Columns of the target", columns=count))
        self.rows.valueChanged.connect(lambda count: self._choose("Rows of the target", rows=count))
        self.share.valueChanged.connect(lambda share: self._choose("Marker size", marker_share=round(share, 2)))
        self.dictionary.textActivated.connect(lambda name: self._choose("Marker dictionary", dictionary=name))
        self._session.changed.connect(self._show_state)
        self._job.progress.connect(self.progress.show_share)
        self._job.done.connect(self._found)
        self._job.failed.connect(self._failed)
        self._job.busyChanged.connect(lambda _: self._show_busy())

    @property
    def busy(self) -> bool:
        """Whether a search is running."""
        return self._job.busy

    def find_points(self) -> None:
        """Search all snapshots, on another thread."""
        state, rig = self._session.state, self._session.rig
        self._job.start(lambda progress: find_pairs(state.choices, state.snapshots, rig, progress))

    def close_jobs(self) -> None:
        """Cancel a running search."""
        self._job.stop()

    def _choose(self, text: str, **values: object) -> None:
        self._session.choose(text, self._gestures.number(), **values)

    def _show_state(self, state: SessionState) -> None:
        choices = state.choices
        with QSignalBlocker(self.columns), QSignalBlocker(self.rows), QSignalBlocker(self.share):
            self.columns.setValue(choices.columns)
            self.rows.setValue(choices.rows)
            self.share.setValue(choices.marker_share)
        self.target.setCurrentIndex(self.target.findData(choices.target))
        self.target.setToolTip(_TARGETS[choices.target][1])
        self.dictionary.setCurrentText(choices.dictionary)
        for box, name in ((self.columns, "column"), (self.rows, "row")):
            box.setVisible(choices.target != "texture")
            box.setToolTip(f"Number of {_UNITS.get(choices.target, '')} in a {'row' if name == 'column' else 'column'}")
        for widget in (self.share, self.dictionary):
            widget.setVisible(choices.target == "charuco")
        self._show_busy()

    def _show_busy(self) -> None:
        self.progress.setVisible(self.busy)
        self.cancel.setVisible(self.busy)
        self.words.setVisible(not self.busy)
        self.search.setEnabled(not self.busy and bool(self._session.state.snapshots))

    def _found(self, found: Found) -> None:
        """Add what the session does not have yet; nothing is selected, as hundreds of rings would hide the images."""
        session = self._session
        have = {(pair.snapshot, pair.proximity, pair.tactile) for pair in session.state.pairs}
        present = {snapshot.digest for snapshot in session.state.snapshots}  # one may be removed during the search
        new = [
            pair
            for pair in found.pairs
            if pair.snapshot in present and (pair.snapshot, pair.proximity, pair.tactile) not in have
        ]
        known = len(found.pairs) - len(new)
        if new:
            session.add_pairs(new, f"Find {counted(len(new), 'pair')}")
            session.select(())
        self.words.setText(found.words + (f" {known} of them were pairs already." if known else ""))

    def _failed(self, sentence: str) -> None:
        self.words.setText(sentence[:1].upper() + sentence[1:] if sentence else "Cancelled; no pairs were added.")
