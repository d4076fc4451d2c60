"""Cloud views of both back ends: software anywhere, OpenGL where there is a display."""

from __future__ import annotations

import pytest
from PyQt6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from tactune.widgets import gl_backend
from tactune.widgets.cloud_view import BackendChoice, CloudView

from .seen_clouds import shown


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
