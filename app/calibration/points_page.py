"""The page for finding and clicking point pairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import hypot, isfinite, nan

from PyQt6.QtCore import QRectF, QSignalBlocker, Qt
from PyQt6.QtWidgets import QComboBox, QWidget

from ...core.calibration.detect import snap_to_feature
from ...core.calibration.geometry import Alignment
from ...core.calibration.report import PairQuality
from ...core.errors import counted
from ...core.model.alignment import Place, PointPair, Side
from ...widgets.basics.controls import ElidedLabel, GestureClock, caption, push_button
from ...widgets.basics.layouts import hbox, holding, splitter, vbox
from ...widgets.basics.record_table import Column, RecordTable
from ...widgets.images.point_image import PointImage
from .correspondence import proximity_partner, tactile_partner
from .finder import Finder
from .fitting import Outcome, image_marks, same_pixels
from .pictures import Picture, picture
from .session import SIDES, Session, SessionState

TITLES: dict[Side, str] = {"proximity": "Proximity camera (left)", "tactile": "Tactile camera (right)"}
_NO_SNAPSHOT = "No snapshot yet: take one on the page Snapshots"
#: Largest distance that snapping moves a click, pixels.
_REACH_PX = 6.0


def other_side(side: Side) -> Side:
    return "tactile" if side == "proximity" else "proximity"


class PointsPage(QWidget):
    """The search for points above two images, which zoom and pan together, and the table of pairs."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._outcome = Outcome()
        self._pictures: dict[Side, Picture] = {}
        self._shown: tuple[str, str] | None = None
        self._clock = GestureClock()
        self._nudges = GestureClock()
        self._nominal = Alignment.of_rig(session.rig)
        self._linking = False
        #: The predicted partner of the first click, if one is offered.
        self.ghost: tuple[Side, Place] | None = None
        self.finder = Finder(session)
        self.images = {side: PointImage(TITLES[side]) for side in SIDES}
        self.table = PointTable()
        self.hint = ElidedLabel()
        self.snapshot, self.image = QComboBox(), QComboBox()
        self.snapshot.setToolTip("The snapshot to click in; points at several inflation levels span depth")
        self.snapshot.setMinimumContentsLength(15)
        self.image.setToolTip("Colour shows the membrane's dots, depth the edges of a pressed object")
        self.image.addItem("Colour", "color")
        self.image.addItem("Depth", "depth")
        self.drop = push_button("", "Delete the pairs that the fit rejects, because the others contradict them")
        self.drop.hide()
        self.load = push_button("&Import…", "Read pairs from a CSV file")
        self.store = push_button("&Export…", "Write the pairs to a CSV file")
        shown = (caption("&Snapshot", self.snapshot), self.snapshot, caption("Ima&ge", self.image), self.image)
        tools = hbox(*shown, (self.finder, 1), spacing=8)
        self.views = holding(hbox(*((image, 1) for image in self.images.values()), margins=0, spacing=8))
        self.split = splitter(Qt.Orientation.Vertical, (self.views, 3), (self.table, 1), sizes=(480, 170))
        below = hbox((self.hint, 1), self.drop, self.load, self.store)
        vbox(tools, (self.split, 1), self.finder.words, below, within=self, margins=(8, 4, 8, 4), spacing=4)
        self._connect()
        self.setFocusProxy(self.images["proximity"])
        self._show_state(session.state)

    def _connect(self) -> None:
        session = self._session
        session.changed.connect(self._show_state)
        session.selectionChanged.connect(lambda _: self._show_points())
        for side, image in self.images.items():
            image.placed.connect(partial(self._clicked, side))
            image.pointed.connect(partial(self._pointed, side))
            image.viewMoved.connect(partial(self._follow, side))
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
        self.image.activated.connect(lambda _: session.set_display(image=self.image.currentData()))
        self.drop.clicked.connect(lambda: session.remove(self._outcome.rejected))

    # Display

    def show_outcome(self, outcome: Outcome) -> None:
        self._outcome = outcome
        self.drop.setText(f"Re&move {counted(len(outcome.rejected), 'rejected pair')}")
        self.drop.setVisible(bool(outcome.rejected))
        self._show_points()

    def _show_state(self, state: SessionState) -> None:
        choices, snapshot = state.choices, state.snapshot
        with QSignalBlocker(self.snapshot):
            self.snapshot.clear()
            for snap in state.snapshots:
                self.snapshot.addItem(snap.name, snap.digest)
            self.snapshot.setCurrentIndex(self.snapshot.findData(choices.snapshot))
        self.image.setCurrentIndex(self.image.findData(choices.image))
        if self._shown != (choices.snapshot, choices.image):
            self._shown = (choices.snapshot, choices.image)
            for side, image in self.images.items():
                if snapshot is None:
                    self._pictures.clear()
                    image.set_image(None, _NO_SNAPSHOT)
                else:
                    self._pictures[side] = picture(snapshot.frame, self._session.rig, side, choices.image)
                    image.set_image(self._pictures[side].pixels)
        self._show_points()

    def _show_points(self) -> None:
        state, selected = self._session.state, self._session.selected
        half = state.pending if state.pending is not None and state.pending.snapshot == state.number else None
        for side, image in self.images.items():
            image.awaits_point = half is not None and half.place(side) is None
            image.layer.set_marks(image_marks(state, self._outcome, side, self._session.rig, selected))
        self.table.set_records(table_rows(state, self._outcome))
        self.table.select(selected)
        self._show_ghost()
        self.hint.setText(self._next_step())

    def _show_ghost(self) -> None:
        self.ghost = None
        state, rig = self._session.state, self._session.rig
        pending = state.pending
        if self._outcome.alignment is not None and pending is not None:
            clicked: Side = "tactile" if pending.proximity is None else "proximity"
            place = pending.place(clicked)
            seen = clicked == "tactile" or same_pixels(pending, state.choices.image, rig)
            expected = self.partner(clicked, place) if seen and place is not None else None
            if expected is not None:
                side = other_side(clicked)
                snapped = self.snapped(side, expected)[0]
                # where nothing snaps, to accept the fit's own prediction would only confirm the fit
                self.ghost = (side, snapped) if snapped != expected else None
        for side, image in self.images.items():
            image.layer.set_ghost(self.ghost[1] if self.ghost is not None and self.ghost[0] == side else None)

    def _next_step(self) -> str:
        state = self._session.state
        pending = state.pending
        if state.snapshot is None:
            return f"{_NO_SNAPSHOT}."
        if pending is not None:
            other = "left" if pending.proximity is None else "right"
            if self.ghost is not None:
                return f"Click the partner in the {other} image, or press Enter to accept the dashed ring. Esc cancels."
            return f"Now click the same spot in the {other} image. Esc removes the first click."
        elsewhere = sum(not same_pixels(pair, state.choices.image, self._session.rig) for pair in state.pairs)
        if elsewhere:
            return f"{counted(elsewhere, 'pair')} clicked in the other image of the left camera: not drawn here."
        if wrong := [pair.id for pair in state.pairs if pair.id in self._outcome.rejected]:
            remove = self.drop.text().replace("&", "")
            return f"The others contradict {', '.join(wrong[:9])}: drag the points, or press {remove}."
        start = "Click" if state.pairs else "Press Find points, or click"
        return (
            f"{start} a dot in one image, then the same dot in the other. Drag or arrow keys correct; Ctrl + click "
            "does not snap."
        )

    # Two images

    def partner(self, side: Side, place: Place) -> Place | None:
        """Predict the pixel in the other image, from the fit or, before the first fit, from the rig."""
        state, rig = self._session.state, self._session.rig
        alignment = self._outcome.alignment or self._nominal
        if state.snapshot is None or alignment is None:
            return None
        find = tactile_partner if side == "proximity" else proximity_partner
        return find(alignment, rig, state.snapshot.frame, state.choices.image, place)

    def snapped(self, side: Side, place: Place) -> tuple[Place, str]:
        """Return the centre of the dot or the crossing near a pixel, or the pixel itself, and what it is."""
        shown = self._pictures.get(side)
        if shown is None:
            return place, ""
        found = snap_to_feature(shown.gray, *place, radius=_REACH_PX)
        if found is None:
            return place, "nothing to snap to"
        name = "dot centre" if found.kind == "blob" else "crossing"
        return (found.u, found.v), f"{name}, {hypot(found.u - place[0], found.v - place[1]):.1f} px away"

    def _pointed(self, side: Side, u: float, v: float) -> None:
        """Show in the loupe what a click snaps to, and in the other image the same spot."""
        inside, loupe = isfinite(u), self.images[side].loupe
        if inside and loupe.isVisible():
            place, words = self.snapped(side, (u, v))
            loupe.set_snapped(place if place != (u, v) else None, words)
        self.images[other_side(side)].layer.set_partner(self.partner(side, (u, v)) if inside else None)

    def _follow(self, side: Side) -> None:
        """Show the same part of the scene in the other image, if the partner of the centre is known."""
        if self._linking:
            return
        image, other = self.images[side], self.images[other_side(side)]
        seen, whole, other_whole = image.box.viewRect(), image.image_rect(), other.image_rect()
        width = seen.width() * other_whole.width() / whole.width()
        height = seen.height() * other_whole.height() / whole.height()
        centre = self.partner(side, (seen.center().x(), seen.center().y()))
        if width >= other_whole.width():
            centre = (other_whole.center().x(), other_whole.center().y())
        if centre is None:
            return
        self._linking = True
        other.show_rect(QRectF(centre[0] - width / 2, centre[1] - height / 2, width, height))
        self._linking = False

    # Actions

    def accept_ghost(self) -> None:
        if self.ghost is not None:
            side, place = self.ghost
            self._session.click(side, *place)

    def _clicked(self, side: Side, u: float, v: float, modifiers: Qt.KeyboardModifier) -> None:
        free = bool(modifiers & Qt.KeyboardModifier.ControlModifier)
        self._session.click(side, *((u, v) if free else self.snapped(side, (u, v))[0]))

    def _pressed(self, key: str, modifiers: Qt.KeyboardModifier) -> None:
        selected = self._session.selected
        if modifiers & Qt.KeyboardModifier.ControlModifier:
            self._session.select([k for k in selected if k != key] if key in selected else [*selected, key])
        else:
            self._session.select([key])

    def _dragged(self, side: Side, key: str, u: float, v: float, done: bool) -> None:
        if not self._clock.held:
            self._clock.hold()
        place = self.snapped(side, (u, v))[0] if done else (u, v)
        self._session.move(key, side, *place, gesture=self._clock.number())
        if done:
            self._clock.release()

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
        """Select the points, and show the snapshot and image of a single one, centred where it is out of view."""
        self._session.select(keys)
        if len(keys) != 1:
            return
        pair, state = self._session.pair(keys[0]), self._session.state
        snapshot, choice = state.snapshot_of(pair), state.choices.image
        self._session.set_display(
            snapshot=state.choices.snapshot if snapshot is None else snapshot.digest,
            image=choice if same_pixels(pair, choice, self._session.rig) else pair.proximity_image,
        )
        for side, image in self.images.items():
            place, rect = pair.place(side), image.box.viewRect()
            if place is not None and not rect.contains(*place):
                rect.moveCenter(rect.center().__class__(*place))
                image.show_rect(rect)


@dataclass(frozen=True)
class PointRow:
    """A pair under the fit, and where it comes from or what to do about it; marked if it stands out."""

    pair: PointPair
    fit: PairQuality
    note: str = ""
    marked: bool = False


def table_rows(state: SessionState, outcome: Outcome) -> list[PointRow]:
    fits, standing_out = outcome.fits, outcome.standing_out
    rows = []
    for pair in state.pairs:
        fit = fits.get(pair.id, PairQuality(pair.id))
        snapshot = state.snapshot_of(pair)
        note = f"{pair.origin} in {'colour' if pair.proximity_image == 'color' else 'depth'}"
        if snapshot is not None:
            note += f", {snapshot.name}"
        if not pair.complete:
            note = "Click the same point in the other image, or press Esc to remove this click"
        elif pair.tactile_depth_m is None:
            note = "No depth under the right point: only the homography can use this pair; move the point a few pixels"
        elif pair.id in fits and not fit.used:
            note = "Rejected, because the others contradict it; check both points"
        elif pair.id in standing_out:
            note = "The residual is large; check both points, or disable the pair"
        rows.append(PointRow(pair, fit, note, pair.id in standing_out))
    return rows


class PointTable(RecordTable):
    """Shows pairs; sorted by any column, the worst on top at first, those that stand out highlighted."""

    def __init__(self) -> None:
        def number(title: str, tip: str, value: str, decimals: int = 2) -> Column:
            return Column(title, lambda row: getattr(row.fit, value), tip, decimals, sample="-0000.00")

        def depth_mm(row: PointRow) -> float:
            return nan if row.pair.tactile_depth_m is None else 1e3 * row.pair.tactile_depth_m

        columns = (
            Column("#", lambda row: float(row.pair.id), "Number of the pair", 0, sample="000"),
            Column(
                "On",
                lambda row: "",
                "Whether the fit uses the pair (space)",
                ticked=lambda row: row.pair.enabled,
                sample="000",
            ),
            number("Res. px", "Distance in the left image between the click and its fitted place", "residual_px"),
            number("Res. mm", "The residual at the point's depth, millimetres", "residual_mm"),
            Column("Depth mm", depth_mm, "Tactile depth at the right point, millimetres", 1, sample="-0000.00"),
            Column("Note", lambda row: row.note, hint=lambda row: row.note),
        )
        super().__init__(
            columns,
            "Point pairs",
            "Point pairs and their residuals: left is proximity, right is tactile",
            key=lambda row: row.pair.id,
            marked=lambda row: row.marked,
            sortable=True,
        )
        self.sortByColumn(2, Qt.SortOrder.DescendingOrder)
