"""Presets of older schema versions, converted to the current version step by step.

To change the format, raise `SCHEMA_VERSION` and append one function to `MIGRATIONS`. Never change or remove an
entry: files of every earlier version must stay readable.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from typing import Any, Final, Literal

from ..errors import PresetError

Document = dict[str, Any]
Migration = Callable[[Document], Document]

SCHEMA_VERSION: Final[Literal[1]] = 1

#: Entry i converts a document of schema version i + 1 to version i + 2.
MIGRATIONS: tuple[Migration, ...] = ()


def migrate(document: Document, origin: str) -> Document:
    """Convert a document of an older schema version to the current version.

    Raises
    ------
    PresetError
        The version is no positive whole number, or newer than this Tactune reads.
    """
    found = document.get("schema_version")
    if not isinstance(found, int) or isinstance(found, bool) or found < 1:
        allowed = "1" if SCHEMA_VERSION == 1 else f"a whole number from 1 to {SCHEMA_VERSION}"
        raise PresetError(f"{origin}: schema_version is {reprlib.repr(found)}; it should be {allowed}")
    if found > SCHEMA_VERSION:
        raise PresetError(
            f"{origin}: schema_version is {reprlib.repr(found)}, this Tactune reads up to {SCHEMA_VERSION}; "
            f"update Tactune (the file was written by version {document.get('tool_version', 'unknown')})"
        )
    for step in MIGRATIONS[found - 1 :]:
        document = step(document)
    return {**document, "schema_version": SCHEMA_VERSION}


def migration_note(document: Document) -> str:
    """Return a note such as ``"written as schema 1, read as 2"``; empty for a document of the current version."""
    found = document["schema_version"]
    return "" if found == SCHEMA_VERSION else f"written as schema {found}, read as {SCHEMA_VERSION}"
