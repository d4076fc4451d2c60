"""Limits of any contact test at a sensor's noise, per simulated sensor.

Without options: how far the edge of contact can be told, the Cramer-Rao bound. With ``--points``: the RMSE of the patch
that is left when the true contact pixels are given, which is the error of the points' depth.

Outside a straight edge at e, the gap of a membrane in equilibrium is g(s) = q (s - e)^2 / 2, with q = p / T - k (see
`tactune.core.contact.membrane.equilibrium`). It is measured with noise of the power S per area, over the strip of width
w along the edge, out to the gap G, that is to R = sqrt(2 G / q). The information on e is the integral of
(dg/de)^2 / S over the strip, w q^2 R^3 / (3 S), so no unbiased estimate has a smaller standard deviation than
sqrt(3 S / (w q^2 R^3)).
"""

from __future__ import annotations

import argparse
import math
from statistics import fmean

from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.finder import CandidateBuffers
from tactune.core.contact.membrane.differences import surface_points
from tactune.core.contact.membrane.finder import MembraneFinder
from tactune.core.evaluation.metrics import symmetric_rmse_m, truth_cloud
from tactune.core.evaluation.sensor_table import measured_rig, plan_sensors
from tactune.core.evaluation.table_cell import PRESSES
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.scene import simulator_rig
from tactune.core.sources.simulator.sensors import SENSORS, SensorModel

#: Distance of the membrane, width of the strip along the edge, and largest gap, metres.
DISTANCE_M, STRIP_M, LARGEST_GAP_M = 0.3, 0.010, 0.005
#: A flat object under a usual membrane, and objects with edges rounded to 25 and 10 mm, 1/m.
PUSHES_PER_M = (10.0, 50.0, 110.0)


def noise_m4(sensor: SensorModel) -> float:
    """Return the noise power of both cameras per area at low spatial frequency, m^4."""
    rig = simulator_rig()
    proximity_m = DISTANCE_M / rig.proximity.intrinsics.fx
    tactile_m = DISTANCE_M / rig.tactile.intrinsics.fx
    per_disparity_m = DISTANCE_M**2 / (rig.tactile.intrinsics.fx * sensor.stereo_baseline_m)
    stereo_m, white_m = sensor.stereo_correlated_px * per_disparity_m, sensor.stereo_white_px * per_disparity_m
    return (
        (sensor.tof_white_m * proximity_m) ** 2
        + 4 * math.pi * (sensor.tof_correlated_m * sensor.tof_correlated_px * proximity_m) ** 2
        + (white_m * tactile_m) ** 2
        + 4 * math.pi * (stereo_m * sensor.stereo_length_px * tactile_m) ** 2
    )


def edge_sigma_m(power_m4: float, push_per_m: float) -> float:
    """Return the smallest standard deviation of the edge's place, metres."""
    reach_m = math.sqrt(2 * LARGEST_GAP_M / push_per_m)
    return math.sqrt(3 * power_m4 / (STRIP_M * push_per_m**2 * reach_m**3))


def points_rmse_mm(sensor: str) -> dict[str, float]:
    """Return the RMSE of patches with the true contact pixels, by press: mean of the objects, standard membrane."""
    found: dict[str, list[float]] = {}
    preset = None
    for scene in plan_sensors([sensor], ["standard"]):
        with open_source(f"{scene.source}&seed=0") as source:
            preset = preset or measured_rig(load_preset("simulator"), source)
            frame, rig = source.next_frame(), source.rig
        finder = MembraneFinder(preset, rig, make_alignment(preset.alignment, rig))
        if (differences := finder.differences(frame, preset)) is None:
            continue
        contact, weight = frame.truth.contact[differences.place], finder.rig_bias.tactile_weight
        patch = surface_points(contact, differences, finder.bias.bias_m, weight, rig, CandidateBuffers(rig))
        rmse_m = symmetric_rmse_m(patch.points, truth_cloud(frame.truth, rig).points)
        found.setdefault(scene.press, []).append(1e3 * rmse_m)
    return {press: fmean(values) for press, values in found.items()}


def print_points() -> None:
    """Print the RMSE that is left with the true contact pixels."""
    print("RMSE in mm with the true contact pixels, at " + ", ".join(PRESSES) + " press:")
    sensors = {name: points_rmse_mm(name) for name, sensor in SENSORS.items() if not sensor.held_out}
    sensors["mean"] = {press: fmean(row[press] for row in sensors.values()) for press in PRESSES}
    for name, row in sensors.items():
        print(f"{name:16}" + "".join(f"{row[press]:8.2f}" for press in PRESSES), flush=True)


def print_edges() -> None:
    """Print the bound for each sensor."""
    print(f"Smallest standard deviation of the edge in mm, per {1e3 * STRIP_M:g} mm of edge, for p / T - k in 1/m:")
    print(f"{'sensor':16}" + "".join(f"{push:8g}" for push in PUSHES_PER_M))
    for name, sensor in SENSORS.items():
        power = noise_m4(sensor)
        print(f"{name:16}" + "".join(f"{1e3 * edge_sigma_m(power, push):8.2f}" for push in PUSHES_PER_M))


def main() -> None:
    """Print the limit that the command line asks for."""
    parser = argparse.ArgumentParser(description="Print limits of any contact test at a sensor's noise.")
    parser.add_argument("--points", action="store_true", help="error of the points' depth instead of the edge's bound")
    (print_points if parser.parse_args().points else print_edges)()


if __name__ == "__main__":
    main()
