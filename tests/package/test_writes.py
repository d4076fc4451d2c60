"""Files are written as a whole or not at all: through `atomic_path`, but for the places that say why not."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Methods and functions that write the file of their receiver or of an argument.
WRITERS = {"write_text", "write_bytes", "savez", "savez_compressed", "savetxt", "savefig", "imwrite", "ZipFile"}
#: Files that are written in another way.
OTHERS = {
    "core/model/files.py": "is atomic_path, which brings what was written to the disk",
    "core/model/untouched_archive.py": "writes to memory",
    "core/output/bag.py": "a recording grows, and a killed one plays up to its last chunk",
    "core/sources/folder.py": "the whole folder gets its name when it is complete",
    "core/tuning/study.py": "a journal grows by lines",
}


def writes(tree: ast.AST, within: frozenset[str] = frozenset()) -> Iterator[int]:
    """Return the lines that write a file to another path than that of an `atomic_path` around them."""
    for node in ast.iter_child_nodes(tree):
        inner = within
        if isinstance(node, ast.With):
            for item in node.items:
                call = item.context_expr
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "atomic_path":
                    inner |= {name.id for name in ast.walk(item) if isinstance(name, ast.Name)}
                elif isinstance(item.optional_vars, ast.Name) and inner & names(call):  # such as temporary.open("w")
                    inner |= {item.optional_vars.id}
        if isinstance(node, ast.Call) and is_write(node) and not inner & names(node):
            yield node.lineno
        yield from writes(node, inner)


def writes_of(code: str) -> Iterator[int]:
    return writes(ast.parse(code)) if any(f"{name}(" in code for name in (*WRITERS, "open")) else iter(())


def names(node: ast.AST) -> set[str]:
    return {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}


def is_write(call: ast.Call) -> bool:
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    texts = [word.value for word in call.args if isinstance(word, ast.Constant) and isinstance(word.value, str)]
    if name == "open":
        return any(set(text) <= set("rwaxbt+") and set(text) & set("wax+") for text in texts)
    return name in WRITERS and bool(call.args) and (name != "ZipFile" or "w" in texts)


def test_every_write_is_atomic_or_says_why_not() -> None:
    found = {
        str(path.relative_to(ROOT)): lines
        for floor in ("core", "widgets", "app")
        for path in sorted((ROOT / floor).rglob("*.py"))
        if (lines := list(writes_of(path.read_text("utf-8"))))
    }
    assert found.keys() == OTHERS.keys(), {path: found[path] for path in found.keys() - OTHERS.keys()}
