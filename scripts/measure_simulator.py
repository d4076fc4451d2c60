"""Compare the simulator preset's patches with the truth, per object and press depth.

    .venv/bin/python scripts/measure_simulator.py [--noise 1] [--seed 0] [--mesh]

Prints the largest share of pixels in the patch over all frames without contact, then the means of IoU,
precision, recall and symmetric RMSE in bands of press depth, and the pipeline's median time. With ``--mesh``
instead: how much the patch's area changes with mesh cells of half the length; this takes minutes.
"""

from __future__ import annotations

import argparse
import statistics

from tactune.core import ContactPipeline, load_preset
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.sources.simulator.scenes import Press, Variant, resolve_scene
from tactune.core.sources.simulator.source import SimulatorSource

OBJECTS = ("cube", "cup", "octopus")
PRESSES: tuple[Press, ...] = ("low", "medium", "high")
BANDS_MM = ((0, 5), (5, 15), (15, 30), (30, 60))


def measure(scene: str, seed: int, noise: float) -> None:
    """Run a whole press sequence and print its rows."""
    bands: dict[tuple[int, int], list[dict[str, float]]] = {band: [] for band in BANDS_MM}
    untouched_shares, times_ms = [], []
    with SimulatorSource(scene, seed, noise, sensor="datasheet") as source:
        pipeline = ContactPipeline(load_preset("simulator").with_value("contact_test", "tolerance"), source.rig)
        for frame in source:
            patch = pipeline.process(frame)
            times_ms.append(sum(patch.stage_ms.values()))
            depth_mm = 1e3 * source.facts(frame.sequence).depth_m
            assert frame.truth is not None
            if not frame.truth.contact.any():
                untouched_shares.append(100 * len(patch.points) / patch.mask.size)
                continue
            band = next(band for band in BANDS_MM if band[0] <= depth_mm < band[1])
            bands[band].append(compare_with_truth(patch, frame.truth, source.rig))
    print(
        f"{scene}: {len(untouched_shares)} frames without touch, worst share of pixels {max(untouched_shares):.4f} %; "
        f"median {statistics.median(times_ms):.1f} ms a frame"
    )
    for (near, far), scores in bands.items():
        iou, precision, recall, rmse_mm = (
            statistics.fmean(score[key] for score in scores) for key in ("iou", "precision", "recall", "rmse_mm")
        )
        print(
            f"  {near:2d}-{far:2d} mm  {len(scores):2d} frames  IoU {iou:.3f}  precision {precision:.3f}  "
            f"recall {recall:.3f}  RMSE {rmse_mm:.2f} mm"
        )


def measure_mesh() -> None:
    """Print the area of the true patch of the still presses, also with mesh cells of half the length."""
    for scene in OBJECTS:
        for press in PRESSES:
            variant = Variant(press=press)
            cells = resolve_scene(scene, variant).design.cells
            areas_cm2 = []
            for times in (1, 2):
                halved = (times * cells[0], times * cells[1])
                with SimulatorSource(scene, noise=0.0, cells=halved, variant=variant) as source:
                    areas_cm2.append(1e4 * true_area_m2(source))
            print(
                f"{scene}, {press} press: {areas_cm2[0]:.2f} cm2, cells halved {areas_cm2[1]:.2f} cm2, "
                f"{100 * (areas_cm2[0] / areas_cm2[1] - 1):+.1f} %"
            )


def true_area_m2(source: SimulatorSource) -> float:
    """Return the area of the true patch across the optical axis."""
    truth, lens = source.read(0).truth, source.rig.proximity.intrinsics
    assert truth is not None and truth.depth_m is not None
    return float((truth.depth_m[truth.contact].astype(float) ** 2).sum() / (lens.fx * lens.fy))


def main() -> None:
    """Measure every object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--mesh", action="store_true")
    arguments = parser.parse_args()
    if arguments.mesh:
        measure_mesh()
    else:
        for scene in OBJECTS:
            measure(scene, arguments.seed, arguments.noise)


if __name__ == "__main__":
    main()
