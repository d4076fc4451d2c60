"""A cloud view and a parameter panel."""

import pyqtgraph as pg
import pytest

from hands import shown
from seen_clouds import shown_view
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.parameters.parameter_panel import ParameterPanel


@pytest.fixture(autouse=True)
def light_theme(qapp):
    apply_theme(qapp, "light")
    pg.setConfigOptions(mouseRateLimit=-1)  # every mouse move counts


@pytest.fixture
def view(qtbot):
    return shown_view(qtbot, "Proximity")


@pytest.fixture
def panel(qtbot):
    return shown(qtbot, ParameterPanel(), 340, 1000)


class Recorder:
    """Everything a panel emitted."""

    def __init__(self, panel):
        self.edits, self.resets, self.modes = [], [], []
        panel.valueEdited.connect(lambda *edit: self.edits.append(edit))
        panel.valuesEdited.connect(lambda *reset: self.resets.append(reset))
        panel.eyedropperRequested.connect(self.modes.append)


@pytest.fixture
def seen(panel):
    return Recorder(panel)
