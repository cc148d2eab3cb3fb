"""EllipBody: 20 posed ellipsoids, kept as Warp arrays on any device (paper, section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import warp as wp

from ..errors import check_whole
from ..interop.device_cache import device_cache
from ..interop.movable import Movable
from ..kernels import kinematics
from .icosphere import icosphere
from .template import (
    BODY_SHAPES,
    BODY_SIZES,
    NUM_JOINTS,
    NUM_PARTS,
    PARENTS,
    PART_NAMES,
    SHAPE_INDICES,
    THICKNESS_NAMES,
    subtree_masks,
    template,
)

if TYPE_CHECKING:
    import torch

DEFAULT_SUBDIVISIONS = 1  # E1, the paper's default (section 4.3, "Speed of Part Differentiable Renderer")

_PRECISIONS = {wp.float32: (wp.vec3f, wp.mat33f), wp.float64: (wp.vec3d, wp.mat33d)}


@device_cache(32, typed=True)
def bone_tree(device: str, dtype: type = wp.float32, subdivisions: int = DEFAULT_SUBDIVISIONS) -> kinematics.BoneTree:
    """The template's arrays on ``device`` (a Warp device alias such as ``"cuda:0"``) in ``dtype``."""
    vec, mat = _PRECISIONS[dtype]
    constants = template()
    vertices, _ = icosphere(subdivisions)
    levels: list[int] = []
    for parent in PARENTS:
        levels.append(0 if parent < 0 else levels[parent] + 1)
    subtrees = subtree_masks()[:-1]
    bones = (
        wp.array(PARENTS, dtype=int, device=device),
        wp.array(SHAPE_INDICES, dtype=wp.vec3i, device=device),
        wp.array(constants.rest_directions, dtype=vec, device=device),
        wp.array(constants.rest_axes, dtype=mat, device=device),
        wp.array(levels, dtype=int, device=device),
        wp.array(subtrees, dtype=int, device=device),
    )
    return kinematics.BoneTree(bones, max(levels) + 1, wp.array(vertices, dtype=vec, device=device))


@lru_cache(maxsize=4, typed=True)
def ellipbody_faces(subdivisions: int = DEFAULT_SUBDIVISIONS) -> tuple[np.ndarray, np.ndarray]:
    """Faces of all 20 ellipsoids, (20 F, 3) int32, and the part label 1 to 20 of each, (20 F,) uint8."""
    vertices, faces = icosphere(subdivisions)
    offsets = np.arange(NUM_PARTS, dtype=np.int32)[:, None, None] * len(vertices)
    labels = np.repeat(np.arange(1, NUM_PARTS + 1, dtype=np.uint8), len(faces))
    return (faces[None] + offsets).reshape(-1, 3), labels


class WarpArrays(Movable):
    """Mixin for a dataclass of Warp arrays: views and copies of them, pickling and deep copies."""

    def torch(self) -> dict[str, torch.Tensor]:
        """Views as torch tensors, such as rotations (B, 20, 3, 3): writing to one changes the body."""
        return {field.name: wp.to_torch(getattr(self, field.name)) for field in fields(self)}

    def numpy(self) -> dict[str, np.ndarray]:
        """Copies on the host."""
        return {field.name: getattr(self, field.name).numpy() for field in fields(self)}

    def __copy__(self) -> Self:
        return replace(self)  # over the same memory, as tensors' copies are

    def __getstate__(self) -> dict[str, Any]:
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: (array.numpy(), array.dtype, array.device.alias) for name, array in arrays.items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, (values, dtype, device) in state.items():
            self.__dict__[name] = wp.array(values, dtype=dtype, device=device)


@dataclass(frozen=True)
class PosedEllipBody(WarpArrays):
    """Joints, ellipsoids and meshes of posed bodies, in the frame of ``translation`` (camera or world) [m].

    Attributes:
        joints: ``JOINT_NAMES``, shape (B, 21), vec3.
        rotations: Global rotation of each bone, shape (B, 20), mat33.
        centres: Ellipsoid centres, shape (B, 20), vec3.
        axes: Ellipsoid axes as columns (bone, first thickness, second thickness), shape (B, 20), mat33.
        semi_axes: Half of length and thicknesses, shape (B, 20), vec3.
        vertices: Mesh vertices, shape (B, 20, N), vec3.
    """

    joints: wp.array
    rotations: wp.array
    centres: wp.array
    axes: wp.array
    semi_axes: wp.array
    vertices: wp.array


@dataclass
class EllipBody(WarpArrays):
    """Batch of B bodies by their parameters; ``pose`` computes joints, ellipsoids and meshes.

    Attributes:
        global_orient: Rotation of the whole body, shape (B,), mat33.
        translation: Position of the pelvis [m], shape (B,), vec3.
        rotations: Local rotation of each bone with respect to its parent, shape (B, 20), mat33.
        lengths: Lengths ``LENGTH_NAMES`` [m], shape (B, 12).
        thicknesses: Thicknesses ``THICKNESS_NAMES`` [m], full widths, shape (B, 15).

    Examples:
        >>> from warp_partdr import EllipBody
        >>> body = EllipBody.mean(batch_size=2)
        >>> body.torch()["lengths"][1] *= 1.1  # the second body's bones are 10 % longer
        >>> body.pose().torch()["joints"].shape
        torch.Size([2, 21, 3])
        >>> f"{body.measure(0)['left forearm length']:.2f} m, {body.measure(1)['left forearm length']:.2f} m"
        '0.23 m, 0.25 m'
    """

    global_orient: wp.array
    translation: wp.array
    rotations: wp.array
    lengths: wp.array
    thicknesses: wp.array

    @classmethod
    def mean(cls, batch_size: int = 1, *, device: str | None = None, dtype: type = wp.float32) -> EllipBody:
        """Mean adults in the rest pose at the origin.

        Args:
            batch_size: B; 0 is fine.
            device: Warp device; the current one by default.
            dtype: ``warp.float32`` or ``warp.float64``.

        Examples:
            >>> from warp_partdr import EllipBody
            >>> EllipBody.mean(batch_size=3).lengths.shape
            (3, 12)
        """
        batch_size = check_whole("batch_size", batch_size, 0)
        constants = template()
        identity = np.eye(3)
        return cls.from_numpy(
            global_orient=np.tile(identity, (batch_size, 1, 1)),
            translation=np.zeros((batch_size, 3)),
            rotations=np.tile(identity, (batch_size, NUM_PARTS, 1, 1)),
            lengths=np.tile(constants.mean_lengths, (batch_size, 1)),
            thicknesses=np.tile(constants.mean_thicknesses, (batch_size, 1)),
            device=device,
            dtype=dtype,
        )

    @classmethod
    def from_numpy(
        cls,
        *,
        global_orient: np.ndarray,
        translation: np.ndarray,
        rotations: np.ndarray,
        lengths: np.ndarray,
        thicknesses: np.ndarray,
        device: str | None = None,
        dtype: type = wp.float32,
    ) -> EllipBody:
        """Copy arrays of shape (B, 3, 3), (B, 3), (B, 20, 3, 3), (B, 12) and (B, 15) to a device.

        Raises:
            ValueError: If a shape differs, a value is not finite or beyond 1e12, a rotation is none, or a size is not
                positive.

        Examples:
            >>> import numpy as np
            >>> from warp_partdr import EllipBody
            >>> arrays = EllipBody.mean().numpy()
            >>> arrays["translation"] = np.array([[0.0, 0.0, 4.0]])
            >>> EllipBody.from_numpy(**arrays).pose().numpy()["joints"][0, 0]
            array([0., 0., 4.], dtype=float32)
        """
        import torch  # only where bodies come from outside: the rest of this module needs Warp alone

        from ..interop.checks import check_numbers

        if dtype not in _PRECISIONS:
            raise ValueError(f"dtype: {dtype}; expected warp.float32 or warp.float64")
        vec, mat = _PRECISIONS[dtype]
        batch = len(np.atleast_1d(global_orient))
        given = [np.asarray(value) for value in (global_orient, translation, rotations, lengths, thicknesses)]
        for (name, shape), value in zip(BODY_SHAPES.items(), given, strict=True):
            if value.shape != (batch, *shape):
                raise ValueError(f"{name}: shape {value.shape}; expected {(batch, *shape)}")
            if value.dtype.kind not in "fiu":
                raise ValueError(f"{name}: {value.dtype}; expected numbers")
        numbers = [torch.from_numpy(value.astype(np.float64)) for value in given]
        named = dict(zip(BODY_SHAPES, numbers, strict=True))
        check_numbers(named, rotations=("global_orient", "rotations"), positive=BODY_SIZES)
        kinds = (mat, vec, mat, dtype, dtype)
        return cls(*(wp.array(value, dtype=kind, device=device) for value, kind in zip(given, kinds, strict=True)))

    @property
    def batch_size(self) -> int:
        """Number of bodies, B."""
        return self.lengths.shape[0]

    @property
    def device(self) -> wp.Device:
        """Device of the arrays."""
        return self.lengths.device

    def pose(self, *, subdivisions: int = DEFAULT_SUBDIVISIONS) -> PosedEllipBody:
        """Joints, ellipsoids and mesh vertices of all bodies.

        Args:
            subdivisions: Level of the mesh, 0 to 3: 20, 80, 320 or 1280 faces for each ellipsoid.

        Examples:
            >>> from warp_partdr import EllipBody
            >>> posed = EllipBody.mean().pose(subdivisions=2).torch()
            >>> posed["vertices"].shape
            torch.Size([1, 20, 162, 3])
        """
        tree = bone_tree(self.device.alias, self.lengths.dtype, subdivisions)
        vec, mat = _PRECISIONS[self.lengths.dtype]
        shape = (self.batch_size, NUM_PARTS)
        posed = PosedEllipBody(
            joints=wp.empty((self.batch_size, NUM_JOINTS), dtype=vec, device=self.device),
            rotations=wp.empty(shape, dtype=mat, device=self.device),
            centres=wp.empty(shape, dtype=vec, device=self.device),
            axes=wp.empty(shape, dtype=mat, device=self.device),
            semi_axes=wp.empty(shape, dtype=vec, device=self.device),
            vertices=wp.empty((*shape, tree.unit_vertices.shape[0]), dtype=vec, device=self.device),
        )
        parameters = [self.global_orient, self.translation, self.rotations, self.lengths, self.thicknesses]
        bones = [posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes]
        kinematics.launch_pose(tree, parameters, bones)
        kinematics.launch_vertices(tree, bones[2:], posed.vertices)
        return posed

    def measure(self, index: int = 0) -> dict[str, float]:
        """Every length and thickness of one body by name [m], such as ``{"left forearm length": 0.26}``.

        Raises:
            ValueError: If there is no body ``index``.

        Examples:
            >>> from warp_partdr import EllipBody
            >>> sizes = EllipBody.mean().measure()
            >>> len(sizes), f"{sizes['head length']:.2f} m"
            (48, '0.18 m')
        """
        index = check_whole("index", index, 0, self.batch_size - 1)
        lengths, thicknesses = self.lengths.numpy()[index], self.thicknesses.numpy()[index]
        measured: dict[str, float] = {}
        for part, (length, first, second) in zip(PART_NAMES, SHAPE_INDICES, strict=True):
            name = part.replace("_", " ")
            measured[f"{name} length"] = float(lengths[length])
            for thickness in dict.fromkeys((first, second)):
                # "left foot width" reads better than "left foot foot width"
                kind = THICKNESS_NAMES[thickness].split()[-1]
                measured[f"{name} {kind}"] = float(thicknesses[thickness])
        return measured
