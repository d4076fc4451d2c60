"""The solved scene in the package is what the solver gives."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from tactune.core.sources.simulator.source import SHIPPED, SimulatorSource, load_shipped


@pytest.mark.long
def test_the_shipped_scene_is_the_solver_s():
    (path,) = SHIPPED.glob("*.zip")
    simulator = SimulatorSource()
    solved = simulator.solve_anew(lambda share, words: None)
    shipped = load_shipped(path, len(solved.states))
    facts = [[asdict(facts) for facts in scene.facts] for scene in (shipped, solved)]
    assert facts[0] == facts[1]
    for ours, theirs in zip(shipped.states, solved.states, strict=True):
        for name, image in theirs.arrays().items():
            assert np.array_equal(getattr(ours, name), image), name
