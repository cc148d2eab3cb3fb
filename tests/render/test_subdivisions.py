"""The level of the mesh that keeps a tolerance, against silhouettes that are measured."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.bodies import observation_of, random_bodies
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from warp_partdr.body.icosphere import icosphere
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import Posed
from warp_partdr.cameras import Camera, Crop, Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh
from warp_partdr.render.renderers import RendererMesh
from warp_partdr.render.subdivisions import coarsest_subdivisions, silhouette_error
from warp_partdr.solve.ellipsoids.energy import Energy

SIZE = 128
FINE = 8  # samples a side of a pixel, where silhouettes are measured


def views(bodies: BodyParameters) -> dict[str, tuple[Posed | Ellipsoids, Camera]]:
    """Both cameras see the same bodies, the perspective one from near by."""
    posed, weak = bodies.posed(), bodies.camera(SIZE)
    focal = torch.full_like(weak.scale, 1.5 * SIZE)
    camera, offset = weak.to_perspective(focal, torch.full_like(weak.translation, SIZE / 2))
    moved = Ellipsoids(posed.centres + offset[:, None], posed.axes, posed.semi_axes)
    return {"weak": (posed, weak), "perspective": (moved, camera)}


def silhouettes(parts: Posed | Ellipsoids, camera: Camera, mesh: PartMesh, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Silhouettes of ellipsoids and of their mesh, shape (B, H, W), finely sampled."""
    size = (SIZE * FINE, SIZE * FINE)
    fine = camera.in_crop(Crop(0.0, 0.0, FINE, size))
    exact = draw_ellipsoids(parts, fine, size).labels.cpu().numpy() > 0
    posed = Posed(parts.centres, parts.axes, parts.centres, parts.axes, parts.semi_axes)  # vertices ask for three
    return exact, draw_mesh(posed.vertices(level), mesh, fine, size).labels.cpu().numpy() > 0


def measured_error(exact: np.ndarray, drawn: np.ndarray) -> float:
    """Greatest distance of pixels of the exact silhouette from the mesh's [px]."""
    return float(distance_transform_edt(~drawn)[exact].max()) / FINE


@pytest.mark.parametrize("kind", ["weak", "perspective"])
@pytest.mark.parametrize("tolerance", [2.0, 0.5, 0.2])
def test_auto_keeps_its_tolerance(device: str, kind: str, tolerance: float) -> None:
    bodies = random_bodies(4, device)
    for index in range(4):
        parts, camera = views(bodies.select(torch.tensor([index], device=device)))[kind]
        level = coarsest_subdivisions(parts, camera, tolerance=tolerance)
        (exact,), (drawn,) = silhouettes(parts, camera, ellipbody_mesh(level, device=device), level)
        assert not (drawn & ~exact).any()  # the mesh is inscribed
        assert measured_error(exact, drawn) <= tolerance + 1.5 / FINE  # a sample, and its diagonal
        if level > 0:  # a coarser one would not do
            assert float(silhouette_error(parts, camera, level - 1).max()) > tolerance


@pytest.mark.parametrize("kind", ["weak", "perspective"])
@pytest.mark.parametrize("level", [0, 1])
def test_silhouette_error_is_what_pictures_show(device: str, kind: str, level: int) -> None:
    parts, camera = views(random_bodies(3, device))[kind]
    # The body's own error can be less, where the worst part is before another one: so one part at a time.
    errors = silhouette_error(parts, camera, level)
    looked_at = 0
    for part in (0, 5, 13):
        alone = Ellipsoids(*(tensor[:, part : part + 1] for tensor in (parts.centres, parts.axes, parts.semi_axes)))
        mesh = ellipbody_mesh(level, device=device).relabel({label: int(label == 1) for label in range(1, 21)})
        exact, drawn = silhouettes(alone, camera, mesh, level)
        for body in range(3):
            if exact[body].any() and not exact[body][[0, -1]].any() and not exact[body][:, [0, -1]].any():
                seen = measured_error(exact[body], drawn[body])
                assert seen == pytest.approx(float(errors[body, part]), abs=1.5 / FINE)
                looked_at += 1
    assert looked_at >= 6  # of nine; the picture's border may cut others


@pytest.mark.parametrize("level", [0, 1, 2])
def test_silhouette_error_of_a_sphere_is_its_polygons_gap(device: str, level: int) -> None:
    """The circle's radius less how near the polygon's edges come to its centre, from whichever side it is seen.

    Hardly more, where a corner is too blunt to be found, and never less: a level must keep its tolerance.
    """
    radius, scale, count = 0.7, 100.0, 12
    axes = torch.from_numpy(Rotation.random(count, rng=0).as_matrix()).to(device)[:, None]
    centres = torch.zeros(count, 1, 3, dtype=torch.float64, device=device)
    sphere = Ellipsoids(centres, axes, torch.full_like(centres, radius))
    camera = WeakPerspective(centres[:, 0, 0] + scale, centres[:, 0, :2])
    corners = (radius * scale * (axes[:, 0].cpu().numpy() @ icosphere(level)[0].T))[:, :2].transpose(0, 2, 1)
    gaps = [radius * scale - np.abs(ConvexHull(each).equations[:, 2]).min() for each in corners]
    shares = silhouette_error(sphere, camera, level)[:, 0].cpu().numpy() / gaps
    assert shares.min() > 1 - 1e-9
    assert shares.max() < 1.02
    assert np.median(shares) < 1 + 1e-9


def test_tolerance_beyond_the_finest_level_is_said(device: str) -> None:
    parts, camera = views(random_bodies(1, device))["weak"]
    with pytest.raises(ValueError, match=r"tolerance: 0.001 px; expected 0\.\d+ or more, what E3 keeps here"):
        coarsest_subdivisions(parts, camera, tolerance=1e-3)
    with pytest.raises(ValueError, match="tolerance: 0; expected a positive number"):
        coarsest_subdivisions(parts, camera, tolerance=0)


def test_nothing_to_draw_needs_no_level(device: str) -> None:
    parts, camera = views(random_bodies(2, device))["perspective"]
    none = torch.tensor([], dtype=torch.long, device=device)
    empty = Ellipsoids(parts.centres[none], parts.axes[none], parts.semi_axes[none])
    assert coarsest_subdivisions(empty, Perspective(camera.intrinsics[none, :2], camera.intrinsics[none, 2:])) == 0
    behind = Ellipsoids(parts.centres - torch.tensor([0.0, 0.0, 100.0], device=device), parts.axes, parts.semi_axes)
    assert float(silhouette_error(behind, camera, 0).max()) == 0.0


def test_energy_and_result_take_auto(device: str) -> None:
    bodies = random_bodies(1, device)
    seen = observation_of(bodies, size=SIZE)
    found = Energy(seen, SIZE, renderer=RendererMesh("auto", 0.3))(bodies)["seg"]
    level = coarsest_subdivisions(bodies.posed(), bodies.camera(SIZE), tolerance=0.3)
    assert level > 0
    assert float(found) == float(Energy(seen, SIZE, renderer=RendererMesh(level))(bodies)["seg"])
    assert float(found) != float(Energy(seen, SIZE, renderer=RendererMesh(level - 1))(bodies)["seg"])
