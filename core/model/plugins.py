"""Extensions by entry point: sources, cameras, methods and tabs, built in or from other packages.

A package declares what it adds in its ``pyproject.toml``::

    [project.entry-points."tactune.sources"]
    noise = "my_package.noise:KIND"

The built-in ones are declared in the same way in Tactune's own ``pyproject.toml``. Nothing is imported
before it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, distributions
from typing import Generic, TypeVar

from ..errors import PluginError

T = TypeVar("T")


@dataclass(frozen=True)
class Plugins(Generic[T]):
    """What an entry-point group provides.

    Attributes
    ----------
    found : dict of str to object
        The loaded objects by entry-point name.
    problems : tuple of str
        One sentence for each entry point that cannot be loaded.
    """

    found: dict[str, T]
    problems: tuple[str, ...]


def plugin_names(group: str) -> tuple[str, ...]:
    """Return the names of the entry points of a group, such as ``"tactune.sources"``; imports none."""
    return tuple(_declared(group))


def load_plugin(group: str, name: str, kind: type[T]) -> T:
    """Import one entry point and return its object.

    Parameters
    ----------
    group, name : str
    kind : type
        What the object must be an instance of.

    Raises
    ------
    PluginError
        There is none of that name, its import fails, or the object is no ``kind``; the message names the
        entry point and its package.
    """
    found = _declared(group).get(name)
    if found is None:
        raise PluginError(f"{group} has no entry point {name!r}; install the package that provides it")
    where = f"the entry point {name!r} ({group}) of the package {_package(found)}"
    try:
        loaded = found.load()
    except Exception as error:  # another package's module may raise anything
        detail = " ".join(str(error).split())
        raise PluginError(
            f"{where} cannot be loaded ({type(error).__name__}: {detail}); update or uninstall the package"
        ) from error
    if not isinstance(loaded, kind):
        raise PluginError(f"{where} is no {kind.__name__} but {loaded!r}; update or uninstall the package")
    return loaded


def load_plugins(group: str, kind: type[T]) -> Plugins[T]:
    """Import every entry point of a group; those that cannot be loaded become `Plugins.problems`."""
    found: dict[str, T] = {}
    problems: list[str] = []
    for name in plugin_names(group):
        try:
            found[name] = load_plugin(group, name, kind)
        except PluginError as error:
            problems.append(str(error))
    return Plugins(found, tuple(problems))


@cache
def _declared(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; a built-in one wins over another of the same name.

    `importlib.metadata.entry_points` reads one distribution of each name only, the first one on the path: in a source
    tree that would be an outdated ``tactune.egg-info``.
    """
    found = [entry for distribution in distributions() for entry in distribution.entry_points if entry.group == group]
    return {entry.name: entry for entry in sorted(found, key=lambda entry: (_package(entry) == "tactune", entry.name))}


def _package(found: EntryPoint) -> str:
    return found.dist.name if found.dist is not None else "?"
