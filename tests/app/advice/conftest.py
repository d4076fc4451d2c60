"""A window at a frame of the printed membrane."""

import pytest

from hands import show_source
from printed_source import PrintedSource


@pytest.fixture
def main(window, qtbot):
    """A window at frame 6 of the printed membrane, its mask off."""
    show_source(qtbot, window, PrintedSource(), 6)
    return window
