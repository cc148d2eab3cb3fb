"""EllipBodyNet: shapes, its heads and losses against plain formulas, data with gaps, and that it learns."""

import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from helpers.training import make_task
from PIL import Image
from safetensors.torch import load_file

from warp_partdr.body.labels import label_set
from warp_partdr.body.landmarks import annotated
from warp_partdr.body.skeletons import MPJPE_HIPS, MPJPE_JOINTS, skeleton
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.kernels.launch import get_num_threads, set_num_threads
from warp_partdr.lab.synthetic.shaded import shaded_people
from warp_partdr.lab.training.augment import Augmentation
from warp_partdr.lab.training.config import make_config, read_config
from warp_partdr.lab.training.loop import run_training
from warp_partdr.lab.training.picture_data import ExampleDataset, Examples, Feed, Source, make_example
from warp_partdr.lab.training.picture_losses import body_terms, head_terms, seg_term
from warp_partdr.networks.regression.checkpoint import load_ellipbodynet, save_ellipbodynet
from warp_partdr.networks.regression.ellipbodynet import EllipBodyNet, EllipBodyNetConfig, PicturePrediction
from warp_partdr.networks.regression.heads import soft_argmax
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.predicted import posed_landmarks
from warp_partdr.networks.regression.regressor import RegressorConfig

SIZE = 64
TINY = {
    "model_type": "resnet",
    "layer_type": "basic",
    "embedding_size": 16,
    "hidden_sizes": [16, 32, 48, 64],
    "depths": [1, 1, 1, 1],
}
CONFIG = EllipBodyNetConfig(
    architecture=TINY, size=SIZE, head_width=16, part_cells=4, regressor=RegressorConfig(width=64, dropout=0.0)
)
STILL = Augmentation(flip=0, angle=0, zoom=0, shift=0, colour=0)


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    """A few small bodies are not worth several, and a busy machine makes them wait for each other."""
    before = get_num_threads(), torch.get_num_threads()
    set_num_threads(1)
    torch.set_num_threads(1)
    yield
    set_num_threads(before[0])
    torch.set_num_threads(before[1])


@pytest.fixture(scope="module")
def people():
    return shaded_people(4, seed=9)


@pytest.fixture(scope="module")
def examples(people):
    return Examples.cat([make_example(sample, SIZE) for sample in people])


def network(config: EllipBodyNetConfig = CONFIG) -> EllipBodyNet:
    torch.manual_seed(0)
    return EllipBodyNet(config)


@pytest.fixture(scope="module")
def prediction(examples):
    return network().eval()(examples.pictures)


def rows(batch: Examples, first: int, last: int) -> Examples:
    return Examples(**{name: value[first:last] for name, value in vars(batch).items()})


def all_terms(prediction: PicturePrediction, examples: Examples) -> dict[str, torch.Tensor]:
    terms = {**body_terms(prediction, examples), **head_terms(prediction, examples)}
    return {**terms, "seg": seg_term(prediction, examples, size=SIZE, gradient="partdr")}


@pytest.mark.parametrize("half", [False, True])
def test_predictions_have_their_shapes_and_bodies_are_in_float32(device, examples, half):
    net = network().to(device)
    with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=half):
        prediction = net(examples.pictures.to(device))
    assert prediction.heatmaps.dtype == (torch.bfloat16 if half else torch.float32)
    assert prediction.keypoints.dtype == prediction.bodies.orientation.dtype == torch.float32
    assert prediction.heatmaps.shape == (4, 24, 16, 16)
    assert prediction.keypoints.shape == (4, 24, 3)
    assert prediction.parts.shape == (4, 21, 16, 16)
    assert prediction.part_labels(SIZE).shape == (4, SIZE, SIZE)
    assert prediction.bodies.rotations.shape == (4, 20, 3, 3)
    terms = all_terms(prediction, examples.to(device))
    assert all(torch.isfinite(term) for term in terms.values())
    torch.stack(list(terms.values())).sum().backward()
    assert [name for name, parameter in net.named_parameters() if parameter.grad is None] == []
    assert all(torch.isfinite(parameter.grad).all() for parameter in net.parameters())
    assert all(parameter.grad.any() for parameter in net.regressor.parameters())


def test_floats_are_pictures_too(examples, prediction):
    torch.testing.assert_close(network().eval()(examples.pictures.float() / 255).parts, prediction.parts)


@pytest.mark.parametrize(
    "architecture",
    [
        {"model_type": "convnext", "hidden_sizes": [8, 16, 24, 32], "depths": [1, 1, 1, 1]},
        {"model_type": "dinov2", "hidden_size": 48, "num_hidden_layers": 2, "num_attention_heads": 2, "patch_size": 16},
        {"model_type": "swin", "embed_dim": 12, "depths": [1, 1], "num_heads": [2, 2], "image_size": 64},
    ],
)
def test_other_backbones_work(architecture):
    prediction = network(replace(CONFIG, architecture=architecture)).eval()(torch.zeros(1, 3, SIZE, SIZE))
    assert prediction.bodies.shift.shape == (1, 2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"backbone": "/nowhere/at-all", "architecture": {}}, "no such folder"),
        ({"architecture": {"model_type": "bert"}}, "no feature maps"),
        ({"architecture": {"model_type": "nonsense"}}, "architecture: "),
        ({"architecture": {"depths": [1]}}, "architecture: "),
        ({"architecture": {**TINY, "layer_type": "odd"}}, "architecture: "),
    ],
)
def test_unknown_backbones_are_refused(change, said):
    with pytest.raises(InputError, match=said):
        EllipBodyNet(replace(CONFIG, **change))


def test_a_backbone_comes_from_a_folder_with_or_without_weights(tmp_path, monkeypatch):
    """A configuration is enough for random weights. Pretrained weights that are missing are an error."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    (tmp_path / "config.json").write_text(json.dumps(TINY))
    config = replace(CONFIG, backbone=str(tmp_path), architecture={})
    assert network(config).config.architecture["hidden_sizes"] == [16, 32, 48, 64]
    with pytest.raises(InputError, match=r"no weights found; .*hf download"):
        EllipBodyNet(replace(config, pretrained=True))
    source = network()
    source.backbone.save_pretrained(tmp_path)
    loaded = network(replace(config, pretrained=True))
    for (name, weight), other in zip(source.backbone.named_parameters(), loaded.backbone.parameters(), strict=True):
        torch.testing.assert_close(weight, other, msg=name)
    assert loaded.config.pretrained is False


@pytest.mark.parametrize("shape", [(1, 3, 32, SIZE), (1, 1, SIZE, SIZE), (3, SIZE, SIZE)])
def test_pictures_of_another_shape_or_type_are_refused(shape):
    with pytest.raises(ValueError, match="pictures: shape"):
        network()(torch.zeros(shape))
    with pytest.raises(ValueError, match=r"pictures: torch\.int64"):
        network()(torch.zeros(1, 3, SIZE, SIZE, dtype=torch.int64))


def test_soft_argmax_finds_sharp_peaks_and_is_unsure_of_flat_maps():
    """A sharp peak is where it is, and sure; a flat map is in the middle, and unsure."""
    heatmaps = torch.zeros(1, 2, 16, 32)
    heatmaps[0, 0, 3, 20] = 50.0
    (x, y, confidence), flat = soft_argmax(heatmaps)[0]
    assert (x, y) == pytest.approx(((20.5 / 16) - 1, (3.5 / 8) - 1), abs=1e-5)
    assert confidence > 0.99
    assert flat[:2].abs().max() < 1e-6
    assert flat[2] < 1e-3


def test_joints_count_where_they_and_the_hips_are_known(examples, prediction):
    """In the batch, one has no 3D, one no hip, and one is as predicted. The formula is in test_losses.py."""
    joints, has_joints = examples.joints.clone(), examples.has_joints.clone()
    joints[0] = posed_landmarks(prediction.bodies.posed(), MPJPE_JOINTS)[0].detach() + 3.0
    has_joints[1] = 0
    has_joints[2, MPJPE_HIPS[0]] = 0
    has_joints[3, MPJPE_JOINTS.index("neck")] = 0
    changed = replace(examples, joints=joints, has_joints=has_joints)
    last = replace(prediction, bodies=prediction.bodies.select(slice(3, 4)))
    alone = body_terms(last, rows(changed, 3, 4))["joints"].item()
    assert alone > 1
    assert body_terms(prediction, changed)["joints"].item() == pytest.approx(alone / 4, rel=1e-4)


@pytest.mark.parametrize("marks", [False, True])
def test_keypoints_pull_to_what_their_format_marks(examples, prediction, marks):
    bodies = prediction.bodies
    names = annotated(LANDMARKS) if marks else LANDMARKS
    seen = bodies.camera(2).project(posed_landmarks(bodies.posed(), names))[..., :2].detach() - 1
    keypoints = torch.cat([seen, torch.ones_like(seen[..., :1])], dim=-1)
    own, others = (
        body_terms(prediction, replace(examples, keypoints=keypoints, annotated=torch.full((4,), said)))["proj"].item()
        for said in (marks, not marks)
    )
    assert own == pytest.approx(0, abs=1e-2)
    assert others > 10


def test_what_is_not_known_pulls_nowhere(examples, prediction):
    """2D-only, unlabelled and keypoint-less people: their numbers don't count."""
    empty = replace(
        examples,
        groups=torch.full_like(examples.groups, 255),
        part_groups=torch.zeros_like(examples.part_groups),
        keypoints=torch.zeros_like(examples.keypoints),
        has_joints=torch.zeros_like(examples.has_joints),
    )
    counted = {name for name, term in all_terms(prediction, empty).items() if term.item() != 0}
    assert counted == {"lengths", "thicknesses"}


def test_label_sets_mix_in_a_batch(examples, prediction):
    """Half of a batch with coarser labels: L_seg is the sum of the halves', and parts of one group add up."""
    coarse = label_set("lsp6")
    table = torch.from_numpy(coarse.from_parts(np.arange(256).clip(0, 255).astype(np.uint8) % 21))
    table[255] = 255
    groups, part_groups = examples.groups.clone(), examples.part_groups.clone()
    groups[2:] = table[groups[2:].long()]
    part_groups[2:] = torch.from_numpy(coarse.part_groups)
    mixed = replace(examples, groups=groups, part_groups=part_groups)

    def seg(batch: Examples, pictures: torch.Tensor) -> float:
        return seg_term(network().eval()(pictures), batch, size=SIZE, gradient="edges").item()

    halves = [seg(rows(mixed, *span), examples.pictures[slice(*span)]) for span in ((0, 2), (2, 4))]
    assert seg(mixed, examples.pictures) == pytest.approx(np.mean(halves), rel=1e-5)
    assert seg(mixed, examples.pictures) != pytest.approx(seg(examples, examples.pictures), rel=1e-3)
    fine, merged = (head_terms(prediction, batch)["parts"] for batch in (examples, mixed))
    assert merged.item() < fine.item()


def test_part_loss_is_of_the_groups_share(examples, prediction):
    """A pixel of a group of five parts, all as likely as the other 16 classes: -log(5 / 21); a sure one: 0."""
    groups = torch.full_like(examples.groups, 255)
    groups[:, 5:9] = 1
    part_groups = torch.zeros_like(examples.part_groups)
    part_groups[:, [3, 7, 8, 11, 20]] = 1
    batch = replace(examples, groups=groups, part_groups=part_groups)
    even = torch.zeros(4, 21, 16, 16)
    assert float(head_terms(replace(prediction, parts=even), batch)["parts"]) == pytest.approx(np.log(21 / 5))
    even[:, 8] = 40.0
    assert float(head_terms(replace(prediction, parts=even), batch)["parts"]) == pytest.approx(0, abs=1e-5)


def test_heatmap_loss_is_least_at_the_keypoint(examples, prediction):
    keypoints = torch.zeros(4, 24, 3)
    keypoints[:, 0] = torch.tensor([0.3, -0.5, 1.0])
    keypoints[:, 1] = torch.tensor([1.3, 0.0, 1.0])  # outside: no heat map can show it
    batch = replace(examples, keypoints=keypoints)
    losses = {}
    for place in ((10, 4), (10, 3), (10, 6), (4, 10)):
        heatmaps = torch.zeros(4, 24, 16, 16)
        heatmaps[:, :, place[1], place[0]] = 5.0
        losses[place] = float(head_terms(replace(prediction, heatmaps=heatmaps), batch)["heatmaps"])
    # (0.3, -0.5) lies on the line between rows 3 and 4, in column 10.
    assert losses[10, 4] == pytest.approx(losses[10, 3], rel=1e-5)
    assert losses[10, 4] < losses[10, 6] < losses[4, 10]


def test_a_saved_network_predicts_the_same(tmp_path, examples, prediction):
    net = network()
    save_ellipbodynet(tmp_path / "net.safetensors", net.state_dict(), net.config, {"steps": 1})
    loaded = load_ellipbodynet(tmp_path / "net.safetensors")
    torch.testing.assert_close(loaded(examples.pictures).keypoints, prediction.keypoints)
    (tmp_path / "junk.safetensors").write_bytes(b"junk")
    for name in ("junk.safetensors", "nothing.safetensors"):
        with pytest.raises(InputError, match="expected an EllipBodyNet"):
            load_ellipbodynet(tmp_path / name)


def test_an_example_holds_the_whole_person_and_marks_missing_truth(people, examples):
    """The crop holds the whole person; keypoints lie on their parts; what has no truth is marked so."""
    example = make_example(people[1], 128)
    assert example.pictures.shape == (1, 3, 128, 128)
    assert (example.groups == 255).float().mean() < 0.4
    places = ((example.keypoints[0, :, :2] + 1) * 64).long().clamp(0, 127)
    for keypoint in ("left_knee", "right_knee", "left_elbow", "right_elbow"):
        x, y = places[LANDMARKS.index(keypoint)].tolist()
        shown = example.groups[0, max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]
        assert ((shown > 0) & (shown < 255)).any(), keypoint
    bare = make_example(replace(people[0], joints=None, parts=None, target=None), SIZE)
    assert bare.has_joints.sum() == 0
    assert (bare.groups == 255).all()


def test_mirrored_example_is_of_a_mirrored_person(people):
    flip = replace(STILL, flip=1.0)
    plain = make_example(people[0], 128)
    mirrored = make_example(people[0], 128, flip, np.random.default_rng(0))
    assert (mirrored.pictures.flip(3).int() - plain.pictures.int()).abs().max() <= 1
    left, right = (LANDMARKS.index(f"{side}_wrist") for side in ("left", "right"))
    torch.testing.assert_close(mirrored.keypoints[0, left], plain.keypoints[0, right] * torch.tensor([-1.0, 1.0, 1.0]))
    arm, other = (label_set("ellipbody20").group_names.index(f"{side}_forearm") + 1 for side in ("left", "right"))
    torch.testing.assert_close(mirrored.groups.flip(2) == arm, plain.groups == other)
    left, right = (MPJPE_JOINTS.index(f"{side}_wrist") for side in ("left", "right"))
    torch.testing.assert_close(mirrored.joints[0, left], plain.joints[0, right] * torch.tensor([-1.0, 1.0, 1.0]))


def test_feed_goes_on_where_it_was(people):
    """Orders and augmentation hang on seed and place alone, whoever makes the batches."""
    everybody = ExampleDataset(people, 32, Augmentation(), seed=5)
    feed = Feed(everybody, 3)
    batches = [next(feed) for _ in range(4)]
    again = Feed(everybody, 3, consumed=6)
    assert all(torch.equal(batch.pictures, next(again).pictures) for batch in batches[2:])
    assert again.consumed == feed.consumed == 12
    assert torch.equal(next(Feed(everybody, 3, workers=1)).pictures, batches[0].pictures)
    two = [Feed(everybody, 3, rank=rank, processes=2) for rank in range(2)]
    both = torch.stack([next(part).pictures for part in two], dim=1).flatten(0, 1)
    assert torch.equal(both, torch.cat([batch.pictures for batch in batches[:2]]))


def test_unreadable_samples_are_skipped_and_named(people, tmp_path):
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8 not a picture")
    Image.fromarray(people[0].picture[:100]).save(tmp_path / "small.png")
    bad = [
        replace(people[0], name="broken", picture=tmp_path / "broken.jpg"),
        replace(people[0], name="gone", picture=None),
        replace(people[0], name="small", picture=tmp_path / "small.png"),
        replace(people[0], name="blind", keypoints=Keypoints2D("coco17", np.zeros((17, 2), "f4"), np.zeros(17, "f4"))),
    ]
    feed = Feed(ExampleDataset([*people, *bad], 32, STILL), 8)
    assert len(next(feed).pictures) == 8
    assert {text.split(":")[0] for text in feed.skipped} == {f"shaded {one.name}" for one in bad}
    assert len(feed.skipped) == len(bad)
    with pytest.raises(InputError, match="none of 4 samples can be read"):
        next(Feed(ExampleDataset(bad, 32, STILL), 2))


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"kind": "folder", "path": "EMPTY"}, "no pictures"),
        ({"kind": "cinema"}, "kind: 'cinema'; expected one of human36m"),
        ({"kind": "human36m", "path": "EMPTY/h36m.npz"}, "h36m.npz"),
        ({"kind": "shaded", "count": 1, "first_phase": 1}, "data.sources: none to begin with"),
    ],
)
def test_wrong_sources_of_examples_are_refused(source, said, tmp_path):
    source = {**source, "path": source.get("path", "").replace("EMPTY", str(tmp_path))}
    with pytest.raises(InputError, match=said):
        make_task(tiny_config(data={"sources": [source]}))


def test_a_folder_is_read_as_partdr_evaluate_reads_it(people, tmp_path):
    """Pictures, keypoints and labels as ``partdr evaluate folder`` takes them."""
    for index, person in enumerate(people[:2]):
        Image.fromarray(person.picture).save(tmp_path / f"{index}.png")
        Image.fromarray(person.target).save(tmp_path / f"{index}.parts.png")
        values = np.concatenate([person.keypoints.points, person.keypoints.confidence[:, None]], axis=1)
        pose = {"people": [{"pose_keypoints_2d": values.flatten().tolist()}]}
        (tmp_path / f"{index}.keypoints.json").write_text(json.dumps(pose))
    read = Source("folder", str(tmp_path), labels="ellipbody20").read()
    expected = make_example(replace(people[1], joints=None), SIZE)
    have = make_example(read[1], SIZE)
    assert torch.equal(have.pictures, expected.pictures)
    torch.testing.assert_close(have.keypoints, expected.keypoints)


def test_the_packaged_config_has_the_papers_numbers():
    config = read_config("ellipbodynet", ["model.pretrained=false"])
    first, second = config.phases
    assert (config.epochs, config.batch_size, first.until) == (100, 128, 0.7)
    assert (config.learning_rate, second.learning_rate) == (1e-3, 1e-4)
    assert first.without == ("seg",)
    assert second.frozen == ("regressor.heads.camera",)
    papers = {"joints": 1, "proj": 1, "seg": 1e-2, "lengths": 1e-3, "thicknesses": 1e-3}
    assert config.weights.items() >= papers.items()
    assert {source.first_phase for source in config.data.sources} == {0, 1}
    names = [name for name, _ in EllipBodyNet(config.model).named_parameters()]
    assert all(any(name.startswith(prefix) for name in names) for phase in config.phases for prefix in phase.frozen)


def test_shaded_people_repeat_by_seed_and_lie_under_their_keypoints(people):
    again = shaded_people(4, seed=9)
    assert all((one.picture == other.picture).all() for one, other in zip(people, again, strict=True))
    assert not (people[0].picture == shaded_people(1, seed=10)[0].picture).all()
    for person in people:
        covered = person.target > 0
        assert covered.mean() > 0.02
        x, y = person.keypoints.points[skeleton("body25").landmarks.index("mid_hip")].astype(int)
        assert covered[y, x]
        assert isinstance(person.parts, PartLabels)


def tiny_config(steps: int = 4, data: dict | None = None, model: dict | None = None, **values):
    architecture = {**TINY, "hidden_sizes": [8, 8, 16, 16]}
    small = {"architecture": architecture, "size": 32, "head_width": 8, "regressor": {"width": 32}}
    people = {"kind": "shaded", "count": 3, "seed": 9}
    numbers = {
        "task": "ellipbodynet",
        "steps": steps,
        "batch_size": 2,
        "model": small | (model or {}),
        "data": {"workers": 0, "render_size": 32, "sources": [people, {**people, "first_phase": 1}]} | (data or {}),
    }
    return make_config({**numbers, **values})


def test_the_network_learns_four_pictures_by_heart(tmp_path):
    """After a hundred steps, its error is below two thirds of the first one."""
    regressor = {"width": 256, "dropout": 0.0}
    people = {"kind": "shaded", "count": 4, "seed": 9}
    sources = [people, {**people, "validation": True}]
    config = tiny_config(
        100,
        model={"architecture": TINY, "size": SIZE, "head_width": 16, "regressor": regressor},
        data={"render_size": SIZE, "augmentation": asdict(STILL), "sources": sources},
        batch_size=4,
        phases=[{"without": ["seg"]}],
    )
    task = make_task(config)
    torch.manual_seed(0)
    model = task.model()
    task.begin(config.phases[0])
    optimizer = torch.optim.Adam(model.parameters(), lr=5e-4)
    for step in range(config.steps):
        optimizer.param_groups[0]["lr"] = 5e-4 * min(1, (step + 1) / 20)
        total = task.loss(model, task.batch(torch.device("cpu")))["total"]
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
    with torch.no_grad():
        errors = task.validate(model.eval(), torch.device("cpu"))
        sheet = task.pictures(model, torch.device("cpu"))
    assert errors["PA-MPJPE [mm]"] < 75  # 128 at first
    assert sheet.size == (4 * SIZE, 3 * SIZE)
    task.save(tmp_path / "net.safetensors", model.state_dict(), {}, bits=16)
    assert load_ellipbodynet(tmp_path / "net.safetensors").config.size == SIZE


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path):
    """The run goes through the training loop, and over the change of phase that brings a new data set in."""

    def numbers(out: str, checkpoint_every: int):
        phases = [{"until": 0.25, "without": ["seg"]}, {"frozen": ["regressor.heads.camera"]}]
        values = {"schedule": "constant", "validate_every": 100, "checkpoint_every": checkpoint_every}
        return tiny_config(out=str(tmp_path / out), phases=phases, **values)

    whole = run_training(numbers("whole", 4), device="cpu")
    assert whole.report["errors"] == {}
    run_training(numbers("halves", 2), device="cpu")
    shutil.rmtree(max((tmp_path / "halves/checkpoints").iterdir()))
    resumed = run_training(numbers("halves", 2), resume=True, device="cpu")
    assert (resumed.step, resumed.report["resumed_at"]) == (4, 2)
    one, other = (load_file(tmp_path / name / "model.safetensors") for name in ("whole", "halves"))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_begins_with_a_trained_network_of_the_same_sizes(tmp_path):
    task = make_task(tiny_config())
    model = task.model()
    weights = model.state_dict()
    save_ellipbodynet(tmp_path / "net.safetensors", weights, replace(model.config, backbone="elsewhere"), {})
    read = task.read(str(tmp_path / "net.safetensors"))
    assert all(torch.equal(read[name], value) for name, value in weights.items())
    save_ellipbodynet(tmp_path / "other.safetensors", network().state_dict(), network().config, {})
    with pytest.raises(InputError, match=r"other\.safetensors: a network of"):
        task.read(str(tmp_path / "other.safetensors"))
    with pytest.raises(InputError, match="the package has no EllipBodyNet"):
        task.read("packaged")
