"""Cameras: weak perspective and perspective, in pixels, and exact conversions between them and between crops.

Camera frame: x right, y down, z away from the viewer [m]; pixel (row v, column u) has its centre at (u + 0.5, v + 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from .errors import check_type, check_whole
from .interop.checks import FLOATS, check_tensor
from .interop.derivatives import is_transformed
from .interop.movable import Movable

# Focal length of a usual lens, as a share of a picture's longer side: 36 mm on full frame. Phones and cameras have 0.65
# to 1.6, mostly 0.7 to 1.2.
USUAL_FOCAL = 1.0


@dataclass(frozen=True)
class WeakPerspective(Movable):
    """Weak-perspective cameras: u = s X + t_u, v = s Y + t_v.

    Attributes:
        scale: Scale s of each camera [px/m], shape (B,).
        translation: Pixel (t_u, t_v) at which each camera sees the frame's origin [px], shape (B, 2).
        near: Depth at or before which nothing is drawn [m]. By default, everything is drawn.

    Raises:
        ValueError: If a shape or dtype is wrong, the two differ in dtype or device, ``near`` is NaN, or a scale on the
            CPU is not positive.

    Examples:
        >>> import torch
        >>> from warp_partdr import WeakPerspective
        >>> camera = WeakPerspective(scale=torch.tensor([250.0]), translation=torch.tensor([[160.0, 120.0]]))
        >>> camera.project(torch.tensor([[[0.1, -0.4, 0.0]]]))  # u [px], v [px], z [m]
        tensor([[[185.,  20.,   0.]]])
    """

    scale: torch.Tensor
    translation: torch.Tensor
    near: float = -math.inf

    perspective = False

    def __post_init__(self) -> None:
        _check_near(self.near)
        check_tensor("scale", self.scale, (None,), dtypes=FLOATS)
        _check_positive("scale", self.scale)
        shape = (self.scale.shape[0], 2)
        check_tensor("translation", self.translation, shape, dtypes=FLOATS, like=("scale", self.scale))

    @property
    def near_plane(self) -> float:
        """Depth at or before which nothing is drawn [m]."""
        return float(self.near)

    @property
    def intrinsics(self) -> torch.Tensor:
        """Intrinsics (f_x, f_y, c_x, c_y) for ``u = f_x X + c_x``, shape (B, 4)."""
        focal = self.scale[:, None]
        return torch.cat([focal, focal, self.translation], dim=1)

    def project(self, points: torch.Tensor) -> torch.Tensor:
        """Points in the camera frame [m], shape (B, N, 3), to (u [px], v [px], z [m])."""
        _check_points(points, self.scale)
        image = points[..., :2] * self.scale[:, None, None] + self.translation[:, None]
        return torch.cat([image, points[..., 2:]], dim=-1)

    def in_crop(self, crop: Crop) -> WeakPerspective:
        """The camera of the crop's own picture."""
        return WeakPerspective(self.scale * crop.zoom, crop.to_crop(self.translation), self.near)

    def in_full(self, crop: Crop) -> WeakPerspective:
        """The camera of the full picture, where this one is the crop's."""
        return WeakPerspective(self.scale / crop.zoom, crop.to_full(self.translation), self.near)

    @classmethod
    def from_hmr(cls, parameters: torch.Tensor, image_size: int) -> WeakPerspective:
        """Make cameras from HMR's (s, t_x, t_y) of a square crop: x = s (X + t_x) in [-1, 1] (Kanazawa et al., 2018).

        Args:
            parameters: Parameters (s, t_x, t_y), shape (B, 3).
            image_size: Side of the crop [px].

        Returns:
            B cameras whose pixels are those of the crop.

        Raises:
            TypeError: If ``parameters`` is no tensor.
            ValueError: If its shape or dtype is wrong, or ``image_size``, or a scale on the CPU, is not positive.
        """
        check_tensor("parameters", parameters, (None, 3), dtypes=FLOATS)
        _check_side(image_size)
        scale = parameters[:, 0] * (image_size / 2)
        return cls(scale, scale[:, None] * parameters[:, 1:] + image_size / 2)

    def to_hmr(self, image_size: int) -> torch.Tensor:
        """HMR's (s, t_x, t_y) of a square crop of this side [px], shape (B, 3)."""
        _check_side(image_size)
        shift = (self.translation - image_size / 2) / self.scale[:, None]
        return torch.cat([self.scale[:, None] / (image_size / 2), shift], dim=1)

    def to_perspective(self, focal: torch.Tensor, centre: torch.Tensor) -> tuple[Perspective, torch.Tensor]:
        """A perspective camera that sees the frame's origin at the same place and size.

        Args:
            focal: Focal length f [px], for square pixels, shape (B,).
            centre: Principal point [px], shape (B, 2).

        Returns:
            The camera, and the translation [m], shape (B, 3), to add to points in front of it. Points in the origin's
            depth plane project exactly as here.
        """
        check_tensor("focal", focal, (self.scale.shape[0],), dtypes=FLOATS, like=("scale", self.scale))
        check_tensor("centre", centre, tuple(self.translation.shape), dtypes=FLOATS, like=("scale", self.scale))
        depth = focal / self.scale
        shift = (self.translation - centre) / self.scale[:, None]
        return Perspective(focal[:, None].expand(-1, 2), centre), torch.cat([shift, depth[:, None]], dim=1)


@dataclass(frozen=True)
class Perspective(Movable):
    """Perspective cameras: u = f_x X / Z + c_x, v = f_y Y / Z + c_y.

    Attributes:
        focal: Focal lengths (f_x, f_y) [px], shape (B, 2).
        centre: Principal point (c_x, c_y) [px], shape (B, 2).
        near: Depth at or before which nothing is drawn [m]. Values below 1e-6 count as 1e-6.

    Raises:
        ValueError: If a shape or dtype is wrong, the two differ in dtype or device, ``near`` is NaN, or a focal length
            on the CPU is not positive; on a GPU, fits and scenes' views say so.

    Examples:
        >>> import torch
        >>> from warp_partdr import Perspective
        >>> camera = Perspective.of_picture((480, 640), focal=600.0)
        >>> camera.project(torch.tensor([[[0.5, 0.0, 3.0]]]))  # u [px], v [px], z [m]
        tensor([[[420., 240.,   3.]]])
    """

    focal: torch.Tensor
    centre: torch.Tensor
    near: float = 0.01

    perspective = True

    def __post_init__(self) -> None:
        _check_near(self.near)
        check_tensor("focal", self.focal, (None, 2), dtypes=FLOATS)
        _check_positive("focal", self.focal)
        shape = (self.focal.shape[0], 2)
        check_tensor("centre", self.centre, shape, dtypes=FLOATS, like=("focal", self.focal))

    @classmethod
    def of_picture(
        cls,
        image_size: tuple[int, int],
        *,
        focal: float | None = None,
        fov: float | None = None,
        principal: tuple[float, float] | None = None,
    ) -> Perspective:
        """The camera of a picture, with square pixels, B = 1.

        Args:
            image_size: Height and width (H, W) of the picture [px].
            focal: Focal length [px]. Either this or ``fov`` must be given.
            fov: Horizontal angle of view [degrees].
            principal: Principal point (u, v) [px]. By default, it is the picture's middle.

        Raises:
            ValueError: If not one of ``focal`` and ``fov`` is given, or a number is out of range.

        Examples:
            >>> from warp_partdr import Perspective
            >>> Perspective.of_picture((480, 640), fov=90.0).focal
            tensor([[320., 320.]])
        """
        height, width = image_size
        if (focal is None) == (fov is None):
            raise ValueError(f"focal, fov: {focal}, {fov}; expected one of the two")
        if fov is not None:
            if not 0 < fov < _MOST_FOV:
                raise ValueError(f"fov: {fov:g}; expected degrees between 0 and {_MOST_FOV}")
            focal = width / 2 / math.tan(math.radians(fov) / 2)
        assert focal is not None
        if not 0 < focal <= _MOST_PIXELS:
            given = f"focal: {focal:g}" if fov is None else f"fov: {fov:g}, a focal length of {focal:g}"
            raise ValueError(f"{given}; expected a positive number of pixels, up to {_MOST_PIXELS:g}")
        centre = (width / 2, height / 2) if principal is None else principal
        if not all(abs(number) <= _MOST_PIXELS for number in centre):
            raise ValueError(f"principal: {centre}; expected pixels, up to {_MOST_PIXELS:g}")
        return cls(torch.tensor([[focal, focal]], dtype=torch.float32), torch.tensor([centre], dtype=torch.float32))

    @property
    def near_plane(self) -> float:
        """Depth at or before which nothing is drawn [m]: never behind the camera."""
        return max(float(self.near), _MIN_DEPTH)

    @property
    def intrinsics(self) -> torch.Tensor:
        """Intrinsics (f_x, f_y, c_x, c_y) [px], shape (B, 4)."""
        return torch.cat([self.focal, self.centre], dim=1)

    def project(self, points: torch.Tensor) -> torch.Tensor:
        """Points in the camera frame [m], shape (B, N, 3), to (u [px], v [px], z [m]).

        A point at or behind the camera has no picture; its z says so, and the renderer leaves its faces out.
        """
        _check_points(points, self.focal)
        depth = points[..., 2:]
        # Finite numbers for points that are not drawn anyway; the sign of z stays.
        safe = torch.where(depth.abs() < _MIN_DEPTH, torch.full_like(depth, _MIN_DEPTH), depth)
        image = points[..., :2] / safe * self.focal[:, None] + self.centre[:, None]
        return torch.cat([image, depth], dim=-1)

    def in_crop(self, crop: Crop) -> Perspective:
        """The camera of the crop's own picture."""
        return Perspective(self.focal * crop.zoom, crop.to_crop(self.centre), self.near)

    def in_full(self, crop: Crop) -> Perspective:
        """The camera of the full picture, where this one is the crop's."""
        return Perspective(self.focal / crop.zoom, crop.to_full(self.centre), self.near)

    def to_weak(self, point: torch.Tensor) -> WeakPerspective:
        """Weak-perspective camera that agrees at the depth of ``point``; its offsets are measured from ``point``.

        Args:
            point: The body's origin in the camera frame [m], shape (B, 3).
        """
        check_tensor("point", point, (self.focal.shape[0], 3), dtypes=FLOATS, like=("focal", self.focal))
        scale = self.focal.mean(1) / point[:, 2]
        return WeakPerspective(scale, self.project(point[:, None])[:, 0, :2])


@dataclass(frozen=True)
class UsualLens(Perspective):
    """Camera of a picture whose own camera is not known: a usual lens, with its axis in the picture's middle.

    Fits and networks treat it as any other camera, but know that it is assumed.
    """

    @classmethod
    def of_size(cls, image_size: tuple[int, int]) -> UsualLens:
        """Camera of a picture of (H, W) pixels, B = 1: its focal length is ``USUAL_FOCAL`` of the longer side.

        Raises:
            TypeError: If ``image_size`` is no sequence.
            ValueError: If these are not two whole numbers from 1 to a million.
        """
        height, width = (check_whole("image_size", side, 1, int(_MOST_PIXELS)) for side in image_size)
        camera = cls.of_picture((height, width), focal=USUAL_FOCAL * max(height, width))
        assert isinstance(camera, cls)
        return camera


_MIN_DEPTH = 1e-6  # [m]
_MOST_FOV = 170  # [degrees]
_MOST_PIXELS = 1e6  # [px] of focal length and principal point; beyond, float32 can't tell depths within a body
_SQUARE = 1e-3  # share by which the focal lengths of square pixels may differ
_ROTATION_ERROR = 1e-3  # of R^T R


def _check_near(near: float) -> None:
    if math.isnan(near):
        raise ValueError(f"near: {near}; expected a depth")


def _check_positive(name: str, values: torch.Tensor) -> None:
    """Raise ValueError if a number is 0 or less; NaN passes, and a GPU is not waited for."""
    if values.is_cpu and not torch.compiler.is_compiling() and not is_transformed(values) and (values <= 0).any():
        raise ValueError(f"{name}: {values.detach().min():g}; expected positive numbers")


def _check_side(image_size: float) -> None:
    """Raise ValueError unless a picture can have this side."""
    if not 0 < image_size < math.inf:
        raise ValueError(f"image_size: {image_size}; expected a positive number")


def _check_points(points: torch.Tensor, like: torch.Tensor) -> None:
    """Raise unless there are points (B, N, 3) for B cameras; one camera serves any number."""
    batch = like.shape[0] if like.shape[0] != 1 else None
    check_tensor("points", points, (batch, None, 3), dtypes=FLOATS)
    if points.device != like.device:
        raise ValueError(f"points: on {points.device}; expected {like.device}, as the camera")


@dataclass(frozen=True)
class Crop:
    """An axis-aligned crop of a picture, resized by one factor: u_crop = (u - left) · zoom.

    Attributes:
        left: First column of the crop in the full picture [px]. It may be negative.
        top: First row of the crop in the full picture [px]. It may be negative.
        zoom: Number of pixels of the crop for each pixel of the full picture.
        size: Height and width (H, W) of the resized crop [px].

    Raises:
        ValueError: If a number is not finite, or ``zoom`` is not positive.

    Examples:
        >>> import torch
        >>> from warp_partdr import Crop
        >>> crop = Crop(left=100.0, top=-20.0, zoom=2.0, size=(256, 256))
        >>> crop.to_crop(torch.tensor([[110.0, 0.0]]))
        tensor([[20., 40.]])
        >>> crop.to_full(torch.tensor([[20.0, 40.0]]))
        tensor([[110.,   0.]])
    """

    left: float
    top: float
    zoom: float
    size: tuple[int, int]

    def __post_init__(self) -> None:
        for name in ("left", "top", "zoom"):
            if not math.isfinite(value := getattr(self, name)):
                raise ValueError(f"{name}: {value}; expected a finite number")
        if not self.zoom > 0:
            raise ValueError(f"zoom: {self.zoom}; expected a positive number")

    def to_crop(self, points: torch.Tensor) -> torch.Tensor:
        """Points (..., 2) [px] of the full picture in the crop."""
        return (points - points.new_tensor([self.left, self.top])) * self.zoom

    def to_full(self, points: torch.Tensor) -> torch.Tensor:
        """Points (..., 2) [px] of the crop in the full picture."""
        return points / self.zoom + points.new_tensor([self.left, self.top])


@dataclass(frozen=True)
class ScreenCamera:
    """Camera of points (u [px], v [px], z [m]) that were projected already; one serves any batch.

    Attributes:
        perspective: Kind of the camera that put them there: depth is linear in the picture, or 1 / depth is.
        near: Depth of that camera's near plane [m]; None takes its default.

    Examples:
        >>> from warp_partdr import BodyParameters, ScreenCamera, draw_mesh, ellipbody_mesh
        >>> body = BodyParameters.mean(1)
        >>> points = body.camera(64).project(body.posed().vertices(1))  # by any camera: u [px], v [px], z [m]
        >>> draw_mesh(points, ellipbody_mesh(1), ScreenCamera(perspective=False), (64, 64)).labels.shape
        torch.Size([1, 64, 64])
    """

    perspective: bool
    near: float | None = None

    @property
    def near_plane(self) -> float:
        """Depth at or before which nothing is drawn [m]."""
        if self.perspective:
            return max(Perspective.near if self.near is None else self.near, _MIN_DEPTH)
        return WeakPerspective.near if self.near is None else self.near

    def project(self, points: torch.Tensor) -> torch.Tensor:
        """Return the points unchanged, for they are in the picture already."""
        return points


Camera = WeakPerspective | Perspective


def first_of(camera: Camera) -> Camera:
    """The first of B cameras, without its gradient."""
    tensors = {name: each[:1].detach() for name, each in vars(camera).items() if isinstance(each, torch.Tensor)}
    return replace(camera, **tensors)  # type: ignore[arg-type]


def zoomed(camera: Camera, zoom: float, size: tuple[int, int]) -> Camera:
    """The camera of the whole picture at another size, (H, W) [px], ``zoom`` pixels a pixel."""
    return camera.in_crop(Crop(left=0.0, top=0.0, zoom=zoom, size=size))


def check_square(camera: Perspective) -> None:
    """Raise ValueError unless this is one camera with square pixels."""
    if len(camera.focal) != 1:
        raise ValueError(f"camera: {len(camera.focal)} of them; expected one")
    across, down = camera.focal[0].tolist()
    if not (camera.intrinsics.isfinite().all() and across > 0 and abs(across - down) <= _SQUARE * across):
        raise ValueError(f"camera: focal lengths {across:g} and {down:g}; expected square pixels")
    if not camera.intrinsics.abs().max() <= _MOST_PIXELS:
        raise ValueError(f"camera: {camera.intrinsics[0].tolist()}; expected pixels, up to {_MOST_PIXELS:g}")


def is_rotation(matrix: torch.Tensor) -> bool:
    """True for a rotation (3, 3), as files round it; a mirror image is none."""
    turn = matrix.double()
    off = (turn.mT @ turn - torch.eye(3, dtype=turn.dtype, device=turn.device)).abs().max()
    return bool(off < _ROTATION_ERROR and torch.linalg.det(turn) > 0)


def check_camera(camera: Camera, batch: int, like: tuple[str, torch.Tensor]) -> torch.Tensor:
    """Intrinsics of a camera, one for all B bodies or one a body; raise unless it is one, on the device of ``like``.

    Another object that has ``intrinsics`` and ``project`` will do.
    """
    try:
        intrinsics = camera.intrinsics
    except AttributeError:
        check_type("camera", camera, Camera, "such as BodyParameters.camera(256)")
        raise
    check_tensor("camera", intrinsics, (None, 4), dtypes=FLOATS)
    if intrinsics.shape[0] not in (1, batch):
        raise ValueError(f"camera: {intrinsics.shape[0]} of them; expected {batch}, as {like[0]}, or 1")
    if intrinsics.device != like[1].device:
        raise ValueError(f"camera: on {intrinsics.device}; expected {like[1].device}, as {like[0]}")
    return intrinsics
