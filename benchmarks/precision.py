"""How far float32 kernels are from float64 references: depth, place of the silhouette, gradient.

    python benchmarks/precision.py [--device cpu] [--scenes 6] [--out precision.json]

One thing varies at a time: how thin an ellipsoid or a triangle is against its length, how far away, and how large the
picture is. It is seen as 0.35 of the picture's side, turned at random, before a ball or another triangle. Worst of some
random scenes:

* depth: relative, where a pixel is safely covered;
* place [px]: how far from the true outline a pixel's centre lies that is drawn and should not be, or the reverse;
* gradient: of PartDR's rule through maps, as a share of its own length; pictures up to 128 px.

Pictures are looked at where rows and columns cross outlines, and in places drawn at random; small ones in many copies,
moved by shares of a pixel.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
import warp as wp
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from warp_partdr.reference import ellipsoids as ellipsoid_reference
from warp_partdr.reference import mesh as reference
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh

RATIOS: list[float] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6]
DISTANCES: list[float] = [0.1, 1.0, 1e1, 1e2, 1e3, 1e4]  # [m]
SIDES: list[float] = [1, 8, 64, 256, 1024, 8192]  # [px]
SHARE = 0.35  # of the picture's side that the longest semi-axis is seen as
LARGE = 0.5  # [m] the longest semi-axis, but at small distances
GRADIENT_SIDE = 128  # [px] the largest picture whose gradient the reference finds in reasonable time
SAFE = 0.5  # [px] from any outline
PLACES = 4000  # that are looked at in a scene, in as many copies as there have to be
LINES = 300  # of rows and of columns, in a copy
NAMES = ("depth", "place", "gradient")


@dataclass(frozen=True)
class Setting:
    """What is drawn."""

    ratio: float = 10.0
    distance: float = 3.0
    side: int = 128
    perspective: bool = False


@dataclass(frozen=True)
class Intrinsics:
    """A camera as its four numbers."""

    intrinsics: torch.Tensor
    perspective: bool


def float32(values: np.ndarray) -> np.ndarray:
    """What the kernels see, in double."""
    return np.asarray(values, dtype=np.float32).astype(float)


def smooth_maps(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """Gradients of two label maps that vary slowly."""
    x, y = ellipsoid_reference.pixel_centres(size)
    waves = [np.cos(rng.normal() * x / 20 + rng.normal() * y / 20 + rng.uniform(0, 6)) for _ in range(2)]
    return float32(np.stack(waves) + rng.normal(size=(2, 1, 1)))


def share(have: np.ndarray, want: np.ndarray) -> float:
    """Error as a share of the length."""
    length = float(np.linalg.norm(want))
    return float(np.linalg.norm(have - want)) / length if length > 0 else float(np.linalg.norm(have))


# --- Exact ellipsoids -------------------------------------------------------------------------------------------


def ellipsoid_scene(setting: Setting, rng: np.random.Generator) -> ellipsoid_reference.EllipsoidScene:
    """A thin ellipsoid and a ball behind it."""
    large = min(LARGE, setting.distance / 4)
    depth = setting.distance
    pixels = SHARE * setting.side / large  # a metre
    middle = setting.side / 2 + rng.uniform(-0.5, 0.5, 2)
    semi_axes = np.array([[large, large, large / setting.ratio], [large / 2] * 3])
    semi_axes[0] = rng.permutation(semi_axes[0])
    centres = np.array([[0.0, 0.0, depth], [0.4 * large, -0.3 * large, depth + 1.2 * large]])
    scale = pixels * (depth if setting.perspective else 1.0)
    numbers = centres, Rotation.random(2, rng=rng).as_matrix(), semi_axes, np.array([scale, scale, *middle])
    near = 0.01 if setting.perspective else -np.inf
    return ellipsoid_reference.EllipsoidScene(*map(float32, numbers), np.array([1, 2]), setting.perspective, near)


def outline_distance(scene: ellipsoid_reference.EllipsoidScene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance of places from the nearest outline [px], to first order."""
    nearest = np.full(x.shape, np.inf)
    step = 1e-4
    for k in range(len(scene.centres)):
        margin = ellipsoid_reference.meet(scene, k, x, y)[0]
        slopes = [
            (ellipsoid_reference.meet(scene, k, x + dx, y + dy)[0] - margin) / step
            for dx, dy in ((step, 0.0), (0.0, step))
        ]
        nearest = np.fmin(nearest, np.abs(margin) / np.hypot(*slopes))
    return nearest


def look_at(
    side: int, crossings: list[tuple[int, int, float]], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (rows, columns) on both sides of places (axis, line, where on it) that outlines cross, and some others."""
    found = [rng.integers(0, side, (PLACES // 10, 2))]
    for axis, line, place in crossings:
        along = np.clip(np.floor(place - 0.5).astype(int) + np.arange(-1, 3), 0, side - 1)
        pair = np.full(4, line), along
        found.append(np.stack(pair if axis == 0 else pair[::-1], 1))
    return tuple(np.concatenate(found).T)


def some_lines(side: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Rows (axis 0) and columns (axis 1)."""
    lines = rng.permutation(side)[:LINES] if side > LINES else np.arange(side)
    return [(axis, int(line)) for axis in (0, 1) for line in lines]


def shown_at(image: torch.Tensor, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Pixels of a picture (1, H, W), in double."""
    index = [torch.from_numpy(each).to(image.device) for each in (rows, columns)]
    return image[0, index[0], index[1]].cpu().numpy().astype(float)


def ellipsoid_errors(setting: Setting, seed: int, device: str) -> dict[str, float]:
    """Of one random scene."""
    rng = np.random.default_rng(seed)
    size = setting.side, setting.side
    scene = ellipsoid_scene(setting, rng)

    def leaf(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values[None], dtype=torch.float32, device=device, requires_grad=True)

    leaves = {name: leaf(getattr(scene, name)) for name in ("centres", "axes", "semi_axes", "camera")}
    ellipsoids = Ellipsoids(leaves["centres"], leaves["axes"], leaves["semi_axes"])
    errors, looked = {"depth": 0.0, "place": 0.0}, 0
    while looked < PLACES:
        moved = replace(scene, camera=float32(scene.camera + np.array([0, 0, *rng.uniform(-0.5, 0.5, 2)])))
        image = draw_ellipsoids(ellipsoids, Intrinsics(leaf(moved.camera), setting.perspective), size)
        crossings = [
            (axis, line, place)
            for axis, line in some_lines(setting.side, rng)
            for k in range(2)
            for place in ellipsoid_reference.crossings(moved, k, axis, line)
        ]
        rows, columns = look_at(setting.side, crossings, rng)
        looked += len(rows)
        x, y = columns + 0.5, rows + 0.5
        depths = ellipsoid_reference.fronts(moved, x, y)
        depth, parts = depths.min(0), np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0)
        near, shown = outline_distance(moved, x, y), shown_at(image.parts, rows, columns)
        # Where surfaces meet, depth decides who shows, and not the silhouette.
        errors["place"] = max(errors["place"], near[(shown == 0) != (parts == 0)].max(initial=0.0))
        safe = (shown == parts) & (parts > 0) & (near > SAFE)
        relative = shown_at(image.depth, rows, columns)[safe] / depth[safe] - 1
        errors["depth"] = max(errors["depth"], np.abs(relative).max(initial=0.0))
    if setting.side <= GRADIENT_SIDE:
        g = smooth_maps(rng, size)
        seen = Intrinsics(leaves["camera"], setting.perspective)
        image = draw_ellipsoids(ellipsoids, seen, size, num_maps=2, gradient="partdr")
        assert image.maps is not None
        (image.maps[0] * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
        want = ellipsoid_reference.partdr_gradient(scene, image.parts[0].cpu().numpy(), g)
        errors["gradient"] = max(
            share(tensor.grad[0].cpu().numpy().astype(float), getattr(want, name)) for name, tensor in leaves.items()
        )
    return {name: float(value) for name, value in errors.items()}


# --- Meshes -------------------------------------------------------------------------------------------------------


def triangle_errors(setting: Setting, seed: int, device: str) -> dict[str, float]:
    """Of a thin triangle, in front everywhere, and a large one."""
    rng = np.random.default_rng(seed)
    size = setting.side, setting.side
    radius = SHARE * setting.side
    middle = setting.side / 2 + rng.uniform(-0.5, 0.5, 2)
    angle = rng.uniform(0, 2 * np.pi)
    way = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-way[1], way[0]]) / setting.ratio
    thin = np.stack([way, across - way, -across - way])
    turn = Rotation.from_euler("z", angle).as_matrix()[:2, :2]
    fat = 0.8 * turn @ np.array([[1, 0.2], [-0.6, 0.7], [-0.2, -0.9]]).T
    depths = setting.distance * np.array([1.0, 1.05, 1.1, 1.2, 1.25, 1.3])
    places = middle + radius * np.concatenate([thin, fat.T])
    vertices = np.concatenate([places, depths[:, None]], 1).astype(np.float32)
    faces, labels = np.arange(6).reshape(2, 3), np.array([1, 2])
    mesh = PartMesh.from_faces(faces, labels, device=device)
    errors, looked = {"depth": 0.0, "place": 0.0}, 0
    while looked < PLACES:
        moved = vertices + np.array([*rng.uniform(-0.5, 0.5, 2), 0], dtype=np.float32)
        points = torch.from_numpy(moved).to(device)[None]
        image = draw_mesh(points, mesh, size, perspective=setting.perspective, near=1e-3)
        exact = moved.astype(float)
        rows, columns = look_at(setting.side, edge_crossings(exact, faces, some_lines(setting.side, rng)), rng)
        looked += len(rows)
        found = [triangle(exact[face], columns + 0.5, rows + 0.5, setting.perspective) for face in faces]
        inside, near, depth = (np.stack(each) for each in zip(*found, strict=True))
        want = np.where(inside[0], 1, np.where(inside[1], 2, 0))
        shown, near = shown_at(image.labels, rows, columns), near.min(0)
        errors["place"] = max(errors["place"], near[shown != want].max(initial=0.0))
        safe = (shown == want) & (want > 0) & (near > SAFE)
        relative = shown_at(image.depth, rows, columns)[safe] / np.where(want == 1, depth[0], depth[1])[safe] - 1
        errors["depth"] = max(errors["depth"], np.abs(relative).max(initial=0.0))
    if setting.side <= GRADIENT_SIDE:
        g = smooth_maps(rng, size)
        leaf = torch.from_numpy(vertices).to(device)[None].requires_grad_()
        image = draw_mesh(leaf, mesh, size, perspective=setting.perspective, num_maps=2, near=1e-3)
        assert image.maps is not None
        (image.maps[0] * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
        forces = reference.gradient(
            vertices.astype(float),
            faces,
            labels,
            image.labels[0].cpu().numpy(),
            image.face_index[0].cpu().numpy(),
            g,
            perspective=setting.perspective,
            depth=image.depth[0].cpu().numpy(),
        )
        errors["gradient"] = share(leaf.grad[0].cpu().numpy().astype(float), forces)
    return {name: float(value) for name, value in errors.items()}


def edge_crossings(
    vertices: np.ndarray, faces: np.ndarray, lines: list[tuple[int, int]]
) -> list[tuple[int, int, float]]:
    """Where rows and columns cross edges: axis, line, place on it."""
    found = []
    for axis, line in lines:
        for start, end in ((vertices[face[k]], vertices[face[(k + 1) % 3]]) for face in faces for k in range(3)):
            share_of_edge = (line + 0.5 - start[1 - axis]) / (end[1 - axis] - start[1 - axis])
            if 0 <= share_of_edge <= 1:
                found.append((axis, line, start[axis] + share_of_edge * (end[axis] - start[axis])))
    return found


def triangle(
    corners: np.ndarray, x: np.ndarray, y: np.ndarray, perspective: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether a triangle covers places, how far they are from the lines of its edges [px], and its depth there [m]."""
    edges = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
    areas = np.stack([reference.cross(start, end, (x, y)) for start, end in (edges[1], edges[2], edges[0])])
    lengths = np.array([np.hypot(*(end - start)[:2]) for start, end in (edges[1], edges[2], edges[0])])
    total = reference.cross(*corners)
    weights = areas / total
    lines = np.abs(areas) / lengths[:, None]
    z = corners[:, 2][:, None]
    depth = 1 / (weights / z).sum(0) if perspective else (weights * z).sum(0)
    return (weights > 0).all(0), lines.min(0), depth


# --- Table --------------------------------------------------------------------------------------------------------

Measure = Callable[[Setting, int, str], dict[str, float]]
RENDERERS: dict[str, Measure] = {"exact": ellipsoid_errors, "mesh": triangle_errors}
VARIED: list[tuple[str, Setting, str, list[float]]] = [
    ("length / thickness", Setting(), "ratio", RATIOS),
    ("the same, 8192 px", Setting(side=8192), "ratio", RATIOS),
    ("distance [m]", Setting(), "distance", DISTANCES),
    ("the same, 8192 px", Setting(side=8192), "distance", DISTANCES),
    ("picture [px]", Setting(), "side", SIDES),
]


def measure(renderer: str, setting: Setting, scenes: int, device: str) -> dict[str, float]:
    """The worst of some scenes."""
    found = [RENDERERS[renderer](setting, seed, device) for seed in range(scenes)]
    return {name: max(each[name] for each in found) for name in found[0]}


def main() -> None:
    """Measure, print, and write JSON where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    np.seterr(all="ignore")
    rows = []
    console = Console()
    for renderer in RENDERERS:
        table = Table(title=f"{renderer} renderer, {options.device}: worst errors of float32")
        table.add_column("varied")
        table.add_column("value", justify="right")
        for camera in ("weak", "perspective"):
            for name in NAMES:
                table.add_column(f"{camera}\n{name}{' [px]' if name == 'place' else ''}", justify="right")
        for title, base, varied, values in VARIED:
            for value in values:
                row = [title, f"{value:g}"]
                for perspective in (False, True):
                    setting = replace(base, perspective=perspective, **{varied: value})
                    errors = measure(renderer, setting, options.scenes, options.device)
                    rows.append({"renderer": renderer, **asdict(setting), **errors})
                    row += [f"{errors[name]:.0e}" if name in errors else "-" for name in NAMES]
                table.add_row(*row)
            table.add_section()
        console.print(table)
    if options.out:
        options.out.write_text(json.dumps({"device": options.device, "scenes": options.scenes, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
