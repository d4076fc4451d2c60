"""*Find points*: the search for point pairs on the membrane's texture or on a chessboard."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtWidgets import QComboBox, QSpinBox, QWidget

from ...core.calibration.detect import detect_chessboard
from ...core.calibration.texture import match_texture
from ...core.errors import CalibrationError, as_sentence, counted
from ...core.model.alignment import PointPair
from ...core.model.frames import Rig
from ...widgets.basics.controls import ElidedLabel, GestureClock, caption, named, push_button
from ...widgets.basics.layouts import STRETCH, hbox
from ..worker.jobs import Job, JobRow, Progress
from .pictures import picture
from .session import SIDES, Choices, Session, SessionState, Snapshot, Target, renumbered, tactile_depth

_TARGETS: dict[Target, tuple[str, str]] = {
    "texture": (
        "Membrane texture",
        "Match the dye droplets on the membrane in both colour images; wrong matches are rejected",
    ),
    "chessboard": ("Chessboard", "All inner corners of a chessboard that both cameras see completely"),
}


def find_pairs(
    choices: Choices, snapshots: Sequence[Snapshot], rig: Rig, progress: Progress
) -> tuple[list[PointPair], str]:
    """Search every snapshot for points; return the pairs, and in words what was found and what was not."""
    pairs: list[PointPair] = []
    if choices.target == "texture":
        pairs, words = _matches(snapshots, rig, progress)
    else:
        words = ""
        for number, snapshot in enumerate(snapshots):
            progress(number / len(snapshots), f"Searching {snapshot.name}")
            try:
                pairs += _corners(number, snapshot, choices, rig)
            except CalibrationError as error:
                words += f" Not in {snapshot.name}: {error}."
        if not pairs:
            raise CalibrationError(words.strip().rstrip("."))
    return pairs, f"{counted(len(pairs), 'pair')} found in {counted(len(snapshots), 'snapshot')}.{words}"


def _matches(snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> tuple[list[PointPair], str]:
    for snapshot in snapshots:
        if snapshot.frame.tactile_color is None:
            raise CalibrationError(
                f"{snapshot.name}: the tactile camera has no colour image to match; detect a chessboard or click "
                "the points"
            )
    progress(0.1, "Matching droplets")
    try:
        pairs, rms_px = match_texture([snapshot.frame for snapshot in snapshots], rig)
    except CalibrationError as error:
        why = str(error).partition(";")[0]  # what follows is advice on clicked pairs
        raise CalibrationError(f"nothing reliable was found, click at least four dots in both images: {why}") from error
    progress(1.0, "Matched")
    return pairs, f" Together they fit a rigid pose to {rms_px:.2f} px."


def _corners(number: int, snapshot: Snapshot, choices: Choices, rig: Rig) -> list[PointPair]:
    frame = snapshot.frame
    proximity, tactile = (
        detect_chessboard(picture(frame, rig, side, choices.image).gray, choices.columns, choices.rows).tolist()
        for side in SIDES
    )
    return [
        PointPair(
            id=str(corner),
            proximity_u=left[0],
            proximity_v=left[1],
            tactile_u=right[0],
            tactile_v=right[1],
            tactile_depth_m=tactile_depth(frame, rig, *right),
            proximity_image=choices.image,
            snapshot=number,
            origin=f"chessboard {corner}",
        )
        for corner, (left, right) in enumerate(zip(proximity, tactile, strict=True))
    ]


class Finder(QWidget):
    """One row: the target and its size, and progress. Found pairs are added as one undoable step."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._searched: tuple[str, ...] = ()
        self._pairs = 0  # how many there were when the words were said
        gestures = GestureClock()
        self.job = Job(self, self._found, self._failed)
        self.search = push_button(
            "Find &points", "Find points automatically in all snapshots and add them as pairs (Ctrl+F)", "Ctrl+F"
        )
        self.target = QComboBox()
        for number, (target, (title, tip)) in enumerate(_TARGETS.items()):
            self.target.addItem(title, target)
            self.target.setItemData(number, tip, Qt.ItemDataRole.ToolTipRole)
        self.columns, self.rows = QSpinBox(), QSpinBox()
        for box, name, other in ((self.columns, "columns", "row"), (self.rows, "rows", "column")):
            named(box, f"Number of {name}", f"Number of inner corners in a {other}")
            box.setRange(3, 60)
            box.setSuffix(f" {name}")
        self.running, self.words = JobRow(self.job), ElidedLabel()
        row = (caption("&Find", self.target), self.target, self.columns, self.rows, self.running)
        hbox(*row, STRETCH, within=self, margins=0, spacing=8)
        self.search.clicked.connect(self.find_points)
        self.target.activated.connect(
            lambda _: session.choose(f"Look for: {self.target.currentText()}", target=self.target.currentData())
        )
        self.columns.valueChanged.connect(
            lambda count: session.choose("Columns of the board", gestures.number(), columns=count)
        )
        self.rows.valueChanged.connect(lambda count: session.choose("Rows of the board", gestures.number(), rows=count))
        session.changed.connect(self._show_state)
        self.job.busyChanged.connect(self._show_busy)
        self._show_state(session.state)

    def find_points(self) -> None:
        state, rig = self._session.state, self._session.rig
        self._searched = state.digests
        self.job.start(lambda progress: find_pairs(state.choices, state.snapshots, rig, progress))

    def _show_state(self, state: SessionState) -> None:
        choices = state.choices
        self.target.setCurrentIndex(self.target.findData(choices.target))
        self.target.setToolTip(_TARGETS[choices.target][1])
        for box, count in ((self.columns, choices.columns), (self.rows, choices.rows)):
            with QSignalBlocker(box):
                box.setValue(count)
            box.setVisible(choices.target == "chessboard")
        if len(state.pairs) < self._pairs:
            self._say("")  # what was found is no longer there
        self._show_busy(self.job.busy)

    def _show_busy(self, busy: bool) -> None:
        self.words.setVisible(not busy and bool(self.words.text()))
        self.search.setEnabled(not busy and bool(self._session.state.snapshots))

    def _found(self, found: tuple[list[PointPair], str]) -> None:
        """Add what the session does not have yet; nothing is selected, as hundreds of rings would hide the images."""
        pairs, words = found
        state = self._session.state
        have = {(pair.snapshot, pair.proximity, pair.tactile) for pair in state.pairs}
        present = renumbered(pairs, self._searched, state.digests)  # one may be removed during the search
        present = tuple(pair for pair in present if pair.snapshot is not None)
        new = [pair for pair in present if (pair.snapshot, pair.proximity, pair.tactile) not in have]
        if new:
            self._session.add_pairs(new, f"Find {counted(len(new), 'pair')}")
            self._session.select(())
        known = len(present) - len(new)
        self._say(words + (f" {known} of them were pairs already." if known else ""))

    def _failed(self, sentence: str) -> None:
        self._say(as_sentence(sentence) if sentence else "Cancelled; no pairs were added.")

    def _say(self, words: str) -> None:
        self._pairs = len(self._session.state.pairs)
        self.words.setText(words)
        self.words.setVisible(bool(words))
