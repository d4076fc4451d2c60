"""Fields of a preset that are set on the command line: ``--set FIELD=VALUE``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ...core.errors import PresetError


def parse_settings(texts: Sequence[str]) -> dict[str, Any]:
    """Return what each ``FIELD=VALUE`` sets, with the switches of the sections that they belong to.

    Raises
    ------
    PresetError
        A text has no ``=``.
    """
    return _turning_sections_on(dict(_parse_setting(text) for text in texts))


def _parse_setting(text: str) -> tuple[str, Any]:
    """Split ``path=value``; the value is JSON, or else a bare word."""
    path, separator, value = text.partition("=")
    if not separator:
        raise PresetError(f"--set {text}: there is no =; write FIELD=VALUE, such as tolerance.t=0.01")
    try:
        return path.strip(), json.loads(value)
    except (ValueError, RecursionError):
        return path.strip(), value


def _turning_sections_on(values: dict[str, Any]) -> dict[str, Any]:
    """Add ``section.enabled`` for every section that a value is set in, or its contact test, unless set as well."""
    from ...core.preset.file import preset_paths

    sections = {path.partition(".")[0] for path in values}
    switches: dict[str, Any] = {f"{name}.enabled": True for name in sections if f"{name}.enabled" in preset_paths()}
    if "membrane" in sections:
        switches["contact_test"] = "membrane"
    return switches | values
