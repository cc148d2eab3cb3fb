"""The label network's losses and its training task."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch
from helpers.bodies import walker
from helpers.training import make_task

from warp_partdr.body.lens import ray_rotations
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic.training_people import PeopleBatch
from warp_partdr.lab.training.config import Phase, TrainingConfig, make_config, read_config
from warp_partdr.lab.training.label_task import LabelTask, body_losses, uncertainty_losses
from warp_partdr.networks.regression.label_network import KNOWN_LENS
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.predicted import Predicted
from warp_partdr.networks.regression.regressor import RegressorConfig
from warp_partdr.networks.regression.uncertainty import Uncertainty
from warp_partdr.render.ellipsoids import draw_ellipsoids

SIZE = 64
DISTANCE = 2.5  # [m]
SMALL = {
    "size": SIZE,
    "channels": [8, 16, 16, 16, 16],
    "places": 4,
    "keypoint_features": 16,
    "regressor": {"width": 32},
}


def small_config(seed: int = 0) -> TrainingConfig:
    numbers = {"task": "label-network", "steps": 1, "batch_size": 6, "model": SMALL, "data": {"validation": 14}}
    return make_config({**numbers, "seed": seed})


@pytest.fixture(scope="module")
def task() -> LabelTask:
    found = make_task(small_config())
    found.begin(Phase())
    return found


def known(device: str) -> tuple[Predicted, PeopleBatch]:
    """Two bodies, and the truth that they are right."""
    body = walker(device).select(torch.zeros(2, dtype=torch.int64, device=device))
    predicted = Predicted(
        orientation=body.global_orient(),
        rotations=rotation_from_axis_angle(body.free_rotations()),
        lengths=body.lengths,
        thicknesses=body.thicknesses,
        log_scale=body.log_scale,
        shift=body.shift,
        uncertainty=Uncertainty(
            torch.full((2, 20), 1e-3, device=device),
            torch.full((2, 19), 1e-3, device=device),
            torch.full((2,), 1 / DISTANCE, device=device),
        ),
    )
    posed = predicted.posed()
    # One camera looks straight at its person, the other one past it.
    lenses = torch.tensor([[0.0, *body.shift[0].tolist()], [0.0, 0.6, -0.4]], device=device)
    lenses[:, 0] = DISTANCE * body.log_scale.exp()
    turns = torch.cat([ray_rotations(body.select(torch.tensor([i], device=device)), lenses[i]) for i in range(2)])
    turned = replace(predicted, orientation=turns @ predicted.orientation)
    camera, pelvises = turned.camera(SIZE).to_perspective(lenses[:, 0] * SIZE / 2, (lenses[:, 1:] + 1) * SIZE / 2)
    before = turned.posed().at(pelvises)
    points = camera.project(LandmarkGather(LANDMARKS, device)(before))[..., :2] * (2 / SIZE) - 1
    parts = draw_ellipsoids(before, camera, (SIZE, SIZE)).labels
    return predicted, PeopleBatch(
        groups=parts,
        label_sets=torch.zeros(2, dtype=torch.int64, device=device),
        keypoints=torch.cat([points, torch.ones_like(points[..., :1])], dim=-1),
        parts=parts,
        points=points,
        joints=posed.joints,
        orientation=predicted.orientation,
        rotations=predicted.rotations,
        lengths=predicted.lengths,
        lenses=lenses,
        lens_certainty=torch.tensor([KNOWN_LENS, 0.0], device=device),
        statures=torch.tensor([1.7, 0.0], device=device),
        turns=turns,
        distances=torch.full((2,), DISTANCE, device=device),
    )


@pytest.mark.parametrize(
    ("changed", "costs"),
    [
        ("nothing", set()),
        ("orientation", {"joints", "rotations", "proj", "seg", "spreads"}),
        ("lengths", {"joints", "proj", "seg", "lengths", "spreads"}),
        ("thicknesses", {"proj", "seg", "thicknesses"}),  # eyes and ears lie on the surface
        ("log_scale", {"proj", "seg"}),
        ("shift", {"proj", "seg"}),
        ("depths", {"spreads"}),
        ("turns", {"spreads"}),
        ("nearness", {"nearness"}),
    ],
)
def test_what_is_wrong_costs_where_it_shows(device, changed, costs):
    predicted, truth = known(device)
    if changed == "orientation":
        turn = rotation_from_axis_angle(torch.tensor([0.0, 0.5, 0.2], device=device))
        predicted = replace(predicted, orientation=turn @ predicted.orientation)
    elif changed in vars(predicted.uncertainty):
        said = {changed: 1.5 * getattr(predicted.uncertainty, changed)}
        predicted = replace(predicted, uncertainty=replace(predicted.uncertainty, **said))
    elif changed != "nothing":
        value = getattr(predicted, changed)
        wrong = 1.4 * value if changed in ("lengths", "thicknesses") else value + 0.2
        predicted = replace(predicted, **{changed: wrong})
    for name, loss in body_losses(predicted, truth).items():
        assert float(loss) > 1e-4 if name in costs else float(loss) == pytest.approx(0.0, abs=1e-5), name


def test_a_phase_leaves_terms_out(task):
    people = task.batch(torch.device("cpu"))
    model = task.model().train()
    whole = task.loss(model, people)
    assert whole["total"].item() == pytest.approx(sum(v.item() for k, v in whole.items() if k != "total"), rel=1e-5)
    task.begin(Phase(without=("seg",)))
    assert "seg" not in task.loss(model, people)
    task.begin(Phase())


def test_a_network_learns_a_batch_by_heart(task):
    torch.manual_seed(0)
    people, model = task.batch(torch.device("cpu")), task.model().train()
    optimizer = torch.optim.AdamW(model.parameters(), 3e-3)
    totals = []
    for _ in range(80):
        loss = task.loss(model, people)["total"]
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        totals.append(loss.item())
    assert totals[-1] < 0.4 * totals[0]


def test_held_out_people_are_the_same_in_every_run(task):
    torch.manual_seed(0)
    model = task.model().eval()
    other = make_task(small_config(seed=5))
    with torch.no_grad():
        errors = task.validate(model, torch.device("cpu"))
        assert errors == other.validate(model, torch.device("cpu"))
        sheet = task.pictures(model, torch.device("cpu"))
    assert sheet.size == (12 * SIZE, 3 * SIZE)
    shares = {f"{what} within their 68 %" for what in ("depths", "rotations")}
    assert set(errors) == {
        "MPJPE [mm]",
        "PA-MPJPE [mm]",
        "PA-MPJPE of the tilted [mm]",
        "part F1",
        "foreground F1",
        *shares,
    }
    assert all(0 <= errors[name] <= 1 for name in shares)


def test_spreads_are_least_wrong_where_68_percent_of_errors_are_below():
    """The pinball loss of 10,000 known errors, over spreads of all sizes."""
    predicted, people = known("cpu")
    count = 10_000
    errors = torch.randn(count, generator=torch.Generator().manual_seed(0)).abs() * 0.1
    some = torch.zeros(count, dtype=torch.int64)
    predicted, truth = predicted.select(some), {each.name: getattr(people, each.name)[some] for each in fields(people)}
    joints = truth["joints"].clone()
    joints[:, 1:, 2] += errors[:, None]
    truth = PeopleBatch(**{**truth, "joints": joints})
    own = predicted.posed().joints

    def loss(spread: float) -> float:
        said = replace(predicted.uncertainty, depths=torch.full((count, 20), spread))
        return float(uncertainty_losses(replace(predicted, uncertainty=said), own, truth)["spreads"])

    spreads = [0.06, 0.08, 0.09, 0.0994, 0.11, 0.12, 0.15]  # 68 % of normal errors are below 0.9945 deviations
    losses = [loss(spread) for spread in spreads]
    assert losses.index(min(losses)) == 3


def test_batches_go_on_where_they_stopped_and_differ_between_processes(task):
    state = task.state_dict()
    want = task.batch(torch.device("cpu"))
    task.load_state_dict(state)
    have = task.batch(torch.device("cpu"))
    assert all(torch.equal(getattr(have, each.name), getattr(want, each.name)) for each in fields(have))
    first, second = (make_task(small_config(), rank, 2).batch(torch.device("cpu")) for rank in range(2))
    assert not torch.equal(first.orientation, second.orientation)


def test_people_made_ahead_come_as_often_as_said_and_meet_others_each_time():
    numbers = small_config().to_json()
    task = make_task(make_config({**numbers, "data": {"validation": 14, "ahead": 3, "uses": 2}}))
    batches, states = [], []
    for _ in range(8):
        states.append(task.state_dict())
        batches.append(task.batch(torch.device("cpu")).orientation.flatten(1))
    stock = torch.cat(batches[:6])
    people, counts = torch.unique(stock, dim=0, return_counts=True)
    assert (len(people), set(counts.tolist())) == (18, {2})
    met = [{tuple(row) for row in batch.tolist()} for batch in batches]
    assert not any(first & second for first in met[:3] for second in met[:3] if first is not second)
    assert all(met[i] not in met[3:6] for i in range(3))
    assert not met[6] & set().union(*met[:6])  # the stock was used up
    for place in (1, 6, 7):
        task.load_state_dict(states[place])
        assert torch.equal(task.batch(torch.device("cpu")).orientation.flatten(1), batches[place])


@pytest.mark.parametrize("name", ["ahead", "uses", "validation"])
def test_counts_of_people_are_positive(name):
    with pytest.raises(InputError, match=rf"data\.{name}: 0; expected 1 or more"):
        make_config({"task": "label-network", "steps": 1, "data": {name: 0}})


def test_begins_with_a_trained_network_of_the_same_sizes(task, tmp_path):
    weights = task.model().state_dict()
    task.save(tmp_path / "model.safetensors", weights, {}, bits=32)
    read = task.read(str(tmp_path / "model.safetensors"))
    assert read.keys() == weights.keys()  # and so the file can be loaded
    assert all(torch.equal(read[name], value) for name, value in weights.items())
    with pytest.raises(InputError, match="initial: packaged: a network of"):
        task.read("packaged")
    packaged = make_task(read_config("label-network"))
    packaged.model().load_state_dict(packaged.read("packaged"))


FEEDBACK = {"regressor": RegressorConfig(width=32, feedback=True)}


@pytest.mark.parametrize("more", [FEEDBACK, {"attention_layers": 1, "attention_width": 8} | FEEDBACK])
def test_goes_on_with_more_inputs_from_a_network_without_as_the_same_network(task, tmp_path, more):
    before = task.model().eval()
    task.save(tmp_path / "model.safetensors", before.state_dict(), {}, bits=32)
    wider = make_task(replace(task.config, model=replace(task.config.model, **more)))
    after = wider.model().eval()
    after.load_state_dict(wider.read(str(tmp_path / "model.safetensors")))
    people = task.held_out[0]
    found, expected = (each.predict(network, people) for each, network in ((wider, after), (task, before)))
    torch.testing.assert_close(found.posed().joints, expected.posed().joints, atol=1e-6, rtol=0)
    wider.save(tmp_path / "wider.safetensors", after.state_dict(), {}, bits=32)
    with pytest.raises(InputError, match=r"initial: .*wider.safetensors: a network of"):
        task.read(str(tmp_path / "wider.safetensors"))
