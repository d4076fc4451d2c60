"""The numbers of the status bar fit at every width of the window."""

from __future__ import annotations

import pytest

from tactune.app.window.status import FrameStatus

TIMES = {"fusion": 1.5, "gaps": 1.6, "edge": 1.1, "press": 3.2, "balance": 4.6, "clusters": 0.3, "points": 0.5}


@pytest.mark.parametrize("width_px", [1000, 1280, 1920])
def test_the_times_of_the_stages_are_summed_up_where_they_do_not_fit(qtbot, width_px):
    bar = FrameStatus()
    qtbot.addWidget(bar)
    bar.resize(width_px, 24)
    each = bar._in_words(TIMES)
    if width_px == 1920:
        assert each == "fusion 1.5  gaps 1.6  edge 1.1  press 3.2  balance 4.6  clusters 0.3  points 0.5 ms"
    if width_px == 1000:
        assert each == "12.8 ms, balance 4.6 of it"
    assert bar.fontMetrics().horizontalAdvance(each) <= 0.45 * width_px
    assert bar._in_words({"fusion": 1.5, "outliers": 0.4, "clusters": 0.0}) == "fusion 1.5  outliers 0.4 ms"
    assert bar._in_words(dict.fromkeys(TIMES, 0.0)) == "nothing computed anew"
