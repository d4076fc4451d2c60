"""A cloud view and a parameter panel."""

import pyqtgraph as pg
import pytest

from hands import shown
from panel_steering import Recorder
from seen_clouds import shown_view
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.parameters.parameter_panel import ParameterPanel


@pytest.fixture(autouse=True)
def light_theme(qapp):
    apply_theme(qapp, "light")


@pytest.fixture(autouse=True)
def every_mouse_move_counts():
    before = pg.getConfigOption("mouseRateLimit")
    pg.setConfigOptions(mouseRateLimit=-1)
    yield
    pg.setConfigOptions(mouseRateLimit=before)


@pytest.fixture
def view(qtbot):
    return shown_view(qtbot, "Proximity")


@pytest.fixture
def panel(qtbot):
    return shown(qtbot, ParameterPanel(), 340, 1000)


@pytest.fixture
def seen(panel):
    return Recorder(panel)
