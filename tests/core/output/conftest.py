import pytest

from tactune.core import ContactPipeline, load_preset, open_source


@pytest.fixture(scope="session")
def processed():
    preset = load_preset("simulator")
    with open_source("sim:cup") as source:
        source.seek(40)
        frame = source.next_frame()
        assert frame is not None
        return frame, ContactPipeline(preset, source.rig).process(frame), preset
