"""Presets of older schema versions, brought to the present one step by step, and what is to be said of it."""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from typing import Any, Literal

from ..errors import PresetError

Document = dict[str, Any]
Migration = Callable[[Document], Document]

SCHEMA_VERSION: Literal[6] = 6


def _add_calibration(document: Document) -> Document:
    """Version 2: the alignment keeps the record of its calibration; version 1 had none."""
    alignment = document.get("alignment", {})
    if not isinstance(alignment, dict):
        return document
    return {**document, "alignment": {**alignment, "calibration": None}}


def _add_cameras(document: Document) -> Document:
    """Version 3: presets name the cameras of a live source; up to version 2 any that fits is taken."""
    camera = {"serial": "", "options": {}}
    return {"cameras": {"proximity": camera, "tactile": camera, "tactile_delay_s": 0.0}, **document}


#: The membrane test's parameters that came with version 4.
_MEMBRANE_4: Document = {
    "gap_m": 0.0018,
    "retreat": 0.9,
    "window_px": 2.5,
    "bias_m": 0.0012,
    "least_area_mm2": 25.0,
    "difference_m": 0.005,
    "slope": True,
    "core": 0.6,
    "most_px": 16.0,
    "smooth_px": 2.0,
    "tactile_weight": 0.5,
}
#: What was chosen anew when version 5 asked for the membrane's curvature, too.
_CHOSEN_ANEW_5: Document = {
    "gap_m": 0.0014, "least_area_mm2": 2.0, "difference_m": 0.008, "core": 0.5, "curvature": 0.7,
}  # fmt: skip
_MEMBRANE_5: Document = {**_MEMBRANE_4, **_CHOSEN_ANEW_5, "frames": 1, "curvature_px": 11.0}


def _add_contact_test(document: Document) -> Document:
    """Version 4: presets choose the contact test and may keep an untouched frame; version 3 knew the tolerance only."""
    return {"contact_test": "tolerance", "membrane": {**_MEMBRANE_4}, "untouched": None, **document}


def _add_curvature(document: Document) -> Document:
    """Version 5: the membrane test asks for the curvature and may average frames.

    A test that is neither chosen nor tuned takes the values chosen with it; any other goes on as before.
    """
    membrane = document.get("membrane")
    if not isinstance(membrane, dict):
        return document
    news = {"curvature": 0.0, "frames": 1, "curvature_px": 11.0}
    unused = document.get("contact_test") == "tolerance" and membrane == _MEMBRANE_4
    chosen = _CHOSEN_ANEW_5 if unused else {}
    return {**document, "membrane": {**news, **membrane, **chosen}}


def _add_balance(document: Document) -> Document:
    """Version 6: the membrane test ends contact by the membrane's balance; one chosen or tuned goes on without."""
    membrane = document.get("membrane", {})
    if not isinstance(membrane, dict):
        return document
    complete = {**_MEMBRANE_5, **membrane}
    unused = document.get("contact_test", "tolerance") == "tolerance" and complete == _MEMBRANE_5
    chosen = {"least_area_mm2": 5.0} if unused else {}
    return {**document, "membrane": {"balance": unused, **complete, **chosen}}


#: What a migration leaves different from a new preset: the membrane test's new field, its value then, and the words.
_LEFT_BEHIND: dict[Migration, tuple[str, Any, str]] = {
    _add_curvature: ("curvature", 0.0, "the membrane test goes on without the curvature (membrane.curvature is 0)"),
    _add_balance: ("balance", False, "the balanced edge stays off (membrane.balance is false)"),
}

#: Entry i takes a document of schema version i + 1 to version i + 2. Append only.
MIGRATIONS: tuple[Migration, ...] = (
    _add_calibration,
    _add_cameras,
    _add_contact_test,
    _add_curvature,
    _add_balance,
)


def migrate(document: Document, origin: str) -> Document:
    """Bring a document of an older schema version to the present one, step by step."""
    found = document.get("schema_version")
    if not isinstance(found, int) or isinstance(found, bool) or found < 1:
        raise PresetError(
            f"{origin}: schema_version is {reprlib.repr(found)}; it should be a whole number from 1 to {SCHEMA_VERSION}"
        )
    if found > SCHEMA_VERSION:
        raise PresetError(
            f"{origin}: schema_version is {reprlib.repr(found)}, this Tactune reads up to {SCHEMA_VERSION}; "
            f"update Tactune (the file was written by version {document.get('tool_version', 'unknown')})"
        )
    for step in MIGRATIONS[found - 1 :]:
        document = step(document)
    return {**document, "schema_version": SCHEMA_VERSION}


def migration_note(document: Document) -> str:
    """Say from which older version a document that `migrate` takes is read, and what that leaves different.

    Returns
    -------
    str
        Such as ``"written as schema 5, read as 6: the balanced edge stays off (...)"``, empty for the present version.
    """
    found = document["schema_version"]
    if found == SCHEMA_VERSION:
        return ""
    left = []
    for step in MIGRATIONS[found - 1 :]:
        document = step(document)
        if step in _LEFT_BEHIND:
            field, value, words = _LEFT_BEHIND[step]
            if document.get("membrane", {}).get(field) == value:
                left.append(words)
    return f"written as schema {found}, read as {SCHEMA_VERSION}" + (f": {'; '.join(left)}" if left else "")
