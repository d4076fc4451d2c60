"""Scenes of the simulator as evidence."""

from functools import lru_cache

import pytest

from tactune.core.errors import AdviceError
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.registry import open_source
from tactune.core.tuning.advice.proposal import Evidence
from tactune.core.tuning.advice.suggest import suggest_all


@lru_cache(maxsize=8)
def scene(name):
    """The rig, four frames and the untouched frame of a simulated scene."""
    with open_source(name) as source:
        frames = tuple(frame for _, frame in zip(range(4), source, strict=False))
        return source.rig, frames, untouched_frame(source)


@pytest.fixture(scope="session")
def evidence():

    def make(preset, name="sim:cup?press=medium", *, untouched=True):
        rig, frames, free = scene(name)
        return Evidence(preset, rig, frames, free if untouched else None)

    return make


@pytest.fixture(scope="session")
def suggest():
    """Make the proposal of one section; its refusal is raised."""

    def make(section, shown):
        found = suggest_all(shown, sections=(section,))
        if found.refusals:
            raise AdviceError(found.refusals[section])
        return found.parts[0]

    return make
