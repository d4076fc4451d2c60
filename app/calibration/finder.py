"""*Find points*: the search for point pairs on the membrane's texture or on a chessboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtWidgets import QComboBox, QSpinBox, QWidget

from ...core.calibration.detect import detect_chessboard
from ...core.calibration.texture import match_texture
from ...core.errors import CalibrationError, counted
from ...core.model.alignment import PointPair, Side
from ...core.model.frames import Rig
from ...widgets.basics.controls import ElidedLabel, ProgressBar, caption, push_button
from ...widgets.basics.gestures import GestureClock
from ...widgets.basics.layouts import hbox
from ..worker.jobs import Job, Progress
from .pictures import picture, tactile_depth_at
from .session import Choices, ImageChoice, Session, SessionState, Snapshot, Target, renumbered

_TARGETS: dict[Target, tuple[str, str]] = {
    "texture": (
        "Membrane texture",
        "Match the dye droplets on the membrane in both colour images; wrong matches are rejected",
    ),
    "chessboard": ("Chessboard", "All inner corners of a chessboard that both cameras see completely"),
}


@dataclass(frozen=True)
class Found:
    """The pairs of a search in snapshots, by their digests, and what was found and what was not, in words."""

    pairs: list[PointPair]
    digests: tuple[str, ...]
    words: str


def find_pairs(choices: Choices, snapshots: Sequence[Snapshot], rig: Rig, progress: Progress) -> Found:
    """Search every snapshot for points."""
    digests, many = tuple(snapshot.digest for snapshot in snapshots), counted(len(snapshots), "snapshot")
    if choices.target == "texture":
        for snapshot in snapshots:
            if snapshot.frame.tactile_color is None:
                raise CalibrationError(
                    f"{snapshot.name}: the tactile camera has no colour image to match; detect a chessboard or click "
                    "the points"
                )
        progress(0.1, f"Matching droplets in {many}")
        try:
            matches, rms_px = match_texture([snapshot.frame for snapshot in snapshots], rig)
        except CalibrationError as error:
            why = str(error).partition(";")[0]  # what follows is advice on clicked pairs
            raise CalibrationError(
                f"nothing reliable was found, click at least four dots in both images: {why}"
            ) from error
        progress(1.0, "Matched")
        words = f"{counted(len(matches), 'pair')} found in {many}; together they fit a rigid pose to {rms_px:.2f} px."
        return Found(matches, digests, words)
    found: list[PointPair] = []
    problems: list[str] = []
    for number, snapshot in enumerate(snapshots):
        progress(number / len(snapshots), f"Searching {snapshot.name}")
        try:
            found += _corners(number, snapshot, choices, rig)
        except CalibrationError as error:
            problems.append(f"{snapshot.name}: {error}")
    if not found:
        raise CalibrationError(problems[-1] if problems else "no snapshot yet: take one on the page Snapshots")
    words = f"{counted(len(found), 'pair')} found in {many}."
    return Found(found, digests, " ".join([words, *(f"Not in {problem}." for problem in problems)]))


def _corners(number: int, snapshot: Snapshot, choices: Choices, rig: Rig) -> list[PointPair]:
    frame = snapshot.frame
    sides: tuple[tuple[Side, ImageChoice], ...] = (
        ("proximity", choices.proximity_image),
        ("tactile", choices.tactile_image),
    )
    left, right = (
        detect_chessboard(picture(frame, rig, side, image, stretch=True).gray, choices.columns, choices.rows).tolist()
        for side, image in sides
    )
    return [
        PointPair(
            id=str(corner),
            proximity_u=u,
            proximity_v=v,
            tactile_u=tactile[0],
            tactile_v=tactile[1],
            tactile_depth_m=tactile_depth_at(frame, rig, *tactile),
            proximity_image="color" if choices.proximity_image == "color" else "depth",
            snapshot=number,
            origin=f"chessboard {corner}",
        )
        for corner, ((u, v), tactile) in enumerate(zip(left, right, strict=True))
    ]


class Finder(QWidget):
    """One row: the target and its size, progress, and the result. Found pairs are added as one undoable step.

    The wizard places the button ``search``.
    """

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        gestures = GestureClock()
        self._job = Job(self)
        self.search = push_button(
            "Find points", "Find points automatically in all snapshots and add them as pairs (Ctrl+F)", "Ctrl+F"
        )
        self.target = QComboBox()
        self.target.setAccessibleName("What to find")
        for number, (target, (title, tip)) in enumerate(_TARGETS.items()):
            self.target.addItem(title, target)
            self.target.setItemData(number, tip, Qt.ItemDataRole.ToolTipRole)
        self.columns, self.rows = QSpinBox(), QSpinBox()
        for box, name, other in ((self.columns, "columns", "row"), (self.rows, "rows", "column")):
            box.setRange(3, 60)
            box.setSuffix(f" {name}")
            box.setAccessibleName(f"Number of {name}")
            box.setToolTip(f"Number of inner corners in a {other}")
        self.cancel = push_button("Cancel", "Stop searching")
        self.progress, self.words = ProgressBar(), ElidedLabel()
        row = (caption("&Find", self.target), self.target, self.columns, self.rows, self.progress, self.cancel)
        hbox(*row, (self.words, 1), within=self, margins=0, spacing=8)
        self.search.clicked.connect(self.find_points)
        self.cancel.clicked.connect(self._job.cancel)
        self.target.activated.connect(
            lambda _: session.choose(f"Look for: {self.target.currentText()}", target=self.target.currentData())
        )
        self.columns.valueChanged.connect(
            lambda count: session.choose("Columns of the board", gestures.number(), columns=count)
        )
        self.rows.valueChanged.connect(lambda count: session.choose("Rows of the board", gestures.number(), rows=count))
        session.changed.connect(self._show_state)
        self._job.progress.connect(self.progress.show_share)
        self._job.done.connect(self._found)
        self._job.failed.connect(self._failed)
        self._job.busyChanged.connect(lambda _: self._show_busy())
        self._show_state(session.state)

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

    def _show_state(self, state: SessionState) -> None:
        choices = state.choices
        self.target.setCurrentIndex(self.target.findData(choices.target))
        self.target.setToolTip(_TARGETS[choices.target][1])
        for box, count in ((self.columns, choices.columns), (self.rows, choices.rows)):
            with QSignalBlocker(box):
                box.setValue(count)
            box.setVisible(choices.target == "chessboard")
        self._show_busy()

    def _show_busy(self) -> None:
        self.progress.setVisible(self.busy)
        self.cancel.setVisible(self.busy)
        self.words.setVisible(not self.busy)
        self.search.setEnabled(not self.busy and bool(self._session.state.snapshots))

    def _found(self, found: Found) -> None:
        """Add what the session does not have yet; nothing is selected, as hundreds of rings would hide the images."""
        state = self._session.state
        have = {(pair.snapshot, pair.proximity, pair.tactile) for pair in state.pairs}
        pairs = renumbered(found.pairs, found.digests, state.digests)  # one may be removed during the search
        pairs = tuple(pair for pair in pairs if pair.snapshot is not None)
        new = [pair for pair in pairs if (pair.snapshot, pair.proximity, pair.tactile) not in have]
        if new:
            self._session.add_pairs(new, f"Find {counted(len(new), 'pair')}")
            self._session.select(())
        known = len(pairs) - len(new)
        self.words.setText(found.words + (f" {known} of them were pairs already." if known else ""))

    def _failed(self, sentence: str) -> None:
        self.words.setText(sentence[:1].upper() + sentence[1:] if sentence else "Cancelled; no pairs were added.")
