"""Contact pressure and force in the window: colour and legend, arrow, number, curve; and the mask in other light."""

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource
from hands import show_source, shows_preset_of_document, strip_position
from tactune.app.worker.rendering import Scene, draw_strip
from tactune.app.worker.results import CloudName, ColorBy, Wanted
from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.rig.untouched import untouched_frame
from tactune.widgets.basics.controls import new_gesture

PATCH, TACTILE, PROXIMITY = CloudName.PATCH, CloudName.TACTILE, CloudName.PROXIMITY
GAUGE_PA = 2000.0


@pytest.fixture(scope="module")
def pressed():
    """The rig of two cameras, the untouched frame, and a press."""
    with open_source("sim:cup?press=medium") as source:
        return source.rig, untouched_frame(source), source.next_frame()


@pytest.fixture(scope="module")
def preset():
    return load_preset("simulator")


@pytest.fixture
def shown(window, qtbot, pressed):
    rig, untouched, frame = pressed
    frames = [untouched, *(replace(frame, sequence=number) for number in (1, 2, 3))]
    show_source(qtbot, window, FakeSource(rig=rig, frames=frames, name="press", untouched=untouched), 3)
    return window


def edit(window, qtbot, **values):
    window.document.edit_many({path.replace("__", "."): value for path, value in values.items()}, new_gesture())
    qtbot.waitUntil(lambda: shows_preset_of_document(window) and window.result.patch is not None)


def choices(window):
    return [window.views.color_by.itemText(row) for row in range(window.views.color_by.count())]


def choose_pressure(window, qtbot):
    window.views.color_by.setFocus()
    QTest.keyClick(window.views.color_by, Qt.Key.Key_End)
    qtbot.waitUntil(lambda: window.result.rendered.color_by is ColorBy.PRESSURE)


def legend(window, name):
    return {text: color.getRgb()[:3] for text, color in window.views.views[name].header.entries}


def colors_of(window, name):
    cloud = window.views.views[name].cloud()
    return cloud.lut[cloud.rows()][..., :3].astype(int)


def test_pressure_is_a_choice_where_the_contact_test_tells_it_and_comes_back_with_it(shown, qtbot):
    without = shown.views.color_by.toolTip()
    assert "Pressure" not in choices(shown)
    edit(shown, qtbot, contact_test="pressure")
    assert choices(shown)[-1] == "Pressure"
    assert shown.views.color_by.toolTip() != without, "the reason is gone"
    choose_pressure(shown, qtbot)
    edit(shown, qtbot, contact_test="membrane")
    assert "Pressure" not in choices(shown)
    assert shown.result.rendered.color_by is ColorBy.CONTACT
    assert "contact" in legend(shown, PATCH)
    shown.document.undo_stack.undo()
    qtbot.waitUntil(lambda: shown.result.rendered.color_by is ColorBy.PRESSURE)
    assert shown.views.color_by.currentText() == "Pressure"


def test_membrane_and_patch_have_the_colours_of_the_legend_in_kpa_or_relative(shown, qtbot):
    edit(shown, qtbot, contact_test="pressure", pressure__gauge_pa=0.0)
    depths = colors_of(shown, PROXIMITY)
    choose_pressure(shown, qtbot)
    facts, mask = shown.result.patch.pressure, shown.result.patch.mask
    top, _ = shown.result.rendered.pressure_scale
    assert np.quantile(facts.at_points.get(), 0.98) <= top
    relative = legend(shown, TACTILE)
    low, half, high, unknown = relative.values()
    assert [*relative][2] == f"{top:.3g} × inflation"
    for name, values in ((TACTILE, facts.on_membrane.get()), (PATCH, facts.relative.get())):
        colors = colors_of(shown, name)
        within = np.ones(values.shape, bool) if name is TACTILE else mask
        for rgb, where in ((low, values <= 0), (half, abs(values - top / 2) < 0.001 * top), (high, values >= top)):
            assert (abs(colors[within & where] - rgb) <= 3).all()
        assert (colors[within & np.isnan(values)] == unknown).all()
    assert (colors_of(shown, PROXIMITY) == depths).all(), "the proximity camera sees no membrane"

    edit(shown, qtbot, pressure__gauge_pa=GAUGE_PA)
    assert [*legend(shown, PATCH)][2] == f"{top * GAUGE_PA / 1e3:.3g} kPa"
    assert [*legend(shown, PATCH).values()][:3] == [low, half, high]
    np.testing.assert_allclose(
        shown.result.patch.pressure_pa, facts.relative.get() * GAUGE_PA, rtol=1e-6, err_msg="as the legend says"
    )


def force_reading(window):
    return next((each for each in window.views.views[PATCH].canvas.readings if each.caption.startswith("force")), None)


def test_the_force_is_an_arrow_and_a_number_with_its_deviation(shown, qtbot):
    assert force_reading(shown) is None
    view = shown.views.views[PATCH]
    assert view.canvas.arrow is None
    edit(shown, qtbot, contact_test="pressure", pressure__gauge_pa=0.0)
    facts = shown.result.patch.pressure
    sizes = [float(word.replace(",", "")) for word in force_reading(shown).value.split() if word[0].isdigit()]
    assert sizes == [round(each) for each in facts.strength]
    assert force_reading(shown).value.endswith("mm²")
    assert force_reading(shown).caption != "force"
    start, end = np.array(view.canvas.arrow)
    weights = np.fmax(facts.at_points.get(), 0)
    np.testing.assert_allclose(start, weights @ shown.result.patch.points / weights.sum(), atol=1e-5)
    along = (end - start) / np.linalg.norm(end - start)
    np.testing.assert_allclose(along, facts.force_mm2 / np.linalg.norm(facts.force_mm2), atol=1e-6)
    assert np.pi * np.linalg.norm(1e3 * (end - start)) ** 2 == pytest.approx(facts.strength[0])
    before = view.grab().toImage()
    view.set_arrow(None)
    assert view.grab().toImage() != before, "it is painted"

    edit(shown, qtbot, pressure__gauge_pa=GAUGE_PA)
    size_n, _ = shown.result.patch.pressure.strength
    assert size_n == pytest.approx(np.linalg.norm(shown.result.patch.force_n))
    assert force_reading(shown).value.startswith(f"{size_n:.1f} ± ")
    assert force_reading(shown).value.endswith(" N")

    shown.worker.seek(0)
    qtbot.waitUntil(lambda: shown.result.playback.index == 0 and shown.result.area_mm2 == 0)
    assert view.canvas.arrow is None
    assert not any(map(str.isdigit, force_reading(shown).value)), "no contact has no force of 0.00 N"


def test_the_pixel_under_the_mouse_says_its_pressure(shown, qtbot):
    edit(shown, qtbot, contact_test="pressure", pressure__gauge_pa=GAUGE_PA)
    v, u = (int(each) for each in np.argwhere(shown.result.patch.mask)[100])
    shown.strip.point_at(u, v)
    pressure_kpa = 1e-3 * shown.result.patch.pressure_pa[v, u]
    qtbot.waitUntil(lambda: f"{pressure_kpa:.2f} kPa" in shown.status.readout.text())


def test_the_strip_draws_the_force_and_says_what_it_needs(shown, qtbot):
    strip = shown.time_strip
    strip.curve_box.setFocus()
    for _ in range(strip.curve_box.findData("force_n")):
        QTest.keyClick(strip.curve_box, Qt.Key.Key_Down)
    assert strip.curve.key == "force_n"
    values = {"force_n": np.array([0.0, 1.5, 3.25])}
    strip.set_series(np.arange(3) / 30, values, np.ones(3, bool))
    strip.set_words("")
    assert strip.words == ""
    QTest.mouseMove(strip.plot_widget.viewport(), strip_position(strip, 2).toPoint() + QPoint(0, 10))
    qtbot.waitUntil(lambda: strip.words.endswith(": 3.25 N"))
    strip.set_series(np.arange(3) / 30, {"force_n": np.full(3, np.nan)}, np.ones(3, bool))
    strip.set_words("")
    assert strip.words
    assert strip.curve.missing.startswith(strip.words.rstrip("…"))


def test_the_mask_is_drawn_as_it_was_used_in_half_of_the_light(pressed, preset):
    rig, untouched, frame = pressed
    preset = preset.with_value("mask.value", (110, 255))  # in half of the light no print is so bright
    pipeline = ContactPipeline(preset, rig, untouched)

    def masked(each):
        patch = pipeline.process(each)
        scene = Scene(each, patch, preset, rig, ColorBy.CONTACT, "light", (0.2, 0.4), (0.2, 0.4))
        with_mask, without = (draw_strip(scene, Wanted(shows_mask=shows)) for shows in (True, False))
        return (with_mask.panes["color"] != without.panes["color"]).any(axis=2), with_mask.masked_share

    (bright, share), (dark, share_dark) = (
        masked(each) for each in (frame, replace(frame, proximity_color=frame.proximity_color // 2))
    )
    assert bright.sum() > 1000
    assert (bright & dark).sum() / (bright | dark).sum() > 0.8
    assert share_dark == pytest.approx(share, rel=0.2)


def test_force_is_calibrated_by_presses_on_a_scale(shown, qtbot, pressed):
    truth = pressed[2].truth
    shown.actions_.calibrate_force.trigger()
    window = shown.force
    qtbot.waitUntil(window.isVisible)
    window.force.setFocus()
    window.force.selectAll()
    QTest.keyClicks(window.force, f"{np.linalg.norm(truth.force_n):.3f}".replace(".", ","))
    QTest.mouseClick(window.add, Qt.MouseButton.LeftButton)
    assert window.note.text() and not window.table.records()  # another contact test tells no force
    edit(shown, qtbot, contact_test="pressure")
    QTest.mouseClick(window.add, Qt.MouseButton.LeftButton)
    assert len(window.table.records()) == 1
    QTest.mouseClick(window.apply, Qt.MouseButton.LeftButton)
    section = shown.document.preset.pressure
    assert abs(section.gauge_pa - truth.inflation_pa) < 2 * section.gauge_sigma_pa
    shown.actions_.undo.trigger()
    assert shown.document.preset.pressure.gauge_pa == 0.0
    window.table.selectAll()
    QTest.keyClick(window.table, Qt.Key.Key_Delete)
    assert not window.table.records() and not window.apply.isEnabled() and not window.verdict.text()
