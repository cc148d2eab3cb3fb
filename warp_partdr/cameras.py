"""Cameras: weak perspective and perspective, in pixels, and exact conversions between them and between crops.

Camera frame: x right, y down, z away from the viewer [m]; pixel (row v, column u) has its centre at (u + 0.5, v + 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class WeakPerspective:
    """u = s X + t_u, v = s Y + t_v.

    Attributes:
        scale: s [px/m], shape (B,).
        translation: (t_u, t_v), where the frame's origin is seen [px], shape (B, 2).
    """

    scale: torch.Tensor
    translation: torch.Tensor

    perspective = False

    @property
    def intrinsics(self) -> torch.Tensor:
        """(f_x, f_y, c_x, c_y) for ``u = f_x X + c_x``, shape (B, 4)."""
        return torch.cat([self.scale[:, None].expand(-1, 2), self.translation], dim=1)

    def project(self, points: torch.Tensor) -> torch.Tensor:
        """Points in the camera frame [m], shape (B, N, 3), to (u [px], v [px], z [m])."""
        image = points[..., :2] * self.scale[:, None, None] + self.translation[:, None]
        return torch.cat([image, points[..., 2:]], dim=-1)

    def in_crop(self, crop: Crop) -> WeakPerspective:
        """The camera of the crop's own picture."""
        return WeakPerspective(
            self.scale * crop.zoom, (self.translation - crop.origin_of(self.translation)) * crop.zoom
        )

    def in_full(self, crop: Crop) -> WeakPerspective:
        """The camera of the full picture, where this one is the crop's."""
        return WeakPerspective(self.scale / crop.zoom, self.translation / crop.zoom + crop.origin_of(self.translation))

    @classmethod
    def from_hmr(cls, parameters: torch.Tensor, image_size: int) -> WeakPerspective:
        """From HMR's (s, t_x, t_y) of a square crop: x = s (X + t_x) in [-1, 1] (Kanazawa et al., 2018).

        Args:
            parameters: Shape (B, 3).
            image_size: Side of the crop [px].
        """
        scale = parameters[:, 0] * (image_size / 2)
        return cls(scale, scale[:, None] * parameters[:, 1:] + image_size / 2)

    def to_hmr(self, image_size: int) -> torch.Tensor:
        """HMR's (s, t_x, t_y) of a square crop of this side [px], shape (B, 3)."""
        shift = (self.translation - image_size / 2) / self.scale[:, None]
        return torch.cat([self.scale[:, None] / (image_size / 2), shift], dim=1)

    def to_perspective(self, focal: torch.Tensor, centre: torch.Tensor) -> tuple[Perspective, torch.Tensor]:
        """A perspective camera that sees the frame's origin at the same place and size.

        Args:
            focal: f [px], square pixels, shape (B,).
            centre: Principal point [px], shape (B, 2).

        Returns:
            The camera, and the translation [m], shape (B, 3), to add to points in front of it. Points in the origin's
            depth plane project exactly as here.
        """
        depth = focal / self.scale
        shift = (self.translation - centre) / self.scale[:, None]
        return Perspective(focal[:, None].expand(-1, 2), centre), torch.cat([shift, depth[:, None]], dim=1)


@dataclass(frozen=True)
class Perspective:
    """u = f_x X / Z + c_x, v = f_y Y / Z + c_y.

    Attributes:
        focal: (f_x, f_y) [px], shape (B, 2).
        centre: Principal point (c_x, c_y) [px], shape (B, 2).
    """

    focal: torch.Tensor
    centre: torch.Tensor

    perspective = True

    @property
    def intrinsics(self) -> torch.Tensor:
        """(f_x, f_y, c_x, c_y), shape (B, 4)."""
        return torch.cat([self.focal, self.centre], dim=1)

    def project(self, points: torch.Tensor) -> torch.Tensor:
        """Points in the camera frame [m], shape (B, N, 3), to (u [px], v [px], z [m]).

        A point at or behind the camera has no picture; its z says so, and the renderer leaves its faces out.
        """
        depth = points[..., 2:]
        # Finite numbers for points that are not drawn anyway; the sign of z stays.
        safe = torch.where(depth.abs() < _MIN_DEPTH, torch.full_like(depth, _MIN_DEPTH), depth)
        image = points[..., :2] / safe * self.focal[:, None] + self.centre[:, None]
        return torch.cat([image, depth], dim=-1)

    def in_crop(self, crop: Crop) -> Perspective:
        """The camera of the crop's own picture."""
        return Perspective(self.focal * crop.zoom, (self.centre - crop.origin_of(self.centre)) * crop.zoom)

    def in_full(self, crop: Crop) -> Perspective:
        """The camera of the full picture, where this one is the crop's."""
        return Perspective(self.focal / crop.zoom, self.centre / crop.zoom + crop.origin_of(self.centre))

    def to_weak(self, point: torch.Tensor) -> WeakPerspective:
        """The weak-perspective camera that agrees at depth ``point`` z; offsets are then measured from ``point``.

        Args:
            point: The body's origin in the camera frame [m], shape (B, 3).
        """
        scale = self.focal.mean(1) / point[:, 2]
        return WeakPerspective(scale, self.project(point[:, None])[:, 0, :2])


_MIN_DEPTH = 1e-6  # [m]


@dataclass(frozen=True)
class Crop:
    """An axis-aligned crop of a picture, resized by one factor: u_crop = (u - left) · zoom.

    Attributes:
        left: First column of the crop in the full picture [px]; may be negative.
        top: First row.
        zoom: Pixels of the crop a pixel of the full picture.
        size: (H, W) of the resized crop [px].
    """

    left: float
    top: float
    zoom: float
    size: tuple[int, int]

    def origin_of(self, like: torch.Tensor) -> torch.Tensor:
        """(left, top) as a tensor like ``like``."""
        return like.new_tensor([self.left, self.top])

    def to_crop(self, points: torch.Tensor) -> torch.Tensor:
        """Points (..., 2) [px] of the full picture in the crop."""
        return (points - self.origin_of(points)) * self.zoom

    def to_full(self, points: torch.Tensor) -> torch.Tensor:
        """Points (..., 2) [px] of the crop in the full picture."""
        return points / self.zoom + self.origin_of(points)


Camera = WeakPerspective | Perspective
