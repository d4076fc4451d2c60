"""The Strain tab: a pressed printed grid, measured on another thread."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource
from hands import show_source, type_into
from rigs import one_place_rig
from tactune.core.model.frames import GroundTruth, SensorFrame, TrueStrain

RIG = one_place_rig(320, 240, 193.0, 1e-5, 1e-5)
LENS = RIG.tactile.intrinsics
V, U = np.mgrid[:240, :320].astype(float)


def sheet(index, stretch=(1.0, 1.0), depth_m=0.3, dots=True):
    """A flat sheet with 13 x 9 dots, 10 mm apart before it was stretched."""
    s = (U - LENS.cx) / LENS.fx * depth_m / stretch[0]
    t = (V - LENS.cy) / LENS.fy * depth_m / stretch[1]
    column, row = np.rint(s / 0.01), np.rint(t / 0.01)
    gap = np.hypot((s - column * 0.01) * stretch[0], (t - row * 0.01) * stretch[1])
    cover = np.clip((0.0022 - gap) / 0.0012 + 0.5, 0, 1)
    cover[(np.abs(column) > 6) | (np.abs(row) > 4)] = 0
    color = np.repeat((170 - 130 * cover * dots).astype(np.uint8)[..., None], 3, axis=2)
    counts = np.full((240, 320), round(depth_m / 1e-5), np.uint16)
    return SensorFrame(index, counts, counts, color, color)


def pressed(untouched=True, dots=True):
    """Frame n is 3 n mm nearer and stretched by 5 n % along the length and 2 n % along the width."""

    def make(index, rig):
        frame = sheet(index, (1 + 0.05 * index, 1 + 0.02 * index), 0.3 - 0.003 * index, dots)
        strain = TrueStrain(0.05 * index, 0.02 * index, 0.05 * index, 0.02 * index)
        return replace(frame, truth=GroundTruth(np.zeros((240, 320), bool), strain=strain))

    return FakeSource(rig=RIG, make=make, untouched=sheet(0) if untouched else None)


def opened(qtbot, window, source, index=3):
    show_source(qtbot, window, source, index)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitExposed(window.analysis.window)
    tab = window.analysis.window.made["strain"]
    settled(qtbot, tab, index)
    return tab


def settled(qtbot, tab, index):
    qtbot.waitUntil(
        lambda: (
            tab.found is not None
            and tab.result.frame.sequence == index
            and not tab.job.busy
            and tab.found.spacing_m == pytest.approx(tab.spacing.value() / 1e3)
        ),
        timeout=60_000,
    )


def test_map_numbers_and_curve_of_a_press(qtbot, window, tmp_path):
    tab = opened(qtbot, window, pressed())
    measured = tab.found.measured
    assert measured.length.largest == pytest.approx(0.15, abs=0.015)
    assert measured.width.largest == pytest.approx(0.06, abs=0.015)
    assert tab.found.displacement_mm == pytest.approx(9.0, abs=0.2)
    assert len(measured.cells) == 12 * 8
    assert all(word in tab.numbers.text() for word in ("9.0 mm", "solver 15.0 %", "solver 6.0 %"))
    for index in (4, 5):
        window.worker.seek(index)
        settled(qtbot, tab, index)
    tab.save_to(tmp_path / "strain.csv")
    qtbot.waitUntil((tmp_path / "strain.csv").exists)
    rows = list(csv.DictReader((tmp_path / "strain.csv").read_text().splitlines()))
    assert [row["sequence"] for row in rows] == ["3", "4", "5"]
    assert float(rows[2]["displacement_mm"]) == pytest.approx(15.0, abs=0.3)
    assert [len(curve.getData()[0]) for curve in tab._curves] == [3, 3]


def test_another_spacing_is_measured_and_remembered(qtbot, window):
    tab = opened(qtbot, window, pressed())
    type_into(tab.spacing, "11.5")
    settled(qtbot, tab, 3)
    assert tab.found.measured.length.largest == pytest.approx(0.0, abs=0.015)
    assert type(tab)(window.context).spacing.value() == 11.5


def test_frames_of_a_still_membrane_are_averaged(qtbot, window):
    tab = opened(qtbot, window, FakeSource(rig=RIG, make=lambda index, rig: sheet(index), untouched=sheet(0)))
    window.worker.seek(4)
    settled(qtbot, tab, 4)
    assert tab.found.averaged == 1
    type_into(tab.average, "2")
    qtbot.waitUntil(lambda: tab.found.averaged == 2)


def test_without_dots_or_untouched_frame_the_tab_says_so(qtbot, window):
    tab = opened(qtbot, window, pressed(dots=False))
    assert tab.found.measured is None and "grid of dots" in tab.numbers.text() and not tab.rows
    show_source(qtbot, window, pressed(untouched=False), 2)
    qtbot.waitUntil(lambda: 2 in tab.rows, timeout=60_000)
    assert "untouched" in tab.numbers.text()
    assert tab.rows[2][1] is None and not tab._curves[0].getData()[0]
