"""Preset files: reading with migration of older versions, atomic saving, and the presets that Tactune ships.

`tactune.core.sources.presets.load_preset` also reads the preset inside a recording.
"""

from __future__ import annotations

import importlib.resources
import json
import reprlib
from importlib.metadata import version
from pathlib import Path

from ..errors import ExportError, PresetError
from ..model.files import atomic_path, remove_leftovers
from ..model.loading import MAX_JSON_BYTES, parse_json, read_file, read_json
from .migrations import SCHEMA_VERSION, Document, migrate, migration_note
from .preset import SCHEMA_NAME, Preset, parse_preset


def shipped_presets() -> list[str]:
    """Return the names of the presets that come with Tactune, ``default`` first."""
    folder = importlib.resources.files("tactune.presets")
    names = [file.name.removesuffix(".json") for file in folder.iterdir() if file.name.endswith(".json")]
    return sorted((name for name in names if not name.endswith(".schema")), key=lambda name: (name != "default", name))


def preset_text(path_or_name: Path | str) -> tuple[str, str]:
    """Return the text of a preset file or shipped preset, and its name for messages.

    Raises
    ------
    PresetError
        The file does not exist or is not a text file.
    """
    path = Path(path_or_name)
    if str(path_or_name) in shipped_presets() and not path.is_file():
        resource = importlib.resources.files("tactune.presets") / f"{path_or_name}.json"
        return resource.read_text("utf-8"), f"shipped preset {path_or_name}"
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


def preset_from_text(text: str, origin: str) -> Preset:
    """Parse the text of a preset file; ``origin`` names it in messages."""
    return preset_and_note(text, origin)[0]


def preset_and_note(text: str, origin: str) -> tuple[Preset, str]:
    """Parse the text of a preset file; return the preset and what `migration_note` says about its version.

    Raises
    ------
    PresetError
        Not a preset, a version that this Tactune does not read, or a field that is unknown or out of range.
    """
    document = _parse_document(text, origin)
    return parse_preset(migrate(document, origin), origin), migration_note(document)


def _parse_document(text: str, origin: str) -> Document:
    try:
        document = parse_json(text)
    except ValueError as error:
        raise PresetError(f"{origin} is no preset: {error}") from error
    if not isinstance(document, dict):
        raise PresetError(f'{origin} is no preset: it is no JSON object with "schema": "{SCHEMA_NAME}"')
    if document.get("schema") != SCHEMA_NAME:
        found = reprlib.repr(document.get("schema"))
        raise PresetError(f'{origin} is no preset: "schema" should be "{SCHEMA_NAME}", it is {found}')
    return document


def preset_json(preset: Preset) -> str:
    """Return the text of a preset file."""
    document = {
        "schema": SCHEMA_NAME,
        "schema_version": SCHEMA_VERSION,
        "tool_version": version("tactune"),
        **preset.model_dump(mode="json"),
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def save_preset(preset: Preset, path: Path | str) -> None:
    """Save atomically. A file of an older schema version there is kept as ``NAME.schema-N.json``.

    Raises
    ------
    ExportError
        The file cannot be written, or holds a preset of a newer schema version; whatever was there before is unchanged.
    """
    path = Path(path)
    _keep_older_version(path)
    remove_leftovers(path.parent, path.name)
    with atomic_path(path, follow_link=True) as temporary:
        temporary.write_text(preset_json(preset), "utf-8")


def _keep_older_version(path: Path) -> None:
    if not path.is_file():
        return
    try:
        document = read_json(path)
        found = document["schema_version"] if document["schema"] == SCHEMA_NAME else SCHEMA_VERSION
    except (OSError, ValueError, KeyError, TypeError):
        return  # nothing there, or no preset: there is no older preset to keep
    if isinstance(found, int) and found > SCHEMA_VERSION:
        raise ExportError(
            f"{path} holds a preset of schema version {found}, newer than this Tactune's {SCHEMA_VERSION}; "
            "it stays as it is: save under another name"
        )
    if isinstance(found, int) and found < SCHEMA_VERSION:
        kept = path.with_name(f"{path.stem}.schema-{found}{path.suffix}")
        with atomic_path(kept) as temporary:
            temporary.write_bytes(read_file(path))
