"""Pictures of people: their meshes in random colours under a random light, before backgrounds that mean nothing."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch

from ...body.template import PART_NAMES
from ...cameras import Camera, zoomed
from ...models.anny import anny
from ...render.mesh import PartImage, draw_mesh
from ...render.part_mesh import PartMesh
from .garments import is_hairy
from .rng import TorchRng
from .skin import anny_skin

SAMPLES = 2  # a side of a pixel, for smooth outlines
_NOISE = ((2, 0.5), (6, 0.25), (24, 0.15), (96, 0.1))  # cells a side, and how much they change a colour
_BOXES = 4
_GRAIN = 0.02
_PIECES = (  # ends of the names of parts: skin, shirt, sleeves, trousers, legs, shoes
    ("head", "neck", "hand"),
    ("abdomen", "chest", "shoulder", "upper_arm"),
    ("forearm",),
    ("hip", "upper_leg"),
    ("lower_leg",),
    ("foot",),
)
# After the background, 0, and the pieces; dark are eyes and mouth.
HAIR_FACE, DARK_FACE = len(_PIECES) + 1, len(_PIECES) + 2
_LASHES, _LIPS = 0.011, 0.006  # [m], how far about their middles these are
_SKIN = (0.95, 0.75, 0.62)
_BALD = 0.1


@torch.no_grad()
def shade_people(
    vertices: torch.Tensor, mesh: PartMesh, camera: Camera, size: tuple[int, int], rng: TorchRng
) -> tuple[np.ndarray, PartImage]:
    """Shade people, each alone in a picture.

    Args:
        vertices: Vertices of Anny, and perhaps more vertices after them, in the camera frame [m], shape (B, V, 3).
        mesh: Mesh whose first faces are Anny's.
        camera: Cameras, one for each person.
        size: Height and width (H, W) of the pictures [px].
        rng: Source of colours, light and backgrounds, on the device of ``vertices``.

    Returns:
        Pictures, shape (B, H, W, 3), uint8, and what is drawn at ``SAMPLES`` times their size.
    """
    count, (height, width) = len(vertices), size
    fine = (height * SAMPLES, width * SAMPLES)
    drawn = draw_mesh(vertices, mesh, zoomed(camera, SAMPLES, fine), fine)
    corners = vertices[:, mesh.faces.long()]
    normals = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    light = rng.uniform(count, 3, low=-1) * torch.tensor([1.0, 1.0, 0.5], device=vertices.device)
    light[:, 2] -= 0.7  # from the viewer's side
    unit = torch.nn.functional.normalize
    lit = (unit(normals, dim=-1) * unit(light, dim=-1)[:, None]).sum(-1).clamp_min(0)
    ambient = rng.uniform(count, 1, low=0.3, high=0.6)
    shown = drawn.face_index.flatten(1).long()
    brightness = (ambient + (1 - ambient) * lit).gather(1, shown.clamp_min(0))
    pieces = torch.where(shown >= 0, _face_pieces(mesh)[shown], 0)
    colours = _colours(rng, count).gather(1, pieces[..., None].expand(-1, -1, 3))
    foreground = (colours * brightness[..., None]).unflatten(1, fine).permute(0, 3, 1, 2)
    image = torch.where(drawn.labels[:, None] > 0, foreground, noise_backgrounds(count, fine, rng))
    image = torch.nn.functional.avg_pool2d(image, SAMPLES) + _GRAIN * rng.uniform(count, 3, *size, low=-1)
    return (image.clamp(0, 1) * 255).byte().permute(0, 2, 3, 1).cpu().numpy(), drawn


@lru_cache(maxsize=8)
def _pieces_of_parts() -> np.ndarray:
    """Piece of each part label, shape (21,)."""
    return np.array([0, *([name.endswith(ends) for ends in _PIECES].index(True) + 1 for name in PART_NAMES)])


def _face_pieces(mesh: PartMesh) -> torch.Tensor:
    """Piece that each face belongs to, shape (F,), int64."""
    pieces = torch.from_numpy(_pieces_of_parts()).to(mesh.faces.device)[mesh.face_labels.long()]
    features = torch.from_numpy(face_features()).to(pieces)
    pieces[: len(features)] = torch.where(features > 0, features, pieces[: len(features)])
    return pieces


@lru_cache(maxsize=1)
def face_features() -> np.ndarray:
    """Hair, eyes and mouth among Anny's faces, 0 elsewhere, shape (F,)."""
    model, names = anny(), ("left_eye", "left_eye_outer", "mouth_left")
    eye, outer, lips = model.landmarks(model.rest(torch.zeros(1, model.num_shapes)), names)[0].numpy()
    middles, head = anny_skin().points[model.faces.numpy()].mean(1), anny_skin().shares["head"][model.faces.numpy()]
    features = np.where(is_hairy(middles), HAIR_FACE, 0)
    for middle, half in ((eye, np.array([outer[0] - eye[0], _LASHES / 2])), (lips * [0, 1, 1], [lips[0], _LIPS])):
        near = (np.abs(middles[:, :2] - middle[:2]) < half).all(1) & (middles[:, 2] > outer[2] - _LASHES)
        features[near] = DARK_FACE
    return np.where((head > 0).all(1), features, 0)


def _colours(rng: TorchRng, count: int) -> torch.Tensor:
    """RGB of the background, which is black, and of each piece, shape (count, 9, 3)."""
    colours = rng.uniform(count, len(_PIECES), 3)
    skin = torch.tensor(_SKIN, device=rng.device) * (0.35 + 0.65 * colours[:, :1, :1])
    bare = colours[:, 2:5:2, :1] > 0.5  # sleeves and trousers may be short
    worn = torch.cat([skin, colours[:, 1:]], dim=1)
    worn[:, 2:5:2] = torch.where(bare, skin, worn[:, 1:4:2])
    tone = rng.uniform(count, 1, 1) ** 2 * torch.tensor([1.0, 0.8, 0.55], device=rng.device)
    hair = torch.where(rng.chance(_BALD, count, 1, 1), skin, tone)
    return torch.cat([torch.zeros_like(skin), worn, hair, 0.25 * skin], dim=1)


def noise_backgrounds(count: int, size: tuple[int, int], rng: TorchRng) -> torch.Tensor:
    """Smooth noise on several scales about a random colour, and boxes, shape (count, 3, H, W)."""
    image = rng.uniform(count, 3, 1, 1).expand(-1, -1, *size)
    for cells, strength in _NOISE:
        noise = rng.uniform(count, 3, cells, cells, low=-strength, high=strength)
        image = image + torch.nn.functional.interpolate(noise, size=size, mode="bilinear")
    down, across = ((torch.arange(side, device=image.device) + 0.5) / side for side in size)
    for _ in range(_BOXES):
        middle, half = rng.uniform(count, 2, 1), rng.uniform(count, 2, 1, low=0.02, high=0.25)
        rows, columns = ((places - middle[:, axis]).abs() < half[:, axis] for axis, places in ((1, down), (0, across)))
        image = torch.where((rows[:, :, None] & columns[:, None])[:, None], rng.uniform(count, 3, 1, 1), image)
    return image
