"""The solved scene in the package is what the solver gives."""

from dataclasses import asdict

import numpy as np
import pytest

from tactune.core.sources.simulator.source import SHIPPED, SimulatorSource, load_scene


@pytest.mark.long
@pytest.mark.parametrize("file", ["cup-118", "cup-none"])
def test_the_shipped_scene_is_the_solver_s(file):
    (path,) = SHIPPED.glob(f"{file}*.npz")
    simulator = SimulatorSource() if file == "cup-118" else SimulatorSource().with_object_away()
    solved = simulator.solve_anew(simulator.scene, lambda share, words: None)
    shipped = load_scene(path, len(solved.states))
    # Other processors round the last digits otherwise.
    for ours, theirs in zip(shipped.facts, solved.facts, strict=True):
        assert flat(asdict(ours)) == pytest.approx(flat(asdict(theirs)), rel=1e-6, abs=1e-9, nan_ok=True)
    for ours, theirs in zip(shipped.states, solved.states, strict=True):
        for name, image in vars(theirs).items():
            assert np.count_nonzero(getattr(ours, name) != image) <= 1e-5 * image.size, name


def flat(facts):
    numbers = []
    for value in facts.values():
        numbers += flat(value) if isinstance(value, dict) else np.ravel(np.asarray(value, float)).tolist()
    return numbers
