"""Adapters of other rasterizers, against stand-ins of their interfaces; and how right gradients are."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import pytest
import torch

from warp_partdr.bench.kernels import peer_gradients, peers
from warp_partdr.bench.kernels.calls import mesh_view
from warp_partdr.bench.scene import BenchScene
from warp_partdr.cameras import ScreenCamera
from warp_partdr.render.mesh import draw_mesh

SIZE = 64


@pytest.fixture
def view() -> peers.MeshView:
    return mesh_view(BenchScene.random(2, SIZE, "cpu"), "mesh E1")


def faces_at(view: peers.MeshView, pixels: torch.Tensor) -> torch.Tensor:
    """The face seen at each pixel of vertices (u, v, z), -1 for none; pixels' centres are at + 0.5."""
    drawn = draw_mesh(pixels.contiguous(), view.mesh, ScreenCamera(perspective=False), view.image_size)
    assert drawn.face_index is not None
    return torch.where(drawn.labels > 0, drawn.face_index, -1)


def fake_drtk(view: peers.MeshView) -> dict[str, ModuleType | SimpleNamespace]:
    """DRTK: pixels, whose centres have whole coordinates; index -1 is nothing; images have channels first."""

    def rasterize(v: torch.Tensor, vi: torch.Tensor, height: int, width: int) -> torch.Tensor:
        assert (height, width) == view.image_size
        assert (v[..., 2] > 0).all()  # before the camera
        return faces_at(view, v + v.new_tensor([0.5, 0.5, 0.0]))

    def edge_grad_estimator(
        v_pix: torch.Tensor, vi: torch.Tensor, bary_img: torch.Tensor, img: torch.Tensor, index_img: torch.Tensor
    ) -> torch.Tensor:
        assert img.shape == (len(v_pix), 20, *view.image_size)
        return img + 0 * v_pix.sum()

    render = lambda v, vi, index: (index.float(), index.float())  # noqa: E731
    return {"drtk": SimpleNamespace(rasterize=rasterize, render=render, edge_grad_estimator=edge_grad_estimator)}


def fake_nvdiffrast(view: peers.MeshView) -> dict[str, ModuleType | SimpleNamespace]:
    """nvdiffrast: clip space, y = -1 in the first row; triangles are numbered from 1, 0 is nothing."""

    def rasterize(
        context: object, pos: torch.Tensor, tri: torch.Tensor, resolution: list[int]
    ) -> tuple[torch.Tensor, None]:
        assert pos.shape[-1] == 4
        assert (pos[..., 2].abs() <= pos[..., 3]).all()  # between the clipping planes
        height, width = resolution
        flat = pos[..., :3] / pos[..., 3:]
        pixels = (flat + flat.new_tensor([1.0, 1.0, 0.0])) * flat.new_tensor([width / 2, height / 2, 1.0])
        return torch.nn.functional.pad((faces_at(view, pixels) + 1).float()[..., None], (3, 0)), None

    def antialias(color: torch.Tensor, rast: torch.Tensor, pos: torch.Tensor, tri: torch.Tensor) -> torch.Tensor:
        assert color.shape == (*rast.shape[:3], 20)
        return color + 0 * pos.sum()

    whole = ModuleType("nvdiffrast")
    part = SimpleNamespace(RasterizeCudaContext=lambda device: device, rasterize=rasterize, antialias=antialias)
    return {"nvdiffrast": whole, "nvdiffrast.torch": part}


def fake_pytorch3d(view: peers.MeshView) -> dict[str, ModuleType | SimpleNamespace]:
    """PyTorch3D: x to the left, y up; faces of a batch are numbered on."""

    def rasterize_meshes(
        meshes: tuple[torch.Tensor, torch.Tensor], image_size: tuple[int, int], blur_radius: float, faces_per_pixel: int
    ) -> tuple[torch.Tensor, ...]:
        points, faces = meshes
        height, width = image_size
        pixels = (1 - points) * points.new_tensor([width / 2, height / 2, 1.0])
        pixels = torch.cat([pixels[..., :2], points[..., 2:]], dim=-1)
        seen = faces_at(view, pixels)
        packed = torch.where(seen < 0, -1, seen + faces.shape[1] * torch.arange(len(points))[:, None, None])
        distances = torch.full(packed.shape, -1.0) + 0 * points.sum()
        return packed[..., None], packed[..., None].float(), packed[..., None].float(), distances[..., None]

    names = ("pytorch3d", "pytorch3d.renderer", "pytorch3d.renderer.mesh")
    return {name: ModuleType(name) for name in names} | {
        "pytorch3d.structures": SimpleNamespace(Meshes=lambda points, faces: (points, faces)),
        "pytorch3d.renderer.mesh.rasterize_meshes": SimpleNamespace(rasterize_meshes=rasterize_meshes),
    }


@pytest.mark.parametrize(
    ("name", "fake"), [("DRTK", fake_drtk), ("nvdiffrast", fake_nvdiffrast), ("PyTorch3D", fake_pytorch3d)]
)
def test_adapters_speak_their_peer_s_language(
    view: peers.MeshView, name: str, fake: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, stand_in in fake(view).items():  # type: ignore[operator]
        monkeypatch.setitem(sys.modules, module, stand_in)
    draw, loss = peers.PEERS[name].adapt(view)
    ours = peers.ours(view)
    assert (draw() == ours[0]()).float().mean() > 0.995  # vertices are rounded on their way there
    assert loss is not None
    leaf = view.vertices.clone().requires_grad_()
    found = loss(leaf)
    assert torch.isfinite(found)
    (gradient,) = torch.autograd.grad(found, leaf)
    assert gradient.shape == leaf.shape
    if name != "PyTorch3D":  # which fades
        torch.testing.assert_close(found, ours[1](view.vertices), rtol=0.05, atol=0)


def test_the_true_derivative_is_that_of_a_disk(view: peers.MeshView) -> None:
    """A part that moves by dx covers its height times dx more of what is wanted, and uncovers as much."""
    vertices = view.vertices[:1].clone()
    part = peer_gradients._part_of(view)
    vertices[:, part != 3] = -1000.0  # out of the picture
    own = vertices[:, part == 3]
    vertices[:, part == 3] = 32 + 10 * torch.nn.functional.normalize(own - own.mean(1, keepdim=True), dim=-1)
    targets = torch.zeros(1, SIZE, SIZE, dtype=torch.uint8)
    targets[:, :, 32:] = 4
    found = peer_gradients.true_moves(peers.MeshView(vertices, view.mesh, targets))
    assert found[0, 3, 0] == pytest.approx(
        -40, rel=0.1
    )  # twice the height: less is wrong on the left, more is right on the right
    assert abs(float(found[0, 3, 1])) < 1
    assert found[0, :3].abs().max() == 0


def test_ours_point_along_the_area_s_derivative() -> None:
    remarks: list[str] = []
    rows = list(peer_gradients.measure_gradients(SIZE, "cpu", remarks))
    assert {row["mesh"] for row in rows} == {"mesh E0", "mesh E1", "mesh E2", "mesh E3"}
    for row in rows:
        if row["renderer"] == "warp-partdr, edges":
            assert row["cosine"] > 0.9
            assert 0.8 < row["length"] < 1.2
    assert not remarks


def test_compared_gradients() -> None:
    true = torch.tensor([[[1.0, 0.0]], [[0.0, 2.0]]])
    cosine, length = peer_gradients.compare_moves(torch.tensor([[[2.0, 0.0]], [[2.0, 0.0]]]), true)
    assert (cosine, length) == (pytest.approx(0.5), pytest.approx(1.5))
