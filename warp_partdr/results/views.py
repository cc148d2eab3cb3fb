"""Sheet of views of a picture's people: over the photo, from the front, from the side and from above, with the camera.

All views but the photo are without perspective, so that lengths can be compared. The squares on the ground are 1 m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..cameras import Camera, Perspective, WeakPerspective, zoomed
from ..inputs.keypoints import Keypoints2D
from ..models.registration import Registered
from ..render.mesh import draw_mesh
from ..solve.scene.ground import ankle_confidence
from .overlays import GRAY, gray_picture, surface_over
from .palette import PALE_PEOPLE_COLOURS
from .placements import Placement, camera_offset, with_usual_lens
from .shading import SKIN_COLOUR, BodySurface

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

VIEWS = "views.png"
_HEIGHT, _WIDTHS = 560, (420, 900)  # [px], height of a view, and least and greatest width
_SMALL = 12  # [px], size of small letters
_SMOOTH = 2  # factor by which lines and letters are drawn larger, for smooth edges
_GAP, _TITLE = 12, 34  # [px], gap between views, and height of the line of titles
_BACK, _FLOOR, _LINE, _INK = (250, 250, 251), (236, 238, 241), (206, 211, 217), (52, 60, 70)
_SHADOW = (120, 126, 134)
_SIGHT, _GLASS = (188, 200, 214), (214, 226, 240)
_MARGIN = 0.06  # margin around what a view shows, as a share of it
_TILT = 0.16  # [rad], by which front and side look down, so that the ground is seen
_AROUND = 0.5  # [m], ground around people and camera
_FRUSTUM = 0.45  # [m], length of the camera's frustum, or less if somebody is near
_SMALLEST, _SMALLEST_ABOVE = 95.0, 60.0  # [px/m], scales below which the camera is left out and its distance written
_FEET = 0.5  # confidence of the ankles from which on feet count as seen

# Rotations from the camera's axes (x right, y down, z away) to a view's.
_FRONT = np.eye(3)
_SIDE = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # the camera is at the left
_ABOVE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # the camera is below


@dataclass(frozen=True)
class PlacedBody:
    """Body of a picture, and where it stands before the camera.

    Attributes:
        name: Name of the person.
        body: Detailed body in the frame of ``camera``, the first of its batch.
        camera: Camera of the picture.
        placement: Position of the body in the scene.
        feet: True if the picture shows the feet, so that they tell where the ground is.
        lens_assumed: True if the camera is not known, so that distances are for an assumed lens.
        surface: BodySurface of the body in the frame of ``camera``, which is drawn.
    """

    name: str
    body: Registered
    camera: Camera
    placement: Placement
    feet: bool
    lens_assumed: bool
    surface: BodySurface

    def turned_surface(self, rotation: np.ndarray) -> BodySurface:
        """Surface in the scene, turned by a rotation (3, 3) from the camera's axes to a view's."""
        return self.surface.moved(rotation, self.placement.offset, self.placement.scale)

    def vertices(self) -> np.ndarray:
        """Vertices in the scene, whose origin is the camera [m], shape (V, 3)."""
        return self.placement.apply(self.body.detailed.vertices[0].detach().cpu().double().numpy())


def feet_seen(keypoints: Keypoints2D) -> bool:
    """True if a picture shows a person's ankles, so that the body tells where the ground is."""
    return ankle_confidence(keypoints) >= _FEET


def place_alone(
    body: Registered,
    camera: Camera,
    size: tuple[int, int],
    keypoints: Keypoints2D,
    *,
    lens_assumed: bool,
    bare: bool = False,
) -> PlacedBody:
    """Place the first body of a batch before the camera of its picture.

    Args:
        body: Bodies in the frame of the camera.
        camera: Camera of the picture.
        size: Size (H, W) of the picture [px].
        keypoints: Keypoints of the person, which tell if the feet are seen.
        lens_assumed: True if the camera is not known.
        bare: True draws the skin alone. By default the body wears a plain T-shirt and shorts.
    """
    offset = camera_offset(camera, size)
    distance = float(body.detailed.joints[0, 0, 2]) + float(offset[2])
    placement = Placement(offset, 1.0, distance)
    surface = BodySurface.of_body(body.detailed.vertices, body.model, bare=bare)
    return PlacedBody("person", body, camera, placement, feet_seen(keypoints), lens_assumed, surface)


def draw_views(bodies: Sequence[PlacedBody], size: tuple[int, int], photo: np.ndarray | None = None) -> Image:
    """Draw the people of one picture over it, from the front, from the side and from above, in one sheet.

    Several people have a colour each, which is the same in all views.

    Args:
        bodies: Bodies of the people, at least one.
        size: Size (H, W) of the picture [px].
        photo: Picture, RGB, shape (H, W, 3), uint8, which may have been scaled to the size of overlays; None: gray.
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    scene = _Scene.of(bodies, size)
    views = [
        ("photo", _over_photo(scene, bodies, size, photo)),
        ("front", scene.draw(_FRONT, _TILT)),
        ("side (camera at the left)", scene.draw(_SIDE, _TILT)),
        ("from above (camera below)", scene.draw(_ABOVE, 0.0)),
    ]
    rows = [views[:2], views[2:]]
    width = max(sum(view.width + _GAP for _, view in row) + _GAP for row in rows)
    sheet = PilImage.new("RGB", (width, 2 * (_HEIGHT + _TITLE) + _TITLE), "white")
    draw, font, small = ImageDraw.Draw(sheet), ImageFont.load_default(18), ImageFont.load_default(15)
    for number, row in enumerate(rows):
        top = number * (_HEIGHT + _TITLE)
        left = (width - sum(view.width + _GAP for _, view in row) + _GAP) // 2
        for title, view in row:
            draw.text((left + 2, top + _TITLE / 2), title, _INK, font, anchor="lm")
            sheet.paste(view, (left, top + _TITLE))
            left += view.width + _GAP
    draw.text((width / 2, sheet.height - _TITLE / 2), scene.note(), _INK, small, anchor="mm")
    return sheet


def _over_photo(scene: _Scene, bodies: Sequence[PlacedBody], size: tuple[int, int], photo: np.ndarray | None) -> Image:
    """Draw the bodies over the photo, at the height of the views unless it is very wide."""
    from PIL import Image as PilImage

    zoom = min(_HEIGHT / size[0], _WIDTHS[1] / size[1])
    height, width = max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1)
    picture = gray_picture((height, width))
    if photo is not None:
        picture = np.asarray(PilImage.fromarray(photo).resize((width, height), PilImage.Resampling.LANCZOS))
    for index in scene.order(_FRONT):
        camera = zoomed(bodies[index].camera, zoom, (height, width))
        picture = surface_over(picture, bodies[index].surface, camera, scene.colours[index])
    view = PilImage.new("RGB", (max(width, _WIDTHS[0] // 2), _HEIGHT), GRAY)
    view.paste(PilImage.fromarray(picture), ((view.width - width) // 2, (_HEIGHT - height) // 2))
    return view


@dataclass(frozen=True)
class _Scene:
    """Bodies in the frame of the camera.

    Attributes:
        bodies: The bodies.
        points: Vertices of each body [m], shape (V, 3).
        colours: Colour of each body, RGB, shape (3,), uint8.
        ground: Height of the ground, y down [m]; NaN if no feet are seen.
        corners: Corners of the picture at the distance of 1 m before the camera, clockwise, shape (4, 3).
    """

    bodies: Sequence[PlacedBody]
    points: list[np.ndarray]
    colours: list[np.ndarray]
    ground: float
    corners: np.ndarray

    @classmethod
    def of(cls, bodies: Sequence[PlacedBody], size: tuple[int, int]) -> _Scene:
        """Place the bodies before the camera of a picture of (H, W) pixels."""
        points = [each.vertices() for each in bodies]
        feet = [float(vertices[:, 1].max()) for each, vertices in zip(bodies, points, strict=True) if each.feet]
        pale = PALE_PEOPLE_COLOURS
        colours = [SKIN_COLOUR if len(bodies) == 1 else pale[index % len(pale)] for index in range(len(bodies))]
        camera = bodies[0].camera
        if not isinstance(camera, Perspective):
            camera, _ = with_usual_lens(camera, size)
        focal_x, focal_y, *centre = camera.intrinsics[0].tolist()
        height, width = size
        edges = np.array([(0, 0), (width, 0), (width, height), (0, height)]) - centre
        corners = np.column_stack([edges / (focal_x, focal_y), np.ones(4)])
        return cls(bodies, points, colours, max(feet, default=math.nan), corners)

    def note(self) -> str:
        """Line that explains the sheet."""
        lens = " Distances are for an assumed lens." if self.bodies[0].lens_assumed else ""
        if math.isnan(self.ground):
            return f"The ground is left out, because the photo shows no feet.{lens}"
        return f"Squares on the ground are 1 m. The camera is taken as upright.{lens}"

    def order(self, rotation: np.ndarray) -> list[int]:
        """Indices of the bodies, the farthest first."""
        depths = [float((vertices @ rotation[2]).mean()) for vertices in self.points]
        return sorted(range(len(depths)), key=lambda index: -depths[index])

    def draw(self, rotation: np.ndarray, tilt: float) -> Image:
        """Draw the scene with a rotation to a view's axes, and then tilted down by an angle [rad]."""
        from PIL import Image as PilImage
        from PIL import ImageDraw, ImageFilter

        down = np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]])
        view = _View.around(self, down @ rotation, with_camera=rotation is not _FRONT)
        canvas = PilImage.new("RGB", (view.width * _SMOOTH, _HEIGHT * _SMOOTH), _BACK)
        draw = ImageDraw.Draw(canvas)
        if not math.isnan(self.ground):
            self._draw_ground(draw, view)
        if view.has_camera:
            self._draw_camera(draw, view)
        canvas = canvas.reduce(_SMOOTH)
        if not math.isnan(self.ground):
            shadows = self._shadows(view).filter(ImageFilter.GaussianBlur(5)).point(lambda value: value * 0.6)
            canvas.paste(_SHADOW, mask=shadows)
        picture = np.asarray(canvas)
        for index in self.order(view.rotation):
            turned = self.bodies[index].turned_surface(view.rotation)
            picture = surface_over(picture, turned, view.camera(), self.colours[index])
        canvas = PilImage.fromarray(picture)
        self._write(ImageDraw.Draw(canvas), view, rotation)
        return canvas

    def _draw_ground(self, draw: ImageDraw, view: _View) -> None:
        """Draw the ground as squares of 1 m."""
        (left, near), (right, far) = view.floor
        corners = [(left, near), (right, near), (right, far), (left, far)]
        draw.polygon([view.at(x, self.ground, z) for x, z in corners], fill=_FLOOR)
        for x in range(math.ceil(left), math.floor(right) + 1):
            draw.line([view.at(x, self.ground, near), view.at(x, self.ground, far)], fill=_LINE, width=_SMOOTH)
        for z in range(math.ceil(near), math.floor(far) + 1):
            draw.line([view.at(left, self.ground, z), view.at(right, self.ground, z)], fill=_LINE, width=_SMOOTH)

    def _shadows(self, view: _View) -> Image:
        """Mask of the bodies' shadows on the ground, from right above."""
        from PIL import Image as PilImage

        size = _HEIGHT, view.width
        covered = np.zeros(size, dtype=bool)
        for each, points in zip(self.bodies, self.points, strict=True):
            flat = points.copy()
            flat[:, 1] = self.ground
            turned = torch.from_numpy((flat @ view.rotation.T).astype(np.float32))[None]
            covered |= draw_mesh(turned, each.surface.coat.mesh, view.camera(), size).labels[0].numpy() > 0
        return PilImage.fromarray(covered.astype(np.uint8) * 255)

    def _draw_camera(self, draw: ImageDraw, view: _View) -> None:
        """Draw the camera as a frustum, and the borders of what it sees, as far as the farthest person."""
        far = max(float(points[:, 2].max()) for points in self.points)
        eye, rim = view.at(0.0, 0.0, 0.0), [view.at(*corner) for corner in (self.corners * self.frustum).tolist()]
        for corner in (self.corners * far).tolist():
            draw.line([eye, view.at(*corner)], fill=_SIGHT, width=_SMOOTH)
        draw.polygon(rim, fill=_GLASS, outline=_INK, width=_SMOOTH)
        for edge in rim:
            draw.line([eye, edge], fill=_INK, width=_SMOOTH)

    @property
    def frustum(self) -> float:
        """Length of the camera's frustum [m]."""
        return min(_FRUSTUM, 0.4 * min(float(points[:, 2].min()) for points in self.points))

    def _write(self, draw: ImageDraw, view: _View, rotation: np.ndarray) -> None:
        """Write the names and distances of people, where the camera is, and the metres on the ground."""
        for each, points in zip(self.bodies, self.points, strict=True):
            turned = points @ view.rotation.T
            words = [each.name] if len(self.bodies) > 1 else []
            words += [f"{each.placement.distance:.1f} m"] if rotation is _ABOVE else []
            x, y = view.flat(*turned[turned[:, 1].argmin(), :2].tolist())
            _write(draw, (x, y - 4), ", ".join(words), "mb")
        if view.has_camera:
            lens = np.concatenate([np.zeros((1, 3)), self.corners * self.frustum]) @ view.rotation.T
            x, y = view.flat(float(lens[:, 0].mean()), float(lens[:, 1].max()))
            _write(draw, (x, y + 4), "camera", "ma")
        elif rotation is not _FRONT:
            told = f"camera, {min(each.placement.distance for each in self.bodies):.1f} m"
            if rotation is _SIDE:
                _write(draw, (10, _HEIGHT / 2), f"< {told}", "lm")
            else:
                _write(draw, (view.width / 2, _HEIGHT - 8), f"v {told}", "mb")
        if math.isnan(self.ground):
            left, bottom = 14, _HEIGHT - 16
            metres = 1.0 if view.scale < 0.4 * view.width else 0.5
            right = left + metres * view.scale
            draw.line([left, bottom, right, bottom], fill=_INK, width=3)
            _write(draw, ((left + right) / 2, bottom - 5), f"{metres:g} m", "mb")
        elif rotation is not _FRONT:
            (left_side, near), (right_side, far) = view.floor
            for z in range(max(math.ceil(near), 0), math.floor(far) + 1):
                if rotation is _SIDE:
                    x, y = view.point(right_side, self.ground, z)
                    _write(draw, (x, y + 4), f"{z} m", "ma", _SMALL)
                else:
                    x, y = view.point(left_side, self.ground, z)
                    _write(draw, (x - 5, y), f"{z} m", "rm", _SMALL)


@dataclass(frozen=True)
class _View:
    """View without perspective.

    Attributes:
        rotation: Rotation from the camera's axes to the view's, shape (3, 3).
        scale: Scale [px/m].
        middle: Point of the view's plane in the middle of the picture [m], shape (2,).
        width: Width of the picture [px].
        floor: Least and greatest (x, z) of the ground that is shown [m], shape (2, 2).
        has_camera: True if the camera is in the picture.
    """

    rotation: np.ndarray
    scale: float
    middle: np.ndarray
    width: int
    floor: np.ndarray
    has_camera: bool

    @classmethod
    def around(cls, scene: _Scene, rotation: np.ndarray, *, with_camera: bool) -> _View:
        """View of all bodies, and of the camera unless they would be too small then."""
        points = np.concatenate(scene.points)
        eye = np.zeros((int(with_camera), 3))
        lens = scene.corners * scene.frustum if with_camera else eye
        flat = np.concatenate([points, eye, lens])[:, [0, 2]]
        floor = np.stack([flat.min(0) - _AROUND, flat.max(0) + _AROUND])
        shown = np.concatenate([points, eye, lens])
        if not math.isnan(scene.ground):
            corners = [(x, scene.ground, z) for x in floor[:, 0] for z in floor[:, 1]]
            shown = np.concatenate([shown, corners])
        turned = shown @ rotation.T
        low, high = turned[:, :2].min(0), turned[:, :2].max(0)
        low, high = low - _MARGIN * (high - low) - 0.05, high + _MARGIN * (high - low) + 0.05
        across, down = (high - low).tolist()
        scale = min(_HEIGHT / down, _WIDTHS[1] / across)
        if with_camera and scale < (_SMALLEST_ABOVE if abs(rotation[2, 1]) > 0.5 else _SMALLEST):
            return cls.around(scene, rotation, with_camera=False)
        width = min(max(round(across * scale), _WIDTHS[0]), _WIDTHS[1])
        return cls(rotation, scale, (low + high) / 2, width, floor, with_camera)

    def at(self, x: float, y: float, z: float) -> tuple[float, float]:
        """Position of a point of the scene in the picture, ``_SMOOTH`` times as large."""
        left, top = self.point(x, y, z)
        return left * _SMOOTH, top * _SMOOTH

    def point(self, x: float, y: float, z: float) -> tuple[float, float]:
        """Position of a point of the scene in the picture."""
        across, down, _ = (self.rotation @ (x, y, z)).tolist()
        return self.flat(across, down)

    def flat(self, across: float, down: float) -> tuple[float, float]:
        """Position of a point of the view's plane [m] in the picture."""
        x, y = ((across, down) - self.middle).tolist()
        return x * self.scale + self.width / 2, y * self.scale + _HEIGHT / 2

    def camera(self) -> WeakPerspective:
        """Camera that draws points in the view's axes into the picture."""
        return WeakPerspective(torch.tensor([self.scale]).float(), torch.tensor([self.flat(0.0, 0.0)]).float())


def _write(draw: ImageDraw, place: tuple[float, float], words: str, anchor: str, size: int = 14) -> None:
    """Write words with a white border."""
    from PIL import ImageFont

    ink, font = _INK if size > _SMALL else _SHADOW, ImageFont.load_default(size)
    draw.text(place, words, ink, font, anchor=anchor, stroke_width=2, stroke_fill=_BACK)
