"""One press: the rig, the equilibrium at each object position, and the clean images of every state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from ...model.arrays import Float32Array, Float64Array, Uint8Array, Uint16Array
from ...model.clouds import nearest_pixels
from ...model.frames import ColorCamera, DepthCamera, Matrix4, Rig, TrueStrain, pose_matrix, rigid_transform
from ...model.intrinsics import Intrinsics
from . import render
from .membrane import (
    ATMOSPHERE_PA,
    Membrane,
    MembraneDesign,
    MembraneState,
    contact_load,
    contact_share,
    object_pose,
)
from .objects import clearance, turn
from .render import Camera, Surface
from .scenes import Scene, Step

#: Distance of the standard membrane's inflated, untouched apex from the proximity camera's plane, metres.
APEX_M: Final = 0.314
#: Distance of the rim, which is the same for all membranes, metres.
RIM_M: Final = APEX_M - MembraneDesign.apex_m
#: Tolerance of steps that only lead to another, if nothing sticks, over the membrane's own.
_LOOSE: Final = 10.0
#: A node of the fine mesh touches where this share of the coarse nodes around it do.
_TOUCHING_SHARE: Final = 0.999
#: Far wall behind the sensor, as n . x = d in the membrane's frame.
_BACKDROP: Final = (0.09, -0.05, 0.9946, 0.62)
#: Visible share of a dot's disc from which the dot counts as completely visible: its centroid is then exact.
_WHOLE_SHARE: Final = 0.9
#: Sample points across a dot's diameter.
_POINTS_ACROSS: Final = 11
#: A point is hidden where its pixel shows the membrane nearer by more than this, metres.
_BEFORE_M: Final = 4e-3


def simulator_rig() -> Rig:
    """Return the rig with its true poses: an L515 and a D405, 40 mm beside it and slightly rotated."""
    return Rig(
        proximity=DepthCamera(
            model="Intel RealSense L515",
            serial="SIM-L515",
            intrinsics=Intrinsics(width=640, height=480, fx=460.3, fy=460.9, cx=325.6, cy=238.7),
            depth_unit_m=0.00025,
        ),
        tactile=DepthCamera(
            model="Intel RealSense D405",
            serial="SIM-D405",
            intrinsics=Intrinsics(width=640, height=480, fx=386.2, fy=386.2, cx=317.4, cy=241.9),
            depth_unit_m=0.0001,
        ),
        proximity_color=ColorCamera(
            intrinsics=Intrinsics(width=640, height=480, fx=451.7, fy=452.1, cx=318.9, cy=243.3),
            T_color_depth=_rigid((0.35, -0.28, 0.12), (0.0004, 0.0139, -0.0017)),
        ),
        T_proximity_tactile=_rigid((0.5, -1.3, 0.4), (0.0400, 0.0006, -0.0012)),
    )


def _rigid(degrees: tuple[float, float, float], translation_m: tuple[float, float, float]) -> Matrix4:
    return rigid_transform(pose_matrix(turn(degrees), translation_m))


def cameras(rig: Rig) -> tuple[Camera, Camera, Camera]:
    """Return proximity, tactile and colour cameras in the membrane's frame, centred between the first two."""
    assert rig.proximity_color is not None
    assert rig.T_proximity_tactile is not None
    proximity_membrane = pose_matrix(np.eye(3), (0.020, 0.0, RIM_M))
    tactile = np.linalg.inv(np.array(rig.T_proximity_tactile)) @ proximity_membrane
    colour = np.array(rig.proximity_color.T_color_depth) @ proximity_membrane
    return (
        Camera(rig.proximity.intrinsics, proximity_membrane[:3]),
        Camera(rig.tactile.intrinsics, np.ascontiguousarray(tactile[:3])),
        Camera(rig.proximity_color.intrinsics, np.ascontiguousarray(colour[:3])),
    )


class CleanState(NamedTuple):
    """Noise-free images of one state; depths in ``CLEAN_UNIT_M``, 0 where there is none."""

    #: In the proximity camera, (H, W): depth of the surface behind the membrane, and of the membrane.
    behind: Uint16Array
    membrane: Uint16Array
    #: (H, W): cosine of incidence at the surface behind the membrane, times 255.
    cosine: Uint8Array
    #: (H, W): contact, depth step and reflective rubber, see `flag`.
    flags: Uint8Array
    proximity_color: Uint8Array
    #: (H, W): depth of the membrane in the tactile camera.
    tactile: Uint16Array
    tactile_color: Uint8Array
    #: (H, W): contact pressure in the proximity camera, pascals.
    pressure: Uint16Array


@dataclass(frozen=True)
class PressFacts:
    """Ground truth of one state beyond its images."""

    #: Travel of the object past first touch; a gap is negative.
    depth_m: float
    strain: TrueStrain
    #: The solver's, see `MembraneState`.
    residual: float
    #: True pose of the object in the proximity depth frame.
    T_proximity_object: Matrix4
    #: Force of the object on the membrane in the proximity depth frame, and gauge pressure of the air.
    force_n: tuple[float, float, float]
    inflation_pa: float


class Press:
    """The object of a scene, moved step by step against the membrane, and three cameras."""

    def __init__(self, scene: Scene, membrane: Membrane, rig: Rig) -> None:
        self.pressed, self.scene = scene.pressed, scene
        self.membrane = membrane
        self._cameras = cameras(rig)
        design = membrane.design
        self._sheet = render.paint_sheet(design.width_m, design.height_m, scene.print)
        #: From 4096 linear levels to 8-bit display values.
        self._gamma = np.round(255.0 * np.linspace(0.0, 1.0, 4096) ** (1 / 2.2)).astype(np.uint8)
        self._rotation = turn(self.pressed.rotation_deg)
        self._touch_z = self._first_touch()

    def pose(self, step: Step) -> Float64Array:
        x, y = self.pressed.offset_m
        origin = x + step.x_m, y + step.y_m, self._touch_z - step.depth_m
        return object_pose(turn(step.turn_deg) @ self._rotation, origin)

    def _first_touch(self) -> float:
        """Lower the object by its distance from the membrane until it touches."""
        surface, z = self.membrane.surface(self.membrane.rest.nodes), self.membrane.design.apex_m + 0.2
        for _ in range(200):
            pose = object_pose(self._rotation, (*self.pressed.offset_m, z))
            gap = clearance(self.pressed.kind, pose, surface)
            z -= gap
            if gap < 1e-7:
                break
        return z

    def states(self) -> Iterator[tuple[float, Float64Array, MembraneState]]:
        """Solve the path; yield depth, pose and state of drawn steps; those before the first on a coarse mesh."""
        way, drawn = self.scene.way, self.scene.drawn
        before, held = self._led_to(drawn[0])
        for number in range(drawn[0], len(way)):
            pose, depth = self.pose(way[number]), way[number].depth_m
            if depth <= 0.0:
                state = self.membrane.rest
            else:
                state = _follow(self.membrane, self.pressed.kind, pose, before, held, self.membrane.tolerance)
                before, held = [*before[-1:], state.nodes], self._held(state, number)
            if number in drawn:
                yield depth, pose, state

    def _led_to(self, first: int) -> tuple[list[Float64Array], Float64Array | None]:
        """Return the fine nodes, interpolated, of the coarse membrane at a step, and where they stick then."""
        if first == 0:
            return [], None
        fine = self.membrane
        coarse = fine.coarse or fine
        before: list[Float64Array] = []
        held = None
        for number, step in enumerate(self.scene.way[: first + 1]):
            loose = 1.0 if number == first or fine.design.sticks else _LOOSE
            state = _follow(coarse, self.pressed.kind, self.pose(step), before, held, loose * coarse.tolerance)
            before, held = [*before[-1:], state.nodes], self._held(state, number)
        nodes = fine.interpolated(coarse, state.nodes)
        if not fine.design.sticks:
            return [nodes], None
        touching = np.repeat((state.reaction_n > 0.0)[:, None].astype(np.float64), 3, axis=1)
        share = coarse.at(fine.mesh.flat[:, :2], touching)
        return [nodes], np.where(share > _TOUCHING_SHARE, nodes, np.nan)

    def _held(self, state: MembraneState, number: int) -> Float64Array | None:
        """Return where the nodes that touch at a step stick at the next one: they move with the object."""
        if not self.membrane.design.sticks or number + 1 == len(self.scene.way):
            return None
        now, after = (self.pose(step) for step in self.scene.way[number : number + 2])
        on_object = state.nodes @ now[:, :3].T + now[:, 3]
        return np.where((state.reaction_n > 0.0)[:, None], (on_object - after[:, 3]) @ after[:, :3], np.nan)

    def facts(self, depth_m: float, pose: Float64Array, state: MembraneState) -> PressFacts:
        object_membrane = np.vstack([pose, (0.0, 0.0, 0.0, 1.0)])
        proximity_membrane = np.vstack([self._cameras[0].pose, (0.0, 0.0, 0.0, 1.0)])
        force = self._cameras[0].pose[:, :3] @ contact_load(self.membrane, state).sum(axis=0)
        return PressFacts(
            depth_m=depth_m,
            strain=true_strain(self.membrane, state.nodes, self._cameras[1]),
            residual=state.residual,
            T_proximity_object=rigid_transform(proximity_membrane @ np.linalg.inv(object_membrane)),
            force_n=(float(force[0]), float(force[1]), float(force[2])),
            inflation_pa=state.pressure_pa - ATMOSPHERE_PA,
        )

    def picture(self, pose: Float64Array, state: MembraneState) -> CleanState:
        mesh, kind = self.membrane.mesh, self.pressed.kind
        surface = self.membrane.surface(state.nodes)
        touching = contact_share(self.membrane, state, kind, pose)
        areas = render.node_areas(surface, mesh.triangles)
        sizes = np.linalg.norm(areas, axis=1)
        pressure = np.linalg.norm(contact_load(self.membrane, state), axis=1) / sizes
        values = np.column_stack([mesh.flat[:, :2], touching, areas / sizes[:, None], pressure])
        near, tactile, colour = self._cameras
        sheets = [render.rasterise(camera, surface, mesh.triangles, values) for camera in self._cameras]

        behind, cosine = np.empty_like(sheets[0].depth), np.empty(sheets[0].depth.shape, dtype=np.uint8)
        render.see_through(near.pose, near.pinhole, sheets[0].depth, kind, pose, np.array(_BACKDROP), behind, cosine)
        flags = np.empty_like(cosine)
        render.flag(behind, sheets[0].attributes, self._sheet, flags)
        return CleanState(
            behind=_counts(behind),
            membrane=_counts(sheets[0].depth),
            cosine=cosine,
            flags=flags,
            pressure=np.round(sheets[0].attributes[..., 6].clip(0, 65535)).astype(np.uint16),
            proximity_color=self._colour(colour, sheets[2], pose),
            tactile=_counts(sheets[1].depth),
            tactile_color=self._colour(tactile, sheets[1], pose),
        )

    def _colour(self, camera: Camera, sheet: Surface, pose: Float64Array) -> Uint8Array:
        image = np.empty((*sheet.depth.shape, 3), dtype=np.uint8)
        render.shade(
            camera.pose,
            camera.pinhole,
            sheet.depth,
            sheet.attributes,
            self.pressed.kind,
            pose,
            np.array(self.pressed.colour),
            self._sheet,
            self._gamma,
            image,
        )
        return image


def _counts(depth_m: Float32Array) -> Uint16Array:
    return np.round(depth_m.astype(np.float64) / render.CLEAN_UNIT_M).astype(np.uint16)


def _follow(
    membrane: Membrane,
    kind: int,
    pose: Float64Array,
    before: list[Float64Array],
    held: Float64Array | None,
    tolerance: float,
) -> MembraneState:
    """Solve the next step from an extrapolated guess, or from the last state where the extrapolation fails."""
    guesses: list[Float64Array | None] = [2 * before[-1] - before[-2]] if len(before) > 1 else []
    guesses.append(before[-1] if before else None)
    for guess in guesses:
        state = membrane.press(kind, pose, guess, held, tolerance)
        if state.residual < tolerance:
            break
    return state


# True strain between the dots of the printed grid: over all dots, and over completely visible ones


def true_strain(membrane: Membrane, nodes: Float64Array, camera: Camera) -> TrueStrain:
    """Return the strain for membrane nodes (N, 3), from dot to dot; 0 where no two neighbouring dots are seen whole."""
    design = membrane.design
    columns, rows = render.dot_counts(design.width_m, design.height_m)
    flat = render.dot_grid(design.width_m, design.height_m)
    dots = membrane.at(flat, membrane.surface(nodes)).reshape(rows, columns, 3)
    whole = (_dots_shown(membrane, nodes, camera) >= _WHOLE_SHARE).reshape(rows, columns)
    largest = []
    for axis in (1, 0):
        strain = np.linalg.norm(np.diff(dots, axis=axis), axis=2) / render.DOT_SPACING_M - 1.0
        both = np.take(whole, range(1, whole.shape[axis]), axis) & np.take(whole, range(whole.shape[axis] - 1), axis)
        largest.append((float(strain.max()), float(strain[both].max(initial=0.0))))
    (length, length_seen), (width, width_seen) = largest
    return TrueStrain(length, width, length_seen, width_seen)


def _dots_shown(membrane: Membrane, nodes: Float64Array, camera: Camera) -> Float64Array:
    """Return the share of each dot's disc that a camera sees, (M,): points of the disc beside the depth image."""
    design, mesh = membrane.design, membrane.mesh
    steps = (np.arange(_POINTS_ACROSS) + 0.5) / _POINTS_ACROSS * 2.0 - 1.0
    disc = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)
    disc = render.DOT_RADIUS_M * disc[np.hypot(*disc.T) <= 1.0]
    grid = render.dot_grid(design.width_m, design.height_m)
    surface = membrane.surface(nodes)
    depth_m = render.rasterise(camera, surface, mesh.triangles, np.zeros((len(nodes), 6))).depth
    points = membrane.at((grid[:, None] + disc).reshape(-1, 2), surface)
    points = points @ camera.pose[:, :3].T + camera.pose[:, 3]
    row, column, inside = nearest_pixels(points, camera.intrinsics)
    shown = inside & (points[:, 2] < depth_m[row, column] + _BEFORE_M)
    return np.asarray(shown.reshape(len(grid), len(disc)).mean(axis=1))
