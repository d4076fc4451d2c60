"""The page *Cameras*: the connected cameras, and which of them has which role."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import QSignalBlocker
from PyQt6.QtWidgets import QComboBox, QFormLayout

from ...core.errors import as_sentence
from ...core.preset import CamerasSection
from ...widgets.basics.controls import caption, named, push_button
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.overlays import Notice
from ...widgets.basics.record_table import Column, RecordTable
from ..worker.jobs import Job
from .list_devices import ask_driver
from .pages import SourcePage

CAMERAS = "cameras:"

_NONE = (
    "No RealSense camera was found. Plug both cameras into USB 3 ports and press Refresh. If they are plugged in, "
    "run tactune doctor: it reports what is missing and the remedy."
)
_ONE = "Only one camera was found. Plug in the other one and press Refresh, or choose none as the proximity camera."
_COLUMNS = (
    Column("Model", lambda camera: camera["model"]),
    Column("Serial number", lambda camera: camera["serial"]),
    Column("Firmware", lambda camera: camera.get("firmware", "")),
    Column("USB", lambda camera: f"USB {camera['usb']}" if camera.get("usb") else ""),
    Column("Note", lambda camera: camera.get("problem", ""), hint=lambda camera: camera.get("problem", "")),
)
_ROS2 = "ros2:"
#: Data of the entry for no proximity camera.
_ALONE = "none"


class CamerasPage(SourcePage):
    """Lists the connected cameras and asks which is the proximity and which the tactile one."""

    title = "Cameras"

    def __init__(self, cameras: CamerasSection) -> None:
        super().__init__()
        self._search = Job(self, done=self._show_answer, failed=self._show_failure)
        self._remembered = cameras.proximity.serial, cameras.tactile.serial
        self._found: list[dict[str, Any]] = []
        self._hint = ""
        self._has_searched = False
        self.list = RecordTable(_COLUMNS, "Connected cameras", "The cameras that are connected now")
        self.empty = Notice(self.list)
        through = "Looks through the membrane at the object: the L515 (infrared, time of flight)"
        self.proximity = named(QComboBox(), "Proximity camera", through)
        self.tactile = named(
            QComboBox(), "Tactile camera", "Sees the membrane itself: the D405 (visible light, stereo)"
        )
        self.refresh = push_button("Re&fresh", "Search for cameras again (F5)", shortcut="F5")
        self.topics = push_button("Open &ROS 2 topics", f"Open {_ROS2}, the cameras whose ROS 2 drivers publish now")
        form = QFormLayout()
        form.addRow(caption("&Proximity camera", self.proximity), self.proximity)
        form.addRow(caption("&Tactile camera", self.tactile), self.tactile)
        vbox((self.list, 1), hbox(self.refresh, self.topics, STRETCH), form, within=self, margins=8)
        self.refresh.clicked.connect(self._look)
        self.topics.clicked.connect(lambda: self._open(_ROS2))
        self.proximity.currentIndexChanged.connect(self._check)
        self.tactile.currentIndexChanged.connect(self._check)
        self.list.activated.connect(lambda _: self.activated.emit())

    @property
    def serials(self) -> tuple[str, str] | None:
        """Serial numbers of the proximity and the tactile camera, empty for *by its model*; None without a choice."""
        if not self.name.startswith(CAMERAS):
            return None
        proximity = self.proximity.currentData()
        return "" if proximity in (None, _ALONE) else proximity, self.tactile.currentData() or ""

    def come_up(self) -> None:
        if not self._has_searched:
            self._look()

    def stop(self) -> None:
        self._search.stop()

    def _choose(self, name: str, note: str = "") -> None:
        """Choose a name; without cameras the note stands where they would."""
        there = bool(self.list.records())
        self.empty.set_text("" if there else note)
        super()._choose(name, note if there else "")

    def _look(self) -> None:
        self._has_searched = True
        self.refresh.setEnabled(False)
        self._choose("", "Searching for cameras…")
        self._search.start(lambda _: ask_driver())

    def _show_answer(self, answer: dict[str, Any]) -> None:
        cameras = answer["devices"]
        self._found = [camera for camera in cameras if camera["serial"]]
        self._hint = ""
        if not any(camera.get("role") == "proximity" for camera in cameras):
            self._hint = "; ".join(filter(None, [answer.get("hint", ""), *answer.get("problems", [])]))
        self.refresh.setEnabled(True)
        self.list.set_records(cameras)
        for combo, remembered, through in zip(
            (self.proximity, self.tactile), self._remembered, (True, False), strict=True
        ):
            with QSignalBlocker(combo):
                self._fill(combo, remembered, through)
        self._check()

    def _fill(self, combo: QComboBox, remembered: str, through: bool) -> None:
        """Offer all cameras. Select the one chosen before, else one of a suitable kind."""
        combo.clear()
        combo.addItem("by its model", "")
        if through:
            combo.addItem("none: a tactile camera only", _ALONE)
        for camera in self._found:
            combo.addItem(f"{camera['model']} (serial {camera['serial']})", camera["serial"])
        fitting = [camera["serial"] for camera in self._found if (camera.get("role") == "proximity") == through]
        known = combo.findData(remembered) if remembered else -1
        combo.setCurrentIndex(known if known >= 0 else combo.findData(next(iter(fitting), "")))

    def _show_failure(self, sentence: str) -> None:
        self._show_answer({"devices": []})
        self._choose("", as_sentence(sentence))

    def _check(self) -> None:
        """Say what is wrong with the choice; only a valid one has a name."""
        first, second = self.proximity.currentData(), self.tactile.currentData()
        problem, alone = "", first == _ALONE
        if not self._found:
            problem = _NONE
        elif alone:
            problem = "" if second else "Choose the tactile camera."
        elif len(self._found) == 1:
            problem = _ONE
        elif first and first == second:
            problem = "The same camera is chosen twice: choose another one for one role."
        said = problem or ("A rig with a tactile camera only." if alone else f"{len(self._found)} cameras were found.")
        name = f"{CAMERAS}{'' if alone else first},{second}" if first and second else CAMERAS
        self._choose("" if problem else name, f"{said} {as_sentence(self._hint)}" if self._hint else said)
