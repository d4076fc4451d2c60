"""Extensions by entry point: sources, cameras, methods and tabs, built in or from other packages.

A package declares what it adds in its ``pyproject.toml``::

    [project.entry-points."tactune.sources"]
    noise = "my_package.noise:KIND"

The built-in ones are declared in the same way in Tactune's own ``pyproject.toml``. Nothing is imported
before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, distributions, entry_points
from typing import Any, Generic, TypeVar

from ..errors import PluginError

T = TypeVar("T")

#: Where not even the built-in entry points are found.
NOT_INSTALLED = "Tactune is installed without its entry points; install it again: make setup, or pip install -e ."


@dataclass(frozen=True)
class Plugins(Generic[T]):
    """What an entry-point group provides.

    Attributes
    ----------
    found : dict of str to object
        The loaded objects by entry-point name.
    problems : dict of str to str
        One sentence for each entry point that cannot be loaded, by its name.
    """

    found: dict[str, T]
    problems: dict[str, str]


@cache
def added_by_others(group: str, kind: type[Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Import what other packages add to a group, once; our own parts are plain imports of the caller.

    Parameters
    ----------
    group : str
        Such as ``"tactune.sources"``.
    kind : type
        What each object must be an instance or a subclass of.

    Returns
    -------
    found : dict of str to object
        By the names of the entry points.
    problems : dict of str to str
        One sentence for each that cannot be loaded, with the entry point and its package.
    """
    found: dict[str, Any] = {}
    problems: dict[str, str] = {}
    for entry in entry_points(group=group):
        package = entry.dist.name if entry.dist is not None else "?"
        if package == "tactune":
            continue
        where = f"the entry point {entry.name!r} ({group}) of the package {package}"
        try:
            loaded: Any = entry.load()
        except Exception as error:  # another package's module may raise anything
            detail = f"{type(error).__name__}: {' '.join(str(error).split())}"
            problems[entry.name] = f"{where} cannot be loaded ({detail}); update or uninstall the package"
            continue
        if isinstance(loaded, kind) or (isinstance(loaded, type) and issubclass(loaded, kind)):
            found[entry.name] = loaded
        else:
            problems[entry.name] = f"{where} is no {kind.__name__}; update or uninstall the package"
    return found, problems


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
    loaded = _load(group, name)
    if not isinstance(loaded, kind):
        raise _wrong_kind(group, name, kind)
    return loaded


def load_plugin_class(group: str, name: str, kind: type[T]) -> type[T]:
    """Import one entry point that names a subclass of ``kind``, and return it.

    Raises
    ------
    PluginError
        As `load_plugin`.
    """
    loaded = _load(group, name)
    if not (isinstance(loaded, type) and issubclass(loaded, kind)):
        raise _wrong_kind(group, name, kind)
    return loaded


def load_plugins(group: str, load: Callable[[str], T]) -> Plugins[T]:
    """Call ``load`` with each name of a group; where it raises `PluginError`, keep the sentence."""
    found: dict[str, T] = {}
    problems: dict[str, str] = {}
    for name in plugin_names(group):
        try:
            found[name] = load(name)
        except PluginError as error:
            problems[name] = str(error)
    return Plugins(found, problems)


def _load(group: str, name: str) -> object:
    found = _declared(group).get(name)
    if found is None:
        raise PluginError(f"{group} has no entry point {name!r}; install the package that provides it")
    try:
        return found.load()
    except Exception as error:  # another package's module may raise anything
        detail = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise PluginError(
            f"{_where(group, name)} cannot be loaded ({detail}); update or uninstall the package"
        ) from error


def _wrong_kind(group: str, name: str, kind: type) -> PluginError:
    return PluginError(f"{_where(group, name)} is no {kind.__name__}; update or uninstall the package")


def _where(group: str, name: str) -> str:
    return f"the entry point {name!r} ({group}) of the package {_package(_declared(group)[name])}"


def forget() -> None:
    """Look for entry points again at the next call, because ``sys.path`` has changed."""
    _declared.cache_clear()
    added_by_others.cache_clear()


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
