"""The command and the Python program that compute headless what the window shows."""

from __future__ import annotations

import json
from functools import reduce
from pprint import pformat
from shlex import quote
from typing import Any

from ...core.errors import PresetError
from ...core.preset.preset import preset_paths
from ...core.sources.presets import default_preset, load_preset
from .comparison import differing_fields
from .document import Document

#: Fields that change no patch, and fields that no option can set: the rig, and a frame in a file beside the preset.
_LABELS, _FILES = ("name", "notes"), ("rig", "untouched")


def as_command(document: Document, source: str) -> str:
    """Return the command; values that the preset's file does not have are options."""
    origin, values = _preset_of(document, source)
    words = ["tactune", "run", "--source", source, "--preset", origin]
    for path, value in values.items():
        words += ["--set", f"{path}={json.dumps(value, separators=(',', ':'))}"]
    return " ".join(map(quote, words))


def as_python(document: Document, source: str) -> str:
    """Return the program, which prints a line for each frame."""
    origin, values = _preset_of(document, source)
    changes = f".with_values({pformat(values, sort_dicts=False)})" if values else ""
    force = ", patch.force_n" if document.preset.contact_test == "pressure" else ""
    return f"""\
from tactune.core import ContactPipeline, {_finder(document)}, load_preset, open_source

preset = load_preset({origin!r}){changes}
with open_source({source!r}, cameras=preset.cameras) as source:
    untouched = {_finder(document)}(preset, {origin!r}, source).frame
    pipeline = ContactPipeline(preset, source.rig, untouched)
    for frame in source:
        patch = pipeline.process(frame)
        print(patch.sequence, len(patch.points), patch.area_mm2, patch.centroid_m{force})
"""


def _finder(document: Document) -> str:
    return "find_untouched" if document.preset.test.needs_untouched else "kept_untouched"


def _preset_of(document: Document, source: str) -> tuple[str, dict[str, Any]]:
    """Return the preset's file, or the usual preset of the source, and the values in use that it does not have."""
    path, preset = document.path, document.preset
    origin = str(path.absolute()) if path is not None else default_preset(source)
    changed = differing_fields(document.baseline if path is not None else load_preset(origin), preset)
    if any(name in changed for name in _FILES):
        raise PresetError("save the preset first (Ctrl+S): its rig or its untouched frame is in no file yet")
    names = [name for name in changed if name not in _LABELS]
    if names:  # --set turns on what it sets, so the switches are said, too
        sections = {name.partition(".")[0] for name in names}
        switches = ["contact_test", *(f"{section}.enabled" for section in sorted(sections))]
        names = list(dict.fromkeys([*names, *(name for name in switches if name in preset_paths())]))
    plain = preset.model_dump(mode="json")
    return origin, {name: reduce(lambda section, part: section[part], name.split("."), plain) for name in names}
