"""Which sections of the parameter panel are shown, open, disabled or folded."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QComboBox, QLabel

from hands import type_into
from panel_steering import EYE3, EYE4, LEFT, Recorder
from tactune.core.preset import (
    AlignmentSection,
    HomographyAlignment,
    MembraneSection,
    Preset,
    RigidAlignment,
)
from tactune.widgets.parameters.form import ShownFinding
from tactune.widgets.parameters.parameter_panel import ParameterPanel


def test_a_folded_section_unfolds_for_an_error(panel: ParameterPanel) -> None:
    QTest.mouseClick(panel.sections["mask"].button, LEFT)
    assert panel.collapsed_sections() == ["mask"]
    assert not panel.rows["mask.hue"].widget.isVisible()
    panel.show_error("mask.enabled", "no")
    assert panel.rows["mask.enabled"].message.isVisible()
    panel.set_collapsed_sections(["alignment", "region"])
    assert panel.collapsed_sections() == ["alignment", "region"]


def test_only_the_chosen_alignment_is_shown(panel: ParameterPanel, seen: Recorder) -> None:
    pose, plane = (
        panel.rows[f"alignment.{name}"].widget for name in ("rigid.T_proximity_tactile", "homography.plane_distance_m")
    )
    panel.set_open_folds(["alignment"])
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
    panel.set_preset(Preset(alignment=AlignmentSection(model="homography", homography=HomographyAlignment(H_p_t=EYE3))))
    assert not plane.isEnabled()
    assert "12.5" in panel.rows["alignment.homography.H_p_t"].widget.text()
    panel.set_preset(Preset(alignment=AlignmentSection(rigid=RigidAlignment(T_proximity_tactile=EYE4))))
    assert "40.00 mm" in pose.text()
    assert "-1.23 mm" in pose.text()


def test_advanced_fields_are_folded_until_they_matter(panel: ParameterPanel) -> None:
    trust, gap = panel.rows["membrane.trust_m"], panel.rows["membrane.gap_m"]
    assert gap.widget.isVisible()
    assert not trust.widget.isVisible()
    assert panel.open_folds() == []
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    assert trust.widget.isVisible()
    assert panel.open_folds() == ["membrane"]
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    panel.set_preset(Preset(membrane=MembraneSection(trust_m=0.02)))
    assert trust.widget.isVisible(), "a value that differs is not hidden"
    QTest.mouseClick(panel.forms["membrane"].more, LEFT)
    panel.set_preset(Preset(name="next", membrane=MembraneSection(trust_m=0.02)))
    assert not trust.widget.isVisible(), "who closes it again is not disturbed"
    finding = {"alignment.depth_scale": ShownFinding("The scale is wrong.")}
    panel.show_findings(finding)
    assert panel.rows["alignment.depth_scale"].finding.isVisible()
    QTest.mouseClick(panel.forms["alignment"].more, LEFT)
    panel.show_findings(finding)
    assert panel.open_folds() == [], "the same finding again"


def test_the_contact_test_decides_which_sections_are_shown(panel: ParameterPanel, seen: Recorder) -> None:
    def shown() -> set[str]:
        return {name for name in ("tolerance", "outliers", "membrane") if panel.sections[name].isVisible()}

    assert shown() == {"membrane"}, "the default test"
    assert not panel.histograms["tolerance.t"].isVisible()
    box = panel.rows["contact_test"].widget
    assert isinstance(box, QComboBox)
    assert "as published" in box.toolTip()
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Down)
    assert seen.edits[-1][:2] == ("contact_test", "tolerance")
    assert shown() == {"tolerance", "outliers"}
    assert panel.histograms["tolerance.t"].isVisible()
    QTest.keyClick(box, Qt.Key.Key_Up)
    assert seen.edits[-1][:2] == ("contact_test", "membrane")
    assert shown() == {"membrane"}
    assert not panel.histograms["tolerance.t"].isVisible()
    notes = [label.text() for label in panel.findChildren(QLabel) if label.isVisible()]
    assert any("ignored" in note for note in notes)
    type_into(panel.rows["membrane.gap_m"].widget.entry, "1.1")
    assert seen.edits[-1][:2] == ("membrane.gap_m", 0.0011)
    panel.set_preset(Preset(contact_test="tolerance"))
    assert shown() == {"tolerance", "outliers"}
