"""``partdr bench tradeoff``: the truth is the truth, the true gradient is the loss's slope, and what a run leaves."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO, StringIO
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.cli import bench
from warp_partdr.inputs.observation import REFERENCE_SIZE, resize_nearest
from warp_partdr.lab.bench.renderers import COVERAGE, EXACT, PARTDR
from warp_partdr.lab.bench.tradeoff.chart import draw_tradeoff_chart
from warp_partdr.lab.bench.tradeoff.fits import refine_all, score_bodies
from warp_partdr.lab.bench.tradeoff.gradient import gradient_error, true_gradient
from warp_partdr.lab.bench.tradeoff.measure import run_tradeoff
from warp_partdr.lab.bench.tradeoff.plan import (
    DISTANCE,
    FAR,
    ITERATIONS,
    NAMES,
    NEAR,
    SIZE,
    Setting,
    TradeoffPlan,
    plan_tradeoff,
)
from warp_partdr.lab.bench.tradeoff.report import FLOAT32, FLOAT64, TradeoffReport, front
from warp_partdr.lab.bench.tradeoff.tables import NOTES, print_tradeoff
from warp_partdr.lab.synthetic.tradeoff_people import ANNY, ELLIPBODY, TRUTH_SIZE, People, draw_truth, make_people
from warp_partdr.lab.tables import TABLE_WIDTH
from warp_partdr.reference.ellipsoids import EllipsoidScene, ray_cast
from warp_partdr.render.renderers import RendererMesh
from warp_partdr.solve.ellipsoids.stepper import SHAPE_RATE


@pytest.fixture(scope="module")
def crowds() -> tuple[People, People]:
    return make_people(2, 2)


@pytest.fixture(scope="module")
def own(crowds: tuple[People, People], device: str) -> People:
    return crowds[0].to(device)


@pytest.fixture(scope="module")
def report(device: str) -> TradeoffReport:
    """A run of everything that there is, with as little of it as can be."""
    return run_tradeoff(TradeoffPlan(device, 1, 1, (32, SIZE), (2, ITERATIONS), (DISTANCE,), (DISTANCE,), 0.01, 0))


def test_true_labels_are_the_float64_reference(crowds: tuple[People, People]) -> None:
    """The exact renderer at 3 samples a side of a 512 px picture against the reference at the same samples."""
    size, people = 192, crowds[0]  # the reference is slow
    posed, camera = people.bodies.posed(), people.bodies.camera(size)
    drawn = draw_truth(people.bodies, size)
    for body in range(len(people)):
        scale, shift = camera.scale[body].item(), camera.translation[body].tolist()
        scene = EllipsoidScene(
            *(tensor[body].double().numpy() for tensor in (posed.centres, posed.axes, posed.semi_axes)),
            camera=np.array([scale, scale, *shift]),
            labels=np.arange(1, 21),
        )
        labels, _, _ = ray_cast(scene, (size, size))
        assert (labels != drawn[body].numpy()).sum() <= 2  # rays that graze an outline
        assert (labels > 0).sum() > 1000
    assert people.labels.shape == (2, TRUTH_SIZE, TRUTH_SIZE)


def test_annys_are_seen_as_large_as_their_ellipbodies(crowds: tuple[People, People]) -> None:
    ellipbodies, annys = crowds
    assert (ellipbodies.name, annys.name) == (ELLIPBODY, ANNY)
    shares = [(people.labels > 0).float().mean((1, 2)) for people in crowds]
    assert ((shares[0] / shares[1] - 1).abs() < 0.5).all()
    for people in crowds:
        assert people.labels.unique().tolist()[-1] == 20
        assert (people.points.abs() < 1).float().mean() > 0.95
        exact = score_bodies(people.bodies, people)
        assert (
            exact["joint_error_mm"] < (1e-3 if people.name == ELLIPBODY else 10)
        ).all()  # of Annys, the nearest there is
        assert (exact["part_f1"] > (0.999 if people.name == ELLIPBODY else 0.5)).all()


def test_starts_are_as_far_off_as_they_say(own: People) -> None:
    starts = [own.starts(distance) for distance in (0.0, NEAR, DISTANCE, FAR)]
    errors = [score_bodies(bodies, own)["joint_error_mm"].mean() for bodies in starts]
    assert errors == sorted(errors)
    assert errors[0] < 60  # sizes are the mean adult's
    turned = (own.starts(DISTANCE).rotations - own.bodies.rotations).std()
    assert float(turned) == pytest.approx(DISTANCE, rel=0.2)
    again = own.starts(DISTANCE)
    torch.testing.assert_close(own.starts(DISTANCE).orientation, again.orientation, rtol=0, atol=0)


def test_true_gradient_is_the_slope_of_the_supersampled_loss(own: People) -> None:
    """Central differences of the loss in pictures of 3072 px, along the gradient itself."""
    start = own.starts(DISTANCE)
    gradient = true_gradient(own, start)
    size, step = 2 * TRUTH_SIZE, 3e-3

    def loss(body: BodyParameters, target: torch.Tensor) -> float:
        drawn = draw_truth(body, size)
        wrong = drawn != target
        area = (wrong & (drawn > 0)).sum() + (wrong & (target > 0)).sum()
        return float(area) * (REFERENCE_SIZE / size) ** 2

    def moved(body: BodyParameters, way: torch.Tensor) -> BodyParameters:
        tensors, first = {}, 0
        for name, tensor in body.tensors().items():
            part = way[first : first + tensor.numel()].view(tensor.shape)
            tensors[name] = tensor + part * (SHAPE_RATE if name in ("lengths", "thicknesses") else 1.0)
            first += tensor.numel()
        return BodyParameters(**tensors)

    for person in range(len(own)):
        body = start.select(torch.tensor([person], device=start.shift.device))
        target = resize_nearest(own.labels[person : person + 1], size)
        way = gradient[person] / gradient[person].norm()
        slope = (loss(moved(body, step * way), target) - loss(moved(body, -step * way), target)) / (2 * step)
        assert slope == pytest.approx(float(gradient[person].norm()), rel=0.03)


def test_finer_pictures_have_truer_gradients(own: People) -> None:
    start = own.starts(DISTANCE)
    true = true_gradient(own, start)
    for name in (COVERAGE, EXACT):
        errors = [gradient_error(Setting(name, size), own, start, true) for size in (64, 512)]
        assert (errors[1]["angle_deg"] < errors[0]["angle_deg"]).all()
        assert (np.abs(errors[1]["length_ratio"] - 1) < 0.05).all()
    partdr = gradient_error(Setting(PARTDR, 512), own, start, true)
    assert (partdr["angle_deg"] > errors[1]["angle_deg"]).all()


@pytest.mark.parametrize("name", NAMES)
def test_refinements_come_nearer(own: People, name: str) -> None:
    """All people at once give the same as each alone."""
    start = own.starts(DISTANCE)
    setting = Setting(name, 64, 12)
    bodies, seconds = refine_all(setting, own, start)
    assert seconds > 0
    before, after = score_bodies(start, own), score_bodies(bodies, own)
    assert (after["part_f1"] > before["part_f1"]).all()
    if isinstance(setting.renderer, RendererMesh):  # where one observation holds all
        together, _ = refine_all(replace(setting, iterations=2), own, start)
        for person in range(len(own)):
            index = torch.tensor([person], device=start.shift.device)
            alone = People(own.name, own.bodies.select(index), own.labels[index], own.points[index], own.joints[index])
            found, _ = refine_all(replace(setting, iterations=2), alone, start.select(index))
            torch.testing.assert_close(together.select(index).rotations, found.rotations, rtol=0, atol=1e-4)


def test_front_is_what_nothing_beats() -> None:
    assert front([(1.0, 3.0), (2.0, 2.0), (3.0, 2.5), (4.0, 1.0), (1.0, 4.0)]) == {0, 1, 3}
    assert front([(1.0, 1.0), (1.0, 1.0)]) == {0, 1}
    assert front([]) == set()


@pytest.mark.slow
def test_report_has_every_setting(report: TradeoffReport) -> None:
    assert report.settings() == [Setting(name, size) for name in NAMES for size in (32, SIZE)]
    for setting, truth in product(report.settings(), (ELLIPBODY, ANNY)):
        assert report.fit(truth, setting)["batch_seconds"] > 0
        assert report.fit(truth, replace(setting, iterations=2))["batch_seconds"] > 0
        assert report.gradient(setting)["angle_deg"].min() > 0
    assert {row["distance_rad"] for row in report.fits} == {DISTANCE}
    moved = {(row["renderer"], row["numbers"]): row["moved_mm"] for row in report.precisions}
    assert moved[COVERAGE, FLOAT32] == 0
    assert 0 <= moved[COVERAGE, FLOAT64] < 5


def test_the_chart_of_no_results_is_drawn() -> None:
    draw_tradeoff_chart(TradeoffReport("cpu", {"warp": "1"})).savefig(file := BytesIO())
    assert np.asarray(Image.open(file)).min() < 255


def test_whole_fits_stand_in_the_chart() -> None:
    """Time goes to the right, each quality has a mark, and the mesh stage is among them."""
    seconds = {"fast": 0.1, "accurate": 0.3, "mesh stage": 0.4}
    rows = {name: {"part_f1": 0.8 + s / 10, "pa_mpjpe_mm": 50 - s, "seconds": s} for name, s in seconds.items()}
    figure = draw_tradeoff_chart(TradeoffReport("cpu", {"warp": "1"}, qualities={"clean": rows, "realistic": rows}))
    for axes, figures in zip((figure.axes[3], figure.axes[7]), ("part_f1", "pa_mpjpe_mm"), strict=True):
        assert [text.get_text() for text in axes.texts] == 2 * list(rows)
        marks = axes.lines[1]
        assert marks.get_label() == "clean"
        np.testing.assert_allclose(marks.get_xdata(), [0.1, 0.3, 0.4])
        np.testing.assert_allclose(marks.get_ydata(), [row[figures] for row in rows.values()])


@pytest.mark.slow
def test_dearer_and_worse_is_not_marked(report: TradeoffReport) -> None:
    chosen = report.settings().index(Setting(PARTDR, 32))
    times = [{**row, "seconds": 100.0} if index == chosen else row for index, row in enumerate(report.times)]
    slow = replace(report, times=times)
    print_tradeoff(slow, Console(file=(out := StringIO()), width=TABLE_WIDTH))
    lines = [line.split() for line in out.getvalue().splitlines()]
    row = next(line for line in lines if line[:3] == ["exact,", "PartDR", "32"])
    assert row[3] == "1e+05"
    scores = {setting: report.fit(ELLIPBODY, setting)["part_f1"].mean() for setting in report.settings()}
    if max(scores, key=scores.__getitem__) != Setting(PARTDR, 32):
        assert "*" not in row[5]


@pytest.mark.slow
def test_command_leaves_tables_json_and_picture(
    report: TradeoffReport,
    device: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("warp_partdr.lab.bench.tradeoff.measure.run_tradeoff", lambda plan, progress: report)
    bench.bench_tradeoff(device=device, quick=True, out=tmp_path / "new")
    table, picture = (tmp_path / "new" / f"bench-tradeoff-{device}.{kind}" for kind in ("json", "png"))
    assert sorted((tmp_path / "new").iterdir()) == [table, picture]
    with Image.open(picture) as drawn:
        assert drawn.width > 1200
        grey = np.asarray(drawn.convert("RGB")).astype(float).mean(2)
    assert (grey < 100).sum() > 2000  # lines and letters are there without colour, too
    said = capsys.readouterr().out
    wanted = (*NAMES, report.machine["machine"], NOTES[0][:60], "an iteration")
    wanted += ("float64", "labels alone", "[ms]", "[mm]")
    assert [each for each in wanted if each not in said] == []
    assert "…" not in said  # no column is cut
    data = json.loads(table.read_text())
    assert data["machine"] == report.machine
    assert len(data["fits"]) == len(report.fits)
    assert data["times"][0]["seconds"] > 0
    assert len(data["found"]) == 12  # of either truth, three steps, two ways to count


def test_quick_plan_is_smaller() -> None:
    quick, full = plan_tradeoff("cpu", quick=True), plan_tradeoff("cpu")
    assert quick.ellipbodies < full.ellipbodies
    assert set(quick.sizes) < set(full.sizes)
    assert {SIZE} <= set(quick.sizes)  # which the tables beside the first one are about
    assert set(quick.iterations) < set(full.iterations)
    assert full.sizes == (64, 128, 256, 512)
    assert full.iterations == (10, 25, 50, 100)
