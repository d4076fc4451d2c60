"""The quality of the calibration is shown below the alignment model."""

from __future__ import annotations

from datetime import UTC, datetime

from tactune.core.model.alignment import CalibrationRecord, ClickedPair, ModelSummary
from tactune.core.preset import Preset
from tactune.widgets.parameters.parameter_panel import ParameterPanel


def membrane() -> Preset:
    places = {"proximity_u": 1.0, "proximity_v": 2.0, "tactile_u": 3.0, "tactile_v": 4.0}
    quality = ModelSummary(
        alignment_px=0.42, alignment_bound_95_px=0.8, boundary_error_mm=0.5, supported_tolerance=0.0081, excluded=("3",)
    )
    record = CalibrationRecord(
        date=datetime(2026, 3, 4, tzinfo=UTC),
        model="rigid",
        points=tuple(ClickedPair(id=str(number), enabled=number > 0, **places) for number in range(14)),
        quality=quality,
    )
    preset = Preset()
    return preset.model_copy(update={"alignment": preset.alignment.model_copy(update={"calibration": record})})


def test_the_calibration_of_the_preset_is_shown(qtbot) -> None:
    panel = ParameterPanel()
    qtbot.addWidget(panel)
    panel.set_preset(membrane())
    assert panel.alignment_info.isVisibleTo(panel)
    assert panel.alignment_info.text() == (
        "Calibrated 2026-03-04: rigid, 12 points, expected error 0.42 px, good for t from 0.81 %"
    )
    panel.set_preset(Preset())
    assert not panel.alignment_info.isVisibleTo(panel)
