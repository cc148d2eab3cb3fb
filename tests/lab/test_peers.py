"""Adapters of other rasterizers, against stand-ins of their interfaces; and how right gradients are."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch

from warp_partdr.cameras import ScreenCamera
from warp_partdr.lab.bench.kernels import peer_gradients, peers
from warp_partdr.lab.bench.kernels.calls import mesh_view
from warp_partdr.lab.bench.scene import BenchScene
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


class FakeMitsuba:
    """Mitsuba and Dr.Jit: the centre of projection is 0, which looks along z, x to the left, y up; RGB pictures."""

    def __init__(self, view: peers.MeshView, llvm: int = 22) -> None:
        self.view, self.llvm = view, (llvm, 1, 0)
        self.pictures: list[torch.Tensor] = []  # colours of faces, of each picture whose gradient was asked for

    def modules(self) -> dict[str, SimpleNamespace]:
        same = lambda tensor: tensor  # noqa: E731
        mitsuba = SimpleNamespace(
            set_variant=lambda name: None,
            Properties=dict,
            load_dict=lambda given: FakeScene(self, given) if given["type"] == "scene" else given,
            Mesh=FakeMesh,
            traverse=lambda owner: owner.values,
            **dict.fromkeys(("Float", "UInt32", "Int32", "TensorXf"), same),
            Point2f=lambda x, y: (x, y),
        )
        drjit = SimpleNamespace(
            detail=SimpleNamespace(llvm_version=lambda: self.llvm),
            select=lambda where, one, other: SimpleNamespace(torch=lambda: torch.where(where, one, other)),
            grad=lambda leaf: SimpleNamespace(torch=lambda: torch.ones_like(leaf)),
            **dict.fromkeys(("enable_grad", "disable_grad"), lambda leaf: None),
            sync_thread=lambda: None,
        )
        return {"mitsuba": mitsuba, "drjit": drjit}


class Values(dict[str, Any]):
    update = lambda self: None  # type: ignore[assignment]  # noqa: E731


class FakeMesh:
    def __init__(self, name: str, vertex_count: int, face_count: int, props: dict[str, Any]) -> None:
        emitted = {"type": "mesh_attribute", "name": "face_color"}
        assert props["emitter"] == {"type": "area", "radiance": emitted}
        self.values = Values()

    def add_attribute(self, name: str, size: int, values: torch.Tensor) -> None:
        assert (name, size) == ("face_color", 3)
        self.values[name] = values


class FakeScene:
    def __init__(self, world: FakeMitsuba, given: dict[str, Any]) -> None:
        self.view, self.world = world.view, world
        self.height, self.width = self.view.image_size
        assert (given["sensor"]["fov"], given["sensor"]["fov_axis"]) == (90.0, "x")
        assert [given["sensor"]["film"][side] for side in ("height", "width")] == [self.height, self.width]
        assert given["integrator"]["type"] == "prb_projective"  # others see no outlines
        self.values = Values({f"body.{name}": value for name, value in given["body"].values.items()})

    def sensors(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(sample_ray=lambda time, wave, place, lens: (place, 1.0))]

    def integrator(self) -> FakeScene:
        return self

    def ray_intersect_preliminary(self, rays: tuple[torch.Tensor, ...], coherent: bool) -> SimpleNamespace:
        rows, columns = (rays[1] * self.height).view(self.height, -1), (rays[0] * self.width).view(self.height, -1)
        assert rows[:, 0].tolist() == [v + 0.5 for v in range(self.height)]
        assert columns[0].tolist() == [u + 0.5 for u in range(self.width)]
        x, y, z = self.values["body.vertex_positions"].view(-1, 3).T
        assert (z > 0).all()
        pixels = torch.stack([(1 - x / z) * self.width / 2, self.height / 2 - y / z * self.width / 2, -1 / z], -1)
        seen = faces_at(self.view, pixels[None]).flatten()
        return SimpleNamespace(is_valid=lambda: seen >= 0, prim_index=seen)

    def render_backward(self, scene: FakeScene, values: Values, wanted: torch.Tensor, seed: int) -> None:
        assert scene is self
        assert wanted.shape == (self.height, self.width, 3)
        self.world.pictures.append(values["body.face_color"].view(-1, 3))


def fake_mitsuba(view: peers.MeshView) -> dict[str, SimpleNamespace]:
    return FakeMitsuba(view).modules()


@pytest.mark.parametrize(
    ("name", "fake"),
    [("DRTK", fake_drtk), ("nvdiffrast", fake_nvdiffrast), ("PyTorch3D", fake_pytorch3d), ("Mitsuba", fake_mitsuba)],
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


def test_mitsuba_s_pictures_hold_each_label_once(view: peers.MeshView, monkeypatch: pytest.MonkeyPatch) -> None:
    world = FakeMitsuba(view)
    for module, stand_in in world.modules().items():
        monkeypatch.setitem(sys.modules, module, stand_in)
    leaf = view.vertices.clone().requires_grad_()
    peers.mitsuba(view)[1](leaf).backward()
    assert len(world.pictures) == 7 * len(leaf)  # three labels a picture
    colours = torch.cat(world.pictures[:7], dim=1)
    torch.testing.assert_close(colours[:, :20], view.maps_of(view.mesh.face_labels))
    assert not colours[:, 20:].any()


def test_mitsuba_is_not_run_where_it_would_end_the_process(
    view: peers.MeshView, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, stand_in in FakeMitsuba(view, llvm=15).modules().items():
        monkeypatch.setitem(sys.modules, module, stand_in)
    with pytest.raises(RuntimeError, match=r"LLVM 17 or newer.*DRJIT_LIBLLVM_PATH"):
        peers.mitsuba(view)


def disk(view: peers.MeshView) -> peers.MeshView:
    """One part alone, round, of which the right half is wanted."""
    vertices = view.vertices[:1].clone()
    part = peer_gradients._part_of(view)
    vertices[:, part != 3] = vertices.new_tensor([-1000.0, -1000.0, 0.0])  # out of the picture
    own = vertices[:, part == 3]
    vertices[:, part == 3] = 32 + 10 * torch.nn.functional.normalize(own - own.mean(1, keepdim=True), dim=-1)
    targets = torch.zeros_like(view.targets[:1])
    targets[:, :, 32:] = 4
    return peers.MeshView(vertices, view.mesh, targets)


@pytest.mark.skipif(not peers.PEERS["Mitsuba"].is_installed, reason="needs mitsuba")
def test_mitsuba_itself_sees_what_we_see_and_pulls_a_disk_where_it_should(device: str) -> None:
    view = mesh_view(BenchScene.random(2, SIZE, device), "mesh E1")
    try:
        draw, _ = peers.mitsuba(view)
    except (RuntimeError, ImportError) as error:
        pytest.skip(f"Mitsuba doesn't run here: {error}")
    assert (draw() == peers.ours(view)[0]()).float().mean() > 0.999
    alone = disk(view)
    leaf = alone.vertices.clone().requires_grad_()
    peers.mitsuba(alone)[1](leaf).backward()
    assert leaf.grad is not None
    found = peer_gradients.part_moves(alone, leaf.grad)
    cosine, length = peer_gradients.compare_moves(found, peer_gradients.true_moves(alone))
    assert cosine > 0.98
    assert length == pytest.approx(1, abs=0.1)


def test_the_true_derivative_is_that_of_a_disk(view: peers.MeshView) -> None:
    """A part that moves by dx covers its height times dx more of what is wanted, and uncovers as much."""
    found = peer_gradients.true_moves(disk(view))
    assert found[0, 3, 0] == pytest.approx(
        -40, rel=0.1
    )  # twice the height: less is wrong on the left, more is right on the right
    assert abs(float(found[0, 3, 1])) < 1
    assert found[0, :3].abs().max() == 0


def test_ours_point_along_the_area_s_derivative(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_gradients, "PEERS", {})  # whatever is installed
    remarks: list[str] = []
    rows = list(peer_gradients.measure_gradients(SIZE, "cpu", remarks))
    assert {row["mesh"] for row in rows} == {"mesh E0", "mesh E1", "mesh E2", "mesh E3"}
    for row in rows:
        if row["renderer"] == "warp-partdr, edges":
            assert row["cosine"] > 0.9
            assert 0.8 < row["length"] < 1.2
    assert not remarks


def test_gradients_are_compared_by_direction_and_length() -> None:
    true = torch.tensor([[[1.0, 0.0]], [[0.0, 2.0]]])
    cosine, length = peer_gradients.compare_moves(torch.tensor([[[2.0, 0.0]], [[2.0, 0.0]]]), true)
    assert (cosine, length) == (pytest.approx(0.5), pytest.approx(1.5))
