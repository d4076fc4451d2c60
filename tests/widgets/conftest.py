"""Cloud views of both back ends, software anywhere, OpenGL where there is a display; and a parameter panel."""

from __future__ import annotations

from collections.abc import Iterator

import pyqtgraph as pg
import pytest
from PyQt6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from panel_steering import Recorder
from seen_clouds import shown
from tactune.widgets.clouds import gl_backend
from tactune.widgets.clouds.cloud_view import BackendChoice, CloudView
from tactune.widgets.parameters.parameter_panel import ParameterPanel


@pytest.fixture(autouse=True)
def every_mouse_move_counts() -> Iterator[None]:
    before = pg.getConfigOption("mouseRateLimit")
    pg.setConfigOptions(mouseRateLimit=-1)
    yield
    pg.setConfigOptions(mouseRateLimit=before)


@pytest.fixture
def opengl(qapp: QApplication) -> BackendChoice:
    """The OpenGL back end, emulated or not, where there is one."""
    probe = gl_backend.probe_opengl()
    if not probe.usable:
        pytest.skip(f"no OpenGL context: {probe.reason}")
    return "opengl"


@pytest.fixture(params=["software", pytest.param("opengl", marks=pytest.mark.gl)])
def backend(request: pytest.FixtureRequest) -> BackendChoice:
    if request.param == "opengl":
        request.getfixturevalue("opengl")
    choice: BackendChoice = request.param
    return choice


@pytest.fixture
def view(backend: BackendChoice, qtbot: QtBot) -> CloudView:
    return shown(qtbot, CloudView("Proximity", backend))


@pytest.fixture
def panel(qtbot: QtBot) -> ParameterPanel:
    widget = ParameterPanel()
    qtbot.addWidget(widget)
    widget.resize(340, 1000)
    widget.show()
    qtbot.waitExposed(widget)
    widget.activateWindow()
    qtbot.waitUntil(widget.isActiveWindow)
    return widget


@pytest.fixture
def seen(panel: ParameterPanel) -> Recorder:
    return Recorder(panel)
