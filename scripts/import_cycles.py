"""Fail if there are import cycles in the three packages; TYPE_CHECKING imports count."""

from __future__ import annotations

import sys

import grimp


def cycles(*packages: str) -> list[str]:
    """Return each import cycle as one line, ``a -> b -> a``."""
    graph = grimp.build_graph(*packages)
    found: dict[frozenset[str], str] = {}
    for importer in sorted(graph.modules):
        for imported in sorted(graph.find_modules_directly_imported_by(importer)):
            back = graph.find_shortest_chain(importer=imported, imported=importer)
            if back is not None:
                found.setdefault(frozenset(back), " -> ".join((importer, *back)))
    return sorted(found.values())


if __name__ == "__main__":
    circles = cycles("tactune.app", "tactune.widgets", "tactune.core")
    for circle in circles:
        print(f"Import cycle: {circle}")
    sys.exit(bool(circles))
