"""Kernels on the disk are thrown away when any file whose code is in them changes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tactune.core.contact.kernels import chain as kernels
from tactune.core.contact.kernels import compiling

_PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from small.core.outer import doubled
print(doubled(21.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package like ours: a kernel that takes a function of another module in."""
    core = tmp_path / "small" / "core"
    core.mkdir(parents=True)
    (tmp_path / "small" / "__init__.py").write_text("")
    (core / "__init__.py").write_text("")
    shutil.copy(Path(compiling.__file__), core / "compiling.py")
    (core / "inner.py").write_text("from .compiling import inline\n\n\n@inline\ndef factor():\n    return 2.0\n")
    (core / "outer.py").write_text(
        "from .compiling import kernel\nfrom .inner import factor\n\n\n"
        "@kernel\ndef doubled(x):\n    return x * factor()\n"
    )
    return tmp_path


def _run(folder: Path) -> float:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    program = [sys.executable, "-c", _PROGRAM.format(folder=str(folder))]
    return float(subprocess.run(program, capture_output=True, text=True, check=True, env=environment).stdout)


def test_a_change_in_another_module_reaches_the_kernel(package: Path) -> None:
    assert _run(package) == 42.0
    assert list(package.rglob("outer.doubled-*.nbi"))
    inner = package / "small" / "core" / "inner.py"
    inner.write_text(inner.read_text().replace("2.0", "3.0"))
    os.utime(inner, ns=(1, inner.stat().st_mtime_ns + 1_000_000))
    assert _run(package) == 63.0


def test_the_pipelines_kernels_know_all_their_files() -> None:
    names = {Path(path).name for path in compiling._sources(kernels.find_candidates.py_func.__module__)}
    assert {"chain.py", "simd.py", "lenses.py"} <= names
