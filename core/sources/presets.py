"""Loads a preset by name: a file, a recording that holds one, or a preset that comes with Tactune."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path

from ..errors import PresetError, TactuneError
from ..model.files import user_path
from ..preset import Preset
from ..preset.file import preset_and_note, preset_text


def default_preset(source: str) -> str:
    """Return the origin of a source's default preset: the recording's own, ``simulator``, else ``default``."""
    plain = source.removeprefix("live:")
    path = user_path(plain.removeprefix("mcap:"))
    if path.suffix == ".mcap" and path.is_file():
        with suppress(TactuneError):  # opening the source reports what is wrong with it
            load_preset(path)
            return str(path)
    return "simulator" if plain.partition(":")[0] == "sim" else "default"


def load_preset(path_or_name: Path | str) -> Preset:
    """Load a preset from a file, from a recording, or by the name of a shipped preset.

    Parameters
    ----------
    path_or_name : path or str
        A preset file, a recording (``.mcap``) that holds a preset, or one of `preset.file.shipped_presets`. A
        file of a shipped preset's name in the working folder takes precedence.

    Raises
    ------
    PresetError, SourceError
        No such file, no preset, or a value out of range. A field that earlier versions wrote and this one does not
        know is no error: a warning of the logger ``tactune`` names it.
    """
    preset, note = load_preset_and_note(path_or_name)
    if note:  # a program sees it on standard error, unless it configures logging
        logging.getLogger(__name__).warning("%s: %s", path_or_name, note)
    return preset


def load_preset_and_note(path_or_name: Path | str) -> tuple[Preset, str]:
    """Load a preset as `load_preset` does; the note names its fields that are gone, and is empty if there are none."""
    path = Path(path_or_name)
    if path.suffix != ".mcap" or not path.is_file():
        return preset_and_note(*preset_text(path_or_name))
    from .tactune_files import McapSource  # not above: most presets are no recordings

    with McapSource(path) as recording:
        found = recording.preset_text()
    if found is None:
        raise PresetError(f"{path} holds no preset: it was recorded without one; name a preset file")
    return preset_and_note(*found)
