"""Preset files: reading, atomic saving, and the presets that Tactune ships.

`tactune.core.sources.presets.load_preset` also reads the preset inside a recording.
"""

from __future__ import annotations

import importlib.resources
import json
import reprlib
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from ..errors import ExportError, PresetError
from ..model.files import atomic_path, remove_leftovers
from ..model.loading import MAX_JSON_BYTES, parse_json, read_file
from .preset import SCHEMA_NAME, SCHEMA_VERSION, Preset, now, parse_preset

#: Fields that earlier versions wrote and this one does not know. A preset with one loads, and a note names it.
GONE: Final = ("noise.slow_m", "dent")
#: Fields without a date of change in the notes, and how a note of a search begins.
_UNDATED: Final = ("name", "notes", "created", "modified", "rig", "cameras", "suggested", "verdict")
_SEARCHED: Final = "Trial "


def shipped_presets() -> list[str]:
    """Return the names of the presets that come with Tactune, ``default`` first."""
    folder = importlib.resources.files("tactune.presets")
    names = [file.name.removesuffix(".json") for file in folder.iterdir() if file.name.endswith(".json")]
    return sorted((name for name in names if not name.endswith(".schema")), key=lambda name: (name != "default", name))


def _shipped(name: str) -> Path:
    return Path(str(importlib.resources.files("tactune.presets") / f"{name}.json")).resolve()


def with_notes_of_changes(preset: Preset, before: Preset) -> Preset:
    """Return a preset whose notes date each section that differs from ``before``.

    Notes that came with a shipped preset or from a search speak of the values then, so they go; a person's own stay.
    """
    changed = [
        name for name in Preset.model_fields if name not in _UNDATED and getattr(preset, name) != getattr(before, name)
    ]
    if not changed:
        return preset
    shipped = [json.loads(preset_text(name)[0])["notes"] for name in shipped_presets()]
    kept = [
        part
        for part in preset.notes.split("\n\n")
        if part and part not in shipped and not part.startswith((_SEARCHED, *(f"{name}: 2" for name in changed)))
    ]
    dated = [f"{name}: {now():%Y-%m-%d}" for name in changed]
    return preset.model_copy(update={"notes": "\n\n".join([*kept, *dated])[-10_000:]})


def preset_text(path_or_name: Path | str) -> tuple[str, str]:
    """Return the text of a preset file or shipped preset, and its name for messages."""
    path = Path(path_or_name)
    if str(path_or_name) in shipped_presets() and not path.is_file():
        return _shipped(str(path_or_name)).read_text("utf-8"), f"shipped preset {path_or_name}"
    try:
        text = read_file(path, MAX_JSON_BYTES).decode("utf-8-sig")  # Windows editors write a mark in front
    except OSError as error:
        raise PresetError(
            f"cannot read preset {path}: {error.strerror or error}; "
            f"name a file or one of the shipped presets: {', '.join(shipped_presets())}"
        ) from error
    except UnicodeDecodeError as error:
        raise PresetError(
            f"{path} is no preset: it is not a text file (byte {error.start}); choose a .json file"
        ) from error
    return text, str(path)


def preset_and_note(text: str, origin: str) -> tuple[Preset, str]:
    """Return the preset of a file's text, named ``origin`` in messages, and a note of fields that are gone, or ""."""
    try:
        document = parse_json(text)
    except ValueError as error:
        raise PresetError(f"{origin} is no preset: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA_NAME:
        found = reprlib.repr(document.get("schema") if isinstance(document, dict) else document)
        raise PresetError(f'{origin} is no preset: "schema" should be "{SCHEMA_NAME}", it is {found}')
    number = document.get("schema_version")
    if not isinstance(number, int) or number < SCHEMA_VERSION or isinstance(number, bool):
        raise PresetError(f"{origin}: schema_version is {reprlib.repr(number)}; it should be {SCHEMA_VERSION}")
    if number > SCHEMA_VERSION:
        raise PresetError(
            f"{origin}: schema_version is {reprlib.repr(number)}, this Tactune reads up to {SCHEMA_VERSION}; "
            f"update Tactune (the file was written by version {document.get('tool_version', 'unknown')})"
        )
    gone = [path for path in GONE if _taken_out(document, path)]
    if document.get("contact_test") == "dent":  # which pressure has replaced
        document["contact_test"] = "pressure"
        gone.append("contact_test dent (pressure is used)")
    note = f"{', '.join(gone)} of an earlier Tactune: no longer used" if gone else ""
    return parse_preset(document, origin), note


def _taken_out(document: Any, path: str) -> bool:
    """Remove the value at a dotted path from plain data; return whether there was one that said something."""
    *parents, last = path.split(".")
    for parent in parents:
        document = document.get(parent) if isinstance(document, dict) else None
    return isinstance(document, dict) and document.pop(last, None) is not None


def preset_json(preset: Preset) -> str:
    document = {
        "schema": SCHEMA_NAME,
        "schema_version": SCHEMA_VERSION,
        "tool_version": version("tactune"),
        **preset.model_dump(mode="json"),
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def save_preset(preset: Preset, path: Path | str, *, exclusive: bool = False) -> None:
    """Save a preset atomically; `ExportError` if that fails, and whatever was there before is unchanged.

    An ``exclusive`` one is refused where there is a file, and any in the place of a shipped preset.
    """
    path = Path(path)
    if path.stem in shipped_presets() and path.resolve() == _shipped(path.stem):
        raise ExportError(f"{path} comes with Tactune and stays as it is; save under another name")
    remove_leftovers(path.parent, path.name)
    with atomic_path(path, follow_link=True, exclusive=exclusive) as temporary:
        temporary.write_text(preset_json(preset), "utf-8")
