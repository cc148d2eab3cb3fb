"""Bodies as shaded pictures in soft light, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ..body.labels import BACKGROUND
from ..body.posing import Posed
from ..body.rotations import rotation_from_axis_angle
from ..cameras import Camera, Crop, WeakPerspective, first_of
from ..inputs.person import label_bounds
from ..models.model import Detailed, DetailedModel, detailed_mesh
from ..models.normals import vertex_normals
from ..models.suit import suit_of
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .palette import PART_COLOURS

_SUBDIVISIONS = 3
SKIN_COLOUR = np.array([205, 212, 222], dtype=np.uint8)  # unlike all PEOPLE_COLOURS
_TONES = (0.86, 0.74)  # brightness of the T-shirt and of the shorts, as shares of the skin's
_PALE, _FADE = 0.4, 0.4  # opacity of guessed limbs, and the width of their border as a share of parts
# Unit vectors toward the lamps, camera frame: x right, y down, z away from the viewer.
_KEY_FROM, _FILL_FROM = np.array([-0.45, -0.65, -0.612]), np.array([0.8, 0.1, -0.592])
_SKY, _GROUND, _KEY, _FILL, _RIM = 0.60, 0.34, 0.50, 0.08, 0.12  # brightness that each light adds at most
_WRAP = 0.3  # how far the key lamp's light reaches around the body
_BRIGHTEST = 1.2
_REACH, _CREVICE = 0.06, 0.22  # [m], surroundings that take light away, and how much of it
_THIN = 1e-3  # [px²], twice the area below which a face is seen from its edge
_STEP = 0.03  # [m], difference of depths within a pixel that makes it an edge
_FEW_SAMPLES, _MANY_SAMPLES = 2, 3  # samples of a pixel in each direction, for smooth outlines
_SMALL = 15_000  # [px], area of a picture up to which a pixel has many samples


@dataclass(frozen=True, eq=False)
class _Coat:
    """Looks of a mesh's faces in any pose and from any side.

    Attributes:
        mesh: Faces and their part labels, on the CPU.
        fields: Distance of each vertex from the edges of the two garments of a ``Suit`` [m], positive in the cloth, and
            share of the parts in it that are drawn pale, shape (V, 3). They are -1 without garments and pale parts.
        tones: Brightness of each face as a share of the skin's, shape (F,).
        opacities: Opacity of each face, shape (F,).
        mixed: True for faces on a seam or on the border of a pale limb, shape (F + 1,); the last one is no face.
    """

    mesh: PartMesh
    fields: np.ndarray
    tones: np.ndarray
    opacities: np.ndarray
    mixed: np.ndarray

    @classmethod
    def of(cls, mesh: PartMesh, fields: np.ndarray) -> _Coat:
        """Find what each face shows from ``fields`` at the vertices."""
        tone, opacity = suit_tones(fields[:, :2]), _opacity(fields[:, 2])
        one, two, three = mesh.faces.numpy().T
        mixed = (tone[one] != tone[two]) | (tone[one] != tone[three])
        mixed |= (opacity[one] != opacity[two]) | (opacity[one] != opacity[three])
        return cls(mesh, fields, tone[one], opacity[one], np.append(mixed, True))


@lru_cache(maxsize=16)  # pale parts change from frame to frame
def _coat_of(model: DetailedModel, pale: tuple[int, ...], bare: bool) -> _Coat:
    """Coat of a model's bodies, whose parts with the labels ``pale`` are drawn pale, and which may be bare."""
    fields = np.full((model.num_vertices, 3), -1.0)
    if not bare:
        fields[:, :2] = suit_of(model).cloth
    if pale:
        fields[:, 2] = model.spread_weights[:, np.array(pale) - 1].sum(1).cpu().numpy()
    return _Coat.of(detailed_mesh(model).to("cpu"), fields)


@dataclass(frozen=True, eq=False)
class BodySurface:
    """Surface of one body in its clothes, made once and drawn from any side.

    Attributes:
        vertices: Vertices [m], shape (V, 3), float32.
        normals: Normals of the vertices, shape (V, 3), float32.
        coat: Looks of its faces.
    """

    vertices: np.ndarray
    normals: np.ndarray
    coat: _Coat

    @classmethod
    def of(cls, vertices: torch.Tensor, coat: _Coat) -> BodySurface:
        """Surface with vertices (V, 3) [m]."""
        points = vertices.detach().cpu().float().numpy()
        return cls(points, vertex_normals(points, coat.mesh.faces.numpy()), coat)

    @classmethod
    def of_body(
        cls, vertices: torch.Tensor, model: DetailedModel, *, pale: np.ndarray | None = None, bare: bool = False
    ) -> BodySurface:
        """Surface of the first body of a model. The arguments are those of ``shade_skin``."""
        labels = () if pale is None else tuple(label for label in np.flatnonzero(pale).tolist() if label != BACKGROUND)
        worn = vertices[0] if bare else suit_of(model).put_on(vertices[0])
        return cls.of(worn, _coat_of(model, labels, bare))

    def moved(self, rotation: np.ndarray, offset: np.ndarray | float = 0.0, scale: float = 1.0) -> BodySurface:
        """The surface elsewhere: moved by an offset [m], scaled about the origin, then turned by a rotation (3, 3)."""
        vertices = (self.vertices.astype(np.float64) + offset) * scale @ rotation.T
        normals = (self.normals @ rotation.T).astype(np.float32)
        return replace(self, vertices=vertices.astype(np.float32), normals=normals)

    def draw(self, camera: Camera, image_size: tuple[int, int], colour: np.ndarray = SKIN_COLOUR) -> np.ndarray:
        """Draw it in soft light, on a transparent ground.

        Args:
            camera: Camera of the picture, in whose frame the vertices are.
            image_size: Size (H, W) of the picture [px].
            colour: RGB of all parts, shape (3,), or of each label from 0 on, shape (21, 3), uint8.

        Returns:
            RGBA, shape (H, W, 4), uint8.
        """
        return _shade(self, first_of(camera).to("cpu"), image_size, np.broadcast_to(colour, PART_COLOURS.shape))


def shade_body(posed: Posed, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """Draw the first body's ellipsoids, coloured by part and lit, on a transparent ground: RGBA, (H, W, 4), uint8.

    Examples:
        >>> from PIL import Image
        >>> from warp_partdr import BodyParameters
        >>> from warp_partdr.plot import shade_body
        >>> body = BodyParameters.mean(1)
        >>> picture = shade_body(body.posed(), body.camera(256), (256, 256))
        >>> Image.fromarray(picture).save("body.png")  # with a transparent ground
        >>> picture.shape
        (256, 256, 4)
    """
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    return shade_mesh(posed.vertices(_SUBDIVISIONS)[:1], mesh, camera, image_size, PART_COLOURS)


def shade_detailed(
    detailed: Detailed, model: DetailedModel, camera: Camera, image_size: tuple[int, int], *, bare: bool = False
) -> np.ndarray:
    """Draw the first body in one colour, lit, on a transparent ground: RGBA, shape (H, W, 4), uint8.

    It wears a plain T-shirt and shorts, unless ``bare``.

    Examples:
        After ``mesh = refine_mesh(result)``:

        >>> from warp_partdr.plot import shade_detailed
        >>> shade_detailed(mesh.body.detailed, mesh.body.model, mesh.camera, (512, 384)).shape
        (512, 384, 4)
    """
    return shade_skin(detailed.vertices, model, camera, image_size, bare=bare)


def shade_skin(
    vertices: torch.Tensor,
    model: DetailedModel,
    camera: Camera,
    image_size: tuple[int, int],
    colour: np.ndarray = SKIN_COLOUR,
    *,
    pale: np.ndarray | None = None,
    bare: bool = False,
) -> np.ndarray:
    """Draw the first body of a model with given vertices, like ``shade_detailed``: RGBA, shape (H, W, 4), uint8.

    Args:
        vertices: Vertices of the model's bodies in the camera frame [m], shape (B, V, 3).
        model: Model of the bodies.
        camera: Camera of the picture.
        image_size: Size (H, W) of the picture [px].
        colour: Colour of the body, RGB, shape (3,), uint8.
        pale: Flags of the part labels that are drawn half transparent, shape (21,); None: no part is.
        bare: True draws the skin alone. By default the body wears a plain T-shirt and shorts in darker tones.
    """
    return BodySurface.of_body(vertices, model, pale=pale, bare=bare).draw(camera, image_size, colour)


def shade_mesh(
    vertices: torch.Tensor, mesh: PartMesh, camera: Camera, image_size: tuple[int, int], colours: np.ndarray
) -> np.ndarray:
    """Draw a mesh with vertices (1, V, 3) in the camera frame [m] in its labels' colours: RGBA, (H, W, 4), uint8."""
    coat = _Coat.of(mesh.to("cpu"), np.full((vertices.shape[1], 3), -1.0))
    return BodySurface.of(vertices[0], coat).draw(camera, image_size, colours)


def _shade(surface: BodySurface, camera: Camera, image_size: tuple[int, int], colours: np.ndarray) -> np.ndarray:
    """Draw a surface as ``BodySurface.draw`` does, with colours of each label (21, 3)."""
    points = torch.from_numpy(surface.vertices)[None]
    rgba = np.zeros((*image_size, 4), dtype=np.uint8)
    rows, columns = _window(points, camera, image_size)  # most of a photo shows no body
    height, width = rows.stop - rows.start, columns.stop - columns.start
    if 0 in (height, width):
        return rgba
    samples = _MANY_SAMPLES if height * width <= _SMALL else _FEW_SAMPLES
    size = height * samples, width * samples
    own_camera = camera.in_crop(Crop(columns.start, rows.start, samples, size))
    image = draw_mesh(points, surface.coat.mesh, own_camera, size)
    shown, depth = image.face_index[0].numpy(), image.depth[0]
    paint = _Paint.of(surface, own_camera, shown, colours)
    middle = slice(samples // 2, None, samples)

    # Within the body one sample shows as much as many: only pixels on edges and seams need them.
    even = _is_even(image.labels[0].numpy(), depth.numpy(), samples)
    even &= ~surface.coat.mixed[shown[middle, middle]]
    drawn = np.zeros((height, width, 4), dtype=np.float32)
    row, column = np.nonzero(even)
    at = np.stack([column, row], axis=1).astype(np.float32) * samples + samples / 2
    drawn[row, column] = paint.at(at, shown[middle, middle][row, column])
    row, column = np.nonzero(~even & (_greatest(shown, samples) >= 0))
    for down, across in np.ndindex(samples, samples):
        y, x = row * samples + down, column * samples + across
        covered = shown[y, x] >= 0
        y, x = y[covered], x[covered]
        at = np.stack([x, y], axis=1).astype(np.float32) + 0.5
        drawn[row[covered], column[covered]] += paint.at(at, shown[y, x]) / samples**2

    # Colours are weighted by the opacity of a sample, or outlines would turn dark.
    opacity = drawn[..., 3:]
    drawn[..., :3] *= _open_sky(depth[middle, middle], own_camera, samples)[..., None] / np.maximum(opacity, 1e-6)
    opacity *= 255
    rgba[rows, columns] = (drawn + 0.5).clip(0, 255).astype(np.uint8)
    return rgba


def _is_even(labels: np.ndarray, depth: np.ndarray, samples: int) -> np.ndarray:
    """True for pixels all of whose samples show one part without a step in depth, shape (H, W)."""
    highest, farthest = _greatest(labels, samples), _greatest(depth, samples)
    lowest, nearest = 255 - _greatest(255 - labels, samples), -_greatest(-depth, samples)
    even: np.ndarray = (lowest == highest) & (lowest > 0) & (farthest < nearest + _STEP)
    return even


def _greatest(values: np.ndarray, samples: int) -> np.ndarray:
    """Greatest value among the samples of each pixel: (H S, W S) to (H, W)."""
    greatest = values[::samples, ::samples].copy()
    for down, across in np.ndindex(samples, samples):
        np.maximum(greatest, values[down::samples, across::samples], out=greatest)
    return greatest


@dataclass(frozen=True)
class _Paint:
    """Colours of a surface in a picture. What no sample shows is left at 0.

    Attributes:
        coat: Looks of the faces.
        colours: RGB of each face, shape (F, 3), float32.
        light: Brightness of each face, as ``_planes`` gives it, shape (F, 3).
        fields: Planes of ``coat.fields`` on mixed faces, shape (F, 3, 3).
    """

    coat: _Coat
    colours: np.ndarray
    light: np.ndarray
    fields: np.ndarray

    @classmethod
    def of(cls, surface: BodySurface, camera: Camera, shown: np.ndarray, colours: np.ndarray) -> _Paint:
        """Paint a surface whose faces ``shown``, -1 for none, are seen in a picture."""
        coat, faces = surface.coat, surface.coat.mesh.faces.numpy()
        screen = camera.project(torch.from_numpy(surface.vertices)[None])[0, :, :2].double().numpy()
        seen = np.zeros(len(faces) + 1, dtype=bool)
        seen[shown] = True
        seen = np.flatnonzero(seen[:-1])
        light = np.zeros((len(faces), 3, 1), dtype=np.float32)
        light[seen] = _planes(screen, faces[seen], _brightness(surface, camera)[:, None])
        mixed = coat.mixed[:-1]
        fields = np.zeros((len(faces), 3, 3), dtype=np.float32)
        fields[mixed] = _planes(screen, faces[mixed], coat.fields)
        of_faces = colours.astype(np.float32)[coat.mesh.face_labels.numpy()]
        of_faces[~mixed] *= coat.tones[~mixed, None]
        return cls(coat, of_faces, light[..., 0], fields)

    def at(self, points: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """RGB times opacity, and opacity, of points in the picture (N, 2) that show the given faces, shape (N, 4)."""
        light, opacity = self.light[faces], self.coat.opacities[faces]
        brightness = light[:, 0] + light[:, 1] * points[:, 0] + light[:, 2] * points[:, 1]
        some = np.flatnonzero(self.coat.mixed[faces])
        fields = self.fields[faces[some]]
        values = fields[:, 0] + fields[:, 1] * points[some, :1] + fields[:, 2] * points[some, 1:]
        brightness[some] *= suit_tones(values[:, :2])
        opacity[some] = _opacity(values[:, 2])
        painted = np.empty((len(faces), 4), dtype=np.float32)
        painted[:, :3] = self.colours[faces] * (brightness.clip(0, _BRIGHTEST) * opacity)[:, None]
        painted[:, 3] = opacity
        return painted


def suit_tones(cloth: np.ndarray) -> np.ndarray:
    """Brightness as a share of the skin's, by the distances from the edges of garments (N, 2), shape (N,)."""
    return np.where(cloth > 0, np.array(_TONES, dtype=np.float32), np.float32(1)).min(1)


def _opacity(guessed: np.ndarray) -> np.ndarray:
    """Opacity by the share of guessed parts, shape (N,), float32."""
    return (1 - (1 - _PALE) * ((guessed - 0.5) / _FADE + 0.5).clip(0, 1)).astype(np.float32)


def _brightness(surface: BodySurface, camera: Camera) -> np.ndarray:
    """Brightness of each vertex in the light of a sky, a key lamp, a weak lamp and on rims, shape (V,)."""
    points, normals = surface.vertices, surface.normals
    view = -points / np.linalg.norm(points, axis=1, keepdims=True).clip(1e-6) if camera.perspective else [[0, 0, -1]]
    sky = _GROUND + (_SKY - _GROUND) * (0.5 - 0.5 * normals[:, 1])
    key = _KEY * ((normals @ _KEY_FROM + _WRAP) / (1 + _WRAP)).clip(0)
    fill = _FILL * (normals @ _FILL_FROM).clip(0)
    rim = _RIM * (1 - (normals * view).sum(1)).clip(0, 1) ** 3
    brightness: np.ndarray = sky + key + fill + rim
    return brightness


def _planes(screen: np.ndarray, faces: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Planes of fields that change evenly between the corners of faces: value at (0, 0), slope along x, along y.

    Args:
        screen: Vertices in the picture [px], shape (V, 2).
        faces: Indices of the corners, shape (F, 3).
        fields: Values at the vertices, shape (V, C).

    Returns:
        Planes, shape (F, 3, C), float32. The planes of faces that are seen from their edge are level.
    """
    corners, values = screen[faces], fields[faces]
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area = ax * by - ay * bx
    level = np.abs(area) < _THIN
    scale = np.where(level, 0.0, 1.0 / np.where(level, 1.0, area))[:, None]
    first, second = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    along_x = (first * by[:, None] - second * ay[:, None]) * scale
    along_y = (second * ax[:, None] - first * bx[:, None]) * scale
    middle = corners.mean(1)
    base = values.mean(1) - along_x * middle[:, :1] - along_y * middle[:, 1:]
    return np.stack([base, along_x, along_y], axis=1).astype(np.float32)


def _open_sky(depth: torch.Tensor, camera: Camera, samples: int) -> np.ndarray:
    """Share of the light that reaches each pixel: less where the surface lies behind its surroundings, shape (H, W).

    Args:
        depth: Depth of each pixel [m], infinite for the background, shape (H, W).
        camera: Camera of the samples.
        samples: Samples of a pixel in each direction.
    """
    body = torch.isfinite(depth)
    if not bool(body.any()):
        return np.ones(depth.shape, dtype=np.float32)
    distance = float(depth[body].median()) if camera.perspective else 1.0
    reach = _REACH * float(camera.intrinsics[0, 0]) / samples / distance
    step = min(max(round(reach / 3), 1), *depth.shape)
    pair = torch.stack([body.float(), torch.where(body, depth, 0.0)])[None]
    coarse = torch.nn.functional.avg_pool2d(pair, step, ceil_mode=True)
    for _ in range(2):
        coarse = torch.nn.functional.avg_pool2d(coarse, 3, stride=1, padding=1)
    mean = coarse[:, 1:] / coarse[:, :1].clamp_min(1e-6)
    around = torch.nn.functional.interpolate(mean, scale_factor=step, mode="bilinear", align_corners=False)[0, 0]
    around = around[: depth.shape[0], : depth.shape[1]]
    hidden = ((torch.where(body, depth, around) - around) / _REACH).clamp(-0.5, 1.0)
    return (1 - _CREVICE * hidden).numpy()


def _window(vertices: torch.Tensor, camera: Camera, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of (H, W) pixels that may show a body with these vertices, (1, V, 3)."""
    projected = camera.project(vertices)[0]
    if camera.perspective and bool((projected[:, 2] <= 0).any()):  # points behind the camera have no true position
        return slice(0, size[0]), slice(0, size[1])
    left, top = projected[:, :2].amin(0).floor().long().tolist()
    right, bottom = projected[:, :2].amax(0).ceil().long().tolist()
    height, width = size
    rows = slice(min(max(top, 0), height), min(max(bottom, 0), height))
    return rows, slice(min(max(left, 0), width), min(max(right, 0), width))


def blend(photo: np.ndarray, rgba: np.ndarray, opacity: float) -> np.ndarray:
    """Blend ``rgba`` over ``photo``, shape (H, W, 3), uint8.

    Examples:
        >>> from warp_partdr import BodyParameters, read_photo
        >>> from warp_partdr.plot import blend, shade_body
        >>> photo, body = read_photo("photo.png"), BodyParameters.mean(1)
        >>> blend(photo, shade_body(body.posed(), body.camera(384), photo.shape[:2]), opacity=0.6).shape
        (512, 384, 3)
    """
    blended, used = photo.copy(), label_bounds(rgba[..., 3] > 0)
    alpha = rgba[used][..., 3:].astype(np.float32) / 255 * opacity
    blended[used] = (photo[used] * (1 - alpha) + rgba[used][..., :3] * alpha).astype(np.uint8)
    return blended


def turntable_views(posed: Posed, angles: tuple[tuple[float, float], ...], size: int = 320) -> list[np.ndarray]:
    """Draw the first body from other sides on white, RGB, shape (size, size, 3) each.

    Args:
        posed: Posed bodies.
        angles: Turns about the vertical and tilts about the horizontal [degrees]; (0, 0) is the photo's view.
        size: Side of the pictures [px].

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from PIL import Image
        >>> from warp_partdr.plot import turntable_views
        >>> front, side, above = turntable_views(result.posed, ((0, 0), (90, 0), (0, 90)), size=256)
        >>> Image.fromarray(side).save("side.png")
        >>> side.shape
        (256, 256, 3)
    """
    body = Posed(*(tensor[:1].detach().cpu() for tensor in vars(posed).values()))
    middle = (body.joints.amax(1) + body.joints.amin(1)) / 2
    reach = float((body.joints - middle[:, None]).norm(dim=-1).max()) * 1.15 + 0.05
    camera = WeakPerspective(torch.tensor([size / 2 / reach]), torch.full((1, 2), size / 2))
    white = np.full((size, size, 3), 255, dtype=np.uint8)
    pictures = []
    for turn, tilt in np.deg2rad(angles).tolist():
        about_vertical = rotation_from_axis_angle(torch.tensor([0.0, turn, 0.0]))
        about_horizontal = rotation_from_axis_angle(torch.tensor([tilt, 0.0, 0.0]))
        rotation = about_horizontal @ about_vertical
        turned = replace(body, centres=(body.centres - middle) @ rotation.T, axes=rotation @ body.axes)
        pictures.append(blend(white, shade_body(turned, camera, (size, size)), 1.0))
    return pictures
