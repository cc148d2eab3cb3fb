"""PartDR on torch tensors: part images of a mesh and their approximate gradients (paper, section 3.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..cameras import Camera, ScreenCamera, check_camera
from ..errors import check_type, check_whole
from ..interop.checks import FLOATS, check_image_size, check_numbers, check_tensor
from ..interop.derivatives import refuse_transforms
from . import compiled as compiled  # registers the operations for torch.compile
from .mesh_passes import MeshPasses, mesh_passes
from .options import DEFAULT_DEPTH_WEIGHT, IGNORE_LABEL, MeshGradient, check_mesh_rule, check_target
from .part_mesh import MAX_LABEL, PartMesh, mesh_constants
from .pictures import DrawnLater, draw_picture, find_loss


@dataclass(frozen=True)
class PartImage(DrawnLater):
    """Picture of B bodies' meshes.

    Attributes:
        labels: Part at each pixel, 0 = background, shape (B, H, W), uint8.
        depth: Depth of the nearest face [m], inf = background, shape (B, H, W), float32.
        face_index: Nearest face, -1 = background (paper, eq. 8), shape (B, H, W), int32.
        maps: Part maps A^1 to A^K (paper, eq. 9), differentiable, shape (B, K, H, W); None unless asked for.
    """

    labels: torch.Tensor
    depth: torch.Tensor
    face_index: torch.Tensor
    maps: torch.Tensor | None = None


def draw_mesh(
    vertices: torch.Tensor,
    mesh: PartMesh,
    camera: Camera | ScreenCamera,
    image_size: tuple[int, int],
    *,
    num_maps: int = 0,
    gradient: MeshGradient = "partdr",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    validate: bool = True,
) -> PartImage:
    """Draw a part-labelled mesh; with ``num_maps`` the part maps carry gradients back to vertices and camera.

    Gradients are first ones: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.
    Pictures and gradients are the same to the bit in every run on one device. A gradient of the maps that holds NaN or
    infinity makes that of the vertices NaN, for the whole body.

    Args:
        vertices: Vertices in the camera frame [m], shape (B, V, 3). A face with a vertex at or before the camera's near
            plane is not drawn.
        mesh: Topology and labels, on the same device.
        camera: Weak-perspective or perspective cameras, one for each body or one for all. ``ScreenCamera`` is for
            vertices that are in the picture already.
        image_size: Height and width (H, W) of the picture [px]. It need not be square.
        num_maps: Number of maps K. Part maps of the labels 1 to K are made. If it is 0, none are made, and nothing has
            a gradient.
        gradient: Kind of gradient. "partdr" is the paper's rule. "edges" is the derivative of the covered area, sampled
            between each two pixels that show different labels, in the picture's plane alone.
        max_distance: Greatest distance from an edge for "partdr": pixels farther away do not move it [px]. The paper
            has no limit, which finds far targets. Near the target, a few pixels come closer to the true derivative of
            the covered area.
        depth_weight: Lambda of the paper's z gradient (eq. 12) for "partdr". If it is 0, z has no gradient.
        validate: True looks for NaN and infinity. On CUDA, that waits for the device.

    Returns:
        The picture. The gradient of the maps is an estimate: linear in the incoming gradient, not the derivative of
        the step function.

    Raises:
        ValueError: If a shape, size, dtype or option is wrong, devices differ, or a number is NaN or infinite.
        NotImplementedError: Under ``torch.func``, and in a second derivative.

    Examples:
        >>> from warp_partdr import BodyParameters, draw_mesh, ellipbody_mesh
        >>> body = BodyParameters.mean(1).leaves()
        >>> image = draw_mesh(body.posed().vertices(1), ellipbody_mesh(1), body.camera(128), (128, 128), num_maps=20)
        >>> image.labels.shape, image.maps.shape
        (torch.Size([1, 128, 128]), torch.Size([1, 20, 128, 128]))
        >>> image.maps[:, 7].sum().backward()  # the head's map: any loss of the maps has a gradient
        >>> body.lengths.grad.shape
        torch.Size([1, 12])
    """
    rule = check_mesh_rule(gradient, max_distance, depth_weight)
    passes, screen = _project("draw_mesh", vertices, mesh, camera, rule, validate)
    size = check_image_size(image_size, vertices.shape[0])
    num_maps = check_whole("num_maps", num_maps, 0, MAX_LABEL)
    return draw_picture(PartImage, passes, (screen,), size, num_maps)


def mesh_label_loss(
    vertices: torch.Tensor,
    mesh: PartMesh,
    camera: Camera | ScreenCamera,
    target: torch.Tensor,
    *,
    gradient: MeshGradient = "partdr",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    validate: bool = True,
) -> tuple[torch.Tensor, PartImage]:
    """L_seg (paper, eq. 6) against a label image, and its gradient, without making part maps.

    It is a first one: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.

    Args:
        vertices: Vertices in the camera frame [m], shape (B, V, 3).
        mesh: Topology and labels, on the same device.
        camera: Cameras as in ``draw_mesh``, as is all that is not named here.
        target: Target label of each pixel, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
        gradient: Kind of gradient, "partdr" or "edges".
        max_distance: Greatest distance from an edge for "partdr": pixels farther away do not move it [px].
        depth_weight: Lambda of the paper's z gradient for "partdr".
        validate: True looks for NaN, infinity and labels that the mesh does not have.

    Returns:
        The loss of each body [pixels of maps], shape (B,), and the picture, which is drawn when it is first looked at.

    Raises:
        ValueError: If ``draw_mesh`` raises it, or if ``target`` does not fit the batch.
        NotImplementedError: If ``draw_mesh`` raises it.

    Examples:
        >>> from warp_partdr import BodyParameters, draw_mesh, ellipbody_mesh, mesh_label_loss
        >>> body, mesh = BodyParameters.mean(1), ellipbody_mesh(1)
        >>> vertices, camera = body.posed().vertices(1).requires_grad_(), body.camera(128)
        >>> target = draw_mesh(vertices, mesh, camera, (128, 128)).labels.roll(3, dims=2)  # 3 px to the right
        >>> loss, image = mesh_label_loss(vertices, mesh, camera, target)
        >>> loss.sum().backward()
        >>> bool(vertices.grad[..., 0].sum() < 0)  # so a step of descent moves the body to the right
        True
    """
    refuse_transforms("mesh_label_loss", target)
    check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
    rule = check_mesh_rule(gradient, max_distance, depth_weight)
    passes, screen = _project("mesh_label_loss", vertices, mesh, camera, rule, validate)
    check_image_size(target.shape[1:], vertices.shape[0])
    check_target(target, ("vertices", vertices), vertices.shape[0])
    if validate and not torch.compiler.is_compiling():
        check_labels(target, mesh.num_labels)
    return find_loss(PartImage, passes, (screen,), target)


def check_labels(target: torch.Tensor, num_labels: int) -> None:
    """Raise ValueError if a label image shows what a mesh has not; waits for the device."""
    strange = (target > num_labels) & (target != IGNORE_LABEL)
    if strange.any():
        label = int(target[strange][0])
        raise ValueError(f"target: label {label}; expected 0 to {num_labels}, or {IGNORE_LABEL} = ignore")


def _project(
    name: str,
    vertices: torch.Tensor,
    mesh: PartMesh,
    camera: Camera | ScreenCamera,
    rule: tuple[float, float, MeshGradient],
    validate: bool,
) -> tuple[MeshPasses, torch.Tensor]:
    """Check what both entry points share (``name`` is the one called); return passes and vertices on the screen."""
    refuse_transforms(name, vertices)
    check_type("mesh", mesh, PartMesh, "such as ellipbody_mesh()")
    check_tensor("vertices", vertices, (None, None, 3), dtypes=FLOATS)
    given = {"vertices": vertices}
    if not isinstance(camera, ScreenCamera):
        given["camera"] = check_camera(camera, vertices.shape[0], ("vertices", vertices))
        refuse_transforms(name, given["camera"])
    if mesh.faces.device != vertices.device:
        raise ValueError(f"mesh: on {mesh.faces.device}; expected {vertices.device}, as vertices; use mesh.to(device)")
    if mesh.num_vertices > vertices.shape[1]:
        raise ValueError(f"vertices: {vertices.shape[1]} a body; expected {mesh.num_vertices} or more, as the mesh")
    screen = camera.project(vertices)
    if validate and not torch.compiler.is_compiling():
        check_numbers({**given, "projected vertices": screen})
    options = camera.perspective, camera.near_plane, *rule
    return mesh_passes(*mesh_constants(mesh), *options), screen.float()
