"""Publishing from the window: the switch, its settings, and who listens."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from threading import Event

from pydantic import TypeAdapter
from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QCheckBox, QGridLayout, QLineEdit, QPushButton, QSpinBox, QWidget

from ...core.errors import as_sentence, counted
from ...core.output.connections import LOOPBACK, Connections
from ...core.output.publisher import OutputStatus, Publisher
from ...widgets.basics.controls import NoteLabel, caption, choice_button, timer
from ...widgets.basics.layouts import vbox
from ..context import Context
from ..worker.jobs import Job

#: Interval at which clients and rates are shown, ms.
_INTERVAL_MS = 500


class PublishPanel(QWidget):
    """What is published where, the switch, and who listens."""

    def __init__(self, connections: Connections) -> None:
        super().__init__()
        self.foxglove, self.ros2 = QCheckBox("&Foxglove"), QCheckBox("&ROS 2")
        self.port, self.domain, self.namespace, self.host = QSpinBox(), QSpinBox(), QLineEdit(), QLineEdit(LOOPBACK)
        self.port.setRange(1, 65535)
        self.domain.setRange(0, 232)
        for widget, tip in (
            (self.foxglove, "A WebSocket server: the Foxglove app and its clients read topics"),
            (self.ros2, "ROS 2 topics by DDS; neither side needs anything but its own middleware"),
            (self.port, "TCP port of the Foxglove server, 1 to 65535"),
            (self.domain, "ROS 2 domain id, 0 to 232, as ROS_DOMAIN_ID of the subscribers"),
            (self.namespace, "Put before every ROS 2 topic, as in /tactune/contact/patch"),
            (self.host, f"Address to listen on. {LOOPBACK}: this computer only. 0.0.0.0: every network"),
        ):
            widget.setToolTip(tip)
        grid = QGridLayout()
        grid.addWidget(self.foxglove, 0, 0)
        grid.addWidget(self.ros2, 1, 0)
        editors = {"&Port": self.port, "&Domain": self.domain, "&Namespace": self.namespace, "&Address": self.host}
        for row, (title, editor) in enumerate(editors.items()):
            grid.addWidget(caption(title, editor), row, 1)
            grid.addWidget(editor, row, 2)
        grid.setColumnStretch(2, 1)
        self.note = NoteLabel()
        self.start = choice_button(
            "&Start publishing", "Let clients connect, or disconnect them all and stop listening"
        )
        self.state = NoteLabel(lines=2)
        self.state.setAccessibleName("Who listens")
        vbox(grid, self.note, self.start, self.state, within=self, margins=0)
        self.foxglove.setChecked(connections.foxglove)
        self.ros2.setChecked(connections.ros2)
        self.port.setValue(connections.port)
        self.domain.setValue(connections.domain)
        self.namespace.setText(connections.namespace)
        for box in (self.foxglove, self.ros2):
            box.toggled.connect(self._check)
        self.host.textChanged.connect(self._check)
        self._check()

    @property
    def connections(self) -> Connections:
        return Connections(
            self.foxglove.isChecked(),
            self.ros2.isChecked(),
            self.host.text().strip() or LOOPBACK,
            self.port.value(),
            self.domain.value(),
            self.namespace.text().strip(),
        )

    def show_state(self, running: bool, sentence: str = "", error: bool = False) -> None:
        self.start.setChecked(running)
        self.start.setText("&Stop publishing" if running else "&Start publishing")
        for control in (self.foxglove, self.ros2, self.port, self.domain, self.namespace, self.host):
            control.setEnabled(not running)
        self._check()
        if sentence:
            self.state.say(sentence, error)

    def _check(self) -> None:
        self.start.setEnabled(self.start.isChecked() or self.foxglove.isChecked() or self.ros2.isChecked())
        if not self.start.isChecked():
            to = " and ".join(box.text().replace("&", "") for box in (self.foxglove, self.ros2) if box.isChecked())
            todo = f"Start publishing sends patches to {to}" if to else "Tick Foxglove or ROS 2"
            self.state.say(f"Nothing is published. {todo}.")
        warning = self.connections.warning
        self.note.say(as_sentence(warning) if warning else "")


class PublishControl(QObject):
    """Switches publishing on and off. It is off at every start of the window, whatever it was before."""

    def __init__(self, context: Context, indicator: QPushButton) -> None:
        super().__init__(context)
        self._context, self._indicator = context, indicator
        self._publisher: Publisher | None = None
        self._closed = Event()
        panel = self.panel = PublishPanel(self._remembered())
        chosen = panel.foxglove.toggled, panel.ros2.toggled
        for edited in (*chosen, panel.port.valueChanged, panel.domain.valueChanged, panel.namespace.textChanged):
            edited.connect(self._remember)
        self._timer = timer(self, _INTERVAL_MS, self._show)
        panel.start.clicked.connect(self._switch)
        # ROS 2 takes most of a second
        self._starting = Job(self, self._started, lambda sentence: panel.show_state(False, sentence, error=True))

    def close(self) -> None:
        self._closed.set()
        self._starting.stop()
        self._stop()

    def _switch(self, on: bool) -> None:
        if not on:
            self._stop()
            return
        connections = self.panel.connections
        self.panel.show_state(True, "Starting…")
        self.panel.start.setEnabled(False)

        def start(_: object) -> Publisher:
            publisher = self._publisher = Publisher(connections.make_sinks())
            if self._closed.is_set():  # the window has closed meanwhile, perhaps before it saw this publisher
                publisher.close()
            return publisher

        self._starting.start(start)

    def _started(self, publisher: Publisher) -> None:
        self._context.worker.set_publisher(self._publisher)
        self._timer.start()
        self._show()

    def _stop(self) -> None:
        self._timer.stop()
        self._context.worker.set_publisher(None)
        if self._publisher is not None:
            self._publisher.close()
        self._publisher = None
        self._indicator.hide()
        self.panel.show_state(False)

    def _show(self) -> None:
        if self._publisher is None:
            return
        states = self._publisher.status()
        self.panel.show_state(True, "\n".join(map(_in_words, states)))
        clients = sum(state.sink.clients for state in states)
        self._indicator.setText(f"Publishing, {counted(clients, 'client')}")
        self._indicator.show()

    def _remembered(self) -> Connections:
        with suppress(ValueError):
            return TypeAdapter(Connections).validate_json(self._context.settings.text("publish"))
        return Connections(foxglove=True)

    def _remember(self) -> None:
        """Remember all but the address: listening beyond this computer is asked for each time."""
        kept = replace(self.panel.connections, host=LOOPBACK)
        self._context.settings.set("publish", TypeAdapter(Connections).dump_json(kept).decode())


def _in_words(state: OutputStatus) -> str:
    sink = state.sink
    counts = counted(sink.clients, "client")
    if sink.clients:
        counts += f", {state.rate_hz:.0f} frames/s, {state.missed} missed"
    return f"{sink.name}, {sink.place}: {counts}{'. ' if state.error else ''}{state.error}"
