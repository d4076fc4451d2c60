"""``tactune convert``: the target's name, or --to, says what is written."""

from xml.etree import ElementTree

import h5py

from tactune.core.sources.lens import read_lenses


def test_a_recording_becomes_hdf5_and_its_calibration_urdf(tactune, recording, tmp_path):
    done = tactune("convert", recording, tmp_path / "a.h5", "-n", "3")
    assert done.status == 0 and "wrote 3 frames" in done.out
    with h5py.File(tmp_path / "a.h5") as file:
        assert len(file["sequence"]) == 3
    assert tactune("convert", recording, tmp_path / "a.urdf").status == 0
    assert ElementTree.parse(tmp_path / "a.urdf").getroot().tag == "robot"
    assert tactune("convert", "simulator", tmp_path / "b.yaml", "--to", "kalibr").status == 0
    assert len(read_lenses(tmp_path / "b.yaml")) == 3
