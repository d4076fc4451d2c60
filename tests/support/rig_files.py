"""Rigs as files."""

from __future__ import annotations

from pathlib import Path

from tactune.core.model.frames import Rig
from tactune.core.model.rig_file import json_text, rig_to_json


def save_rig(rig: Rig, path: Path) -> Path:
    """Write a rig file, and return its path."""
    path.write_text(json_text(rig_to_json(rig)), encoding="utf-8")
    return path
