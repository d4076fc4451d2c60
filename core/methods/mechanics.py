"""Contact from the mechanics of the membrane: the contact pressure that explains its measured shape."""

from __future__ import annotations

import numpy as np

from ..model.arrays import Float32Array, Float64Array, Uint16Array
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .mechanics_problem import MembraneProblem, MembraneSolver, Solution, build_mesh, interpolation, make_sampler
from .membrane_view import MembraneView
from .method import ContactMethod, MethodKind, MethodPatch, failed

#: Minimum share of the nodes with a measured depth.
_SEEN_SHARE = 0.6


class MembraneMechanics(ContactMethod):
    """Finds the nodes of an elastic, pressurised membrane that carry contact pressure.

    Parameters
    ----------
    preset : Preset
        Gives the pose that transforms tactile points to the proximity frame.
    rig : Rig
    untouched : SensorFrame
        The untouched membrane, from which displacements are measured.
    nodes : int
        Approximate number of mesh nodes; the paper's mesh has 440.
    threshold : float
        A node is in contact if its contact pressure exceeds this share of the air's present gauge pressure. A flat
        object carries the whole gauge pressure.
    gauge_pressure_pa : float
        Gauge pressure of the untouched membrane, Pa.
    housing_m3 : float
        Volume of air below the plane of the rim. The membrane is clamped at its outline in the untouched frame.
    regularisation : float
        Weight of the contact pressure relative to the misfit, see `MembraneProblem`.

    Raises
    ------
    TactuneError
        The untouched frame shows no inflated membrane.

    References
    ----------
    Kuppuswamy et al., "Fast Model-Based Contact Patch and Pose Estimation for Highly Deformable
    Dense-Geometry Tactile Sensors", RA-L 2020.
    """

    name = "mechanics"

    def __init__(
        self,
        preset: Preset,
        rig: Rig,
        untouched: SensorFrame,
        nodes: int = 440,
        threshold: float = 0.5,
        gauge_pressure_pa: float = 1600.0,
        housing_m3: float = 0.009,
        regularisation: float = 1.0,
    ) -> None:
        untouched.check_against(rig)
        self._rig, self._threshold = rig, threshold
        self._view = MembraneView(preset.alignment, rig)
        self._factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
        mesh = build_mesh(
            untouched.tactile_depth,
            rig.tactile.intrinsics,
            self._factor,
            preset.alignment.depth_offset_m,
            nodes,
        )
        self.problem = MembraneProblem(mesh, gauge_pressure_pa, housing_m3, regularisation)
        self._sampler = make_sampler(mesh.pixels, mesh.spacing_px, self._factor)
        self._untouched = self._sampler.sample(untouched.tactile_depth)
        self._way_per_depth = np.linalg.norm(mesh.positions, axis=1) / mesh.positions[:, 2]
        self._pixels, self._corners, self._weights = interpolation(mesh)
        self._solver = MembraneSolver(self.problem.program(np.zeros(len(mesh.pixels))))

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the points of the membrane that carry contact pressure."""
        frame.check_against(self._rig)
        counts = frame.tactile_depth
        way_m = self.way_m(counts)
        seen = np.count_nonzero(np.isfinite(way_m))
        if seen < _SEEN_SHARE * len(way_m):
            return self._failed(
                f"the tactile camera sees {seen} of the {len(way_m)} nodes, too few for a balance of the membrane"
                if seen
                else "the tactile image has no depth where the untouched frame shows the membrane"
            )
        solution = self.solve(way_m)
        if solution.failure:
            return self._failed(solution.failure)
        contact = self.pressure_image(solution) > self._threshold * self.problem.air_pressure(solution.x)
        return MethodPatch(self._view.points(contact, counts), lambda: self._view.pick(contact, counts))

    def way_m(self, counts: Uint16Array) -> Float64Array:
        """Return each node's displacement along its ray since the untouched frame, metres; nan where unseen."""
        return np.asarray((self._sampler.sample(counts) - self._untouched) * self._factor * self._way_per_depth)

    def solve(self, way_m: Float64Array) -> Solution:
        """Return the equilibrium that fits these displacements best."""
        return self._solver.solve(self.problem.program(way_m))

    def pressure_image(self, solution: Solution) -> Float32Array:
        """Return the contact pressure over the untouched gauge pressure, shape (Ht, Wt); 0 off the mesh."""
        pressure = self.problem.contact_pressure(solution.x).astype(np.float32)
        image = np.zeros(self._rig.tactile.intrinsics.shape, np.float32)
        image.reshape(-1)[self._pixels] = np.einsum("ij,ij->i", pressure[self._corners], self._weights)
        return image

    def _failed(self, reason: str) -> MethodPatch:
        return failed(self._rig.proximity.intrinsics.shape, f"mechanics: {reason}")


def _make(preset: Preset, rig: Rig, untouched: SensorFrame | None) -> ContactMethod:
    assert untouched is not None  # `make_method` has checked
    return MembraneMechanics(preset, rig, untouched)


METHOD = MethodKind(
    "mechanics",
    "Tactile camera: where something must press to explain the membrane's shape, by an elastic model",
    (110, 40, 0),
    _make,
    needs_untouched=True,
    dark_rgb=(210, 180, 110),
    rank=13,
)
