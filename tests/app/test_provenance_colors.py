"""Provenance in the three views, chosen by keys as a person does."""

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from tactune.app.worker.results import CloudName, ColorBy
from tactune.core.model.patch import Provenance
from tactune.widgets.basics.colormaps import CONTACT_RGB

PATCH, TACTILE, PROXIMITY = CloudName.PATCH, CloudName.TACTILE, CloudName.PROXIMITY


def choose(window, qtbot, color_by):
    box = window.views.color_by
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Home)
    for _ in range(list(ColorBy).index(color_by)):
        QTest.keyClick(box, Qt.Key.Key_Down)
    assert window.views.colors is color_by
    qtbot.waitUntil(lambda: window.result.rendered.color_by is color_by)


def colors_of(window, name):
    """The colour of every pixel of a cloud, RGBA: int (H, W, 4)."""
    cloud = window.views.views[name].cloud()
    return cloud.lut[cloud.rows()].astype(int)


def test_in_provenance_each_view_answers_its_own_question(window, qtbot):
    window.document.edit("mask.enabled", True)
    window.document.edit("mask.hue", (175, 5))
    choose(window, qtbot, ColorBy.PROVENANCE)
    window.document.edit("region.rectangle", (0, 0, 64, 24))
    window.document.edit("region.enabled", True)
    qtbot.waitUntil(lambda: window.result.preset == window.document.preset)
    names = {name: [text for text, _ in view.legend.entries] for name, view in window.views.views.items()}
    verdicts = window.result.patch.provenance
    assert {Provenance.OUTSIDE_REGION, Provenance.OUTSIDE_TOLERANCE} < set(np.unique(verdicts))
    assert "out of region" in names[PROXIMITY] and "out of region" not in names[PATCH]
    assert names[PATCH][-1] == "not touching"
    assert (colors_of(window, PATCH)[verdicts == Provenance.CONTACT][:, :3] == CONTACT_RGB).all()


def test_the_patch_view_shows_what_late_steps_dropped(window, qtbot):
    choose(window, qtbot, ColorBy.PROVENANCE)
    disc = window.result.patch.mask
    values = {"mask.enabled": True, "mask.hue": (0, 179), "mask.saturation": (0, 255), "mask.value": (0, 255)}
    window.document.edit_many(values, 1, "Drop the disc")
    qtbot.waitUntil(lambda: window.result.preset == window.document.preset and not window.result.patch.mask.any())
    patch = {text: color.getRgb()[:3] for text, color in window.views.views[PATCH].legend.entries}
    assert (colors_of(window, PATCH)[disc][:, :3] == patch["masked"]).all()
