"""The demo as one PyVista picture: the body in 3D on the left, images, gradient and loss on the right.

Everything is made once; ``Scene.update`` changes numbers in place, which is what keeps a change fast.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from ..body.icosphere import icosphere
from ..body.template import NUM_PARTS, PARENTS, PART_NAMES
from ..errors import InputError
from ..palette import PART_COLOURS
from .state import DemoState

if TYPE_CHECKING:
    import pyvista as pv

WINDOW = (1280, 800)  # [px]
_IMAGE_SIDE = 256  # [px] of the images on the right, whatever is drawn
_SMOOTH_LEVEL = 3  # of the sphere that stands for an exact ellipsoid
_PAPER, _INK, _FAINT = "#fafafa", "#22262b", "#b9bec6"
_FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame (y down, z away) to VTK's view (y up, z toward the viewer)
_WALL = 0.9  # [m] behind the pelvis: where the target hangs
_FRONT = 0.4  # [m] before the pelvis: where the drawn part of what the camera sees ends
_WIDEST = 64  # letters of a message's line
_ARROW = 0.22  # of the image's side: the longest arrow
_CAMERA = ((2.3, 0.9, 5.9), (-0.05, 0.02, -0.3), (0.0, 1.0, 0.0))
_AWAY, _ACROSS, _TOWARD = (np.array(rgb) for rgb in ((0, 90, 181), (60, 60, 60), (220, 80, 20)))  # of arrows, by z
_TITLES = {
    "body": ((0, 2), "body"),
    "target": ((0, 3), "target"),
    "difference": ((1, 2), "difference"),
    "gradient": ((1, 3), "pull (orange: nearer, blue: farther)"),
}


class Scene:
    """A plotter with everything in it.

    Args:
        state: What is shown; ``update`` looks at it again.
        off_screen: Draw without a window.
        window_size: (width, height) [px].
        smooth: Smooth outlines (multisampling); without a GPU, a picture takes four times as long.

    Attributes:
        plotter: PyVista's plotter, to add to or to take pictures with.
        message: A line below the status, such as an error; ``update`` shows it.

    Raises:
        InputError: If VTK can't draw here.
    """

    def __init__(
        self,
        state: DemoState,
        *,
        off_screen: bool = True,
        window_size: tuple[int, int] = WINDOW,
        smooth: bool = True,
    ) -> None:
        try:
            import pyvista as pv
            from vtkmodules.vtkCommonCore import vtkLogger

            vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # it tells of each display that it tries in vain
            self._pv: Any = pv  # Any, for the types of PyVista's wrapped methods forget what they wrap
            self.plotter = self._pv.Plotter(
                shape=(3, 4),
                groups=[(slice(0, 3), slice(0, 2)), (2, slice(2, 4))],
                row_weights=[1.0, 1.0, 0.62],
                off_screen=off_screen,
                window_size=list(window_size),
                border=False,
            )
        except (ImportError, RuntimeError, OSError) as error:  # a VTK without libGL, or without a display to open
            raise no_picture(error) from error
        self.plotter.render_window.SetMultiSamples(8 if smooth else 0)
        self.state = state
        self.message = ""
        self.skeleton_only = False
        self._level: int | None = -1  # of the spheres that are shown
        self.plotter.set_background(_PAPER)
        self._add_body()
        self._images = {name: self._add_image(*place) for name, place in _TITLES.items()}
        self._add_arrows()
        self._add_loss()
        self.update()

    def _add_body(self) -> None:
        """Ellipsoids, skeleton, the camera's view volume, and the target on a wall behind."""
        pv, plotter = self._pv, self.plotter
        plotter.subplot(0, 0)
        self.parts = [
            plotter.add_mesh(
                pv.Sphere(),
                color=PART_COLOURS[k + 1].tolist(),
                specular=0.2,
                specular_power=12,
                ambient=0.25,
                name=name,
                render=False,
            )
            for k, name in enumerate(PART_NAMES)
        ]
        joints = np.zeros((NUM_PARTS + 1, 3))
        lines = [[2, PARENTS[k] + 1, k + 1] for k in range(NUM_PARTS)]
        self._skeleton = pv.PolyData(joints, lines=np.array(lines).ravel())
        self._target_skeleton = self._skeleton.copy()
        self._bones = plotter.add_mesh(self._skeleton, color=_INK, line_width=4, render=False)
        self._target_bones = plotter.add_mesh(
            self._target_skeleton, color="#8a8f98", line_width=3, opacity=0.8, render=False
        )
        self._frame = pv.PolyData(np.zeros((8, 3)), lines=np.array(_BOX).ravel())
        plotter.add_mesh(self._frame, color=_FAINT, line_width=1.5, render=False)
        self._wall = pv.Plane(i_resolution=1, j_resolution=1)
        self._wall_image, texture = self._make_texture()
        plotter.add_mesh(self._wall, texture=texture, lighting=False, render=False)
        self._status = plotter.add_text(
            "", position=(0.025, 0.985), viewport=True, font_size=9, color=_INK, font="arial"
        )
        self._status.prop.SetVerticalJustificationToTop()
        plotter.camera_position = _CAMERA
        plotter.camera.view_angle = 30

    def _make_texture(self) -> tuple[pv.ImageData, pv.Texture]:
        pv = self._pv
        image = pv.ImageData(dimensions=(_IMAGE_SIDE, _IMAGE_SIDE, 1))
        image.point_data["rgb"] = np.full((_IMAGE_SIDE**2, 3), 255, dtype=np.uint8)
        image.set_active_scalars("rgb")
        return image, pv.Texture(image)

    def _add_image(self, place: tuple[int, int], title: str) -> pv.ImageData:
        """A picture that fills a square of side 2 about the origin, and its title."""
        self.plotter.subplot(*place)
        image, texture = self._make_texture()
        self.plotter.add_mesh(self._pv.Plane(i_size=2, j_size=2), texture=texture, lighting=False, render=False)
        self.plotter.add_text(title, position=(10, 4), font_size=8, color=_INK, font="arial")
        self.plotter.enable_parallel_projection()
        self.plotter.camera_position = ((0, 0, 5), (0, 0, 0), (0, 1, 0))
        self.plotter.camera.parallel_scale = 1.02
        return image

    def _add_arrows(self) -> None:
        """One arrow an ellipsoid over the last image: along x and y, coloured by z."""
        self.plotter.subplot(*_TITLES["gradient"][0])
        # two triangles a shaft and one a head, flat, as wide as they look at any length
        self._arrows = self._pv.PolyData(
            np.zeros((7 * NUM_PARTS, 3)),
            faces=np.array(
                [[3, *(7 * k + corner for corner in corners)] for k in range(NUM_PARTS) for corners in _ARROW_FACES]
            ).ravel(),
        )
        self._arrows.cell_data["rgb"] = np.zeros((len(_ARROW_FACES) * NUM_PARTS, 3), dtype=np.uint8)
        self.plotter.add_mesh(self._arrows, scalars="rgb", rgb=True, lighting=False, render=False)

    def _add_loss(self) -> None:
        self.plotter.subplot(2, 2)
        chart = self._pv.Chart2D(size=(0.98, 0.95), loc=(0.0, 0.02))
        chart.background_color = chart.border_color = _PAPER
        chart.x_axis.label, chart.y_axis.label = "iteration", "energy"
        for axis in (chart.x_axis, chart.y_axis):
            axis.label_size, axis.tick_label_size, axis.grid = 13, 11, False
        self._curve = chart.line([0, 1], [0, 0], color="#14468c", width=3.0)
        self.plotter.add_chart(chart)
        self._chart = chart

    def update(self) -> None:
        """Bring everything to what the state is now; nothing is drawn yet."""
        self._update_body()
        pictures = self.state.pictures()
        photo = self.state.target.photo
        for name, picture in pictures.items():
            _fill(self._images[name], picture)
        _fill(self._wall_image, pictures["target"] if photo is None else photo)
        faint = 250 - (250 - pictures["body"].astype(int)) // 4
        _fill(self._images["gradient"], faint.astype(np.uint8))
        self._update_arrows()
        self._update_loss()
        self._status.input = self._said()

    def _update_body(self) -> None:
        state = self.state
        body, posed, truth = state.body.detach(), state.posed(), state.target.posed
        if (level := state.settings.level) != self._level:
            vertices, faces = icosphere(_SMOOTH_LEVEL if level is None else level)
            shape = self._pv.PolyData.from_regular_faces(vertices, faces)
            if level is None:
                shape.point_data.active_normals = np.asarray(vertices, dtype=np.float32)
            for actor in self.parts:
                actor.mapper.dataset = shape
                actor.prop.interpolation = "Gouraud" if level is None else "Flat"
            self._level = level
        matrices = np.tile(np.eye(4), (NUM_PARTS, 1, 1))
        matrices[:, :3, :3] = _FLIP @ (posed.axes * posed.semi_axes[:, :, None])[0].numpy()
        matrices[:, :3, 3] = posed.centres[0].numpy() @ _FLIP
        for actor, matrix in zip(self.parts, matrices, strict=True):
            actor.user_matrix = matrix
            actor.prop.opacity = 0.25 if self.skeleton_only else 1.0
        self._skeleton.points = posed.joints[0].numpy() @ _FLIP
        self._target_bones.visibility = truth is not None and self.skeleton_only
        self._bones.visibility = self.skeleton_only
        if truth is not None:
            self._target_skeleton.points = truth.joints[0].numpy() @ _FLIP
        # The weak-perspective camera sees a box without end; it is cut before and behind the body.
        scale, (shift_x, shift_y) = float(body.log_scale.exp()), body.shift[0].tolist()
        square = (np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) - (shift_x, shift_y)) / scale
        box = np.array([(x, -y, z) for z in (_FRONT, -_WALL) for x, y in square])
        self._frame.points = box
        self._wall.points = box[[7, 6, 4, 5]]

    def _update_arrows(self) -> None:
        """The pull in pixels of the crop; the largest has a fixed length, so that small ones at the end are seen."""
        state = self.state
        centres, forces = state.forces()
        body = state.body.detach()
        places = (centres[:, :2] * float(body.log_scale.exp()) + body.shift[0].numpy()) * [1, -1]
        strongest = max(float(np.linalg.norm(forces, axis=1).max()), 1e-12)
        along = forces[:, :2] * [1, -1] * (2 * _ARROW / strongest)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        direction = along / np.maximum(length, 1e-9)
        side = direction[:, ::-1] * [-1, 1]
        half, head = 0.011, np.minimum(0.06, 0.6 * length)
        wing = np.minimum(0.035, 0.6 * length)
        neck, thin = places + direction * (length - head), np.minimum(half, wing)
        corners = np.stack(
            [
                places + side * thin, places - side * thin, neck - side * thin, neck + side * thin,
                neck - side * wing, places + along, neck + side * wing,
            ],
            axis=1,
        )  # fmt: skip
        points = np.zeros((NUM_PARTS, 7, 3))
        points[..., :2], points[..., 2] = corners, 0.01
        self._arrows.points = points.reshape(-1, 3)
        share = forces[:, 2:] / max(float(np.abs(forces[:, 2]).max()), 1e-12)
        colours = np.where(share > 0, _AWAY, _TOWARD) * np.abs(share) + _ACROSS * (1 - np.abs(share))
        np.asarray(self._arrows.cell_data["rgb"])[:] = np.repeat(colours, len(_ARROW_FACES), axis=0)
        self._arrows.cell_data.GetScalars().Modified()

    def _update_loss(self) -> None:
        history = (
            self.state.history if len(self.state.history) > 1 else [0.0, 0.0]
        )  # without a line, VTK hides the axes
        self._curve.update(np.arange(len(history)), history)
        self._chart.x_range = [0, max(self.state.settings.steps, len(history))]
        self._chart.y_range = [0, 1.05 * max(history) or 1.0]

    def _said(self) -> str:
        """What the state is, in words."""
        state, settings = self.state, self.state.settings
        looks = {"parts": "keypoints + parts", "silhouette": "keypoints + silhouette"}.get(
            settings.supervision, "keypoints"
        )
        depth = ("with" if settings.depth_gradient else "without") + " z gradient"
        drawn = f"exact, {settings.gradient}" if settings.level is None else f"mesh {settings.renderer}"
        measures = [f"iteration {len(state.history)}"]
        if (took := state.milliseconds()) is not None:
            measures.append(f"{took:.1f} ms each")
        if (score := state.part_f1()) is not None:
            measures.append(f"part F1 {score:.3f}")
        if (error := state.joint_error()) is not None:
            measures.append(f"joints {error:.0f} mm off")
        lines = [
            f"{looks}, {depth}   ·   {drawn}, {settings.size} px",
            "   ·   ".join(measures),
            textwrap.fill(self.message, _WIDEST),
        ]
        return "\n".join(lines)

    def screenshot(self) -> np.ndarray:
        """The picture as it is now, RGB, shape (height, width, 3), uint8."""
        self.plotter.render()
        return np.asarray(self.plotter.screenshot(return_img=True))

    def close(self) -> None:
        """Give the window and VTK's memory back."""
        self.plotter.close()


def no_picture(error: Exception) -> InputError:
    """What is missing where VTK can't draw."""
    reason = " ".join(str(error).split())[:120]
    return InputError(
        f"demo: VTK can't draw here ({reason}); expected OpenGL (libgl1 or libosmesa6) and, for a window, a display; "
        "partdr fit needs neither"
    )


_BOX = [[2, *edge] for k in range(4) for edge in ((k, (k + 1) % 4), (4 + k, 4 + (k + 1) % 4), (k, k + 4))]
_ARROW_FACES = ((0, 1, 2), (0, 2, 3), (4, 5, 6))


def _fill(image: pv.ImageData, picture: np.ndarray) -> None:
    """Copy a square RGB picture of any size into a texture's image, whose rows go up."""
    rows = ((np.arange(_IMAGE_SIDE) + 0.5) * (len(picture) / _IMAGE_SIDE)).astype(int)
    np.asarray(image.point_data["rgb"])[:] = picture[rows[::-1, None], rows].reshape(-1, 3)
    image.GetPointData().GetScalars().Modified()
    image.Modified()
