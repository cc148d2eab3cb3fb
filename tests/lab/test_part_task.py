"""The part head's losses and its training task."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.training import make_task
from PIL import Image
from safetensors.torch import load_file

from warp_partdr.cli.main import app
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic.photo_people import PhotoBatch
from warp_partdr.lab.synthetic.training_people import cell_of, held_out_cells
from warp_partdr.lab.training.config import Phase, TrainingConfig, make_config, read_config
from warp_partdr.lab.training.loop import run_training
from warp_partdr.lab.training.part_task import PartTask, cell_labels, part_losses
from warp_partdr.networks.detection.heavy_network import join_features, load_part_head
from warp_partdr.networks.detection.part_head import PartHead, PartHeadConfig, SeenParts

CHANNELS = (16, 16, 8, 8, 8)
CPU = torch.device("cpu")


def small_config(**changes: object) -> TrainingConfig:
    data = {"validation": 3, "pool": 32}
    numbers = {"task": "parts", "steps": 1, "batch_size": 2, "model": {"channels": list(CHANNELS)}, "data": data}
    return make_config({**numbers, **changes})


@pytest.fixture(scope="module")
def task() -> PartTask:
    found = make_task(small_config())
    found.begin(Phase())
    return found


def known(device: str) -> tuple[SeenParts, PhotoBatch]:
    """Two pictures, and an answer that is right about them."""
    generator = torch.Generator().manual_seed(0)
    labels = torch.randint(21, (2, 256, 256), generator=generator).to(device, torch.uint8)
    joints = torch.rand(2, 21, 2, generator=generator).to(device)
    truth = labels[:, 1::2, 1::2].long()
    logits = 50.0 * torch.nn.functional.one_hot(truth, 21).permute(0, 3, 1, 2).float()
    spreads = torch.full((2, 21, 2), 0.02, device=device)
    return SeenParts(logits, joints, spreads), PhotoBatch(torch.zeros(2, 3, 256, 256, device=device), labels, joints)


def losses(seen: SeenParts, batch: PhotoBatch) -> dict[str, float]:
    return {name: float(loss) for name, loss in part_losses(seen, batch).items()}


def test_the_right_answer_costs_nothing(device: str) -> None:
    assert losses(*known(device)) == pytest.approx({"labels": 0.0, "joints": 0.0, "spreads": 0.0}, abs=1e-6)


def test_cells_are_every_second_pixel_and_unknown_ones_cost_nothing(device: str) -> None:
    seen, batch = known(device)
    labels = batch.labels.clone()
    labels[:, ::2] = 20 - labels[:, ::2]
    labels[:, :, ::2] = 20 - labels[:, :, ::2]
    assert losses(seen, replace(batch, labels=labels))["labels"] == pytest.approx(0.0, abs=1e-6)
    wrong = batch.labels.clone()
    wrong[:, 1, 1::2] = (wrong[:, 1, 1::2] + 1) % 21
    assert losses(seen, replace(batch, labels=wrong))["labels"] == pytest.approx(50 / 128, rel=1e-4)
    wrong[:, 1] = 255
    assert losses(seen, replace(batch, labels=wrong))["labels"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("off", "cost"), [(0.002, 0.5 * 0.1**2), (0.02, 0.5), (0.1, 4.5)])
def test_joints_cost_their_distance_and_small_errors_their_square(off: float, cost: float, device: str) -> None:
    seen, batch = known(device)
    assert losses(seen._replace(joints=seen.joints + off), batch)["joints"] == pytest.approx(cost, rel=1e-3)


def test_joints_beyond_the_picture_cost_nothing(device: str) -> None:
    seen, batch = known(device)
    joints = batch.joints.clone()
    joints[:, :7, 0] = 1.2
    joints[:, 7:14, 1] = -0.1
    found = seen._replace(joints=seen.joints + 0.1)
    assert losses(found, replace(batch, joints=joints))["joints"] == pytest.approx(4.5, rel=1e-3)
    assert losses(found, replace(batch, joints=joints - 5))["joints"] == 0.0  # nor is it NaN


def test_wide_heat_maps_cost_the_logarithm_of_their_width(device: str) -> None:
    seen, batch = known(device)
    assert losses(seen._replace(spreads=0.0 * seen.spreads + 0.2), batch)["spreads"] == pytest.approx(math.log(8))
    assert losses(seen._replace(spreads=0.0 * seen.spreads + 0.025), batch)["spreads"] == pytest.approx(0.0, abs=1e-6)


def test_terms_are_weighted_and_a_phase_leaves_some_out(task: PartTask) -> None:
    batch, model = task.batch(CPU), task.model().train()
    whole = task.loss(model, batch)
    plain = part_losses(task.see(model, batch.pictures), batch)
    expected = plain["labels"] + 0.05 * plain["joints"] + 0.01 * plain["spreads"]
    assert whole["total"].item() == pytest.approx(expected.item(), rel=1e-4)
    task.begin(Phase(without=("joints",)))
    assert "joints" not in task.loss(model, batch)
    task.begin(Phase())


def test_the_landmark_network_stays_as_it_is(task: PartTask) -> None:
    before = {name: value.clone() for name, value in task._encoder.named_buffers()}
    batch, model = task.batch(CPU), task.model().train()
    optimizer = torch.optim.SGD(model.parameters(), 0.1)
    task.loss(model, batch)["total"].backward()
    optimizer.step()
    assert all(torch.equal(value, before[name]) for name, value in task._encoder.named_buffers())
    assert not list(task._encoder.parameters())
    assert all(parameter.grad is not None for parameter in model.parameters())


def test_a_head_learns_a_batch_by_heart(task: PartTask) -> None:
    torch.manual_seed(0)
    batch, model = task.batch(CPU), task.model().train()
    with torch.no_grad():
        values = task._encoder(batch.pictures)
    features = join_features(values)
    optimizer = torch.optim.AdamW(model.parameters(), 1e-2)
    totals = []
    for _ in range(40):
        terms = part_losses(model(features, values["landmarks"], batch.pictures), batch)
        loss = terms["labels"] + 0.05 * terms["joints"] + 0.01 * terms["spreads"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        totals.append(loss.item())
    assert totals[-1] < 0.5 * totals[0]


def test_the_packaged_head_sees_the_parts_of_people_held_out() -> None:
    """It has learned from such pictures: labels and joints are where it sees them."""
    task = make_task(small_config(model={}, data={"validation": 6, "pool": 32}))
    model = PartHead(PartHeadConfig()).eval()
    model.load_state_dict(task.read("packaged"))
    with torch.no_grad():
        errors = task.validate(model, CPU)
        sheet = task.pictures(model, CPU)
    assert errors["part F1"] > 0.5
    assert errors["joints [px of 256]"] < 15
    rows = np.asarray(sheet).reshape(3, 128, 6, 128, 3)
    seen, truth = rows[1], rows[2]
    assert (seen == truth).all(-1).mean() > 0.8


def test_validation_counts_cells_and_joints_within_the_picture(task: PartTask, monkeypatch) -> None:
    seen, batch = known("cpu")
    joints = batch.joints.clone()
    joints[:, 0] = 1.5
    batch = replace(batch, joints=joints)
    monkeypatch.setattr(task, "_held_out", [batch])
    monkeypatch.setattr(
        task, "see", lambda model, pictures: seen._replace(joints=seen.joints + torch.tensor([0.03, 0.04]))
    )
    errors = task.validate(task.model(), CPU)
    assert errors == pytest.approx({"part F1": 1.0, "joints [px of 256]": 0.05 * 256}, rel=1e-4)


def test_held_out_people_are_the_same_in_every_run(task: PartTask) -> None:
    batches = task._held_out
    assert [len(batch.labels) for batch in batches] == [3]
    other = make_task(small_config(seed=3))
    other.batch(CPU)
    assert torch.equal(batches[0].pictures, other._held_out[0].pictures)


def test_bodies_are_of_their_side_of_the_split(task: PartTask, monkeypatch) -> None:
    for held_out in (False, True):
        people = task._make_maker(0, held_out=held_out)._people
        assert (np.isin(cell_of(people.quantiles(200).numpy()), held_out_cells()) == held_out).all()
    asked = []

    def make_maker(self: PartTask, seed: int, *, held_out: bool):
        asked.append(held_out)
        return lambda count: count

    monkeypatch.setattr(PartTask, "_make_maker", make_maker)
    assert make_task(small_config())._held_out == [3]
    assert asked == [False, True]


def test_a_run_goes_on_with_the_pictures_that_would_have_come(task: PartTask) -> None:
    state = task.state_dict()
    expected = task.batch(CPU)
    other = make_task(small_config())
    other.load_state_dict(state)
    assert torch.equal(other.batch(CPU).pictures, expected.pictures)


def test_processes_learn_from_other_people() -> None:
    first, second = (make_task(small_config(), rank=rank, processes=2).batch(CPU) for rank in (0, 1))
    assert not torch.isclose(first.joints, second.joints).all(-1).any()


def test_a_head_of_other_sizes_is_refused(task: PartTask) -> None:
    with pytest.raises(
        InputError, match=r"initial: packaged: a head of .*128.*; expected .*channels=\(16, 16, 8, 8, 8\)"
    ):
        task.read("packaged")


@pytest.mark.parametrize(
    ("name", "override", "said"),
    [
        ("parts", "data.validation=0", r"data\.validation: 0; expected 1 or more"),
        ("parts", "data.pool=0", r"data\.pool: 0; expected 1 or more"),
        ("parts", "model.channels=[8, 8]", r"channels"),
        ("parts", "data.size=3", r"data\.size: unknown; expected one of backgrounds"),
        ("label-network", "data.backgrounds=x", r"data\.backgrounds: unknown"),
    ],
)
def test_wrong_numbers_of_the_part_head_are_named(name: str, override: str, said: str) -> None:
    with pytest.raises((InputError, ValueError), match=said):
        read_config(name, [override])


def test_a_missing_folder_of_backgrounds_is_named(tmp_path) -> None:
    options = ["--out", str(tmp_path / "out"), "--backgrounds", str(tmp_path / "nowhere"), "--device", "cpu"]
    with pytest.raises(InputError, match=r"data\.backgrounds: .*nowhere; expected a folder"):
        app(["train", "parts-smoke", *options], standalone_mode=False)


def test_the_smoke_run_writes_a_head_in_16_bits(tmp_path, capfd) -> None:
    """Also with quotes in the names of folders, and resumed."""
    photos, out = tmp_path / 'my "photos"', tmp_path / "the first one's"
    photos.mkdir()
    Image.fromarray(np.full((90, 60, 3), 120, dtype=np.uint8)).save(photos / "grey.png")
    options = ["--out", str(out), "--backgrounds", str(photos), "--device", "cpu", "--set", "data.validation=2"]
    app(["train", "parts-smoke", *options, "--set", "steps=1"], standalone_mode=False)
    app(["train", "parts-smoke", *options, "--set", "steps=2", "--resume"], standalone_mode=False)
    assert "part F1" in capfd.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert set(report["errors"]) == {"part F1", "joints [px of 256]"}
    assert report["config"]["data"]["backgrounds"] == str(photos)
    assert (report["steps"], report["resumed_at"]) == (2, 1)
    assert len(list((out / "pictures").iterdir())) == 2
    assert load_file(out / "model.safetensors")["last.weight"].dtype == torch.float16
    head = load_part_head(out / "model.safetensors")
    assert head.config == PartHeadConfig(CHANNELS)


def test_a_head_trains_in_bfloat16(tmp_path) -> None:
    data = {"validation": 2, "pool": 32}
    config = small_config(out=str(tmp_path), precision="bf16", data=data)
    run_training(config, device="cpu", bits=32)
    weights = load_file(tmp_path / "model.safetensors")
    assert weights["last.weight"].dtype == torch.float32
    assert all(value.isfinite().all() for value in weights.values())


def test_cells_of_labels_are_those_of_pixels_right_and_below() -> None:
    labels = torch.arange(16, dtype=torch.uint8).view(1, 4, 4)
    assert cell_labels(labels).tolist() == [[[5, 7], [13, 15]]]
