"""The demo as one PyVista picture: the body in 3D on the left, images, gradient and loss on the right.

Everything is made once; ``PlottedScene.update`` changes numbers in place, which is what keeps a change fast.
"""

from __future__ import annotations

import textwrap

import numpy as np
import torch

from ..body.icosphere import icosphere
from ..body.posing import Posed
from ..body.template import NUM_PARTS, PARENTS, PART_NAMES
from ..results.palette import PART_COLOURS
from .arrows import Arrows
from .overlay import Texture
from .plotted import Plotted
from .state import DemoState
from .style import ACCENT, INK, PAPER
from .targets import BACKGROUND_COLOUR

_IMAGE_SIDE = 256  # [px] of the images on the right, whatever is drawn
_SMOOTH_LEVELS = (2, 3)  # of the sphere that stands for an exact ellipsoid, where outlines are rough and smooth
_FRAME, _TARGET_BONES = "#b9bec6", "#8a8f98"
_FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame (y down, z away) to VTK's view (y up, z toward the viewer)
_WALL = 0.9  # [m] behind the pelvis: where the target hangs
_FRONT = 0.4  # [m] before the pelvis: where the drawn part of what the camera sees ends
_WIDEST = 72  # letters of a message's line
_MOST_ARROWS = 300  # along outlines
_CAMERA = ((2.3, 0.9, 5.9), (-0.05, 0.02, -0.3), (0.0, 1.0, 0.0))
_SKIN = {"specular_power": 12, "ambient": 0.25}
_TITLES = {
    "body": ((0, 2), "body"),
    "target": ((0, 3), "target"),
    "difference": ((1, 2), "difference"),
    "gradient": ((1, 3), "pull (orange: nearer, blue: farther)"),
}


class PlottedScene(Plotted):
    """A plotter with everything in it."""

    def __init__(self, state: DemoState, *, off_screen: bool = True, smooth: bool = True) -> None:
        groups = [(slice(0, 3), slice(0, 2)), (2, slice(2, 4))]
        super().__init__(
            off_screen=off_screen, smooth=smooth, shape=(3, 4), groups=groups, row_weights=[1.0, 1.0, 0.62]
        )
        self._smooth_level = _SMOOTH_LEVELS[smooth]
        self.state = state
        self.skeleton_only = False  # through a pale body
        self.outline_arrows = False  # pull along the silhouettes instead of that at the centres
        self.chosen: str | None = None  # the part that stands out
        self._clothed: Posed | None = None  # the body that the detailed one was made for
        self._level: int | None = -1  # of the spheres that are shown
        self._add_body()
        self._images = {name: self._add_image(*place) for name, place in _TITLES.items()}
        self.plotter.subplot(*_TITLES["gradient"][0])
        self._centre_arrows = Arrows(self.plotter, NUM_PARTS, longest=0.44, half_width=0.011)
        self._outline_arrows = Arrows(self.plotter, _MOST_ARROWS, longest=0.16, half_width=0.0035, strongest=0.95)
        self._add_loss()
        self.update()

    def _add_body(self) -> None:
        """Ellipsoids, skeleton, the camera's view volume, and the target on a wall behind."""
        pv = self._pv
        self.plotter.subplot(0, 0)
        self.parts = [
            self._add(pv.Sphere(), name=name, color=colour, specular=0.2, **_SKIN)
            for name, colour in zip(PART_NAMES, PART_COLOURS[1:].tolist(), strict=True)
        ]
        self._skin = self._add(pv.Sphere(), name="skin", specular=0.1, **_SKIN)
        lines = [[2, parent + 1, k + 1] for k, parent in enumerate(PARENTS)]
        self._skeleton = pv.PolyData(np.zeros((NUM_PARTS + 1, 3)), lines=np.array(lines).ravel())
        self._target_skeleton = self._skeleton.copy()
        self._bones = self._add(self._skeleton, color=INK, line_width=4)
        self._target_bones = self._add(self._target_skeleton, color=_TARGET_BONES, line_width=3, opacity=0.8)
        # The weak-perspective camera sees a box without end; it is cut before and behind the body.
        frame = pv.Box(bounds=(-1, 1, -1, 1, -_WALL, _FRONT)).extract_all_edges()
        wall = pv.Plane(center=(0, 0, -_WALL), i_size=2, j_size=2, i_resolution=1, j_resolution=1)
        self._wall_image = Texture((_IMAGE_SIDE, _IMAGE_SIDE))
        self._camera_box = (
            self._add(frame, color=_FRAME, line_width=1.5),
            self._add(wall, texture=self._wall_image.texture, lighting=False),
        )
        self._status = self._add_status()
        self.look()

    def look(self) -> None:
        """See the body in 3D as at first."""
        self.plotter.subplot(0, 0)
        self.plotter.camera_position = _CAMERA
        self.plotter.camera.view_angle = 30

    @property
    def detailed(self) -> bool:
        """True while the detailed body is shown. It belongs to one body, and is gone when another takes its place."""
        now = self.state.posed
        return self._clothed is not None and all(
            torch.equal(old, new) for old, new in zip(vars(self._clothed).values(), vars(now).values(), strict=True)
        )

    def wear(self, vertices: np.ndarray, faces: np.ndarray, parts: np.ndarray) -> None:
        """Show vertices (V, 3) [m] and faces (F, 3) with labels (F,) instead of the ellipsoids of now."""
        skin = self._pv.PolyData.from_regular_faces(vertices @ _FLIP, faces)
        skin.cell_data["rgb"] = PART_COLOURS[parts]
        mapper = self._skin.mapper
        mapper.dataset = skin.compute_normals(cell_normals=False, split_vertices=False)
        mapper.scalar_map_mode, mapper.array_name = "cell", "rgb"
        mapper.SetColorModeToDirectScalars()
        mapper.scalar_visibility = True
        self._clothed = self.state.posed

    def undress(self) -> None:
        """Show the ellipsoids again."""
        self._clothed = None

    def _add_image(self, place: tuple[int, int], title: str) -> Texture:
        """A picture that fills a square of side 2 about the origin, and its title."""
        self.plotter.subplot(*place)
        image = Texture((_IMAGE_SIDE, _IMAGE_SIDE))
        self._add(self._pv.Plane(i_size=2, j_size=2), texture=image.texture, lighting=False)
        self.plotter.add_text(title, position=(10, 4), font_size=8, color=INK, font="arial")
        self.plotter.enable_parallel_projection()
        self.plotter.camera_position = ((0, 0, 5), (0, 0, 0), (0, 1, 0))
        self.plotter.camera.parallel_scale = 1.02
        return image

    def _add_loss(self) -> None:
        self.plotter.subplot(2, 2)
        self.chart = self._pv.Chart2D(size=(0.98, 0.95), loc=(0.0, 0.02))
        self.chart.background_color = self.chart.border_color = PAPER
        self.chart.x_label, self.chart.y_label = "iteration", "energy"
        for axis in (self.chart.x_axis, self.chart.y_axis):
            axis.label_size, axis.tick_label_size, axis.grid = 13, 11, False
        self._curve = self.chart.line([0, 1], [0, 0], color=ACCENT, width=3.0)
        self.plotter.add_chart(self.chart)

    def update(self) -> None:
        """Bring everything to what the state is now; nothing is drawn yet."""
        self._update_body()
        pictures, photo = self.state.pictures(), self.state.target.photo
        for name, picture in pictures.items():
            self._images[name].show(picture)
        self._wall_image.show(pictures["target"] if photo is None else photo)
        faint = BACKGROUND_COLOUR - (BACKGROUND_COLOUR - pictures["body"]) // 4  # no colour is brighter
        self._images["gradient"].show(faint)
        self._update_arrows()
        self._update_loss()
        self._status.input = self._said()

    def _update_body(self) -> None:
        state = self.state
        body, posed, truth = state.body.detach(), state.posed, state.target.posed
        if (level := state.settings.level) != self._level:
            vertices, faces = icosphere(self._smooth_level if level is None else level)
            shape = self._pv.PolyData.from_regular_faces(vertices, faces)
            if level is None:
                shape.point_data.active_normals = np.asarray(vertices, dtype=np.float32)
            for actor in self.parts:
                actor.mapper.dataset = shape
                actor.prop.interpolation = "Gouraud" if level is None else "Flat"
            self._level = level
        if not (detailed := self.detailed):
            self.undress()
        self._skin.visibility = detailed
        matrices = np.tile(np.eye(4), (NUM_PARTS, 1, 1))
        matrices[:, :3, :3] = _FLIP @ (posed.axes * posed.semi_axes[:, :, None])[0].numpy()
        matrices[:, :3, 3] = posed.centres[0].numpy() @ _FLIP
        for actor, matrix, name in zip(self.parts, matrices, PART_NAMES, strict=True):
            actor.user_matrix = matrix
            actor.visibility = not detailed
            actor.prop.opacity = 0.25 if self.skeleton_only else 1.0
            actor.prop.ambient = 0.6 if name == self.chosen else _SKIN["ambient"]
        self._skeleton.points = posed.joints[0].numpy() @ _FLIP
        self._bones.visibility = self.skeleton_only
        self._target_bones.visibility = truth is not None and self.skeleton_only
        if truth is not None:
            self._target_skeleton.points = truth.joints[0].numpy() @ _FLIP
        scale, (shift_x, shift_y) = float(body.log_scale.exp()), body.shift[0].tolist()
        box = np.diag([1 / scale, 1 / scale, 1, 1])
        box[:2, 3] = -shift_x / scale, shift_y / scale
        for actor in self._camera_box:
            actor.user_matrix = box

    def _update_arrows(self) -> None:
        state, shown = self.state, self._outline_arrows if self.outline_arrows else self._centre_arrows
        points, forces = state.outline_forces() if self.outline_arrows else state.forces()
        body = state.body.detach()
        shown.show(points[:, :2] * float(body.log_scale.exp()) + body.shift[0].numpy(), forces)
        for arrows in (self._centre_arrows, self._outline_arrows):
            arrows.actor.visibility = arrows is shown

    def _update_loss(self) -> None:
        # without a line, VTK hides the axes
        history = self.state.history if len(self.state.history) > 1 else [0.0, 0.0]
        self._curve.update(np.arange(len(history)), history)
        self.chart.x_range = [0, max(self.state.settings.steps, len(history))]
        self.chart.y_range = [0, 1.05 * max(history) or 1.0]

    def _said(self) -> str:
        """Description of the state."""
        state, settings = self.state, self.state.settings
        looks = "keypoints" if settings.supervision == "keypoints" else f"keypoints + {settings.supervision}"
        if settings.offers_depth:
            looks += f", {'with' if settings.has_depth else 'without'} z gradient"
        measures = [f"iteration {len(state.history)}"]
        for style, value in (
            ("{:.1f} ms each", state.milliseconds()),
            ("part F1 {:.3f}", state.part_f1),
            ("joints {:.0f} mm off", state.joint_error()),
        ):
            if value is not None:
                measures.append(style.format(value))
        drawn = f"{looks}   ·   {settings.drawn}, {settings.size} px"
        return "\n".join([drawn, "   ·   ".join(measures), textwrap.fill(self.message, _WIDEST)])
