"""Make the packaged example: a picture of an Anny person, its part labels, its keypoints and the truth behind them.

    python scripts/make_example.py [FOLDER]

A woman walks, turned a little to her left; the right forearm that she holds before her hides part of her torso.
Nothing is random: the same Anny package gives the same files.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from anny_person import Person, PersonFactory, write_json
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import Perspective
from warp_partdr.lab.harness import run_script
from warp_partdr.models.anny import anny
from warp_partdr.models.model import parts_at_joints
from warp_partdr.models.normals import vertex_normals
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh

EXAMPLE = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "example"
IMAGE_SIZE = (512, 384)  # (H, W)
FOCAL = 1000.0  # [px]
DISTANCE = 4.0  # [m]
CAMERA_HEIGHT = 0.92  # [m] above the floor; the camera looks level
SUPERSAMPLING = 4  # of the picture; labels are those of the pixels' centres

PHENOTYPE = {"gender": 0.9, "age": 0.6, "muscle": 0.5, "weight": 0.55, "height": 0.58, "proportions": 0.6}
BODY_YAW = 28.0  # [deg] of the whole body to its left: she walks to the picture's right
# Direction of each bone: (to the person's left, up, forward), before the yaw.
DIRECTIONS: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("upperleg01.L", "lowerleg01.L", (0.03, -0.945, 0.33)),
    ("lowerleg01.L", "foot.L", (0.01, -1.0, 0.04)),
    ("upperleg01.R", "lowerleg01.R", (-0.03, -0.955, -0.27)),
    ("lowerleg01.R", "foot.R", (0.01, -0.79, -0.61)),
    ("upperarm01.L", "lowerarm01.L", (0.28, -0.91, -0.30)),
    ("lowerarm01.L", "wrist.L", (0.17, -0.98, 0.02)),
    ("upperarm01.R", "lowerarm01.R", (-0.33, -0.86, 0.40)),
    ("lowerarm01.R", "wrist.R", (0.72, 0.42, 0.55)),
)
# Turns about the body's own axes (x: nod forward, y: to the left, z: toward the right) [deg], on top of the parent's.
TURNS: dict[str, tuple[float, float, float]] = {
    "spine03": (4.0, 4.0, 0.0),
    "neck01": (9.0, -5.0, 0.0),
    "head": (9.0, -8.0, 0.0),
}

LABELS = label_set("cdcl14")

# Colours (sRGB, 0 to 1) of what she wears, and the light's direction in the camera frame, from her to the lamp.
SKIN, HAIR, SHIRT, TROUSERS = (
    np.array(colour) / 255 for colour in ((222, 172, 142), (74, 50, 38), (196, 92, 74), (58, 74, 108))
)
WALL_TOP, WALL_BOTTOM, FLOOR_FAR, FLOOR_NEAR = (
    np.array(colour) / 255 for colour in ((206, 214, 220), (228, 230, 228), (170, 160, 148), (196, 186, 172))
)
HORIZON = 0.72  # of the picture's height: where the wall meets the floor
LIGHT = np.array([0.42, -0.60, -0.68])
LIGHT /= np.linalg.norm(LIGHT)


def rotation(degrees: tuple[float, float, float]) -> np.ndarray:
    """Turn about y, after z, after x, shape (3, 3)."""
    about_x, about_y, about_z = rotation_from_axis_angle(torch.from_numpy(np.diag(np.radians(degrees)))).numpy()
    return about_y @ about_z @ about_x


def posed_person(factory: PersonFactory) -> tuple[Person, Person]:
    """The person in Anny's rest pose and walking, body frame."""
    rest = factory(phenotype=PHENOTYPE)
    turns: dict[str, np.ndarray] = {}
    for bone, degrees in TURNS.items():
        turns[bone] = factory.turn_of_parent(bone, turns) @ rotation(degrees)
    for bone, end, direction in DIRECTIONS:
        factory.aim(rest, turns, bone, end, np.array(direction))
    return rest, factory(turns, PHENOTYPE)


def camera_from_body(person: Person) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation [m] that stand the person on the floor before the camera."""
    facing = np.diag([1.0, -1.0, -1.0]) @ rotation((0.0, BODY_YAW, 0.0))
    turned = person.vertices @ facing.T
    low, high = turned.min(0), turned.max(0)
    return facing, np.array([-(low[0] + high[0]) / 2, CAMERA_HEIGHT - high[1], DISTANCE - (low[2] + high[2]) / 2])


def scaled_camera(factor: int = 1) -> Perspective:
    """The camera, for a picture ``factor`` times as large."""
    height, width = IMAGE_SIZE
    focal = torch.full((1, 2), FOCAL * factor, dtype=torch.float64)
    return Perspective(focal, torch.tensor([[width / 2, height / 2]], dtype=torch.float64) * factor)


def draw(points: np.ndarray, mesh: PartMesh, factor: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels, nearest face (-1 = none) and the weights of its corners, shapes (H, W), (H, W) and (H, W, 3)."""
    camera = scaled_camera(factor)
    screen = camera.project(torch.from_numpy(points)[None])
    height, width = (factor * size for size in IMAGE_SIZE)
    picture = draw_mesh(torch.from_numpy(points)[None], mesh, camera, (height, width))
    face_index = picture.face_index[0].numpy()
    corners = screen[0].numpy()[mesh.faces.numpy()[np.maximum(face_index, 0)]]  # (H, W, 3 corners, 3)
    v, u = np.mgrid[:height, :width] + 0.5
    du, dv = corners[..., 0] - u[..., None], corners[..., 1] - v[..., None]
    areas = np.roll(du, -1, -1) * np.roll(dv, -2, -1) - np.roll(du, -2, -1) * np.roll(dv, -1, -1)
    weights = areas / corners[..., 2]  # perspective-correct
    return picture.labels[0].numpy(), face_index, weights / weights.sum(-1, keepdims=True)


def interpolate(values: np.ndarray, faces: np.ndarray, face_index: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Values at vertices, shape (V, 3), to those at pixels, shape (H, W, 3)."""
    return np.einsum("hwc,hwcd->hwd", weights, values[faces[np.maximum(face_index, 0)]])


def clothing(rest: Person, rest_points: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Colour at pixels, shape (H, W, 3), from where they lie on the body in its rest pose and from their part."""
    x, y, z = np.moveaxis(rest_points, -1, 0)
    colour = np.broadcast_to(SKIN, rest_points.shape).copy()
    shoulder, elbow = rest.bones["upperarm01.L"], rest.bones["lowerarm01.L"]
    outward = np.stack([np.abs(x), y, z], axis=-1) - shoulder  # Both arms as the left one.
    along = outward @ (elbow - shoulder) / np.sum((elbow - shoulder) ** 2)
    is_arm = np.isin(parts, [k for k, name in enumerate(PART_NAMES) if name.endswith(("arm", "hand"))])
    waist, ankle = rest.bones["spine05"][1] + 0.06, rest.bones["foot.L"][1]
    collar = rest.bones["neck01"][1] - 0.01 - 0.35 * (z - rest.bones["neck01"][2])
    colour[np.where(is_arm, along < 0.72, (y > waist) & (y < collar) & (parts != PART_NAMES.index("head")))] = SHIRT
    colour[~is_arm & (y < waist) & (y > ankle + 0.02)] = TROUSERS
    eye, ear = rest.coco["left_eye"], rest.coco["left_ear"]
    is_hair = (y > eye[1] + 0.045 + 0.3 * np.abs(x)) | ((z < ear[2] + 0.012) & (y > ear[1] - 0.045))
    colour[(parts == PART_NAMES.index("head")) & is_hair] = HAIR
    return colour


def background(size: tuple[int, int], feet: np.ndarray, floor: float) -> np.ndarray:
    """A wall, a floor and the feet's soft shadows, shape (H, W, 3); ``feet`` (2, 3) and ``floor`` (y) in metres."""
    height, width = size
    factor = height / IMAGE_SIZE[0]
    v, u = (np.mgrid[:height, :width] + 0.5) / factor
    t = v[..., None] / IMAGE_SIZE[0]
    wall = WALL_TOP + (WALL_BOTTOM - WALL_TOP) * t / HORIZON
    ground = FLOOR_FAR + (FLOOR_NEAR - FLOOR_FAR) * (t - HORIZON) / (1 - HORIZON)
    # Where the ray through a pixel meets the floor.
    z = floor * FOCAL / np.maximum(v - IMAGE_SIZE[0] / 2, 1.0)
    x = (u - IMAGE_SIZE[1] / 2) * z / FOCAL
    for foot in feet:
        distance = ((x - foot[0]) / 0.12) ** 2 + ((z - foot[2]) / 0.15) ** 2
        ground = ground * (1 - 0.45 * np.exp(-distance))[..., None]
    return np.where(t < HORIZON, wall, ground)


def photograph(rest: Person, person: Person, mesh: PartMesh, points: np.ndarray, feet: np.ndarray) -> Image.Image:
    """The shaded picture; ``points`` are the vertices in the camera frame [m]."""
    _, face_index, weights = draw(points, mesh, SUPERSAMPLING)
    normals = interpolate(vertex_normals(points, person.faces), person.faces, face_index, weights)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    lamp = np.clip(normals @ LIGHT, 0.0, 1.0)
    sky = 0.5 - 0.5 * normals[..., 1]
    rest_points = interpolate(rest.vertices, person.faces, face_index, weights)
    colour = clothing(rest, rest_points, person.face_parts[np.maximum(face_index, 0)])
    colour = colour * (0.38 + 0.17 * sky + 0.55 * lamp)[..., None]
    picture = np.where((face_index >= 0)[..., None], colour, background(face_index.shape, feet, points[:, 1].max()))
    height, width = IMAGE_SIZE
    blocks = np.clip(picture, 0, 1).reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3)
    return Image.fromarray((blocks.mean((1, 3)) * 255).round().astype(np.uint8))


def main(out: Path = EXAMPLE, /) -> None:
    """Make the example.

    Args:
        out: Folder to write; by default the package's own.
    """
    out.mkdir(parents=True, exist_ok=True)

    rest, person = posed_person(PersonFactory())
    facing, translation = camera_from_body(person)

    def to_camera(point: np.ndarray) -> np.ndarray:
        return point @ facing.T + translation

    mesh = PartMesh.from_faces(person.faces, person.face_parts + 1)
    points = to_camera(person.vertices)
    coco = {name: to_camera(point) for name, point in person.coco.items()}
    lsp = {name: to_camera(point) for name, point in person.joints().items()}
    lsp["neck"] = (lsp["left_shoulder"] + lsp["right_shoulder"]) / 2  # As skeletons.py has it.
    head = np.unique(rest.faces[rest.face_parts == PART_NAMES.index("head")])
    lsp["head_top"] = points[head[rest.vertices[head, 1].argmax()]]

    feet = np.array([(coco[f"{side}_heel"] + coco[f"{side}_big_toe"]) / 2 for side in ("left", "right")])
    photograph(rest, person, mesh, points, feet).save(out / "photo.png", optimize=True)

    labels, _, _ = draw(points, PartMesh.from_faces(person.faces, parts_at_joints(anny()).numpy()))  # as CDCL's are
    Image.fromarray(LABELS.to_ids(LABELS.from_parts(labels)).astype(np.uint8)).save(out / "parts.png", optimize=True)

    joints = {"lsp14": lsp, "coco17": coco}
    named = {form: {name: each[name] for name in skeleton(form).landmarks} for form, each in joints.items()}
    keypoints = scaled_camera().project(torch.from_numpy(np.array([*named["coco17"].values()]))[None])[0, :, :2]
    rows = [[*point, 1.0] for point in keypoints.numpy().round(2).tolist()]
    write_json(out / "keypoints.json", {"format": "coco17", "keypoints": rows})
    truth = {
        "frame": "camera: x right, y down, z away from the viewer; metres",
        "camera": {
            "image_size": list(IMAGE_SIZE),
            "focal_px": [FOCAL, FOCAL],
            "centre_px": [IMAGE_SIZE[1] / 2, IMAGE_SIZE[0] / 2],
        },
        "joints": {
            form: {"names": list(each), "points_m": [point.round(5).tolist() for point in each.values()]}
            for form, each in named.items()
        },
        "stature_m": round(float(np.ptp(rest.vertices[:, 1])), 4),
        "body_yaw_deg": BODY_YAW,
        "anny": {"version": version("anny"), "phenotype": PHENOTYPE},
    }
    write_json(out / "truth.json", truth)


if __name__ == "__main__":
    run_script(main)
