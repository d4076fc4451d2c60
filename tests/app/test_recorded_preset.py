"""A recording's own preset is what it is played with, unless somebody says otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactune.app.cli.common import default_preset
from tactune.app.worker.results import SourceInfo
from tactune.core.bench.scenes import synthetic_scene
from tactune.core.errors import PresetError
from tactune.core.recording import SessionWriter
from tactune.core.sources.mcap.source import McapSource
from tactune.core.sources.presets import load_preset


def record(path: Path, preset: bool = True) -> Path:
    scene = synthetic_scene(400, 64, 48)
    own = scene.preset.with_values({"name": "press seven", "tolerance.t": 0.021})
    writer = SessionWriter(path, scene.rig, preset=own if preset else None)
    assert writer.put(scene.frame, wait=True)
    writer.close()
    return path


def test_it_is_the_default_for_its_recording(tmp_path: Path) -> None:
    path = record(tmp_path / "session.mcap")
    for name in (str(path), f"mcap:{path}", f"live:mcap:{path}"):
        chosen = load_preset(default_preset(name))
        assert (chosen.name, chosen.tolerance.t) == ("press seven", 0.021)
    assert default_preset(str(record(tmp_path / "bare.mcap", preset=False))) == "default"
    with pytest.raises(PresetError, match="recorded without"):
        load_preset(tmp_path / "bare.mcap")


def test_run_uses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from tactune.app.cli import main as cli

    path = record(tmp_path / "session.mcap")
    monkeypatch.setattr("sys.argv", ["tactune", "run", "--source", str(path), "--truth"])
    assert cli.main() == 0
    assert "press seven" in capsys.readouterr().out


def test_the_window_offers_it(tmp_path: Path, window, qtbot) -> None:  # type: ignore[no-untyped-def]
    with McapSource(record(tmp_path / "session.mcap")) as source:
        info = SourceInfo.of(source)
    assert info.preset is not None
    before = window.document.preset
    window.file_flows.offer_preset(info.preset)
    (button,) = [b for b in window.messages.findChildren(_button()) if b.text() == "Use recorded preset"]
    button.click()
    assert window.document.preset == info.preset != before
    window.file_flows.offer_preset(info.preset)
    assert not [
        b for b in window.messages.findChildren(_button()) if b.text() == "Use recorded preset" and b.isVisible()
    ]


def _button():  # type: ignore[no-untyped-def]
    from PyQt6.QtWidgets import QAbstractButton

    return QAbstractButton
