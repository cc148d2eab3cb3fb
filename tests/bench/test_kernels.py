"""``partdr bench kernels``: runs compute what the library does, and what a small plan leaves behind."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
import warp as wp
from PIL import Image
from rich.console import Console

from warp_partdr.bench.kernels import measure, peers, start
from warp_partdr.bench.kernels.chart import draw_kernel_chart
from warp_partdr.bench.kernels.measure import run_kernels
from warp_partdr.bench.kernels.plan import (
    GRADIENT,
    LABELS,
    MINIMISE,
    REFINEMENT,
    TORCH_GRADIENT,
    KernelPlan,
    plan_kernels,
)
from warp_partdr.bench.kernels.report import (
    GROUPS,
    KERNELS,
    PEER_ROWS,
    STARTS,
    TARGETS,
    KernelReport,
    TimedRow,
    print_kernels,
)
from warp_partdr.bench.kernels.runs import ExactRun, MeshRun, refined_once
from warp_partdr.bench.machine import about
from warp_partdr.bench.renderers import EXACT, MESH, PARTDR
from warp_partdr.bench.report import TABLE_WIDTH, save_figures
from warp_partdr.bench.scene import BenchScene
from warp_partdr.bench.timing import Timing
from warp_partdr.cli import bench
from warp_partdr.errors import InputError
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = 32


def small_plan(device: str) -> KernelPlan:
    """All that a real one has, on pictures of few pixels."""
    return KernelPlan(
        device=device,
        size=SIZE,
        targets=(
            (GRADIENT, EXACT, 2),
            (LABELS, MESH, 2),
            (REFINEMENT, EXACT, 1),
            (TORCH_GRADIENT, EXACT, 1),
            (TORCH_GRADIENT, MESH, 1),
        ),
        others=((GRADIENT, PARTDR, 1, SIZE), (GRADIENT, "mesh E0", 1, 2 * SIZE), (MINIMISE, EXACT, 4, SIZE)),
        kernels=(2,),
        peers=(1,),
        budget=0.0,
        start=False,
    )


@pytest.fixture(scope="module")
def report(device: str) -> KernelReport:
    return run_kernels(small_plan(device))


def test_bandwidth_and_images() -> None:
    row = TimedRow(TARGETS, "a", "b", 8, 256, "graph", Timing((1e-3, 2e-3, 3e-3)), moved=3_000_000)
    assert row.images_per_second == pytest.approx(4000)
    assert row.bandwidth_share(6e9) == pytest.approx(0.25)  # 1.5 GB/s of 6
    nothing = TimedRow(KERNELS, "a", "b", 8, 256, "kernel", Timing((-1e-9,)), moved=5)  # a difference within the noise
    assert nothing.images_per_second is nothing.bandwidth_share(1e9) is nothing.fastest is None


# --- what is timed -------------------------------------------------------------------------------------------------


def test_scene_is_a_tenth_of_the_picture_and_not_yet_the_target(device: str) -> None:
    scene = BenchScene.random(4, 256, device)
    assert 0.08 < float((scene.targets > 0).float().mean()) < 0.12
    shown = draw_ellipsoids(scene.posed, scene.camera, (256, 256)).labels
    assert 0.1 < float((shown != scene.targets).sum() / (scene.targets > 0).sum()) < 0.8
    again = BenchScene.random(4, 256, device)
    assert torch.equal(scene.targets, again.targets)
    assert len({bytes(target.cpu().numpy()) for target in scene.targets}) == 4
    assert float(scene.points.abs().max()) < 1.5


@pytest.mark.parametrize("gradient", ["coverage", "partdr"])
def test_exact_runs_compute_what_the_library_does(device: str, gradient: str) -> None:
    ExactRun(BenchScene.random(3, SIZE, device), gradient).check()


@pytest.mark.parametrize("level", [0, 1])
def test_mesh_runs_compute_what_the_library_does(device: str, level: int) -> None:
    MeshRun(BenchScene.random(3, SIZE, device), level).check()


def test_a_wrong_run_is_not_timed(device: str) -> None:
    run = MeshRun(BenchScene.random(1, SIZE, device), 0)
    run._losses = wp.zeros_like(run._losses)
    run.gradient = run.labels
    with pytest.raises(AssertionError):
        run.check()


def test_every_row_is_there(report: KernelReport, device: str) -> None:
    plan = small_plan(device)
    for what, name, batch in plan.targets:
        row = report.find(what, name, batch, SIZE)
        assert row is not None
        assert row.group == TARGETS
        assert row.timing.median > 0
    assert all(report.find(*row) for row in plan.others)
    assert report.find(LABELS, MESH, 2, SIZE).memory > 2 * SIZE * SIZE
    names = [f"{row.renderer}: {row.name}" for row in report.rows if row.group == KERNELS]
    for name in (
        *("iteration, exact, edges: push", "iteration, exact, edges: step", "exact, coverage: coverage"),
        *("exact, PartDR: partdr", "mesh E1: draw", "mesh E1: push", "kinematics, E1: pose", "kinematics, E1: place"),
    ):
        assert any(kernel.startswith(name) for kernel in names), name


def test_iterations_leave_bodies_where_they_are(device: str) -> None:
    run = refined_once(BenchScene.random(2, SIZE, device), "coverage", learning_rate=0.0)
    before = run._parameters.clone()
    history = run._history.clone()
    assert (history > 0).all()
    for _ in range(100):  # more than a run has
        run.iterate()
    wp.synchronize_device(device)
    assert torch.equal(run._parameters, before)
    assert torch.equal(run._history, history)


def test_command_times_the_papers_targets() -> None:
    cpu = set(plan_kernels("cpu", quick=True).targets)
    for batch in (1, 16):
        assert {(GRADIENT, EXACT, batch), (GRADIENT, MESH, batch), (REFINEMENT, EXACT, batch)} <= cpu
    cuda = set(plan_kernels("cuda").targets)
    assert {(GRADIENT, EXACT, batch) for batch in (1, 128, 1024)} <= cuda
    assert {(GRADIENT, MESH, 128), (LABELS, EXACT, 128), (LABELS, MESH, 128), (TORCH_GRADIENT, EXACT, 1)} <= cuda
    assert {(REFINEMENT, EXACT, 1), (REFINEMENT, EXACT, 1024)} <= cuda
    full = plan_kernels("cuda")
    assert full.start
    assert not {(*row, full.size) for row in full.targets} & set(full.others)  # nothing twice
    assert len(set(full.others)) == len(full.others)


# --- peers ---------------------------------------------------------------------------------------------------------


def test_a_missing_peer_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = peers.Peer("no_such_package", ("cpu", "cuda"), peers.Drtk)
    monkeypatch.setattr(measure, "PEERS", {"Absent": absent})
    report = KernelReport("cpu", {}, 1.0)
    assert list(measure._peer_jobs(small_plan("cpu"), report)) == []
    assert report.remarks == ["Absent: not timed, no_such_package is not installed"]


def test_a_peer_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch, device: str) -> None:
    broken = peers.Peer("json", ("cpu", "cuda"), peers.Drtk)  # which has no drtk inside
    monkeypatch.setattr(measure, "PEERS", {**peers.PEERS, "Broken": broken})
    report = KernelReport(device, {}, 1.0)
    assert measure._time_peer(small_plan(device), report, "Broken", 1) == []
    assert len(report.remarks) == 1
    assert report.remarks[0].startswith("Broken: not timed, it failed: ModuleNotFoundError")


def test_our_renderer_is_timed_as_peers_are(report: KernelReport) -> None:
    rows = [row for row in report.rows if row.group == PEER_ROWS and row.renderer == peers.OURS]
    assert [row.name for row in rows] == [LABELS, GRADIENT]
    assert [row.agreement for row in rows] == [1.0, 1.0]


def view(batch: int = 2) -> peers.MeshView:
    scene = BenchScene.random(batch, 48, "cpu")
    points = scene.camera.project(scene.posed.vertices(1)).contiguous()
    return peers.MeshView(points, ellipbody_mesh(1), scene.targets)


def test_loss_of_float_maps_is_ours() -> None:
    given = view()
    ours = peers.Ours(given)
    torch.testing.assert_close(given.loss_of(given.maps_of(ours.labels())), ours.loss(given.vertices))


def test_normalised_vertices_fill_the_picture() -> None:
    given = view()
    corners = torch.tensor([[0.0, 0.0, 0.0], [48.0, 48.0, 0.0], [24.0, 12.0, 0.0]])
    assert given.normalised(corners)[:, :2].tolist() == [[-1.0, -1.0], [1.0, 1.0], [0.0, -0.5]]
    depths = given.normalised(given.vertices)[..., 2]
    torch.testing.assert_close(torch.stack(depths.aminmax()), torch.tensor([-0.9, 0.9]))


@pytest.mark.skipif(not peers.PEERS["Embree"].is_installed, reason="needs embreex")
def test_embree_sees_what_we_see() -> None:
    given = view()
    assert (peers.Embree(given).labels() == peers.Ours(given).labels()).float().mean() > 0.999


# --- what is left behind -------------------------------------------------------------------------------------------


def test_table_names_machine_rows_and_remarks(report: KernelReport) -> None:
    console = Console(width=TABLE_WIDTH, file=StringIO())
    print_kernels(report, console)
    said = console.file.getvalue()
    assert report.machine["warp"] in said
    assert report.machine["machine"] in said
    for row in report.rows:
        assert row.name in said
        assert row.renderer in said
    assert [group for group in GROUPS if group in said] == [group for group in GROUPS if group != STARTS]
    assert all(remark in said for remark in report.remarks)
    assert "…" not in said  # no column is cut


def test_command_leaves_json_and_picture(
    report: KernelReport,
    device: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(measure, "run_kernels", lambda plan, progress: report)
    bench.bench_kernels(device=device, quick=True, out=tmp_path / "new")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        f"bench-kernels-{device}.json",
        f"bench-kernels-{device}.png",
    ]
    data = json.loads((tmp_path / "new" / f"bench-kernels-{device}.json").read_text())
    assert data["machine"]["warp"] == wp.config.version
    assert len(data["rows"]) == len(report.rows)
    first = data["rows"][0]
    assert (first["name"], first["renderer"], first["batch"], first["size_px"]) == (GRADIENT, EXACT, 2, SIZE)
    assert first["median_s"] == report.rows[0].timing.median
    assert first["moved_bytes"] / first["median_s"] / data["copy_bandwidth_bytes_per_second"] == pytest.approx(
        first["share_of_copy_bandwidth"]
    )
    with Image.open(tmp_path / "new" / f"bench-kernels-{device}.png") as picture:
        assert picture.width > 800
    assert "The paper's targets" in capsys.readouterr().out


def test_out_that_is_a_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out"):
        bench.bench_kernels(device="cpu", quick=True, out=tmp_path / "file")


def test_chart_marks_every_batch(tmp_path: Path) -> None:
    """Each B has a shape of its own, in black, grey and white alone."""
    rows = [
        TimedRow(TARGETS, LABELS, EXACT, batch, 256, "graph", Timing((batch * 1e-4,))) for batch in (1, 8, 128, 1024)
    ]
    chart = np.asarray(draw_kernel_chart(KernelReport("cpu", about(), 1e9, rows)))
    assert (chart.min(2) == chart.max(2)).all()
    fewer = np.asarray(draw_kernel_chart(KernelReport("cpu", about(), 1e9, rows[:3])))
    assert fewer.shape == chart.shape
    assert (fewer != chart).any()
    nothing = np.asarray(draw_kernel_chart(KernelReport("cpu", about(), 1e9)))
    assert nothing.min() < 255  # nothing was timed, and it says so


def test_json_of_nothing(tmp_path: Path) -> None:
    save_figures(KernelReport("cpu", {}, 1.0).as_dict(), tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text())["rows"] == []


def test_starts_are_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    processes = iter([(1.0, 5.0), (2.0, 0.5)])  # cold, warm: imports and first call
    monkeypatch.setattr(start, "_time_process", lambda device, cache: next(processes))
    rows = measure._time_starts(small_plan("cpu"))
    assert [row.timing.median for row in rows] == [2.0, 5.0, 0.5]
    assert {row.group for row in rows} == {STARTS}


@pytest.mark.slow
def test_a_cold_start_takes_longer_than_a_warm_one(device: str) -> None:
    imports, cold, warm = start.time_starts(device).values()
    assert imports > 0
    assert cold > 1.5 * warm > 0
