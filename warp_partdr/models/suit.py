"""Plain suit of a T-shirt and shorts in which bodies are drawn and exported: its seams, and a surface without detail.

The suit is for looks alone. A fit, its measurements and its arrays are of the body beneath.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..interop.device_cache import device_cache
from .model import DetailedModel
from .normals import vertex_normals
from .registration import Registered

GARMENTS = ("T-shirt", "shorts")
_ARM, _LEG = ("upper_arm", "forearm", "hand"), ("upper_leg", "lower_leg", "foot")
_SLEEVE, _HEM = 0.52, 0.62  # ends of sleeves and shorts, as shares of the upper arm and of the thigh
_NECKLINE = 0.42  # share of neck and head in the skin's motion, above which the T-shirt ends
_SCALE = 0.1  # [m], width over which that share goes from 0 to 1, about
_FAR = 0.1  # [m], greatest distance from a seam that is told
_WAIST = 0.16  # height of the T-shirt's end above the hips, as a share of the trunk's height
_THIGH = 0.3  # share of the thigh below the hip joint that is smoothed, too
_FADE = 0.03  # [m], distance from an edge of the suit within which the smoothing fades
_FINE, _COARSE = 0.022, 0.07  # [m], widths of the smoothing: of the trunk, and of its front
_FARTHEST = 20.0  # square of the distance, in widths, beyond which a vertex does not count
_ROWS = 32  # of means, found at once
_EVEN = 0.05  # [m], width over which the smoothing itself changes


@dataclass(frozen=True, eq=False)
class Suit:
    """Suit of a body model.

    Attributes:
        cloth: Distance of each vertex from the edge of each of ``GARMENTS``, positive in the cloth [m], shape (V, 2).
    """

    cloth: np.ndarray
    _trunk: torch.Tensor  # indices of the vertices that are smoothed, shape (N,)
    _shares: torch.Tensor  # how much each of them is, shape (N, 1)
    _means: torch.Tensor  # weights of the mean around each of them, shape (N, N)

    def put_on(self, vertices: torch.Tensor) -> torch.Tensor:
        """Return the vertices of one body in its suit.

        Args:
            vertices: Vertices of the model, at rest or posed, in any frame [m], shape (V, 3).

        Returns:
            Vertices on the CPU, shape (V, 3), float32. Cloth lies on the skin, and has no thickness.
        """
        worn = vertices.detach().to("cpu", torch.float32, copy=True)
        trunk = worn[self._trunk]
        # The mean of a curved surface lies inside of it. Twice the mean less the mean's mean lies on it.
        inside = self._means @ trunk
        worn[self._trunk] = torch.lerp(trunk, 2 * inside - self._means @ inside, self._shares)
        return worn


def in_suit(registered: Registered) -> Registered:
    """The first body alone, with the vertices of its suit, for files that people look at."""
    first = registered.select(slice(1))
    worn = suit_of(registered.model).put_on(first.detailed.vertices[0])
    return replace(first, detailed=replace(first.detailed, vertices=worn[None].to(first.detailed.vertices)))


@dataclass(frozen=True, eq=False)
class _Rest:
    """Body model at rest, where y is up and z ahead, in double precision."""

    points: np.ndarray  # vertices [m], shape (V, 3)
    faces: np.ndarray  # shape (F, 3)
    shares: np.ndarray  # share of each part in each vertex, shape (V, 20)
    joints: dict[str, np.ndarray]  # joint that carries each part [m], shape (3,)

    def share(self, *endings: str) -> np.ndarray:
        """Share in each vertex of the parts whose names end so, shape (V,)."""
        share: np.ndarray = self.shares[:, [name.endswith(endings) for name in PART_NAMES]].sum(1)
        return share

    def along(self, upper: str, lower: str) -> tuple[np.ndarray, float]:
        """Position of each vertex along the bone of an upper limb, 0 to 1 from end to end, and its length [m]."""
        start, bone = self.joints[upper], self.joints[lower] - self.joints[upper]
        return (self.points - start) @ bone / (bone @ bone), float(np.linalg.norm(bone))


@device_cache(4)
def suit_of(model: DetailedModel) -> Suit:
    """Make the suit of a body model, once."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        joints = model.rest_joints.detach().cpu().double().numpy()
        rest = _Rest(
            model.rest_vertices.detach().cpu().double().numpy(),
            model.faces.cpu().numpy(),
            model.spread_weights.detach().cpu().double().numpy(),
            {name: joints[joint] for name, joint in zip(PART_NAMES, model.part_joints, strict=True)},
        )
        whole = _whole_suit(rest)
        hips = (rest.joints["left_upper_leg"][1] + rest.joints["right_upper_leg"][1]) / 2
        above = rest.points[:, 1] - (hips + _WAIST * (rest.joints["neck"][1] - hips))  # above the waist [m]
        cloth = np.stack([np.minimum(whole, above), np.minimum(whole, -above)], axis=1).clip(-_FAR, _FAR)
        smoothed = _smoothed_share(rest, whole)
        trunk = np.flatnonzero(smoothed)
        trunk = trunk[rest.points[trunk, 1].argsort(kind="stable")]  # by height, as ``_means`` takes them
        return Suit(
            cloth.astype(np.float32),
            torch.from_numpy(trunk),
            torch.from_numpy(smoothed[trunk, None].astype(np.float32)),
            torch.from_numpy(_trunk_means(rest, trunk).astype(np.float32)),
        )


def _whole_suit(rest: _Rest) -> np.ndarray:
    """Distance of each vertex from the edge of the suit as a whole, positive in the cloth [m], shape (V,)."""
    whole = (_NECKLINE - rest.share("neck", "head")) * _SCALE
    for limb, end in ((_ARM, _SLEEVE), (_LEG, _HEM)):
        for side in ("left", "right"):
            parts = [f"{side}_{part}" for part in limb]
            of_limb = rest.share(*parts) > 0.5
            along, length = rest.along(*parts[:2])
            whole[of_limb] = np.minimum(whole, (end - along) * length)[of_limb]
    return whole


def _smoothed_share(rest: _Rest, whole: np.ndarray) -> np.ndarray:
    """Share of the smooth surface in each vertex: 1 on the trunk, falling to 0 on limbs and at the neck, shape (V,)."""
    share = (whole / _FADE).clip(0, 1) * ((0.5 - rest.share(*_ARM)) / 0.3).clip(0, 1)
    for side in ("left", "right"):
        along, _ = rest.along(f"{side}_upper_leg", f"{side}_lower_leg")
        of_leg = rest.share(*(f"{side}_{part}" for part in _LEG)) > 0.5
        share[of_leg] *= ((_THIGH - along[of_leg]) / (_THIGH / 2)).clip(0, 1)
    return share


def _trunk_means(rest: _Rest, trunk: np.ndarray) -> np.ndarray:
    """Weights of the mean around each of the vertices ``trunk``: of a wide one ahead, shape (N, N)."""
    points, areas = rest.points[trunk], _areas(rest.points, rest.faces)[trunk]
    normals = vertex_normals(rest.points, rest.faces)[trunk]
    rough = _means(points, normals, areas, np.full(len(trunk), _EVEN))
    normals = rough @ (rough @ normals)  # of the trunk as a whole, or widths would change below a breast
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ahead = rest.share("chest", "abdomen")[trunk] * (2 * normals[:, 2]).clip(0, 1)
    return _means(points, normals, areas, _FINE + (_COARSE - _FINE) * (rough @ ahead))


def _areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area around each vertex, times six [m²], shape (V,)."""
    corners = points[faces]
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.bincount(faces.ravel(), np.repeat(doubled, 3), len(points))


def _means(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Weights of the mean around each of N points, over those that face the same way, shape (N, N).

    The points are in the order of their heights, so that those near some of them lie side by side.
    """
    squares, heights = (points**2).sum(1), points[:, 1]
    means = np.zeros((len(points), len(points)))
    for start in range(0, len(points), _ROWS):  # so few rows that their numbers stay in the processor's cache
        rows = slice(start, start + _ROWS)
        reach = math.sqrt(_FARTHEST) * widths[rows].max()
        low, high = np.searchsorted(heights, (heights[rows][0] - reach, heights[rows][-1] + reach)).tolist()
        some = slice(low, high)
        distances = squares[rows, None] + squares[some] - 2 * points[rows] @ points[some].T
        distances /= widths[rows, None] ** 2
        # Without a limit, most weights would be too small for float32 to multiply quickly.
        near = np.where(distances < _FARTHEST, np.exp(-distances / 2), 0.0)
        weights = near * (normals[rows] @ normals[some].T).clip(0) * areas[some]
        means[rows, some] = weights / weights.sum(1, keepdims=True)
    return means
