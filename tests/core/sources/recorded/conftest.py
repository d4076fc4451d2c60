from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tactune.core.sources.bag import BagSource

# The makers of recordings are imported by their plain names, also by child processes.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def open_bag() -> Iterator[Callable[..., BagSource]]:
    """Opens recordings and closes them after the test."""
    with ExitStack() as stack:
        yield lambda path, progress=None: stack.enter_context(BagSource(path, progress))
