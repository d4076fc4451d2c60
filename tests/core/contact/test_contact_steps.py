"""Steps of the membrane test that stand alone."""

from __future__ import annotations

import numpy as np

from tactune.core.contact.membrane.differences import surroundings


def test_the_surroundings_end_with_the_image():
    marked = np.zeros((40, 70), bool)
    assert surroundings(marked, 3) is None
    marked[5, 37] = marked[30, 50] = True
    assert surroundings(marked, 3) == np.s_[2:34, 34:54]
    assert surroundings(marked, 12) == np.s_[0:40, 25:63]
