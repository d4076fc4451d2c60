"""What other packages add by entry points: sources, cameras, methods and tabs.

A package declares it in its ``pyproject.toml``::

    [project.entry-points."tactune.sources"]
    noise = "my_package.noise:KIND"

Our own are plain imports of the modules that list them.
"""

from __future__ import annotations

import inspect
from functools import cache
from importlib.metadata import entry_points
from typing import Any


@cache
def added_by_others(group: str, kind: type[Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Import what other packages add to a group, by name; return it, and a sentence for each that cannot be used."""
    found: dict[str, Any] = {}
    problems: dict[str, str] = {}
    for entry in entry_points(group=group):
        package = entry.dist.name if entry.dist is not None else "?"
        where = f"the entry point {entry.name!r} ({group}) of the package {package}"
        try:
            loaded = entry.load()
        except Exception as error:  # another package's module may raise anything
            detail = f"{type(error).__name__}: {' '.join(str(error).split())}"
            problems[entry.name] = f"{where} cannot be loaded ({detail}); update or uninstall the package"
            continue
        is_class = inspect.isabstract(kind) and isinstance(loaded, type) and issubclass(loaded, kind)
        if isinstance(loaded, kind) or is_class:
            found[entry.name] = loaded
        else:
            problems[entry.name] = f"{where} is no {kind.__name__}; update or uninstall the package"
    return found, problems
