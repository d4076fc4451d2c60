"""The dent test and rigs with a tactile camera only: files, recordings, and the simulator's truth."""

import numpy as np
import pytest

from tactune.core import ContactPipeline, Preset, load_preset, open_source
from tactune.core.errors import RigMismatchError
from tactune.core.model.frames import SensorFrame
from tactune.core.model.patch import Provenance
from tactune.core.output.writer import export_mcap
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.folder import export_folder

DENT = Preset(contact_test="dent")
PRESSED = "sim:cup?press=medium&cameras=tactile"


@pytest.fixture(scope="module")
def pressed():
    """The rig, a frame of a press and the untouched frame."""
    with open_source(PRESSED) as source:
        frame, untouched = source.next_frame(), untouched_frame(source)
    assert frame is not None
    assert untouched is not None
    return source.rig, frame, untouched


def plane(depth_m, dent_m=0.0):
    """A flat membrane of 48 x 64 pixels with a square dent of 20 pixels."""
    metres = np.full((48, 64), depth_m)
    metres[14:34, 20:40] -= dent_m
    counts = np.rint(metres / 1e-4).astype(np.uint16)
    return SensorFrame(0, counts, counts, np.zeros((48, 64, 3), np.uint8))


def flat_rig():
    camera = {"model": "D405", "width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5}
    from tactune.core.model.rig_file import parse_rig

    return parse_rig({"tactile": camera | {"depth_unit_m": 1e-4}}, "here")


def test_a_dent_is_found_where_numpy_sees_it_and_a_bulge_is_none():
    rig, untouched = flat_rig(), plane(0.3)
    pipeline = ContactPipeline(DENT.with_value("dent.min_area_mm2", 0.0), rig, untouched)
    patch = pipeline.process(plane(0.3, dent_m=0.01))
    found = patch.mask
    assert found[17:31, 23:37].all()  # what is averaged at the edge may go either way
    found[11:37, 17:43] = False
    assert not found.any()
    assert np.allclose(patch.points[:, 2], 0.29, atol=1e-3)
    assert not pipeline.process(plane(0.3, dent_m=-0.01)).mask.any()
    assert not pipeline.process(plane(0.3, dent_m=0.003)).mask.any()


def test_small_dents_and_holes_and_noise_are_no_contact():
    rig, untouched = flat_rig(), plane(0.3)
    dented = plane(0.3, dent_m=0.01)
    area_mm2 = ContactPipeline(DENT, rig, untouched).process(dented).area_mm2
    large = ContactPipeline(DENT.with_value("dent.min_area_mm2", area_mm2 * 1.1), rig, untouched)
    patch = large.process(dented)
    assert not len(patch.points)
    assert (patch.provenance == Provenance.SMALL_CLUSTER).sum() > 100
    holes = dented.tactile_depth.copy()
    holes[14:34, 20:40] = 0
    hidden = SensorFrame(0, holes, holes, np.zeros((48, 64, 3), np.uint8))
    assert not len(ContactPipeline(DENT, rig, untouched).process(hidden).points)


def test_the_true_contact_is_dented_and_what_hovers_is_not(pressed):
    rig, frame, untouched = pressed
    contact = frame.truth.contact

    def overlap(share):
        found = ContactPipeline(DENT.with_value("dent.share", share), rig, untouched).process(frame).mask
        assert share or (found & contact).sum() > 0.9 * contact.sum()
        return (found & contact).sum() / (found | contact).sum()

    assert overlap(0.6) > 1.7 * overlap(0.0)
    with open_source("sim:cup?gap=5&cameras=tactile") as hovering:
        away = hovering.next_frame()
        assert away is not None
        assert not len(ContactPipeline(DENT, hovering.rig, untouched_frame(hovering)).process(away).points)


@pytest.mark.parametrize("kind", ["folder", "recording"])
def test_a_recording_of_one_camera_gives_the_same_patch(pressed, tmp_path, kind):
    rig, frame, untouched = pressed
    with open_source(PRESSED) as source:
        write = export_folder if kind == "folder" else export_mcap
        path = tmp_path / ("take" if kind == "folder" else "take.mcap")
        write(source, path, 2)
    with open_source(str(path)) as stored:
        assert stored.rig == rig
        assert not stored.rig.has_proximity
        assert stored.health().ok
        read = stored.next_frame()
    assert read is not None
    assert "proximity" not in {image.stem.partition("_")[0] for image in tmp_path.rglob("*.png")}
    ours, theirs = (ContactPipeline(DENT, rig, untouched).process(each).points for each in (frame, read))
    assert np.array_equal(ours, theirs)


def test_what_needs_two_cameras_or_an_untouched_frame_says_so(pressed):
    rig, frame, _ = pressed
    with pytest.raises(RigMismatchError, match="tactile camera only; choose the contact test dent"):
        ContactPipeline(load_preset("default"), rig)
    with pytest.raises(RigMismatchError, match="untouched frame"):
        ContactPipeline(DENT, rig).process(frame)
