"""L_seg or part maps from the parameters of bodies, with gradient, in captured graphs: what a training step needs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, Self

import torch

from ..body.parameters import LOCKED_BITS
from ..body.posing import Posed, check_parameters, matrices_of, pose_parts
from ..body.template import BODY_SHAPES, BODY_SIZES, NUM_PARTS
from ..cameras import Camera, WeakPerspective, check_camera
from ..errors import check_whole
from ..interop.checks import FLOATS, check_image_size, check_numbers, check_tensor
from ..interop.derivatives import refuse_transforms
from ..interop.device_cache import device_cache
from ..interop.layouts import Tensors, as_floats
from .body_passes import BodyPasses
from .mesh import check_labels
from .mesh_passes import MeshPasses
from .options import check_target
from .part_mesh import MAX_LABEL
from .pictures import draw_maps, find_body_losses

ALL_PARTS = tuple(range(1, NUM_PARTS + 1))


class Seeing(NamedTuple):
    """Properties that all bodies of a batch, and their cameras, share.

    Attributes:
        perspective: Kind of the cameras.
        near_plane: Depth at or before which nothing is drawn [m].
        part_labels: Label that each part shows.
        locked: Parts that keep their rest rotation, as bits.
        half_size: Half of the crop's side, if the cameras' numbers are relative to a crop [px]. If it is 0, they are in
            pixels.
    """

    perspective: bool
    near_plane: float
    part_labels: tuple[int, ...]
    locked: int = 0
    half_size: float = 0.0


class CropBodies(Protocol):
    """Bodies in crops of side 2, as ``BodyParameters`` has them; rotations in any of the forms of ``pose``."""

    @property
    def orientation(self) -> torch.Tensor:
        """Global orientation."""

    @property
    def rotations(self) -> torch.Tensor:
        """Local rotations."""

    @property
    def lengths(self) -> torch.Tensor:
        """Shape (B, 12) [m]."""

    @property
    def thicknesses(self) -> torch.Tensor:
        """Shape (B, 15) [m]."""

    @property
    def log_scale(self) -> torch.Tensor:
        """Shape (B,)."""

    @property
    def shift(self) -> torch.Tensor:
        """Shape (B, 2)."""

    def posed(self) -> Posed:
        """Posed bodies, pelvis at the origin."""

    def camera(self, size: int) -> WeakPerspective:
        """Cameras for a crop of ``size`` pixels a side."""


class BodyLoss:
    """Mixin for renderers: L_seg and maps of bodies, with first derivatives, without a step between in torch."""

    def draw(self, *arguments: Any, **options: Any) -> Any:
        """Picture of posed bodies."""
        raise NotImplementedError

    def label_loss(self, *arguments: Any, **options: Any) -> tuple[torch.Tensor, Any]:
        """L_seg of posed bodies."""
        raise NotImplementedError

    def fixed(self, posed: Posed, camera: Camera) -> Self:
        """Renderer in which nothing depends on the bodies."""
        raise NotImplementedError

    def body_passes(self, seeing: Seeing, device: torch.device) -> BodyPasses:
        """Launches of a fixed renderer, of L_seg and of maps."""
        raise NotImplementedError

    def body_loss(
        self,
        parameters: Sequence[torch.Tensor],
        camera: Camera,
        target: torch.Tensor,
        *,
        part_labels: Sequence[int] = ALL_PARTS,
        validate: bool = True,
    ) -> torch.Tensor:
        """L_seg (paper, eq. 6) of bodies, the same as ``label_loss(pose(*parameters), camera, target)[0]``.

        Args:
            parameters: Arguments of ``pose``: global orientation, translation, rotations, lengths, thicknesses.
            camera: One a body, or one for all.
            target: Labels, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
            part_labels: Label that each part shows.
            validate: True looks for NaN, infinity and matrices that are no rotations. On CUDA, that waits for the
                device.

        Returns:
            The loss of each body [pixels of maps], shape (B,).

        Raises:
            ValueError: If ``pose`` or ``label_loss`` raises it.
            NotImplementedError: Under ``torch.func``, and in a second derivative.
        """
        refuse_transforms("body_loss", target)
        numbers = _check("body_loss", parameters, camera)
        lengths, labels = parameters[3], tuple(part_labels)
        check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
        check_image_size(target.shape[1:], len(lengths))
        check_target(target, ("lengths", lengths), len(lengths))
        passes, inputs = self._prepare_bodies(numbers, camera, labels, validate)
        if validate and isinstance(passes.renderer, MeshPasses) and not torch.compiler.is_compiling():
            check_labels(target, passes.renderer.num_labels)
        return find_body_losses(passes, inputs, target)[0]

    def body_maps(
        self,
        parameters: Sequence[torch.Tensor],
        camera: Camera,
        image_size: tuple[int, int],
        *,
        num_maps: int = NUM_PARTS,
        part_labels: Sequence[int] = ALL_PARTS,
        validate: bool = True,
    ) -> torch.Tensor:
        """Part maps of bodies, the same as ``draw(pose(*parameters), camera, image_size, num_maps=num_maps).maps``.

        Args:
            parameters: Parameters of the bodies as in ``body_loss``, as is all that is not named here.
            camera: Cameras, one for each body or one for all.
            image_size: Height and width (H, W) of the picture [px].
            num_maps: Number of maps K, 1 or more. Maps of the labels 1 to K are made.
            part_labels: Label that each part shows.
            validate: True looks for NaN, infinity and matrices that are no rotations. On CUDA, that waits for the
                device.

        Returns:
            The maps, shape (B, K, H, W), float32. Their gradient is the renderer's, and draws the bodies once more.

        Raises:
            ValueError: If ``pose`` or ``draw`` raises it.
            NotImplementedError: Under ``torch.func``, and in a second derivative.
        """
        numbers = _check("body_maps", parameters, camera)
        size, labels = check_image_size(image_size, len(parameters[3])), tuple(part_labels)
        num_maps = check_whole("num_maps", num_maps, 1, MAX_LABEL)
        passes, inputs = self._prepare_bodies(numbers, camera, labels, validate)
        return draw_maps(passes, inputs, size, num_maps)

    def _prepare_bodies(
        self, numbers: dict[str, torch.Tensor], camera: Camera, labels: tuple[int, ...], validate: bool
    ) -> tuple[BodyPasses, Tensors]:
        """Launches and their inputs, from what ``_check`` returned."""
        *parameters, intrinsics = numbers.values()
        if validate and not torch.compiler.is_compiling():
            check_numbers(numbers, rotations=matrices_of(parameters), positive=BODY_SIZES)
        fixed = self
        if getattr(self, "subdivisions", 0) == "auto":
            with torch.no_grad():
                fixed = self.fixed(pose_parts(*parameters), camera)
        passes = fixed.body_passes(Seeing(camera.perspective, camera.near_plane, labels), intrinsics.device)
        return passes, as_floats(intrinsics[:, :2], intrinsics[:, 2:], *parameters)

    def crop_loss(
        self, bodies: CropBodies, target: torch.Tensor, *, part_labels: Sequence[int] = ALL_PARTS
    ) -> torch.Tensor:
        """L_seg of bodies in square crops, as ``body_loss`` of a fixed renderer; their numbers are not looked at.

        A body with NaN, infinity, or a size of 0 or less has a loss and gradients of NaN.

        Args:
            bodies: ``BodyParameters``, whose hips don't turn, or what a network predicts.
            target: Labels, shape (B, S, S) or (1, S, S) for all, uint8.
            part_labels: Label that each part shows.

        Returns:
            The loss of each body [pixels of maps], shape (B,).

        Raises:
            ValueError: If the target has another shape, dtype or device, or the renderer's level is "auto".
        """
        labels, lengths = tuple(part_labels), bodies.lengths
        check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
        size = target.shape[-1]
        if target.shape[1] != size:
            raise ValueError(f"target: shape {tuple(target.shape)}; expected square crops, (B, S, S) or (1, S, S)")
        check_target(target, ("lengths", lengths), len(lengths))
        locked = LOCKED_BITS if bodies.rotations.dim() == 3 else 0
        passes = self.body_passes(Seeing(False, WeakPerspective.near, labels, locked, size / 2), lengths.device)
        pelvis = _origin(lengths.shape[0], lengths.device)
        inputs = as_floats(
            bodies.log_scale, bodies.shift, bodies.orientation, pelvis, bodies.rotations, lengths, bodies.thicknesses
        )
        return find_body_losses(passes, inputs, target)[0]


def _check(name: str, parameters: Sequence[torch.Tensor], camera: Camera) -> dict[str, torch.Tensor]:
    """Check parameters and camera of the function ``name``; return them by name, the camera's numbers last."""
    refuse_transforms(name, *parameters)
    check_parameters(parameters, dtypes=FLOATS)
    lengths = parameters[3]
    intrinsics = check_camera(camera, len(lengths), ("lengths", lengths)).expand(len(lengths), 4)
    refuse_transforms(name, intrinsics)
    return {**dict(zip(BODY_SHAPES, parameters, strict=True)), "camera": intrinsics}


@device_cache(64)
def _origin(batch: int, device: torch.device) -> torch.Tensor:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return torch.zeros(batch, 3, device=device)
