"""The demo as one PyVista picture: the body in 3D on the left, images, gradient and loss on the right.

Everything is made once; ``PlottedScene.update`` changes numbers in place, which is what keeps a change fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from PIL import Image

from ..body.icosphere import icosphere
from ..body.template import NUM_PARTS, PARENTS, PART_NAMES
from ..results.palette import PART_COLOURS
from ..results.shading import SKIN_COLOUR
from .arrows import Arrows
from .overlay import Texture
from .plotted import PANEL, Box, Look, Plotted, controls_beside, halves, split
from .skin import ShownSkin
from .state import DemoState
from .style import ACCENT, INK, PAPER
from .targets import BACKGROUND_COLOUR, Photo

_IMAGE_SIDE = 256  # [px] of the images on the right, whatever is drawn
_SMOOTH_LEVELS = (2, 3)  # of the sphere that stands for an exact ellipsoid, where outlines are rough and smooth
_FRAME, _TARGET_BONES = "#b9bec6", "#8a8f98"
_FLIP = np.diag([1.0, -1.0, -1.0])  # camera frame (y down, z away) to VTK's view (y up, z toward the viewer)
_WALL = 0.9  # [m] behind the pelvis: where the target hangs
_FRONT = 0.4  # [m] before the pelvis: where the drawn part of what the camera sees ends
_MOST_ARROWS = 300  # along outlines
_CAMERA = ((2.3, 0.9, 5.9), (-0.05, 0.02, -0.3), (0.0, 1.0, 0.0))
_ANGLE, _NARROW = (
    30.0,
    0.85,
)  # [degrees] that it sees, and the least width of a view, of its height, in which all is seen
_BACK = 0.3  # of the distance that a camera goes back to see the body from aside
_AROUND = 1.15  # of the crop: what is shown of a photo
_FINE = 1200  # [px] of the photo's longer side, to which a smaller one is enlarged, for no sharp edge is blurred then
_LIT = {"specular_power": 12, "ambient": 0.25}
_MATT = {"specular": 0.0, "ambient": 0.3, "diffuse": 0.75}
_TITLES = {
    "body": "body",
    "target": "target",
    "difference": "difference",
    "gradient": "pull (orange: nearer, blue: farther)",
}
_COLUMN, _STRIP = 430, 120  # [px] of the controls
_SIDE_BY_SIDE = 520  # [px] that the chart and the table need beside each other
_SHARE = 0.56  # of the views' space that the body in 3D has
_PICTURES, _FEWER, _CHART = 0.65, 0.52, 0.36  # of the rest that pictures have, and of what is below them the chart


class PlottedScene(Plotted):
    """A plotter with everything in it."""

    def __init__(self, state: DemoState, *, off_screen: bool = True, smooth: bool = True) -> None:
        names = ["solid", *_TITLES, "loss", "table"]
        super().__init__(names, off_screen=off_screen, smooth=smooth)
        self._smooth_level = _SMOOTH_LEVELS[smooth]
        self.state = state
        self.skeleton_only = False  # through a pale body
        self.outline_arrows = False  # pull along the silhouettes instead of that at the centres
        self.chosen: str | None = None  # the part that stands out
        self.skin: ShownSkin | None = None  # the detailed body, while it is shown
        self.has_table = False  # whether there is something in the view of the table
        self._level: int | None = -1  # of the spheres that are shown
        self._photo: Photo | None = None  # that hangs on the wall
        self._add_body()
        self._images = {name: self._add_image(name, title) for name, title in _TITLES.items()}
        self._open("gradient")
        self._centre_arrows = Arrows(self.plotter, NUM_PARTS, longest=0.44, half_width=0.011)
        self._outline_arrows = Arrows(self.plotter, _MOST_ARROWS, longest=0.16, half_width=0.0035, strongest=0.95)
        self._measured: tuple[object, ...] = ()  # the start that arrows were measured at
        self._add_loss()
        self.look()
        self.arrange(self.look_now)
        self.update()

    def _add_body(self) -> None:
        """Ellipsoids, skin, skeleton, the camera's view volume, and the target on a wall behind."""
        pv = self._pv
        self._open("solid")
        self.parts = [
            self._add(pv.Sphere(), name=name, color=colour, specular=0.2, **_LIT)
            for name, colour in zip(PART_NAMES, PART_COLOURS[1:].tolist(), strict=True)
        ]
        self._skin = self._add(pv.Sphere(), name="skin", color=SKIN_COLOUR.tolist(), **_MATT)
        self._skin.prop.interpolation = "Gouraud"
        lines = [[2, parent + 1, k + 1] for k, parent in enumerate(PARENTS)]
        self._skeleton = pv.PolyData(np.zeros((NUM_PARTS + 1, 3)), lines=np.array(lines).ravel())
        self._target_skeleton = self._skeleton.copy()
        self._bones = self._add(self._skeleton, color=INK, line_width=4)
        self._target_bones = self._add(self._target_skeleton, color=_TARGET_BONES, line_width=3, opacity=0.8)
        # The weak-perspective camera sees a box without end; it is cut before and behind the body.
        frame = pv.Box(bounds=(-1, 1, -1, 1, -_WALL, _FRONT)).extract_all_edges()
        wall = pv.Plane(i_size=2, j_size=2, i_resolution=1, j_resolution=1)
        self._wall_image = Texture((_IMAGE_SIDE, _IMAGE_SIDE))
        self._frame = self._add(frame, color=_FRAME, line_width=1.5)
        # From behind, it would hide the body.
        self._wall = self._add(wall, texture=self._wall_image.texture, lighting=False, culling="back")

    def look(self) -> None:
        """See the body in 3D as at first: as the target's camera does or, if it isn't known, from a little aside."""
        camera = self.body_view.camera
        if self.state.lens is None:
            camera.position, camera.focal_point, camera.up = _CAMERA
        else:
            distance = float(self.state.placed.joints[0, 0, 2])
            camera.position, camera.focal_point, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, -distance), (0.0, 1.0, 0.0)
        self._fit_view()

    def _fit_view(self) -> None:
        """Let the camera see as much as it has to see in a view of such a shape."""
        camera, (width, height) = self.body_view.camera, self.body_view.GetSize()
        aspect = width / max(height, 1)
        if self.state.lens is None:
            camera.view_angle = _angle(math.tan(math.radians(_ANGLE / 2)) / min(aspect / _NARROW, 1.0))
            camera.SetWindowCenter(0.0, 0.0)
            return
        focal, *principal = self.state.lens
        low, high = _shown(self.state.target.photo)
        half = (high - low) / 2
        tall = max(half[1], half[0] / aspect)
        camera.view_angle = _angle(tall / focal)
        beside, below = (low + high) / 2 - principal
        camera.SetWindowCenter(beside / (tall * aspect), -below / tall)

    def smooth_edges(self, smooth: bool) -> None:
        """Smooth the body's edges in the picture (FXAA), which takes about as long as drawing it."""
        self.body_view.SetUseFXAA(smooth)

    @property
    def turned(self) -> float:
        """Angle about the vertical from which the body is seen: 0 from the front, 90 from its left [degrees]."""
        camera = self.body_view.camera
        away = np.subtract(camera.position, camera.focal_point)
        return math.degrees(math.atan2(away[0], away[2]))

    def turn(self, angle: float) -> None:
        """See the body from another side, as high and as far away as now; see ``turned``."""
        camera = self.body_view.camera
        x, y, z = np.subtract(camera.position, camera.focal_point)
        if self.state.lens is not None:  # it may have come nearer or gone away
            camera.focal_point = tuple(self.state.placed.joints[0, 0].numpy() @ _FLIP * (0, 0, 1))
            share = 1 + _BACK * min(abs(angle) / 45, 1.0)
            x, y, z = 0.0, y, share * float(self.state.placed.joints[0, 0, 2])
        far, radians = math.hypot(x, z), math.radians(angle)
        camera.position = tuple(camera.focal_point + np.array([far * math.sin(radians), y, far * math.cos(radians)]))

    @property
    def detailed(self) -> bool:
        """True while the detailed body is shown."""
        return self.skin is not None

    def _add_image(self, name: str, title: str) -> Texture:
        """A picture that fills a square of side 2 about the origin, and its title."""
        self._open(name)
        image = Texture((_IMAGE_SIDE, _IMAGE_SIDE))
        self._add(self._pv.Plane(i_size=2, j_size=2), texture=image.texture, lighting=False)
        self.plotter.enable_parallel_projection()
        self.plotter.camera_position = ((0, 0, 5), (0, 0, 0), (0, 1, 0))
        self._add_title(name, title)
        return image

    def _places(self, look: Look) -> Mapping[str, Box]:
        """The body alone on the first screen; else pictures beside it, and the chart and the table below these."""
        picture, panel = controls_beside(look, _COLUMN, _STRIP)
        if not look.more:
            return {"solid": picture, PANEL: panel}
        solid, rest = halves(picture, _SHARE)
        side_by_side = rest.width > _SIDE_BY_SIDE * look.zoom
        wide, tall = rest.width // 2, round((_PICTURES if side_by_side else _FEWER) * rest.height)
        places = {"solid": solid, PANEL: panel}
        for index, name in enumerate(_TITLES):
            row, column = divmod(index, 2)
            places[name] = Box(rest.left + column * wide, rest.top + row * (tall // 2), wide, tall // 2)
        below = Box(rest.left, rest.top + tall, rest.width, rest.height - tall)
        places["loss"], places["table"] = split(below, _CHART if self.has_table else 1.0, wide=side_by_side)
        return places

    def _arranged(self, boxes: Mapping[str, Box]) -> None:
        self._fit_view()
        for name in _TITLES:
            if (box := boxes.get(name)) is not None:
                # The title stands below the picture, in as much of the view as its letters take.
                title = min(20 * self.look_now.zoom / max(box.height, 1), 0.5)
                scale = max(1.0 / (1 - title), box.height / max(box.width, 1))
                camera = self.view(name).camera
                camera.parallel_scale = 1.02 * scale
                camera.position, camera.focal_point = (0, -title * scale, 5), (0, -title * scale, 0)
        if (box := boxes.get("loss")) is not None:
            letter = int(np.clip(box.width / 20, 7, 13 * self.look_now.zoom))
            for axis in (self.chart.x_axis, self.chart.y_axis):
                axis.label_size, axis.tick_label_size = letter, max(letter - 2, 7)

    def _add_loss(self) -> None:
        self._open("loss")
        self.chart = self._pv.Chart2D(size=(0.98, 0.95), loc=(0.0, 0.02))
        self.chart.background_color = self.chart.border_color = PAPER
        self.chart.x_label, self.chart.y_label = "iteration", "energy"
        for axis in (self.chart.x_axis, self.chart.y_axis):
            axis.grid = False
        self._curve = self.chart.line([0, 1], [0, 0], color=ACCENT, width=3.0)
        self.plotter.add_chart(self.chart)

    def update(self) -> None:
        """Bring everything to what the state is now; nothing is drawn yet."""
        self._update_body()
        pictures = self.state.pictures()
        for name, picture in pictures.items():
            self._images[name].show(picture)
        self._update_wall(pictures["target"])
        faint = BACKGROUND_COLOUR - (BACKGROUND_COLOUR - pictures["body"]) // 4  # no colour is brighter
        self._images["gradient"].show(faint)
        self._update_arrows()
        self._update_loss()
        self.body_view.ResetCameraClippingRange()

    def _update_wall(self, labels: np.ndarray) -> None:
        """Hang the photo or the target's labels behind the body, where the target's camera sees them."""
        state, photo = self.state, self.state.target.photo
        if photo is None:
            self._wall.texture, low, high = self._wall_image.texture, np.array([-1.0, -1.0]), np.array([1.0, 1.0])
            self._wall_image.show(labels)
        else:
            low, high = photo.low, photo.high
            if photo is not self._photo:
                texture = self._pv.Texture(_fine(photo.pixels))
                texture.interpolate = texture.mipmap = True
                self._wall.texture = texture
        if photo is not self._photo:
            self._photo = photo
            self.look()
        body, placed = state.body.detach(), state.placed
        if state.lens is None:
            distance = _WALL
            scale, principal = float(body.log_scale.exp()), body.shift[0].numpy()
        else:
            distance = float(placed.joints[0, 0, 2]) + _WALL
            scale, principal = state.lens[0] / distance, np.array(state.lens[1:])
        hung = np.diag([*((high - low) / 2 / scale), 1, 1])
        hung[:3, 3] = _FLIP @ [*(((low + high) / 2 - principal) / scale), distance]
        self._wall.user_matrix = hung
        box = np.diag([1 / scale, 1 / scale, 1, 1])
        box[:2, 3] = -principal[0] / scale, principal[1] / scale
        self._frame.user_matrix = box
        self._frame.visibility = state.lens is None

    def _update_body(self) -> None:
        state = self.state
        posed, truth = state.placed, state.target.posed
        if (level := state.settings.level) != self._level:
            vertices, faces = icosphere(self._smooth_level if level is None else level)
            shape = self._pv.PolyData.from_regular_faces(vertices, faces)
            if level is None:
                shape.point_data.active_normals = np.asarray(vertices, dtype=np.float32)
            for actor in self.parts:
                actor.mapper.dataset = shape
                actor.prop.interpolation = "Gouraud" if level is None else "Flat"
            self._level = level
        self._skin.visibility = self.skin is not None and not self.skeleton_only
        if self.skin is not None:
            self._update_skin(self.skin)
        matrices = np.tile(np.eye(4), (NUM_PARTS, 1, 1))
        matrices[:, :3, :3] = _FLIP @ (posed.axes * posed.semi_axes[:, :, None])[0].numpy()
        matrices[:, :3, 3] = posed.centres[0].numpy() @ _FLIP
        for actor, matrix, name in zip(self.parts, matrices, PART_NAMES, strict=True):
            actor.user_matrix = matrix
            actor.visibility = self.skin is None or self.skeleton_only
            actor.prop.opacity = 0.25 if self.skeleton_only else 1.0
            actor.prop.ambient = 0.6 if name == self.chosen else _LIT["ambient"]
        self._skeleton.points = posed.joints[0].numpy() @ _FLIP
        self._bones.visibility = self.skeleton_only
        self._target_bones.visibility = truth is not None and self.skeleton_only
        if truth is not None:
            self._target_skeleton.points = truth.joints[0].numpy() @ _FLIP

    def _update_skin(self, skin: ShownSkin) -> None:
        skin.follow(self.state.placed)
        shown, (vertices, normals) = self._skin.mapper.dataset, skin.surface()
        if shown.n_points != len(vertices):
            shown = self._pv.PolyData.from_regular_faces(vertices, skin.faces)
            shown.point_data.set_scalars(skin.colours, "colour")
            self._skin.mapper.dataset = shown
            self._skin.mapper.scalar_visibility, self._skin.mapper.color_mode = True, "direct"
        shown.points = vertices @ _FLIP.astype(np.float32)
        shown.point_data.active_normals = normals @ _FLIP.astype(np.float32)

    def _update_arrows(self) -> None:
        state, shown = self.state, self._outline_arrows if self.outline_arrows else self._centre_arrows
        points, forces = state.outline_forces() if self.outline_arrows else state.forces()
        begun = shown, state.start, state.target, state.settings
        if not state.history or self._measured[:1] != begun[:1]:  # they shrink from what they are at the start
            shown.measure(forces)
            self._measured = begun
        shown.show(state.in_crop(points), forces)
        for arrows in (self._centre_arrows, self._outline_arrows):
            arrows.actor.visibility = arrows is shown

    def _update_loss(self) -> None:
        # without a line, VTK hides the axes
        history = self.state.history if len(self.state.history) > 1 else [0.0, 0.0]
        self._curve.update(np.arange(len(history)), history)
        self.chart.x_range = [0, max(self.state.settings.steps, len(history))]
        self.chart.y_range = [0, 1.05 * max(history) or 1.0]

    def said(self) -> list[str]:
        """Lines about the settings, and about iterations, their time, part F1 and the joints' distance."""
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
        return [f"{looks} · {settings.drawn}, {settings.size} px", " · ".join(measures)]


def _angle(half: float) -> float:
    """Angle of view [degrees] in which half the height is seen at a distance of 1."""
    return 2 * math.degrees(math.atan(half))


def _shown(photo: Photo | None) -> tuple[np.ndarray, np.ndarray]:
    """Upper left and lower right corner of what is shown of a photo: the person and a little around, in the crop."""
    low, high = np.full(2, -_AROUND), np.full(2, _AROUND)
    if photo is not None:
        low, high = np.maximum(low, photo.low), np.minimum(high, photo.high)
        low[1], high[1] = min(low[1], -1.0), max(high[1], 1.0)  # nobody's feet are cut off
    return low, high


def _fine(pixels: np.ndarray) -> np.ndarray:
    """A photo whose longer side has some pixels, so that edges of a small one stay sharp on the screen."""
    side = max(pixels.shape[:2])
    if side >= _FINE:
        return pixels
    height, width = round(pixels.shape[0] * _FINE / side), round(pixels.shape[1] * _FINE / side)
    return np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.LANCZOS))
