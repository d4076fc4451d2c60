"""Presets as files: strict parsing, atomic saving, shipped presets; older versions are migrated on reading."""

from __future__ import annotations

import difflib
import importlib.resources
import json
import re
import reprlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from ..errors import ExportError, PresetError
from ..model.files import atomic_path
from .migrations import SCHEMA_VERSION, Document, migrate, migration_note
from .preset import Preset

SCHEMA_NAME: Literal["tactune.preset"] = "tactune.preset"

#: A message names no more bad fields than this; each needs the schema, and nobody reads a thousand.
_MOST_TOLD = 9


class PresetDocument(Preset):
    """A preset as it stands in a file: the preset and what identifies the format."""

    schema_name: Annotated[Literal["tactune.preset"], Field(alias="schema")] = SCHEMA_NAME
    schema_version: Literal[6] = SCHEMA_VERSION
    tool_version: str = ""


def load_preset(path_or_name: Path | str) -> Preset:
    """Load a preset file, or a shipped preset by its name.

    Parameters
    ----------
    path_or_name : path or str
        A file, a recording (``.mcap``) that holds a preset, or one of `shipped_presets`. A file of that
        name in the working folder wins.

    Raises
    ------
    PresetError
        No such file, not a preset, or a field that is unknown or out of range.
    SourceError
        The ``.mcap`` file is no recording.
    """
    return load_preset_and_note(path_or_name)[0]


def load_preset_and_note(path_or_name: Path | str) -> tuple[Preset, str]:
    """Load a preset as `load_preset` does, and say of which older schema version it is.

    Returns
    -------
    preset : Preset
    note : str
        Such as ``"written as schema 5, read as 6: the balanced edge stays off (...)"``; empty for the present version.
    """
    text, origin = _text_and_origin(path_or_name)
    document = _parse_document(text, origin)
    return parse_preset(migrate(document, origin), origin), migration_note(document)


def _text_and_origin(path_or_name: Path | str) -> tuple[str, str]:
    """Return the text of a preset file, of a recording's preset or of a shipped one, and what messages call it."""
    path = Path(path_or_name)
    if path.suffix == ".mcap" and path.is_file():
        return _recorded_text(path)
    if str(path_or_name) in shipped_presets() and not path.is_file():
        resource = importlib.resources.files("tactune.presets") / f"{path_or_name}.json"
        return resource.read_text("utf-8"), f"shipped preset {path_or_name}"
    try:
        if path.is_char_device():  # /dev/zero would never end
            raise PresetError(f"{path} is no preset: it is a device; choose a .json file")
        text = path.read_text("utf-8")
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


def _recorded_text(path: Path) -> tuple[str, str]:
    from ..sources.mcap.source import McapSource

    with McapSource(path) as recording:
        found = recording.preset_text()
    if found is None:
        raise PresetError(f"{path} holds no preset: it was recorded without; name a preset file")
    return found


def shipped_presets() -> list[str]:
    """Return the names of the presets that come with Tactune, ``default`` first."""
    folder = importlib.resources.files("tactune.presets")
    names = [file.name.removesuffix(".json") for file in folder.iterdir() if file.name.endswith(".json")]
    return sorted((name for name in names if not name.endswith(".schema")), key=lambda name: (name != "default", name))


def preset_from_text(text: str, origin: str) -> Preset:
    """Parse the text of a preset file; ``origin`` names it in messages."""
    return parse_preset(migrate(_parse_document(text, origin), origin), origin)


def _parse_document(text: str, origin: str) -> Document:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}: {error.msg}"
        raise PresetError(f"{origin} is no preset: not valid JSON ({place})") from error
    except RecursionError as error:
        raise PresetError(f"{origin} is no preset: not valid JSON (too deep)") from error
    except ValueError as error:  # Python refuses whole numbers of thousands of digits
        raise PresetError(f"{origin} is no preset: it contains a number of too many digits") from error
    if not isinstance(document, dict):
        raise PresetError(f'{origin} is no preset: it is no JSON object with "schema": "{SCHEMA_NAME}"')
    if document.get("schema") != SCHEMA_NAME:
        found = reprlib.repr(document.get("schema"))
        raise PresetError(f'{origin} is no preset: "schema" should be "{SCHEMA_NAME}", it is {found}')
    return document


def parse_preset(document: Document, origin: str) -> Preset:
    """Validate plain data as a preset.

    Raises
    ------
    PresetError
        Names the first bad fields, each with its path, its value and what is allowed.
    """
    text = json.dumps(document, default=_plain)
    try:
        parsed = PresetDocument.model_validate_json(text, strict=True, by_alias=True)
    except ValidationError as error:
        details = error.errors(include_url=False)
        sentences = list(dict.fromkeys(_explain(detail) for detail in details[:_MOST_TOLD]))
        if len(details) > _MOST_TOLD:
            sentences.append(f"and {len(details) - _MOST_TOLD} more")
        raise PresetError(f"{origin}: " + "; ".join(sentences)) from error
    return Preset.model_construct(**{name: getattr(parsed, name) for name in Preset.model_fields})


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
        The file cannot be written, or holds a preset of a newer schema version; whatever was there
        before is still there.
    """
    path = Path(path)
    _keep_older_version(path)
    with atomic_path(path) as temporary:
        temporary.write_text(preset_json(preset), "utf-8")


def json_schema() -> Document:
    """Return the JSON Schema of preset files (draft 2020-12)."""
    schema = PresetDocument.model_json_schema(by_alias=True, mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Tactune preset",
        "required": ["schema", "schema_version"],
    }


def set_path(document: Document, path: str, value: Any) -> None:
    """Set the value at a dotted path in plain preset data.

    Raises
    ------
    PresetError
        No such field; the message suggests the nearest.
    """
    known = preset_paths()
    if path not in known:
        hint = difflib.get_close_matches(path, known, n=1)
        remedy = f"did you mean {hint[0]}?" if hint else f"fields are {', '.join(known)}"
        raise PresetError(f"a preset has no field {path!r}; {remedy}")
    *parents, last = path.split(".")
    for parent in parents:
        document = document[parent]
    document[last] = value


def preset_paths() -> list[str]:
    """Return the dotted path of every field that can be set by itself."""

    def walk(model: Any, prefix: str) -> list[str]:
        paths = []
        for name, field in model.model_fields.items():
            inner = field.annotation
            if isinstance(inner, type) and hasattr(inner, "model_fields"):
                paths += walk(inner, f"{prefix}{name}.")
            else:
                paths.append(prefix + name)
        return paths

    return walk(Preset, "")


def _keep_older_version(path: Path) -> None:
    if not path.is_file():
        return
    try:
        document = json.loads(path.read_text("utf-8"))
        found = document["schema_version"] if document["schema"] == SCHEMA_NAME else SCHEMA_VERSION
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return  # nothing there, or no preset: there is no older preset to keep
    if isinstance(found, int) and found > SCHEMA_VERSION:
        raise ExportError(
            f"{path} holds a preset of schema version {found}, newer than this Tactune's {SCHEMA_VERSION}; "
            "it stays as it is: save under another name"
        )
    if isinstance(found, int) and found < SCHEMA_VERSION:
        kept = path.with_name(f"{path.stem}.schema-{found}{path.suffix}")
        with atomic_path(kept) as temporary:
            temporary.write_bytes(path.read_bytes())


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if hasattr(value, "isoformat"):
        return value.isoformat()
    raise PresetError(f"a preset cannot hold {value!r} of type {type(value).__name__}; use numbers, texts and lists")


def _explain(error: Any) -> str:
    """Turn one pydantic error into words: path, value, what is allowed."""
    location: Sequence[str | int] = error["loc"]
    path = (
        "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".") or "the preset"
    )
    if error["type"] == "extra_forbidden":
        hint = difflib.get_close_matches(path, preset_paths(), n=1)
        return f"{path} is not a field of a preset" + (f" (did you mean {hint[0]}?)" if hint else "; remove it")
    if error["type"] == "missing":
        return f"{path} is missing"
    if error["type"] == "json_invalid":  # valid to Python's parser, so only texts and depth can be wrong
        return f"a text is no valid Unicode or something is nested too deep ({error['msg']}); write it again"
    shown = repr(error["input"])
    shown = shown if len(shown) <= 80 else shown[:77] + "..."
    message = error["msg"].removeprefix("Value error, ").removesuffix(" after validation")
    if error["type"] in {"bool_type", "bool_parsing"}:
        message = "it should be true or false"
    message = re.sub(r"^(Input|String|Tuple) should", "it should", message)
    return f"{path} is {shown}: {message}{_allowed(location)}"


def _allowed(location: Sequence[str | int]) -> str:
    """Say the allowed range of the field at a location, from the JSON Schema."""
    schema = json_schema()
    node: Any = schema
    for part in location:
        node = _resolve(node, schema)
        if isinstance(part, int):
            node = node["prefixItems"][part] if part < len(node.get("prefixItems", ())) else {}
        else:
            node = node.get("properties", {}).get(part, {})
    node = _resolve(node, schema)
    low = node.get("minimum", node.get("exclusiveMinimum"))
    high = node.get("maximum", node.get("exclusiveMaximum"))
    if low is None or high is None:
        return ""
    return f" (allowed: {'above ' if 'exclusiveMinimum' in node else ''}{low:g} to {high:g})"


def _resolve(node: Any, schema: Any) -> Any:
    while "$ref" in node or "anyOf" in node:
        node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]] if "$ref" in node else node["anyOf"][0]
    return node
