from contextlib import ExitStack

import pytest

from tactune.core.sources.realsense_files import BagSource


@pytest.fixture
def open_bag():
    """Opens recordings and closes them after the test."""
    with ExitStack() as stack:
        yield lambda path, progress=None: stack.enter_context(BagSource(path, progress))
