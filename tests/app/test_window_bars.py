"""Toolbar and status bar are readable at every width of the window."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from PyQt6.QtWidgets import QLabel, QToolButton

from contrast import contrast_ratio
from tactune.app.window.status import FrameStatus
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, Wanted
from tactune.core.preset import Preset
from tactune.widgets.basics.theme import theme_colors
from tiny_sensor import tiny_frame, tiny_rig

TIMES = {"average": 2.0, "fusion": 2.5, "equilibrium": 6.6, "edge": 0.4, "clusters": 0.8, "points": 0.5}
EACH = "average 2.0  fusion 2.5  equilibrium 6.6  edge 0.4  clusters 0.8  points 0.5 ms"
SUM = "12.8 ms (equilibrium 6.6)"


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_arrow_to_actions_without_room_is_seen_and_named(make_window, qtbot, theme):
    window = make_window(size=(1000, 700))
    window.toolbar.show_source("folder:/home/somebody/recordings/cup")
    window.toolbar.show_preset("a preset with a long name", None)
    window.set_theme(theme, remember=False)
    arrow = window.toolbar.findChild(QToolButton, "qt_toolbar_ext_button")
    qtbot.waitUntil(arrow.isVisible)
    for expanded in (False, True):
        arrow.setChecked(expanded)
        image = window.toolbar.grab(arrow.geometry()).toImage()
        middle = {image.pixelColor(x, image.height() // 2).name() for x in range(3, image.width() - 3)}
        contrasts = [contrast_ratio(pixel, theme_colors().window) for pixel in middle]
        assert max(contrasts) > 4.5 and min(contrasts) < 2
    assert arrow.toolTip() == arrow.accessibleName() == "More actions"


@pytest.fixture(scope="module")
def result():
    info = SourceInfo("tiny", tiny_rig(), 1, 30.0)
    return FrameProcessor().process(info, tiny_frame(3, info.rig), Preset(), Wanted(), PlaybackState())


@pytest.fixture
def bar(qtbot):
    made = FrameStatus()
    qtbot.addWidget(made)
    return made


def texts(bar, result, times) -> set[str]:
    patch = SimpleNamespace(points=result.patch.points, averaged_frames=1, stage_ms=times)
    bar.show_result(replace(result, patch=patch))
    return {label.text() for label in bar.findChildren(QLabel)}


@pytest.mark.parametrize(("width_px", "shown", "not_shown"), [(1000, SUM, EACH), (1920, EACH, SUM)])
def test_the_times_of_the_stages_are_summed_up_where_they_do_not_fit(bar, result, width_px, shown, not_shown):
    bar.resize(width_px, 24)
    found = texts(bar, result, TIMES)
    assert shown in found and not_shown not in found


@pytest.mark.parametrize(
    ("times", "shown"),
    [
        ({"fusion": 1.5, "outliers": 0.4, "clusters": 0.0}, "fusion 1.5  outliers 0.4 ms"),
        (dict.fromkeys(TIMES, 0.0), "unchanged"),
    ],
)
def test_stages_that_took_no_time_are_left_out(bar, result, times, shown):
    bar.resize(1280, 24)
    assert shown in texts(bar, result, times)


def test_points_and_area_are_those_of_the_frame_in_the_views_while_frames_play(bar, result):
    running = replace(result, playback=PlaybackState(playing=True))
    count = len(result.patch.points)
    for points in (count, 0, count):  # faster than the other numbers change
        patch = SimpleNamespace(points=result.patch.points[:points], averaged_frames=1, stage_ms=TIMES)
        bar.show_result(replace(running, patch=patch, area_mm2=points / 10))
        shown = {label.text() for label in bar.findChildren(QLabel)}
        assert {f"{points:,} points", f"patch {points / 1000:.1f} cm²"} <= shown


@pytest.mark.parametrize("width_px", [1000, 1280, 1920])
def test_no_number_is_cut_off(bar, result, width_px):
    bar.resize(width_px, 24)
    bar.show()
    texts(bar, result, TIMES)
    bar.layout().activate()
    for label in bar.findChildren(QLabel):
        if label.text() and type(label) is QLabel:
            assert label.width() >= label.fontMetrics().horizontalAdvance(label.text())
            assert label.geometry().right() < bar.width()
