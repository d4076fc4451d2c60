"""The methods by name: the contact tests' variants, then those of the entry points ``tactune.methods``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

from ..errors import PluginError, TactuneError
from ..model.frames import Rig, SensorFrame
from ..model.plugins import NOT_INSTALLED, Plugins, load_plugin, load_plugins, plugin_names
from ..preset import Preset
from .fusion import fusion_kinds
from .method import ContactMethod, MethodKind

#: The entry-point group.
GROUP: Final = "tactune.methods"


@lru_cache(maxsize=1)
def _methods(names: tuple[str, ...]) -> Plugins[MethodKind]:
    """Load the methods of these entry points, and sort all methods."""
    plugins = load_plugins(GROUP, lambda name: load_plugin(GROUP, name, MethodKind))
    kinds = {kind.name: kind for kind in plugins.found.values()} | fusion_kinds()
    ordered = sorted(kinds.values(), key=lambda kind: (kind.rank, kind.name if kind.rank else ""))
    return Plugins({kind.name: kind for kind in ordered}, plugins.problems)


def method_kinds() -> dict[str, MethodKind]:
    """Return every method that can be used, by name, fusion first."""
    return _methods(plugin_names(GROUP)).found


def method_problems() -> dict[str, str]:
    """Return one sentence for each method of another package that cannot be loaded."""
    return _methods(plugin_names(GROUP)).problems


def method_names() -> tuple[str, ...]:
    """Return the names that `make_method` knows, fusion first."""
    return tuple(method_kinds())


def method_kind(name: str) -> MethodKind:
    """Return a method by its name.

    Raises
    ------
    TactuneError
        There is no such method, or its package cannot be loaded.
    """
    kinds = method_kinds()
    check_known([name], tuple(kinds))
    return kinds[name]


def check_known(names: Sequence[str], known: Sequence[str]) -> None:
    """Check that each method's name is one of the known.

    Raises
    ------
    TactuneError
        There is no such method, or its package cannot be loaded.
    """
    for name in names:
        if name not in known:
            if name in method_problems():
                raise PluginError(method_problems()[name])
            if not plugin_names(GROUP):
                raise TactuneError(NOT_INSTALLED)
            raise TactuneError(f"there is no method {name!r}; known are {', '.join(known)}")


def needs_untouched(name: str) -> bool:
    """Return whether a method compares with a frame of the untouched membrane."""
    kind = method_kinds().get(name)
    return kind is not None and kind.needs_untouched


def fields_of(name: str) -> dict[str, Any]:
    """Return the preset fields that a method sets; empty for the preset's own pipeline and for other methods."""
    kind = method_kinds().get(name)
    return dict(kind.fields or {}) if kind is not None else {}


def settings_of(name: str, preset: Preset) -> tuple[Any, ...]:
    """Return all of a preset that decides a method's patches: equal settings, equal patches."""
    return method_kind(name).settings_of(preset)


def make_method(name: str, preset: Preset, rig: Rig, untouched: SensorFrame | None = None) -> ContactMethod:
    """Build a method by its name.

    Parameters
    ----------
    name : str
        One of `method_names`.
    preset : Preset
    rig : Rig
    untouched : SensorFrame, optional
        The inflated, untouched membrane, for methods that need it.

    Raises
    ------
    TactuneError
        There is no such method, the untouched frame is missing, or the method cannot work with these.
    """
    kind = method_kind(name)
    if kind.needs_untouched and untouched is None:
        raise TactuneError(
            f"{name} compares with the untouched membrane, but there is no untouched frame; "
            "capture one while nothing touches the membrane"
        )
    return kind.make(preset, rig, untouched)
