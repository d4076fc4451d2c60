"""The parameter panel: shows every preset exactly, tells what a person does, sections and folds."""

import pytest
from hypothesis import HealthCheck, given, settings
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QComboBox

from any_preset import HOMOGRAPHY, POSE, presets
from hands import LEFT, type_into
from tactune.core.preset import (
    CONTACT_TESTS,
    AlignmentSection,
    HomographyAlignment,
    MaskSection,
    MembraneSection,
    Preset,
    RangeSection,
    RegionSection,
    RigidAlignment,
    ToleranceSection,
)
from tactune.widgets.parameters.parameter_panel import SECTIONS, fields_of


@given(preset=presets)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15, deadline=None)
def test_every_preset_is_shown_exactly_and_silently(panel, seen, preset):
    panel.set_preset(preset)
    for path, row in panel.rows.items():
        assert row.editor.value() == preset.value(path), path
    assert (seen.edits, seen.resets, seen.modes) == ([], [], [])


def test_every_field_of_the_model_has_a_row(panel):
    expected = [spec.path for name, _ in SECTIONS for spec in fields_of(name)]
    assert list(panel.rows) == expected
    assert {"contact_test", "membrane.gap_m"} < set(expected)
    assert "alignment.calibration" not in expected, "a record; in the preset's file only"
    assert "alignment.rigid.T_proximity_tactile" in expected
    facts = {"name", "notes", "created", "modified", "rig", "cameras", "untouched", "noise", "suggested", "verdict"}
    tuned = set(Preset.model_fields) - facts
    assert {name for name, _ in SECTIONS} == tuned


@pytest.mark.parametrize("contact_test", ["tolerance", "membrane"])
def test_visiting_every_widget_by_tab_changes_nothing(panel, seen, contact_test):
    preset = Preset(
        contact_test=contact_test,
        mask=MaskSection(enabled=True),
        tolerance=ToleranceSection(t=0.0123456789),
        alignment=AlignmentSection(depth_offset_m=-0.01234567),
        range=RangeSection(enabled=True, limits_m=(0.1234567, 0.3333333)),
        region=RegionSection(enabled=True),
    )
    panel.set_preset(preset)
    visited = set()
    for _ in range(120):
        focused = QApplication.focusWidget()
        assert focused is not None
        visited.add(focused)
        QTest.keyClick(focused, Qt.Key.Key_Tab)
    assert seen.edits == []
    for path, row in panel.rows.items():
        assert row.editor.value() == preset.value(path)
        for name in ("slider", "entry"):
            part = getattr(row.widget, name, None)
            if part is not None and part.isVisible():
                assert part in visited, (path, name)
        for entry in getattr(row.widget, "entries", []):
            assert entry in visited or not entry.isVisible(), path
    assert all(button in visited for button in panel.eyedroppers.values())
    assert all(section.button in visited for section in panel.sections.values() if section.isVisible())


def test_typing_and_reset(panel, seen):
    panel.set_preset(Preset(contact_test="tolerance"))
    panel.set_baseline(Preset(name="bench", tolerance=ToleranceSection(t=0.0123)))
    row = panel.rows["tolerance.t"]
    assert "1.23 %" in row.reset.toolTip()
    assert "bench" in row.reset.toolTip()
    type_into(row.widget.entry, "7")
    assert seen.edits[-1][:2] == ("tolerance.t", 0.07)
    QTest.mouseClick(row.reset, LEFT)
    assert seen.edits[-1][:2] == ("tolerance.t", 0.0123)
    assert row.editor.value() == 0.0123
    assert not row.reset.isVisible()
    panel.set_baseline(None)
    QTest.mouseClick(row.reset, LEFT)
    assert seen.edits[-1][:2] == ("tolerance.t", Preset().tolerance.t)


def test_a_changed_value_moves_nothing(qapp, panel):
    preset = Preset().with_values({"mask.enabled": True})
    panel.set_preset(preset)
    panel.set_baseline(preset)

    def places():
        qapp.processEvents()
        placed = [*(row.label for row in panel.rows.values()), *(row.widget for row in panel.rows.values())]
        return [(each.mapTo(panel, QPoint(0, 0)), each.size()) for each in placed if each.isVisible()]

    before = places()
    panel.set_preset(preset.with_values({"mask.hue": (10, 20), "membrane.gap_m": 0.0002}))
    assert panel.rows["mask.hue"].reset.isVisible() and places() == before


def test_a_refused_value_is_explained_and_taken_back(panel, seen):
    panel.set_preset(Preset(mask=MaskSection(enabled=True, saturation=(10, 100))))
    row = panel.rows["mask.saturation"]
    type_into(row.widget.entries[0], "200")
    assert seen.edits[-1][1] == (200, 100)
    panel.show_error("mask.saturation", "saturation has its low end 200 above its high end 100")
    assert row.message.isVisible()
    assert "200" in row.message.text()
    assert row.editor.value() == (10, 100)
    type_into(row.widget.entries[0], "20")
    assert not row.message.isVisible()
    assert seen.edits[-1][1] == (20, 100)


def test_a_limit_dragged_in_the_histogram_edits_the_tolerance(panel, seen):
    panel.set_preset(Preset(contact_test="tolerance"))
    panel.histograms["tolerance.t"].limitEdited.emit(0.05, 7)
    assert seen.edits == [("tolerance.t", 0.05, 7)]
    assert panel.rows["tolerance.t"].editor.value() == 0.05


def test_only_the_chosen_alignment_is_shown(panel, seen):
    pose, plane = (
        panel.rows[f"alignment.{name}"].widget for name in ("rigid.T_proximity_tactile", "homography.plane_distance_m")
    )
    panel.forms["alignment"].more.fold(False)
    assert pose.isVisible()
    assert not plane.isVisible()
    assert pose.text() == "from the rig"
    box = panel.rows["alignment.model"].widget
    assert isinstance(box, QComboBox)
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Down)
    assert seen.edits[-1][:2] == ("alignment.model", "homography")
    assert not pose.isVisible()
    assert plane.isVisible()
    assert plane.isEnabled()
    panel.set_preset(
        Preset(alignment=AlignmentSection(model="homography", homography=HomographyAlignment(H_p_t=HOMOGRAPHY)))
    )
    assert not plane.isEnabled()
    assert "12.5" in panel.rows["alignment.homography.H_p_t"].widget.text()
    panel.set_preset(Preset(alignment=AlignmentSection(rigid=RigidAlignment(T_proximity_tactile=POSE))))
    assert " 0.04" in pose.text()
    assert "-0.00123" in pose.text()


def test_advanced_fields_are_folded_until_they_matter(panel):
    trust, gap = panel.rows["membrane.trust_m"], panel.rows["membrane.gap_m"]
    assert gap.widget.isVisible()
    assert not trust.widget.isVisible()
    assert panel.forms["membrane"].more.is_folded
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    assert trust.widget.isVisible()
    assert not panel.forms["membrane"].more.is_folded
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    panel.set_preset(Preset(membrane=MembraneSection(trust_m=0.02)))
    assert trust.widget.isVisible(), "a value that differs is not hidden"
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    panel.set_preset(Preset(name="next", membrane=MembraneSection(trust_m=0.02)))
    assert not trust.widget.isVisible(), "who closes it again is not disturbed"


def test_the_contact_test_decides_which_sections_are_shown(panel):
    sections = {section for test in CONTACT_TESTS.values() for section in test.sections}
    for name, test in CONTACT_TESTS.items():
        panel.set_preset(Preset(contact_test=name))
        assert {section for section in sections if panel.sections[section].isVisible()} == set(test.sections)
        assert test.note in panel.rows["contact_test"].widget.toolTip()
        shown = {path for path, histogram in panel.histograms.items() if histogram.isVisible()}
        assert all(path.partition(".")[0] in test.sections for path in shown)
