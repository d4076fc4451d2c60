"""The Help menu."""

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtTest import QTest

from tactune.app.window import help as help_menu


@pytest.fixture
def opened(monkeypatch):
    urls = []
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda url: urls.append(url.toLocalFile()) or True)
    return urls


def test_f1_opens_the_guide_that_ships_with_the_package(window, opened, monkeypatch, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("guide")
    monkeypatch.setattr(help_menu, "guide_file", lambda name: tmp_path / f"{name}.html")
    QTest.keyClick(window, Qt.Key.Key_F1)
    assert opened == [str(page)]
    (tmp_path / "keys.html").write_text("keys")
    QTest.keyClick(window, Qt.Key.Key_F1, Qt.KeyboardModifier.ShiftModifier)
    assert opened[1:] == [str(tmp_path / "keys.html")]
