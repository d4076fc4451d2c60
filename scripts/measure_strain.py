"""Compare strain measured from the simulated dots with the solver's, in percent.

    python scripts/measure_strain.py [SEED]

Three numbers each along length and width: as measured, the solver's largest between pairs of the dots
that were measured, and its largest of all, hidden dots included.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.spatial import cKDTree

from tactune.core.evaluation.strain import measure_strain
from tactune.core.frames import Float64Array
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.membrane import Membrane
from tactune.core.sources.simulator.scene import Press, cameras
from tactune.core.sources.simulator.sheet import DOT_SPACING_M, dot_grid
from tactune.core.sources.simulator.source import SimulatorSource

#: A metre of depth counts as this many pixels when a dot is looked up.
_PIXELS_A_METRE = 300.0


def true_dots(source: SimulatorSource) -> Float64Array:
    """Solve the first frame's press again and return its dots in the tactile camera, metres."""
    scene, design = source.scene, source.scene.design
    membrane = Membrane(design)
    nodes = next(Press(scene, membrane, source.rig).states())[2].nodes
    pose = cameras(source.rig, design)[1].pose
    return membrane.at(dot_grid(design.width_m, design.height_m), nodes) @ pose[:, :3].T + pose[:, 3]


def main() -> None:
    """Print a line a scene."""
    seed = sys.argv[1] if len(sys.argv) > 1 else "0"
    for press in ("low", "medium", "high"):
        for shape in ("cube", "cup", "octopus"):
            source = open_source(f"sim:{shape}?press={press}&grid=dots&seed={seed}")
            assert isinstance(source, SimulatorSource)
            facts, measured, dots = source.facts(0), measure_strain(source.read(0), source.rig), true_dots(source)
            lens = source.rig.tactile.intrinsics
            known = np.column_stack([lens.project(dots), dots[:, 2] * _PIXELS_A_METRE])
            seen = np.column_stack([measured.pixels, measured.points_m[:, 2] * _PIXELS_A_METRE])
            nearest = np.asarray(cKDTree(known).query(np.nan_to_num(seen))[1])
            words = [f"{shape:8s}{press:7s}{measured.dots:4d} dots"]
            for axis, largest in ((measured.length, facts.strain_length), (measured.width, facts.strain_width)):
                start, end = dots[nearest[axis.pairs]].transpose(1, 0, 2)
                same = float(np.linalg.norm(end - start, axis=1).max()) / DOT_SPACING_M - 1.0
                words.append(f"{100 * axis.largest:6.1f} {100 * same:6.1f} {100 * largest:6.1f}")
            print("  |".join(words), flush=True)


if __name__ == "__main__":
    main()
