"""The preset's fields as parameters that clients of a live connection read and set."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Final

from ..errors import PresetError
from ..preset import Preset
from ..preset.preset import preset_paths

#: A parameter's value; a tuple of numbers is a list.
Value = bool | int | float | str | list[int] | list[float]

#: Sections that are no parameters: what cameras need when they are opened, and fields of the preset as a file.
_EXCLUDED: Final = ("cameras.", "name", "notes", "created", "modified")


class PresetParameters:
    """The preset's numbers, switches and words, by their dotted paths, such as ``"tolerance.t"``; for any thread.

    ``check`` raises `TactuneError` for a preset that cannot be used, and may be replaced once the rig is known.
    ``on_change`` is told what `use` has changed. Unless ``settable``, clients read only.
    """

    def __init__(
        self,
        preset: Preset,
        check: Callable[[Preset], object] = lambda preset: None,
        settable: bool = False,
    ) -> None:
        self._preset = preset
        self._settable = settable
        self.check = check
        self._lock = threading.Lock()
        self.on_change: Callable[[Mapping[str, Value]], None] = lambda values: None

    @property
    def preset(self) -> Preset:
        return self._preset

    def use(self, preset: Preset) -> None:
        """Continue with a preset that was changed elsewhere, and tell clients what is new in it."""
        with self._lock:
            before, self._preset = _values(self._preset), preset
        changed = {path: value for path, value in _values(preset).items() if before.get(path) != value}
        if changed:
            self.on_change(changed)

    def values(self) -> dict[str, Value]:
        return _values(self._preset)

    def set(self, path: str, value: object) -> None:
        """Set one value; `TactuneError` if clients may not, there is no such parameter, or the value is not allowed."""
        if not self._settable:
            raise PresetError(f"{path} was not set: clients may read only; start tactune serve with --settable")
        with self._lock:
            present = _values(self._preset).get(path)
            if present is None:
                raise PresetError(f"there is no parameter {path!r}; parameters are {', '.join(_values(self._preset))}")
            if isinstance(present, int) and isinstance(value, float) and value.is_integer():
                value = int(value)  # JavaScript has one type of number
            changed = self._preset.with_value(path, value)
            self.check(changed)
            self._preset = changed


def _values(preset: Preset) -> dict[str, Value]:
    found = {path: preset.value(path) for path in preset_paths() if not path.startswith(_EXCLUDED)}
    return {
        path: list(value) if isinstance(value, tuple) else value for path, value in found.items() if _is_plain(value)
    }


def _is_plain(value: object) -> bool:
    if isinstance(value, tuple):
        return all(isinstance(item, int | float) for item in value)
    return isinstance(value, bool | int | float | str)
