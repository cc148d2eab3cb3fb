"""``partdr bench kernels``: runs compute what the library does, and what a small plan leaves behind."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from PIL import Image

from warp_partdr.cli import bench
from warp_partdr.errors import InputError
from warp_partdr.lab.bench.kernels import first_call, measure, peers, start
from warp_partdr.lab.bench.kernels.chart import draw_kernel_chart
from warp_partdr.lab.bench.kernels.measure import run_kernels
from warp_partdr.lab.bench.kernels.plan import (
    COMPILED_STEP,
    GRADIENT,
    GROUPS,
    KERNELS,
    LABELS,
    LOOP_STEP,
    MINIMISE,
    PEER_ROWS,
    POSED,
    REFINEMENT,
    STARTS,
    TARGETS,
    TORCH_BODY,
    TORCH_GRADIENT,
    TORCH_LABELS,
    TORCH_POSE,
    WHOLE_STEP,
    KernelPlan,
    plan_kernels,
)
from warp_partdr.lab.bench.kernels.report import copy_share, make_row
from warp_partdr.lab.bench.kernels.runs import ExactRun, MeshRun, refined_once
from warp_partdr.lab.bench.kernels.whole_steps import time_steps
from warp_partdr.lab.bench.machine import about
from warp_partdr.lab.bench.renderers import EXACT, MESH, PARTDR
from warp_partdr.lab.bench.scene import BenchScene
from warp_partdr.lab.bench.timing import Timing
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = 32
# All that a real plan has, on pictures of few pixels.
PLAN = KernelPlan(
    device="cpu",
    size=SIZE,
    targets=(
        (GRADIENT, EXACT, 2, SIZE),
        (LABELS, MESH, 2, SIZE),
        (REFINEMENT, EXACT, 1, SIZE),
        (TORCH_GRADIENT, EXACT, 1, SIZE),
        (TORCH_GRADIENT, MESH, 1, SIZE),
    ),
    calls=(
        (TORCH_BODY, EXACT, 2, SIZE),
        (TORCH_BODY, MESH, 2, SIZE),
        (TORCH_LABELS, EXACT, 2, SIZE),
        (TORCH_LABELS, MESH, 2, SIZE),
        (TORCH_POSE, "", 2, SIZE),
    ),
    others=((GRADIENT, PARTDR, 1, SIZE), (GRADIENT, "mesh E0", 1, 2 * SIZE), (MINIMISE, EXACT, 4, SIZE)),
    steps=((LOOP_STEP, EXACT, 2, SIZE), (WHOLE_STEP, EXACT + POSED, 2, SIZE), (WHOLE_STEP, "mesh E0", 2, SIZE)),
    batches=(2,),
    budget=0.0,
    start=False,
)


@pytest.fixture(scope="module")
def figures(device: str) -> dict[str, Any]:
    return run_kernels(replace(PLAN, device=device))


def test_rows_state_images_a_second_and_the_share_of_bandwidth() -> None:
    row = make_row(TARGETS, ("a", "b", 8, 256), "graph", Timing((1e-3, 2e-3, 3e-3)), moved=3_000_000)
    assert row["images_per_second"] == pytest.approx(4000)
    assert copy_share(row, 6e9) == pytest.approx(0.25)  # 1.5 GB/s of 6
    # A difference within the noise.
    nothing = make_row(KERNELS, ("a", "b", 8, 256), "kernel", Timing((-1e-9,)), moved=5)
    assert nothing["images_per_second"] is copy_share(nothing, 1e9) is nothing["fastest_s"] is None


# --- what is timed -------------------------------------------------------------------------------------------------


def test_scene_is_a_tenth_of_the_picture_and_not_yet_the_target(device: str) -> None:
    scene = BenchScene.random(4, 256, device)
    assert 0.08 < float((scene.targets > 0).float().mean()) < 0.12
    shown = draw_ellipsoids(scene.posed, scene.camera, (256, 256)).labels
    assert 0.1 < float((shown != scene.targets).sum() / (scene.targets > 0).sum()) < 0.8
    assert torch.equal(scene.targets, BenchScene.random(4, 256, device).targets)
    assert len({bytes(target.cpu().numpy()) for target in scene.targets}) == 4
    assert float(scene.points.abs().max()) < 1.5


@pytest.mark.parametrize(("make", "option"), [(ExactRun, "coverage"), (ExactRun, "partdr"), (MeshRun, 0), (MeshRun, 1)])
def test_runs_compute_what_the_library_does(device: str, make: type, option: str | int) -> None:
    make(BenchScene.random(3, SIZE, device), option).check()


@pytest.mark.parametrize("what", ["labels", "gradient"])
def test_a_wrong_run_is_not_timed(device: str, what: str) -> None:
    run = MeshRun(BenchScene.random(1, SIZE, device), 0)
    setattr(run, what, lambda: None)
    with pytest.raises(AssertionError):
        run.check()


def test_a_compiled_step_has_the_losses_of_the_loop(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is compared before it is timed. Torch's own backend of kernels in C++ would take most of a minute."""
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="aot_eager"))
    torch._dynamo.reset()
    scene = BenchScene.random(2, 32, device)
    for name in (EXACT, EXACT + POSED, MESH):
        timing, _ = time_steps(scene, COMPILED_STEP, name, 0.0)
        assert timing.median > 0
    assert COMPILED_STEP in {run[0] for run in plan_kernels("cuda").steps}


def test_every_row_is_there(figures: dict[str, Any]) -> None:
    keys = ("name", "renderer", "batch", "size_px")
    found = {tuple(row[key] for key in keys): row for row in figures["rows"] if row["group"] in GROUPS[:4]}
    assert [*found] == [*PLAN.targets, *PLAN.calls, *PLAN.others, *PLAN.steps]
    assert all(found[run]["median_s"] > 0 for run in PLAN.targets)
    assert all((row["group"] == TARGETS) == (run in PLAN.targets) for run, row in found.items())
    assert found[LABELS, MESH, 2, SIZE]["memory_bytes"] > 2 * SIZE * SIZE
    names = [f"{row['renderer']}: {row['name']}" for row in figures["rows"] if row["group"] == KERNELS]
    for name in (
        *("iteration, exact, edges: push", "iteration, exact, edges: step", "exact, coverage: coverage"),
        *("exact, PartDR: partdr", "mesh E1: draw", "mesh E1: push", "kinematics, E1: pose", "kinematics, E1: place"),
    ):
        assert any(kernel.startswith(name) for kernel in names), name


def test_iterations_leave_bodies_where_they_are(device: str) -> None:
    run = refined_once(BenchScene.random(2, SIZE, device), "coverage", learning_rate=0.0)
    before, history = run._parameters.clone(), run._history.clone()
    assert (history > 0).all()
    for _ in range(100):  # more than a run has
        run.iterate()
    wp.synchronize_device(device)
    assert torch.equal(run._parameters, before)
    assert torch.equal(run._history, history)


def test_command_times_the_papers_targets() -> None:
    cpu, cuda = plan_kernels("cpu", quick=True), plan_kernels("cuda")
    for batch in (1, 16):
        assert {(GRADIENT, EXACT, batch, 256), (GRADIENT, MESH, batch, 256), (REFINEMENT, EXACT, batch, 256)} <= {
            *cpu.targets
        }
    for what, name, batches in (
        (GRADIENT, EXACT, (1, 128, 1024)),
        (REFINEMENT, EXACT, (1, 1024)),
        (TORCH_GRADIENT, EXACT, (1,)),
        *((what, name, (128,)) for what, name in ((GRADIENT, MESH), (LABELS, EXACT), (LABELS, MESH))),
    ):
        assert {(what, name, batch, 256) for batch in batches} <= {*cuda.targets}
    assert cuda.start
    assert len({*cuda.targets, *cuda.others}) == len(cuda.targets) + len(cuda.others)  # nothing twice


# --- peers ---------------------------------------------------------------------------------------------------------


def test_a_peer_that_is_missing_or_fails_is_one_line(monkeypatch: pytest.MonkeyPatch, device: str) -> None:
    def without_its_module(view: peers.MeshView) -> Any:
        """Adapter of a package that is installed, but lacks a module, whatever else is installed."""
        from json import no_such_module

        return no_such_module(view)

    absent = peers.Peer("no_such_package", ("cpu", "cuda"), peers.drtk)
    broken = peers.Peer("json", ("cpu", "cuda"), without_its_module)
    monkeypatch.setattr(measure, "PEERS", {"Absent": absent, "Broken": broken})
    remarks: list[str] = []
    ((_, time_broken),) = measure._peer_jobs(replace(PLAN, device=device), remarks)
    assert time_broken() == []
    assert remarks[0] == "Absent: not timed, no_such_package is not installed"
    assert remarks[1].startswith("Broken: not timed, it failed: ImportError")
    assert len(remarks) == 2


def test_a_slow_peer_draws_few_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "PEERS", {"Slow": peers.Peer("json", ("cpu",), peers.embree, most_bodies=3)})
    jobs = measure._peer_jobs(replace(PLAN, device="cpu", batches=(1, 3, 4)), [])
    assert [name for name, _ in jobs] == ["Slow, B = 1", "Slow, B = 3"]


def test_our_renderer_is_timed_as_peers_are(figures: dict[str, Any]) -> None:
    rows = [row for row in figures["rows"] if row["group"] == PEER_ROWS and row["renderer"] == peers.OURS]
    assert [(row["name"], row["label_agreement"]) for row in rows] == [(LABELS, 1.0), (GRADIENT, 1.0)]


@pytest.fixture(scope="module")
def view() -> peers.MeshView:
    scene = BenchScene.random(2, 48, "cpu")
    points = scene.camera.project(scene.posed.vertices(1)).contiguous()
    return peers.MeshView(points, ellipbody_mesh(1), scene.targets)


def test_loss_of_float_maps_is_ours(view: peers.MeshView) -> None:
    draw, loss = peers.ours(view)
    torch.testing.assert_close(view.loss_of(view.maps_of(draw())), loss(view.vertices))


def test_normalised_vertices_fill_the_picture(view: peers.MeshView) -> None:
    corners = torch.tensor([[0.0, 0.0, 0.0], [48.0, 48.0, 0.0], [24.0, 12.0, 0.0]])
    assert view.normalised(corners)[:, :2].tolist() == [[-1.0, -1.0], [1.0, 1.0], [0.0, -0.5]]
    depths = view.normalised(view.vertices)[..., 2]
    torch.testing.assert_close(torch.stack(depths.aminmax()), torch.tensor([-0.9, 0.9]))


@pytest.mark.skipif(not peers.PEERS["Embree"].is_installed, reason="needs embreex")
def test_embree_sees_what_we_see(view: peers.MeshView) -> None:
    assert (peers.embree(view)[0]() == peers.ours(view)[0]()).float().mean() > 0.999


# --- what is left behind -------------------------------------------------------------------------------------------


def test_command_leaves_table_json_and_picture(
    figures: dict[str, Any],
    device: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(measure, "run_kernels", lambda plan, progress: figures)
    bench.bench_kernels(device=device, quick=True, out=tmp_path / "new")
    table, picture = (tmp_path / "new" / f"bench-kernels-{device}.{kind}" for kind in ("json", "png"))
    assert sorted((tmp_path / "new").iterdir()) == [table, picture]
    data = json.loads(table.read_text())
    assert data["machine"]["warp"] == wp.config.version
    assert data["rows"] == figures["rows"]
    first = data["rows"][0]
    assert (first["name"], first["renderer"], first["batch"], first["size_px"]) == (GRADIENT, EXACT, 2, SIZE)
    assert first["moved_bytes"] / first["median_s"] / data["copy_bandwidth_bytes_per_second"] == pytest.approx(
        first["share_of_copy_bandwidth"]
    )
    with Image.open(picture) as drawn:
        assert drawn.width > 800
    said = capsys.readouterr().out
    wanted = [data["machine"]["warp"], data["machine"]["machine"], "moved [MB]", *data["remarks"]]
    wanted += [row[key] for row in data["rows"] for key in ("name", "renderer")]
    assert [each for each in wanted if each not in said] == []
    assert [group for group in GROUPS if group in said] == [group for group in GROUPS if group != STARTS]
    assert "…" not in said  # no column is cut


def test_out_that_is_a_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for command in (bench.bench_kernels, bench.bench_tradeoff):
        with pytest.raises(InputError, match="--out"):
            command(device="cpu", quick=True, out=tmp_path / "file")


def test_chart_marks_every_batch() -> None:
    """Each B has a shape of its own, in black, grey and white alone."""

    def draw(batches: tuple[int, ...]) -> np.ndarray:
        timings = {batch: Timing((batch * 1e-4,)) for batch in batches}
        rows = [make_row(TARGETS, (LABELS, EXACT, batch, 256), "graph", timings[batch]) for batch in batches]
        figure = draw_kernel_chart({"machine": about(), "rows": rows})
        figure.savefig(file := BytesIO())
        return np.asarray(Image.open(file).convert("RGB"))

    chart, fewer = draw((1, 8, 128, 1024)), draw((1, 8, 128))
    assert (chart.min(2) == chart.max(2)).all()
    assert fewer.shape == chart.shape
    assert (fewer != chart).any()
    assert draw(()).min() < 255  # nothing was timed, and it says so


def test_starts_are_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    processes = iter(["[1.0, 5.0]", "[2.0, 0.5]"])  # cold, warm: imports and first call
    commands = []

    def run(command: list[str], **_: object) -> CompletedProcess[str]:
        if command[2] == start.__name__:
            return CompletedProcess(command, 0, next(processes))
        if command[3:] not in commands:  # the fastest of several counts
            commands.append(command[3:])
        return CompletedProcess(command, 0, "")

    monkeypatch.setattr(subprocess, "run", run)
    rows = measure._time_starts(PLAN)
    assert {row["group"] for row in rows} == {STARTS}
    assert [row["median_s"] for row in rows[:3]] == [2.0, 5.0, 0.5]
    assert [command[0] for command in commands] == ["--help", "fit", "fit"]
    assert all(0 < row["median_s"] < 0.5 for row in rows[3:])
    assert [command[-1] for command in commands[1:]] == ["anny", "none"]
    assert len({row["name"] for row in rows}) == 6


def test_first_calls_are_rows_of_fresh_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first process compiles kernels, and does not count."""
    printed = iter([9.0, 1.0, 3.0, 2.0])

    def run(command: list[str], **_: object) -> CompletedProcess[str]:
        assert command[2:] == [first_call.__name__, PLAN.device]
        seconds = next(printed)
        return CompletedProcess(command, 0, f'Module loaded\n{{"first call": {seconds}, "later call": {seconds / 10}}}')

    monkeypatch.setattr(subprocess, "run", run)
    first, later = measure._time_first_calls(PLAN)
    assert first["group"] == later["group"] == STARTS
    assert (first["name"], first["median_s"], first["fastest_s"], first["repeats"]) == (
        "fit_photo: first call",
        2.0,
        1.0,
        3,
    )
    assert later["median_s"] == 0.2


@pytest.mark.slow
def test_a_first_call_is_timed_in_this_process(device: str) -> None:
    seconds = first_call.time_calls_here(device)
    assert list(seconds) == ["imports", first_call.FIRST, first_call.OTHER, first_call.LATER]
    assert all(each > 0 for each in seconds.values())


@pytest.mark.slow
def test_a_cold_start_takes_longer_than_a_warm_one(device: str) -> None:
    imports, cold, warm = start.time_starts(device).values()
    assert imports > 0
    assert cold > 1.5 * warm > 0


@pytest.mark.slow
def test_commands_run_from_start_to_files(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start, "_TIMES", 1)
    seconds = start.time_commands(device)
    assert len(seconds) == 3
    assert all(each > 0 for each in seconds.values())  # which is longer, a busy machine can change
