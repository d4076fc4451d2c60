"""Loads a preset by name: a file, a recording that holds one, or a preset that comes with Tactune."""

from __future__ import annotations

from pathlib import Path

from ..errors import PresetError
from ..preset import Preset
from ..preset.file import preset_and_note, preset_text


def load_preset(path_or_name: Path | str) -> Preset:
    """Load a preset from a file, from a recording, or by the name of a shipped preset.

    Parameters
    ----------
    path_or_name : path or str
        A preset file, a recording (``.mcap``) that holds a preset, or one of `preset.file.shipped_presets`. A
        file of a shipped preset's name in the working folder takes precedence.

    Raises
    ------
    PresetError
        No such file, not a preset, or a field that is unknown or out of range.
    SourceError
        The ``.mcap`` file is no recording.
    """
    return load_preset_and_note(path_or_name)[0]


def load_preset_and_note(path_or_name: Path | str) -> tuple[Preset, str]:
    """Load a preset as `load_preset` does.

    Returns
    -------
    preset : Preset
    note : str
        From which older schema version it was converted; empty for the current one.
    """
    path = Path(path_or_name)
    recorded = path.suffix == ".mcap" and path.is_file()
    return preset_and_note(*(_recorded_text(path) if recorded else preset_text(path_or_name)))


def _recorded_text(path: Path) -> tuple[str, str]:
    from .mcap.source import McapSource  # not above: most presets are no recordings

    with McapSource(path) as recording:
        found = recording.preset_text()
    if found is None:
        raise PresetError(f"{path} holds no preset: it was recorded without one; name a preset file")
    return found
