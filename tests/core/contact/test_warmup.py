"""Compilation before the first frame: cached on disk, without a writable disk, in threads and in forked processes."""

import os
import subprocess
import sys
from pathlib import Path

SUPPORT = Path(__file__).resolve().parents[2] / "support"

PROCESS = """
import numpy as np
from tactune.core.warmup import is_compiled, warm_up, warm_up_test
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset
from fakes import tiny_frame, tiny_rig
"""


def run(program, **environment):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROCESS + program],
        check=False, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(SUPPORT)} | environment,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_kernels_are_kept_where_the_environment_says(tmp_path):
    program = """
from tactune.core.contact.kernels.compiling import compiled_so_far, is_kept
from tactune.core.contact.kernels.colors import color_lookup
from tactune.core.contact.pixels import colors_at
from tactune.core.model.frames import ColorCamera
rig = tiny_rig()
color = ColorCamera(intrinsics=rig.tactile.intrinsics, T_color_depth=np.eye(4))
rig = rig.model_copy(update={"proximity_color": color})
print(is_compiled(), is_kept(color_lookup))
colors_at(np.ones((2, 3), np.float32), np.arange(2), np.zeros((*rig.tactile.intrinsics.shape, 3), np.uint8), rig)
print(compiled_so_far())
"""
    first = run(program, NUMBA_CACHE_DIR=str(tmp_path))
    assert first.startswith("False False\nCompiled(loaded=0, compiled=1")
    assert str(tmp_path) in first
    again = run(program, NUMBA_CACHE_DIR=str(tmp_path))
    assert again.startswith("False True\nCompiled(loaded=1, compiled=0")


def test_no_frame_of_the_membrane_test_waits_for_a_compiler():
    program = """
from dataclasses import replace
from tactune.core.contact.kernels.compiling import compiled_so_far
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource
source = SimulatorSource("cup", seed=3, variant=Variant(press="medium"), cells=(60, 36))
frames = [source.read(index) for index in range(2)]
frames.append(replace(frames[0], proximity_color=frames[0].proximity_color // 2))  # in half of the light
plain = load_preset("simulator").with_value("mask.value", (110, 255))  # in half of the light no print is so bright
for values in ({"membrane.bias": False}, {}, {"membrane.frames": 2}):  # each needs more than the one before
    preset = plain.with_values(values)
    warm_up_test(preset, lambda share, words: None)
    before = compiled_so_far()
    pipeline = ContactPipeline(preset, source.rig, frames[0])
    for frame in frames:
        patch = pipeline.process(frame)
    after = compiled_so_far()
    print(patch.stage_ms["equilibrium"] > 0.2, after.loaded - before.loaded, after.compiled - before.compiled)
"""
    assert run(program).split() == ["True", "0", "0"] * 3
