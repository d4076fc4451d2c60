"""The page for finding and clicking point pairs."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtGui import QKeySequence, QShortcut
from PyQt6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QToolButton, QWidget

from ...core.calibration.geometry import Alignment
from ...core.errors import counted
from ...core.model.alignment import Place, Side
from ...widgets.basics.controls import ElidedLabel, caption
from ...widgets.basics.gestures import GestureClock
from ...widgets.basics.layouts import hbox, splitter, vbox
from .finder import Finder
from .fitting import Outcome, image_marks, same_pixels, table_rows
from .pair_view import PairView, Snapper
from .pictures import image_choices, picture
from .point_table import PointTable
from .prediction import proximity_partner, tactile_partner
from .session import SIDES, ImageChoice, Session, SessionState, Snapshot

IMAGE_NAMES: dict[ImageChoice, str] = {"color": "Colour", "depth": "Depth", "relative": "Relative depth"}
ARROWS = {"Arrows off": 0.0, "Arrows ×1": 1.0, "Arrows ×10": 10.0, "Arrows ×100": 100.0}
_NO_SNAPSHOT = "No snapshot yet: take one on the page Snapshots"


class PointsPage(QWidget):
    """The search for points above two linked images and the table of pairs."""

    def __init__(self, session: Session, snapper: Snapper) -> None:
        super().__init__()
        self._session = session
        self._outcome = Outcome()
        self._shown: dict[Side, tuple[object, ...]] = {}
        self._clock = GestureClock()
        self._nudges = GestureClock()
        self._nominal = Alignment.of_rig(session.rig)
        self._ghost: tuple[Side, Place] | None = None
        #: What the last click snapped to, and the state that the click led to.
        self._landing: tuple[SessionState, str] = (session.state, "")
        self.finder = Finder(session)
        self.view = PairView(snapper)
        self.table = PointTable()
        self.hint = ElidedLabel()
        self.fit_line = ElidedLabel()
        self._make_tools()
        self._lay_out()
        self._connect()
        self.setFocusProxy(self.view.images["proximity"])
        self._show_state(session.state)

    # Building

    def _make_tools(self) -> None:
        self.snapshot = QComboBox()
        self.snapshot.setToolTip("The snapshot to click in; points at several inflation levels span depth")
        self.snapshot.setAccessibleName("Snapshot")
        self.snapshot.setMinimumContentsLength(15)
        self.left_image, self.right_image = QComboBox(), QComboBox()
        for box, name in ((self.left_image, "Left image (proximity camera)"), (self.right_image, "Right image")):
            box.setAccessibleName(name)
            box.setToolTip(f"{name}: colour shows the membrane's dots, depth the edges of a pressed object")
        self.stretch = _check("Contrast", "Stretch the contrast of both images")
        self.snap = _check(
            "Snap",
            "Move clicks to the centre of the nearest dot or to a crossing within 6 px; Ctrl + click does not snap",
        )
        self.link = _check("Link zoom", "Zoom and pan both images together")
        self.link.setChecked(True)
        self.loupe = _check("Loupe", "Show a magnifier at the cursor")
        self.loupe.setChecked(True)
        self.arrows = QComboBox()
        self.arrows.addItems(list(ARROWS))
        self.arrows.setCurrentIndex(2)
        self.arrows.setAccessibleName("Residual arrows")
        self.arrows.setToolTip(
            "Arrows in the left image point from each click to its fitted position, enlarged by this factor"
        )
        self.whole = _button("Whole", "Fit both images into view (0)")
        self.drop = _button("", "Delete the pairs that the fit rejects, because the others contradict them")
        self.drop.hide()
        self.load = _button("Import…", "Read pairs from a CSV file")
        self.store = _button("Export…", "Write the pairs to a CSV file")

    def _lay_out(self) -> None:
        tools = QHBoxLayout()
        tools.setSpacing(8)
        for label, box in (("Snapshot", self.snapshot), ("Left", self.left_image), ("Right", self.right_image)):
            tools.addWidget(caption(label, box))
            tools.addWidget(box)
        for widget in (self.stretch, self.snap, self.link, self.loupe, self.arrows, self.whole):
            tools.addWidget(widget)
        tools.addStretch(1)
        finding = hbox((self.finder, 1), self.load, self.store)
        self.split = splitter(Qt.Orientation.Vertical, (self.view, 1), self.table, sizes=(480, 170))
        fit = hbox((self.fit_line, 1), self.drop)
        vbox(finding, tools, (self.split, 1), self.hint, fit, within=self, margins=(8, 4, 8, 4), spacing=4)

    def _connect(self) -> None:
        session, view = self._session, self.view
        session.changed.connect(self._show_state)
        session.selectionChanged.connect(self._show_selection)
        view.placed.connect(self._clicked)
        view.set_partner(self.partner)
        for side in SIDES:
            image = view.images[side]
            image.pressed.connect(self._pressed)
            image.dragged.connect(partial(self._dragged, side))
            image.nudged.connect(partial(self._nudged, side))
            image.deleteRequested.connect(self._delete)
            image.acceptRequested.connect(self.accept_ghost)
            image.cancelRequested.connect(session.cancel_pending)
        self.table.ticked.connect(lambda row, on: session.enable(row.pair.id, on))
        self.table.selectionEdited.connect(self._row_selected)
        self.table.deleteRequested.connect(self._delete)
        self.snapshot.activated.connect(lambda _: session.set_display(snapshot=self.snapshot.currentData()))
        self.left_image.activated.connect(lambda _: session.set_display(proximity_image=self.left_image.currentData()))
        self.right_image.activated.connect(lambda _: session.set_display(tactile_image=self.right_image.currentData()))
        self.stretch.clicked.connect(lambda on: session.set_display(stretch=on))
        self.snap.clicked.connect(lambda on: session.set_display(snap=on))
        self.link.toggled.connect(view.set_linked)
        self.loupe.toggled.connect(view.set_loupe_wanted)
        self.arrows.currentTextChanged.connect(self._show_arrows)
        self.whole.clicked.connect(view.show_all)
        self.drop.clicked.connect(lambda: session.remove(self._outcome.rejected))
        self._show_arrows(self.arrows.currentText())
        accept = QShortcut(QKeySequence("Ctrl+Return"), self)
        accept.activated.connect(self.accept_ghost)

    # Display

    def show_outcome(self, outcome: Outcome) -> None:
        """Show a new fit: residuals, arrows, predicted partner."""
        self._outcome = outcome
        self.fit_line.setText("" if outcome.report is None else outcome.sentence)
        self.drop.setText(f"Remove {counted(len(outcome.rejected), 'rejected pair')}")
        self.drop.setVisible(bool(outcome.rejected))
        self._show_points()

    def show_fitting(self, busy: bool) -> None:
        """Say that residuals are being computed."""
        self.table.show_pending(busy)
        if busy:
            self.fit_line.setText("Fitting…")
        elif self.fit_line.text() == "Fitting…":  # cancelled
            self.fit_line.setText("" if self._outcome.report is None else self._outcome.sentence)

    def partner(self, side: Side, place: Place) -> Place | None:
        """Predict the pixel in the other image, from the fit or, before the first fit, from the rig."""
        snapshot = self._session.state.snapshot
        alignment = self._outcome.alignment or self._nominal
        return None if snapshot is None or alignment is None else self._expected(alignment, snapshot, side, place)

    def accept_ghost(self) -> None:
        """Use the predicted pixel as the partner of the pending click."""
        if self._ghost is not None:
            side, place = self._ghost
            self._session.click(side, *place)

    @property
    def ghost(self) -> tuple[Side, Place] | None:
        """The predicted partner, if one is offered."""
        return self._ghost

    def _show_state(self, state: SessionState) -> None:
        self._show_choices(state)
        self._show_pictures(state)
        self._show_points()

    def _show_choices(self, state: SessionState) -> None:
        choices, snapshot = state.choices, state.snapshot
        with QSignalBlocker(self.snapshot):
            self.snapshot.clear()
            for snap in state.snapshots:
                self.snapshot.addItem(snap.name, snap.digest)
            self.snapshot.setCurrentIndex(self.snapshot.findData(choices.snapshot))
        for side, box, chosen in (
            ("proximity", self.left_image, choices.proximity_image),
            ("tactile", self.right_image, choices.tactile_image),
        ):
            box.clear()
            for choice in image_choices(snapshot.frame, side) if snapshot is not None else ():  # type: ignore[arg-type]
                box.addItem(IMAGE_NAMES[choice], choice)
            box.setCurrentIndex(max(0, box.findData(chosen)) if box.count() else -1)
        self.stretch.setChecked(choices.stretch)
        self.snap.setChecked(choices.snap)
        self.view.set_snapping(choices.snap)

    def _show_pictures(self, state: SessionState) -> None:
        snapshot, choices = state.snapshot, state.choices
        for side in SIDES:
            choice = choices.proximity_image if side == "proximity" else choices.tactile_image
            key = (choices.snapshot, choice, choices.stretch)
            if self._shown.get(side) == key:
                continue
            self._shown[side] = key
            if snapshot is None:
                self.view.set_picture(side, None, _NO_SNAPSHOT)
            else:
                self.view.set_picture(side, picture(snapshot.frame, self._session.rig, side, choice, choices.stretch))

    def _show_points(self) -> None:
        state, selected = self._session.state, self._session.selected
        for side in SIDES:
            marks = image_marks(state, self._outcome, side, self._session.rig, selected)
            self.view.images[side].set_marks(marks)
        self.table.set_records(table_rows(state, self._outcome))
        self.table.select(selected)
        self._show_ghost()
        self._show_hint()

    def _show_selection(self, keys: tuple[str, ...]) -> None:
        self._show_points()

    def _show_ghost(self) -> None:
        self._ghost = None
        state, alignment = self._session.state, self._outcome.alignment
        pending, snapshot = state.pending, state.snapshot
        if alignment is not None and pending is not None and snapshot is not None:
            side: Side = "proximity" if pending.tactile is not None else "tactile"
            place = pending.proximity or pending.tactile
            assert place is not None
            expected = None
            if side == "proximity" or same_pixels(pending, state.choices.proximity_image, self._session.rig):
                expected = self._expected(alignment, snapshot, "tactile" if side == "proximity" else "proximity", place)
            if expected is not None:
                self._ghost = side, self.view.snapped(side, expected)[0]
        for side in SIDES:
            ghost = self._ghost[1] if self._ghost is not None and self._ghost[0] == side else None
            self.view.images[side].layer.set_ghost(ghost)

    def _expected(self, alignment: Alignment, snapshot: Snapshot, side: Side, place: Place) -> Place | None:
        image = "color" if self._session.state.choices.proximity_image == "color" else "depth"
        find = tactile_partner if side == "proximity" else proximity_partner
        return find(alignment, self._session.rig, snapshot.frame, image, place)  # type: ignore[arg-type]

    def _show_arrows(self, text: str) -> None:
        for image in self.view.images.values():
            image.layer.set_arrow_factor(ARROWS[text])

    def _show_hint(self) -> None:
        """Say what the last click snapped to and what to do next."""
        state, landing = self._landing
        words = f"{landing[0].upper()}{landing[1:]}. " if landing and state is self._session.state else ""
        self.hint.setText(words + self._words())

    def _words(self) -> str:
        """Say what to do next."""
        state = self._session.state
        pending = state.pending
        if state.snapshot is None:
            return _NO_SNAPSHOT + "."
        if pending is not None:
            other = "left" if pending.proximity is None else "right"
            if self._ghost is not None:
                return (
                    f"Click the partner in the {other} image, or press Enter to accept the dashed ring. Esc "
                    "removes the first click."
                )
            return f"Now click the same spot in the {other} image. Esc removes the first click."
        without = [pair.id for pair in state.pairs if pair.tactile is not None and pair.tactile_depth_m is None]
        if without:
            names = ", ".join(without[:5])
            return (
                f"No tactile depth under point {names}: the rigid model cannot use it. Move it slightly, or "
                "average more frames."
            )
        elsewhere = sum(
            1 for pair in state.pairs if not same_pixels(pair, state.choices.proximity_image, self._session.rig)
        )
        if elsewhere:
            return f"{elsewhere} pairs were clicked in the other left image and are not drawn here."
        start = "Click" if state.pairs else "Press Find points, or click"
        return f"{start} a dot in one image, then the same dot in the other. Drag or arrow keys correct."

    # Actions

    def _clicked(self, side: Side, u: float, v: float, landing: str) -> None:
        self._session.click(side, u, v)
        self._landed(landing)

    def _landed(self, landing: str) -> None:
        self._landing = self._session.state, landing
        self._show_hint()

    def _pressed(self, key: str, modifiers: Qt.KeyboardModifier) -> None:
        selected = self._session.selected
        if modifiers & Qt.KeyboardModifier.ControlModifier:
            toggled = tuple(k for k in selected if k != key) if key in selected else (*selected, key)
            self._session.select(toggled)
        else:
            self._session.select([key])

    def _dragged(self, side: Side, key: str, u: float, v: float, done: bool) -> None:
        if not self._clock.held:
            self._clock.hold()
        place, landing = self.view.snapped(side, (u, v)) if done else ((u, v), "")
        self._session.move(key, side, *place, gesture=self._clock.number())
        if done:
            self._clock.release()
            self._landed(landing)

    def _nudged(self, side: Side, du: float, dv: float) -> None:
        gesture = self._nudges.number()
        for key in self._session.selected:
            place = self._session.pair(key).place(side)
            if place is not None:
                self._session.move(key, side, place[0] + du, place[1] + dv, gesture)

    def _delete(self) -> None:
        if self._session.selected:
            self._session.remove(self._session.selected)

    def _row_selected(self, keys: tuple[str, ...]) -> None:
        """Select the points, and pan to them if they are out of view."""
        self._session.select(keys)
        if len(keys) != 1:
            return
        pair, state = self._session.pair(keys[0]), self._session.state
        image = state.choices.proximity_image
        if not same_pixels(pair, image, self._session.rig):
            image = pair.proximity_image
        snapshot = state.snapshot_of(pair)
        digest = state.choices.snapshot if snapshot is None else snapshot.digest
        self._session.set_display(snapshot=digest, proximity_image=image)
        for side in SIDES:
            place = pair.place(side)
            if place is not None:
                self.view.center_on(side, place)


def _check(text: str, tip: str) -> QCheckBox:
    box = QCheckBox(text)
    box.setToolTip(tip)
    return box


def _button(text: str, tip: str) -> QToolButton:
    button = QToolButton()
    button.setText(text)
    button.setToolTip(tip)
    return button
