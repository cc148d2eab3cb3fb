"""Detailed body models: a skinned mesh whose shape, pose and parts have one interface, whatever the model.

Vertices follow the model's joints by linear blend skinning, differentiable in shape, pose and offsets. At rest, with
all rotations at identity, a model stands as it was made (Anny in an A-pose, SMPL in a T-pose) in the body frame: x to
the person's left, y up, z forward; metres. ``anny.py`` and ``load.py`` make models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from ..body.template import NUM_PARTS, PARENTS, PART_NAMES
from ..interop.checks import check_tensor
from ..interop.device_cache import device_cache
from ..interop.movable import Movable
from ..render.part_mesh import PartMesh
from .joint_chain import chain_joints, homogeneous
from .joint_maps import map_joints
from .skinning import blend_skin, carry_skin

# Parts that hang on the trunk, and those whose joints end their bones.
_LIMBS = {"neck": "head"} | {
    f"{side}_{part}": f"{side}_{end}"
    for part, end in (("upper_arm", "forearm"), ("upper_leg", "lower_leg"))
    for side in ("left", "right")
}
_SPREADING = 16  # rows of vertices, about, over which a part's stretch passes into the next one's


@dataclass(frozen=True, eq=False)
class Detailed(Movable):
    """Posed bodies, in the frame of the translation [m].

    Attributes:
        vertices: Vertices [m], shape (B, V, 3).
        joints: Joints [m], shape (B, J, 3).
        transforms: Each joint's frame, its rotation from rest and its position, shape (B, J, 4, 4).
    """

    vertices: torch.Tensor
    joints: torch.Tensor
    transforms: torch.Tensor

    def moved(self, by: torch.Tensor) -> Detailed:
        """The bodies elsewhere, by (B, 3) [m]."""
        transforms = self.transforms.clone()
        transforms[..., :3, 3] += by[:, None]
        return Detailed(self.vertices + by[:, None], self.joints + by[:, None], transforms)

    def select(self, index: torch.Tensor | slice) -> Detailed:
        """Some of the bodies."""
        return Detailed(*(tensor[index] for tensor in vars(self).values()))

    def split(self) -> list[Detailed]:
        """Each of the bodies alone."""
        return [Detailed(*own) for own in zip(*(tensor.split(1) for tensor in vars(self).values()), strict=True)]


@dataclass(frozen=True, eq=False)
class DetailedModel(Movable):
    """Body model of V vertices, F faces, J joints, S shape values and L landmarks.

    Attributes:
        name: Name of the model, such as "anny" or "smplx".
        joint_names: Names of the J joints.
        parents: Parent of each joint, -1 for the root, which is joint 0. A parent comes before its children.
        part_joints: Joint that carries each of the 20 parts. The two hips may share one.
        landmark_names: Names of the L landmarks: those of ``landmarks.py`` that the model has, and perhaps some of its
            own.
        faces: Vertex indices, shape (F, 3), int32.
        face_parts: Part label 1 to 20 of each face, shape (F,), uint8.
        rest_vertices: Vertices at rest for shape 0 [m], shape (V, 3).
        shape_directions: Change of the vertices by a unit of each shape value [m], shape (S, V, 3).
        rest_joints: Joints at rest for shape 0 [m], shape (J, 3).
        joint_directions: Change of the joints by a unit of each shape value [m], shape (S, J, 3).
        skin_weights: Weight of each joint in each vertex's motion, shape (V, J). Rows sum to 1.
        landmark_weights: Landmarks as linear functions of vertices and then joints, shape (L, V + J).
        pose_directions: Change of the vertices by the entries of (R - I) of all joints but the root [m], shape (9 (J -
            1), 3 V). It is None for a model without.
    """

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    part_joints: tuple[int, ...]
    landmark_names: tuple[str, ...]
    faces: torch.Tensor
    face_parts: torch.Tensor
    rest_vertices: torch.Tensor
    shape_directions: torch.Tensor
    rest_joints: torch.Tensor
    joint_directions: torch.Tensor
    skin_weights: torch.Tensor
    landmark_weights: torch.Tensor
    pose_directions: torch.Tensor | None = None

    @property
    def num_joints(self) -> int:
        """Number of joints, J."""
        return len(self.parents)

    @property
    def num_shapes(self) -> int:
        """Number of shape values, S."""
        return len(self.shape_directions)

    @property
    def num_vertices(self) -> int:
        """Number of vertices, V."""
        return len(self.rest_vertices)

    @property
    def bone_of_part(self) -> dict[str, str]:
        """Name of the joint that carries each of the 20 parts."""
        return {part: self.joint_names[joint] for part, joint in zip(PART_NAMES, self.part_joints, strict=True)}

    def rest(
        self, shape: torch.Tensor, offsets: torch.Tensor | None = None, *, stretches: torch.Tensor | None = None
    ) -> Detailed:
        """Bodies at rest, where the model has its origin.

        Args:
            shape: Shape values, shape (B, S).
            offsets: Offsets that are added to the vertices at rest [m], shape (B, V, 3).
            stretches: Stretch of each part about the joint that carries it, shape (B, 20, 3, 3). ``growth.py`` makes
                some. A part moves with its parent's stretch and does not inherit it.
        """
        self._check("shape", shape, None, self.num_shapes)
        vertices, joints = self._at_rest(shape, offsets, stretches)
        turns = torch.eye(3, dtype=joints.dtype, device=joints.device).expand(*joints.shape, 3)
        return Detailed(vertices, joints, homogeneous(turns, joints))

    def pose(
        self,
        shape: torch.Tensor,
        rotations: torch.Tensor,
        translation: torch.Tensor,
        *,
        offsets: torch.Tensor | None = None,
        stretches: torch.Tensor | None = None,
    ) -> Detailed:
        """Pose bodies; differentiable in every argument.

        Args:
            shape: Shape values, shape (B, S).
            rotations: Local rotation of each joint relative to its parent, in axes that are the body frame's at rest,
                shape (B, J, 3, 3). The root's rotation turns the whole body.
            translation: Position of the root joint [m], shape (B, 3).
            offsets: Offsets that are added to the vertices at rest [m], shape (B, V, 3).
            stretches: Stretch of each part at rest, as in ``rest``, shape (B, 20, 3, 3).

        Raises:
            ValueError: If a shape, dtype or device does not fit the model.
        """
        self._check("shape", shape, None, self.num_shapes)
        return self.carry(*self._at_rest(shape, offsets, stretches), rotations, translation)

    def carry(
        self, vertices: torch.Tensor, joints: torch.Tensor, rotations: torch.Tensor, translation: torch.Tensor
    ) -> Detailed:
        """Pose bodies whose vertices (B, V, 3) and joints (B, J, 3) at rest are known, with arguments of ``pose``."""
        batch = len(joints)
        self._check("rotations", rotations, batch, self.num_joints, 3, 3)
        self._check("translation", translation, batch, 3)
        if self.pose_directions is not None:
            bend = rotations[:, 1:] - torch.eye(3, dtype=joints.dtype, device=joints.device)
            vertices = vertices + (bend.flatten(1) @ self.pose_directions).unflatten(1, (-1, 3))
        transforms, places, maps = map_joints(self.parents, rotations, translation, joints)
        return Detailed(carry_skin(self.skin_weights, maps, vertices), places, transforms)

    def _at_rest(
        self, shape: torch.Tensor, offsets: torch.Tensor | None, stretches: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices and joints of ``rest``, without the joints' frames."""
        found = torch.addmm(self._rests, shape, self._directions).unflatten(1, (-1, 3))
        vertices, joints = found.split([self.num_vertices, self.num_joints], dim=1)
        if offsets is not None:
            self._check("offsets", offsets, shape.shape[0], self.num_vertices, 3)
            vertices = vertices + offsets
        if stretches is not None:
            self._check("stretches", stretches, shape.shape[0], NUM_PARTS, 3, 3)
            bones = joints[:, 1:] - joints[:, self._parents[1:]]
            bones = (stretches[:, self._joint_parts[self._parents[1:]]] @ bones[..., None])[..., 0]
            turns = torch.eye(3, dtype=joints.dtype, device=joints.device).expand(*joints.shape, 3)
            placed = torch.cat([joints[:, :1], bones], dim=1)
            stretched = chain_joints(self.parents, turns, placed)[..., :3, 3]
            places, carrying = stretched[:, self._carrying], joints[:, self._carrying]
            vertices = blend_skin(self.spread_weights, stretches, places, carrying, vertices)
            joints = stretched
        return vertices, joints

    def landmarks(self, detailed: Detailed, names: Sequence[str]) -> torch.Tensor:
        """Positions of landmarks, shape (B, L, 3) [m].

        Raises:
            ValueError: If the model has no landmark of a name.
        """
        return weigh_points(self.weights_of(names), torch.cat([detailed.vertices, detailed.joints], dim=1))

    def weights_of(self, names: Sequence[str]) -> torch.Tensor:
        """Weights of landmarks over vertices and joints, shape (L, V + J), kept, with the errors of ``landmarks``."""
        if unknown := ", ".join(repr(name) for name in names if name not in self.landmark_names):
            known = ", ".join(self.landmark_names)
            raise ValueError(f"names: {self.name} has no landmark {unknown}; expected some of {known}")
        return _landmark_rows(self, tuple(names))

    def rest_landmarks(self, shape: torch.Tensor, names: Sequence[str]) -> tuple[torch.Tensor, torch.Tensor]:
        """Landmarks (B, L, 3) and joints (B, J, 3) of ``rest``, without vertices, with the errors of ``landmarks``."""
        self._check("shape", shape, None, self.num_shapes)
        rests, directions = _rest_rows(self, tuple(names))
        found = torch.addmm(rests, shape, directions).unflatten(1, (-1, 3))
        landmarks, joints = found.split([len(names), self.num_joints], dim=1)
        return landmarks, joints

    @cached_property
    def _rests(self) -> torch.Tensor:
        """Vertices, then joints, of shape 0 in a row, shape (3 (V + J),); CUDA adds a vector within the product."""
        return torch.cat([self.rest_vertices, self.rest_joints]).flatten()

    @cached_property
    def _directions(self) -> torch.Tensor:
        """Changes of vertices and joints by a unit of each shape value, shape (S, 3 (V + J)): one product for both."""
        return torch.cat([self.shape_directions, self.joint_directions], dim=1).flatten(1)

    @cached_property
    def _parents(self) -> torch.Tensor:
        return torch.tensor(self.parents, device=self.faces.device)

    @cached_property
    def _carrying(self) -> torch.Tensor:
        return torch.tensor(self.part_joints, device=self.faces.device)

    @cached_property
    def _joint_parts(self) -> torch.Tensor:
        """Part 0 to 19 of each joint: the one that it carries, else its parent's, shape (J,)."""
        parts: list[int] = []
        for joint, parent in enumerate(self.parents):
            inherited = 0 if parent < 0 else parts[parent]
            parts.append(self.part_joints.index(joint) if joint in self.part_joints else inherited)
        return torch.tensor(parts, device=self.faces.device)

    @cached_property
    def spread_weights(self) -> torch.Tensor:
        """Share of each part in each vertex' stretch or clothes, shape (V, 20): skin weights, spread over the mesh.

        Skin weights change within two or three rows of vertices, where a thicker part would end in a step.
        """
        corners = self.faces.long()
        pairs = torch.stack([corners.flatten(), corners.roll(1, 1).flatten()])
        alone = torch.arange(self.num_vertices, device=corners.device).expand(2, -1)
        pairs = unique_pairs(torch.cat([pairs, pairs.flip(0), alone], dim=1), self.num_vertices)
        counts = torch.bincount(pairs[0], minlength=self.num_vertices)
        starts = counts.cumsum(0) - counts  # of the neighbours of each vertex
        weights = self.skin_weights @ torch.nn.functional.one_hot(self._joint_parts, NUM_PARTS).to(self.skin_weights)
        for _ in range(_SPREADING):
            sums = torch.nn.functional.embedding_bag(pairs[1], weights, starts, mode="sum")
            weights = sums / counts[:, None]
        return weights

    def _check(self, name: str, tensor: torch.Tensor, *shape: int | None) -> None:
        like = self.rest_vertices
        check_tensor(name, tensor, shape, dtypes=(like.dtype,), like=(self.name, like))


def unique_pairs(pairs: torch.Tensor, count: int) -> torch.Tensor:
    """Each pair once, in rising order.

    Args:
        pairs: Pairs of whole numbers from 0 to ``count`` - 1, shape (2, P), int64.
        count: Number that all of them are less than.

    Returns:
        Pairs, shape (2, U), int64.
    """
    # One number stands for a pair: torch sorts numbers forty times as fast as columns.
    keys = (pairs[0] * count + pairs[1]).unique()
    return torch.stack([keys // count, keys % count])


def weigh_points(weights: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Weights (L, N) times points of B bodies (B, N, 3), shape (B, L, 3)."""
    if points.is_cuda:  # one product for all; on the CPU one a body is as quick
        return torch.nn.functional.linear(points.mT.contiguous(), weights).mT.contiguous()
    return weights @ points


@device_cache(16)  # a copy of a megabyte
def _landmark_rows(model: DetailedModel, names: tuple[str, ...]) -> torch.Tensor:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return model.landmark_weights[[model.landmark_names.index(name) for name in names]]


@device_cache(16)
def _rest_rows(model: DetailedModel, names: tuple[str, ...]) -> tuple[torch.Tensor, torch.Tensor]:
    """Landmarks, then joints, of shape 0 in a row, (3 (L + J),), and their changes by shape values, (S, 3 (L + J))."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        every = torch.cat([model._rests[None], model._directions]).unflatten(1, (-1, 3))
        found = model.weights_of(names).double() @ every.double()  # exact, whatever products of float32 are allowed
        rests, *directions = torch.cat([found.to(every), every[:, model.num_vertices :]], dim=1).flatten(1)
        return rests, torch.stack(directions)


@device_cache(8)  # its edges take a moment to find
def detailed_mesh(model: DetailedModel, at_joints: bool = False) -> PartMesh:
    """Make the mesh of a detailed model with labels 1 to 20, on the model's device.

    ``draw_mesh`` and ``mesh_label_loss`` draw it with ``detailed.vertices``, and their gradients reach shape and
    rotations. The mesh's ``relabel`` shows another set of parts.

    Args:
        model: The model.
        at_joints: True lets neck, arms and legs begin at their joints. By default they begin where the skin follows
            them, which for a limb is far inside of the trunk.

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, anny, detailed_mesh, draw_mesh, pose_from_ellipbody
        >>> model, body = anny(), BodyParameters.mean(1)
        >>> shape = torch.zeros(1, model.num_shapes)
        >>> detailed = model.pose(shape, *pose_from_ellipbody(model, body.posed(), shape))
        >>> picture = draw_mesh(detailed.vertices, detailed_mesh(model), body.camera(128), (128, 128))
        >>> picture.labels.shape, picture.labels.unique().numel()  # background and 20 parts
        (torch.Size([1, 128, 128]), 21)
    """
    parts = (parts_at_joints(model) if at_joints else model.face_parts).cpu().numpy()
    faces = model.faces.cpu().numpy()
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return PartMesh.from_faces(faces, parts, device=model.faces.device)


def parts_at_joints(model: DetailedModel) -> torch.Tensor:
    """Part label of each face where neck, arms and legs begin at their joints, shape (F,), uint8.

    Skin follows a limb from far inside of the trunk on. Those of its faces whose middle is before the plane through the
    limb's joint, across its bone at rest, are the part's that it hangs on.
    """
    labels, middles = model.face_parts.clone(), model.rest_vertices[model.faces.long()].mean(1)
    for part, end in _LIMBS.items():
        label = PART_NAMES.index(part) + 1
        start, stop = (model.rest_joints[model.part_joints[PART_NAMES.index(name)]] for name in (part, end))
        before = (model.face_parts == label) & ((middles - start) @ (stop - start) < 0)
        labels[before] = PARENTS[label - 1] + 1
    return labels
