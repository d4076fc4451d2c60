"""The proximity and the tactile image side by side, with linked zoom, loupe, snapping and partners."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import isfinite

from PyQt6.QtCore import QRectF, Qt, pyqtSignal
from PyQt6.QtWidgets import QWidget

from ...core.calibration.detect import Snapped
from ...core.errors import TactuneError
from ...core.model.alignment import Place, Side
from ...widgets.basics.layouts import hbox
from ...widgets.images.point_image import PointImage
from .pictures import Picture, landing
from .session import SIDES

Snapper = Callable[[Picture, Place], Snapped | None]
Partner = Callable[[Side, Place], Place | None]

TITLES: dict[Side, str] = {"proximity": "Proximity camera (left)", "tactile": "Tactile camera (right)"}


class PairView(QWidget):
    """Two linked `PointImage` widgets; ``snapper`` returns the feature near a pixel of a picture, or None."""

    #: Side, u, v of a click where there is no mark yet, snapped unless snapping is off or Ctrl is held, and what it
    #: snapped to; empty if it was not to snap.
    placed = pyqtSignal(str, float, float, str)

    def __init__(self, snapper: Snapper) -> None:
        super().__init__()
        self.images = {side: PointImage(TITLES[side]) for side in SIDES}
        self._pictures: dict[Side, Picture | None] = dict.fromkeys(SIDES)
        self._snapper = snapper
        self._snaps = True
        self._linked = True
        self._linking = False
        self._partner: Partner = lambda side, place: None
        layout = hbox(within=self, margins=0, spacing=8)
        for side in SIDES:
            image = self.images[side]
            layout.addWidget(image, 1)
            image.placed.connect(partial(self._placed, side))
            image.pointed.connect(partial(self._pointed, side))
            image.viewMoved.connect(partial(self._follow, side))

    def set_picture(self, side: Side, picture: Picture | None, message: str = "") -> None:
        """Show another image on one side."""
        self._pictures[side] = picture
        self.images[side].set_image(None if picture is None else picture.pixels, message)

    def set_snapping(self, snaps: bool) -> None:
        """Switch snapping to nearby corners and blobs on or off."""
        self._snaps = snaps

    def set_linked(self, linked: bool) -> None:
        """Link or unlink zoom and pan of both images."""
        self._linked = linked

    def set_partner(self, partner: Partner) -> None:
        """Set the function that predicts the pixel in the other image."""
        self._partner = partner

    def set_loupe_wanted(self, wanted: bool) -> None:
        """Show or hide a magnifier at the cursor."""
        for image in self.images.values():
            image.set_loupe_wanted(wanted)

    def show_all(self) -> None:
        """Fit both images into view."""
        for image in self.images.values():
            image.show_all()

    def center_on(self, side: Side, place: Place) -> None:
        """Pan one image so that a pixel becomes visible, without zooming."""
        image = self.images[side]
        rect = image.box.viewRect()
        if not rect.adjusted(rect.width() / 20, rect.height() / 20, -rect.width() / 20, -rect.height() / 20).contains(
            *place
        ):
            rect.moveCenter(rect.center().__class__(*place))
            image.show_rect(rect)

    def snapped(self, side: Side, place: Place) -> tuple[Place, str]:
        """Return the feature near a pixel, or the pixel itself, and what it is; empty if snapping is off."""
        picture = self._pictures[side]
        if not self._snaps or picture is None:
            return place, ""
        try:
            found = self._snapper(picture, place)
        except TactuneError:
            found = None
        return place if found is None else (found.u, found.v), landing(place, found)

    def _placed(self, side: Side, u: float, v: float, modifiers: Qt.KeyboardModifier) -> None:
        free = bool(modifiers & Qt.KeyboardModifier.ControlModifier)
        place, words = ((u, v), "") if free else self.snapped(side, (u, v))
        self.placed.emit(side, *place, words)

    def _pointed(self, side: Side, u: float, v: float) -> None:
        inside = isfinite(u)
        loupe = self.images[side].loupe
        if inside and loupe.isVisible():
            place, words = self.snapped(side, (u, v))
            loupe.set_snapped(place if place != (u, v) else None, words)
        other = self.images[_other(side)]
        other.layer.set_partner(self._partner(side, (u, v)) if inside else None)

    def _follow(self, side: Side) -> None:
        """Show the same part of the scene in the other image, if the partner of the centre is known."""
        if not self._linked or self._linking:
            return
        image, other = self.images[side], self.images[_other(side)]
        seen, whole, other_whole = image.box.viewRect(), image.image_rect(), other.image_rect()
        centre = self._partner(side, (seen.center().x(), seen.center().y()))
        if centre is None:
            share_u = (seen.center().x() - whole.left()) / whole.width()
            share_v = (seen.center().y() - whole.top()) / whole.height()
            centre = (
                other_whole.left() + share_u * other_whole.width(),
                other_whole.top() + share_v * other_whole.height(),
            )
        width = seen.width() * other_whole.width() / whole.width()
        height = seen.height() * other_whole.height() / whole.height()
        if width >= other_whole.width():
            centre = (other_whole.center().x(), other_whole.center().y())
        self._linking = True
        other.show_rect(QRectF(centre[0] - width / 2, centre[1] - height / 2, width, height))
        self._linking = False


def _other(side: Side) -> Side:
    return "tactile" if side == "proximity" else "proximity"
