"""The label network's input and output, and the files that it is kept in."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import torch
from helpers.bodies import seen_by, walker
from helpers.files import EXAMPLE
from safetensors import safe_open
from safetensors.torch import save_file

from warp_partdr import FitOptions, Perspective, choose_person, fit_body, read_keypoints, read_parts
from warp_partdr.body.labels import LABEL_SETS, label_set
from warp_partdr.body.landmarks import mirror_name, mirror_order
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import FREE_PARTS
from warp_partdr.body.template import JOINT_NAMES, LOCKED_PARTS, NUM_PARTS, PART_NAMES
from warp_partdr.cli.main import app
from warp_partdr.errors import InputError
from warp_partdr.inputs.observation import observe, resize_nearest
from warp_partdr.inputs.observations import Observations, batch_observations
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.interop.checks import rotation_error
from warp_partdr.networks.regression.checkpoint import (
    known_network,
    load_label_network,
    packaged_network,
    save_label_network,
)
from warp_partdr.networks.regression.label_network import (
    KNOWN_LENS,
    NUM_CHANNELS,
    USUAL_LENS,
    LabelNetwork,
    LabelNetworkConfig,
    draw_heatmaps,
    label_shares,
    label_table,
    map_shares,
    network_conditions,
)
from warp_partdr.networks.regression.landmarks import LANDMARKS, network_keypoints
from warp_partdr.networks.regression.predict import (
    REAL_PEOPLE,
    REAL_SIZE,
    ask_about_each,
    ask_network,
    network_inputs,
    predict_bodies,
)
from warp_partdr.networks.regression.predicted import posed_landmarks
from warp_partdr.networks.regression.regressor import Regressor, RegressorConfig, misfits
from warp_partdr.results.body_file import load_body

SMALL = LabelNetworkConfig(
    size=64, channels=(8, 16, 16, 16, 16), places=4, keypoint_features=16, regressor=RegressorConfig(width=32)
)

WIDE = replace(SMALL, regressor=RegressorConfig(width=256))  # with weights that are kept in bytes


@pytest.fixture
def network() -> LabelNetwork:
    torch.manual_seed(0)
    return LabelNetwork(SMALL).eval()


@pytest.fixture
def wide_network() -> LabelNetwork:
    torch.manual_seed(0)
    return LabelNetwork(WIDE).eval()


@pytest.mark.parametrize("name", LABEL_SETS)
def test_every_id_of_every_set_is_a_distribution_over_parts(name):
    labels = LABEL_SETS[name]
    table = label_table(labels)
    assert torch.allclose(table.sum(1), torch.ones(256))
    for group, parts in enumerate(labels.groups.values(), start=1):
        assert (table[group, :NUM_PARTS] > 0).sum() == len(parts)
    assert table[0, NUM_PARTS] == 1  # background
    assert table[255, -1] == 1
    assert (table[labels.num_groups + 1 :, -1] == 1).all()


def test_shares_take_each_image_by_its_own_set(device):
    sets = [label_set("body14"), label_set("ellipbody20")]
    groups = torch.randint(0, 15, (3, 8, 8), generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    tables, which = torch.stack([*map(label_table, sets)]), torch.tensor([1, 0, 1])
    shares = label_shares(groups.to(device), tables.to(device), which.to(device)).cpu()
    assert shares.shape == (3, NUM_CHANNELS, 8, 8)
    for i, which in enumerate((1, 0, 1)):
        assert torch.equal(shares[i, :, 2, 5], label_table(sets[which])[int(groups[i, 2, 5])])


def test_sure_probabilities_have_the_shares_of_labels():
    labels = label_set("body14")
    groups = torch.randint(0, 15, (2, 8, 8), generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    groups[0, 0, 0] = 255
    maps = torch.stack([(groups == group).float() for group in range(1, 15)], dim=1)
    table = label_table(labels)
    want = label_shares(groups, table[None], torch.zeros(2, dtype=torch.int64))
    assert torch.allclose(map_shares(maps, (groups != 255).float(), table), want)


def test_keypoints_of_any_format_find_their_places():
    names = ("left_foot_index", "nose", "left_pinky", "right_knee")
    points = torch.arange(8.0).view(4, 2)
    found = network_keypoints(names, points, torch.tensor([0.5, 1.0, 1.0, 0.0]))
    assert found[LANDMARKS.index("left_big_toe")].tolist() == [0.0, 1.0, 0.5]
    assert found[LANDMARKS.index("nose")].tolist() == [2.0, 3.0, 1.0]
    assert found[:, 2].sum() == 1.5


def test_heatmaps_shine_where_the_keypoint_is():
    keypoints = torch.tensor([[[0.5, -0.25, 0.8], [0.0, 0.0, 0.0]]])
    maps = draw_heatmaps(keypoints, 64)
    v, u = divmod(int(maps[0, 0].argmax()), 64)
    assert abs((u + 0.5) / 32 - 1 - 0.5) < 1 / 32
    assert abs((v + 0.5) / 32 - 1 + 0.25) < 1 / 32
    assert float(maps[0, 0].max()) == pytest.approx(0.8, abs=0.06)  # a keypoint lies between pixels
    assert float(maps[0, 1].max()) == 0


def test_a_regressor_starts_near_the_mean_body():
    torch.manual_seed(0)
    regressor = Regressor(16, RegressorConfig(width=32)).eval()
    predicted = regressor(torch.randn(5, 16))
    mean = BodyParameters.mean(5)
    assert torch.allclose(predicted.lengths, mean.lengths, rtol=0.05)
    assert torch.allclose(predicted.thicknesses, mean.thicknesses, rtol=0.05)
    identity = torch.eye(3).expand(5, len(LOCKED_PARTS), 3, 3)
    assert torch.equal(predicted.rotations[:, list(LOCKED_PARTS)], identity)
    assert rotation_error(predicted.rotations).max() < 1e-5


def test_corrections_see_how_far_landmarks_are_from_the_keypoints(network, device):
    bodies = ask_network(Observations.of([observe(*seen_by(walker()), device=device)[0]]), network.to(device))
    drawn = bodies.camera(64).project(posed_landmarks(bodies.posed(), LANDMARKS))[..., :2] * (2 / 64) - 1
    keypoints = torch.cat([drawn + drawn.new_tensor([0.05, -0.02]), torch.ones_like(drawn[..., :1])], dim=2)
    keypoints[0, 0] = 0.0  # missing
    keypoints[0, 1, 0] += 5.0
    expected = drawn.new_tensor([0.5, -0.2]).repeat(len(LANDMARKS), 1)
    expected[0], expected[1, 0] = 0.0, 10.0
    torch.testing.assert_close(misfits(bodies, keypoints), expected.flatten()[None], atol=1e-4, rtol=0)


def test_a_compiled_regressor_is_one_graph_that_sees_the_same_misfits():
    torch.manual_seed(0)
    regressor = Regressor(4, RegressorConfig(width=8, blocks=0, iterations=2, dropout=0.0, feedback=True)).eval()
    features, keypoints = torch.randn(2, 4), torch.rand(2, len(LANDMARKS), 3)
    weight = regressor.first.linear.weight
    found = []
    for network in (regressor, torch.compile(regressor, fullgraph=True, backend="aot_eager")):
        bodies = network(features, keypoints)
        (gradient,) = torch.autograd.grad(bodies.rotations.sum() + bodies.log_scale.sum(), weight)
        found.append((bodies.rotations, bodies.lengths, gradient))
    torch.testing.assert_close(found[1], found[0])


def test_predicted_numbers_are_those_of_a_fit(network, device):
    network = network.to(device)
    shares = torch.rand(3, NUM_CHANNELS, 64, 64, device=device)
    predicted = network(shares, torch.rand(3, len(LANDMARKS), 3, device=device), torch.zeros(3, 4, device=device))
    body = predicted.parameters()
    assert torch.allclose(body.posed().joints, predicted.posed().joints, atol=1e-5)
    assert torch.equal(body.camera(64).scale, predicted.camera(64).scale)


def test_a_batch_says_what_its_members_say(network):
    keypoints, parts = seen_by(walker())
    with_labels, _ = observe(keypoints, parts)
    without, _ = observe(keypoints, None)
    both = predict_bodies([with_labels, without], network)
    alone = predict_bodies([without], network)
    assert torch.allclose(both.rotations[1], alone.rotations[0], atol=1e-5)
    assert not torch.allclose(both.rotations[0], both.rotations[1], atol=1e-5)
    shares, _, conditions = network_inputs(Observations.of([without]), 64)
    assert (shares[0, -1] == 1).all()
    assert (conditions == 0).all()


def test_inputs_of_many_are_those_of_each():
    """There are labels, probabilities and keypoints alone, several sets and sizes, and some known cameras."""
    keypoints, parts = seen_by(walker())
    hard, _ = observe(keypoints, parts)
    maps = np.moveaxis(np.eye(parts.label_set.num_groups + 1, dtype=np.float32)[parts.groups], -1, 0)
    soft, _ = observe(keypoints, replace(parts, maps=0.9 * maps))
    mask, _ = observe(keypoints, PartLabels(label_set("full1"), (parts.groups > 0).astype(np.uint8)))
    names, marks = hard.landmarks[3:], hard.marks[3:]
    fewer = replace(hard, landmarks=names, marks=marks, points=hard.points[3:], confidence=hard.confidence[3:])
    small = replace(mask, labels=resize_nearest(mask.labels, 100), lens=torch.tensor([2.0, 0.5, -1.0]))
    several = [hard, soft, observe(keypoints, None)[0], mask, fewer, small, soft]
    groups = batch_observations(several)
    assert [rows for rows, _ in groups] == [[0, 4], [1, 6], [2], [3], [5]]
    for rows, some in groups:
        together = network_inputs(some, 64)
        assert [values.shape[1:] for values in together] == [(22, 64, 64), (24, 3), (6,)]
        for own, row in enumerate(rows):
            for values, alone in zip(together, network_inputs(Observations.of([several[row]]), 64), strict=True):
                torch.testing.assert_close(values[own], alone[0])


def test_rare_activations_move_nobody_out_of_the_picture():
    """Channels that fire for one person of a thousand said 56 where others say 2, and the place was kilometres away."""
    seen, _ = observe(*seen_by(walker()))
    network, usual = load_label_network(), load_label_network()
    places = next(stage for stage in network.stages if isinstance(stage, torch.nn.Conv2d))
    signs = 2 * torch.randint(0, 2, (network.config.places,), generator=torch.Generator().manual_seed(0)) - 1

    def fire(module: torch.nn.Module, inputs: object, said: torch.Tensor) -> torch.Tensor:
        said[:, :, 1, 2] = 56.0 * signs
        return said

    places.register_forward_hook(fire)
    found, expected = (ask_network(Observations.of([seen]), each) for each in (network, usual))
    assert (found.shift - expected.shift).abs().max() < 0.5
    assert (found.log_scale - expected.log_scale).abs().max() < 0.5
    assert found.shift.abs().max() < 1  # within the crop


def test_of_a_mirror_image_the_mirrored_body_is_said():
    keypoints, parts = seen_by(walker())
    network = load_label_network()
    seen, _ = observe(keypoints, parts)
    labels = resize_nearest(seen.labels, network.config.size)  # of several pixels, a mirror image takes others
    seen = replace(seen, labels=labels, lens=torch.tensor([2.0, 0.4, -0.1]))
    parts = seen.label_set
    ids = torch.tensor([0, *(mirror_order(parts.group_names) + 1), *range(parts.num_groups + 1, 256)])
    image = replace(
        seen,
        landmarks=tuple(map(mirror_name, seen.landmarks)),
        points=seen.points * torch.tensor([-1.0, 1.0]),
        labels=ids[labels.flip(1).long()].to(torch.uint8),
        lens=seen.lens * torch.tensor([1.0, -1.0, 1.0]),
    )
    own, others = (ask_network(Observations.of([each]), network) for each in (seen, image))
    joints = own.posed().joints[:, mirror_order(JOINT_NAMES)] * torch.tensor([-1.0, 1.0, 1.0])
    assert torch.allclose(others.posed().joints, joints, atol=1e-5)
    assert not torch.allclose(own.posed().joints, joints, atol=1e-2)  # a body that is its own image would prove nothing
    assert torch.allclose(others.log_scale, own.log_scale, atol=1e-5)
    assert torch.allclose(others.shift, own.shift * torch.tensor([-1.0, 1.0]), atol=1e-5)
    swapped = mirror_order(JOINT_NAMES[1:]), [0, *(mirror_order([PART_NAMES[part] for part in FREE_PARTS]) + 1)]
    assert torch.allclose(others.uncertainty.depths, own.uncertainty.depths[:, swapped[0]], atol=1e-6)
    assert torch.allclose(others.uncertainty.turns, own.uncertainty.turns[:, swapped[1]], atol=1e-6)


def test_a_camera_is_seen_by_its_rays_and_only_where_it_is_known(network):
    lenses = torch.tensor([[2.0, 0.5, -1.0], [2.0, 0.5, -1.0], [1e9, 0.0, 0.0]])
    statures = torch.tensor([1.7, 0.0, 1.7 * math.exp(0.1)])
    conditions = network_conditions(lenses, torch.tensor([KNOWN_LENS, 0.0, USUAL_LENS]), statures)
    expected = torch.tensor([[1.0, 0.5, 0.25, -0.5, 1.0, 0.0], [0.0] * 6, [0.5, 0.125, 0.0, 0.0, 1.0, 0.5]])
    assert torch.allclose(conditions, expected, atol=1e-6)
    precise = network_conditions(lenses, torch.tensor([KNOWN_LENS, 0.0, USUAL_LENS]), statures.double())
    assert precise.dtype == torch.float32
    keypoints, parts = seen_by(walker())
    seen = replace(observe(keypoints, parts)[0], lens=None, lens_assumed=False)
    known = replace(seen, lens=lenses[0], stature=1.7)
    assert torch.equal(network_inputs(Observations.of([known]), 64)[2], conditions[:1])
    assumed = network_inputs(Observations.of([replace(known, lens_assumed=True, stature=None)]), 64)[2]
    assert torch.allclose(assumed, torch.tensor([[0.5, 0.5, 0.25, -0.5, 0.0, 0.0]]))
    bodies = predict_bodies([seen, known], network)
    assert not torch.allclose(bodies.rotations[0], bodies.rotations[1], atol=1e-5)


def test_uncertainties_are_widened_for_real_people(network):
    """Real people differ from those that networks learn from."""
    seen = replace(observe(*seen_by(walker()))[0], lens=None, lens_assumed=False)
    inputs = network_inputs(Observations.of([seen]), 64)
    said, found = network(*inputs).uncertainty, ask_network(Observations.of([seen]), network, mirror=False).uncertainty
    assert torch.allclose(found.depths, REAL_SIZE * REAL_PEOPLE * said.depths, rtol=1e-4)
    assert torch.allclose(found.turns, REAL_PEOPLE * said.turns, rtol=1e-4)
    assert torch.allclose(found.nearness, said.nearness / REAL_SIZE, rtol=1e-4)


def test_bodies_are_enlarged_unless_their_stature_is_known(network):
    seen = replace(observe(*seen_by(walker()))[0], lens=None, lens_assumed=False)
    told = replace(seen, stature=1.8)
    found = ask_about_each([seen, told], network, mirror=False)
    said = [network(*network_inputs(Observations.of([each]), 64)) for each in (seen, told)]
    for row, (each, share) in enumerate(zip(said, (REAL_SIZE, 1.0), strict=True)):
        assert torch.allclose(found.lengths[row], share * each.lengths[0], rtol=1e-4)
        assert torch.allclose(found.log_scale[row], each.log_scale[0] - math.log(share), atol=1e-4)


def test_a_network_without_statures_does_not_look_at_them():
    torch.manual_seed(0)
    plain = LabelNetwork(LabelNetworkConfig(size=64)).eval()
    seen = observe(*seen_by(walker()))[0]
    tall = replace(seen, stature=1.9)
    bodies = predict_bodies([seen, tall], plain)
    assert torch.allclose(bodies.rotations[0], bodies.rotations[1], atol=1e-6)


def test_the_packaged_network_knows_that_who_is_far_away_is_no_smaller():
    seen, _ = observe(*seen_by(walker()))
    lenses = [torch.tensor([focal, 0.1 * focal, 0.0]) for focal in (7.0, 30.0, 1000.0)]
    bodies = predict_bodies([replace(seen, lens=lens) for lens in lenses], load_label_network())
    sizes = bodies.lengths.sum(1)
    assert torch.allclose(sizes, sizes[:1].expand(3), rtol=0.03)


def test_uncertainties_are_positive_and_go_with_their_bodies(network):
    shares, keypoints = torch.rand(3, NUM_CHANNELS, 64, 64), torch.rand(3, len(LANDMARKS), 3)
    said = network(shares, keypoints, torch.zeros(3, 4)).uncertainty
    assert [tuple(values.shape) for values in vars(said).values()] == [
        (3, len(JOINT_NAMES) - 1),
        (3, 1 + len(FREE_PARTS)),
        (3,),
    ]
    assert all((values > 0).all() for values in vars(said).values())
    first = network(shares, keypoints, torch.zeros(3, 4)).select(slice(1, 2)).uncertainty
    assert all(torch.equal(have, getattr(said, name)[1:2]) for name, have in vars(first).items())


@pytest.mark.parametrize("bits", [32, 16, 8])
def test_a_network_comes_back_from_its_file(wide_network, tmp_path, bits):
    network, path = wide_network, tmp_path / "network.safetensors"
    save_label_network(path, network.state_dict(), WIDE, {"steps": 3}, bits=bits)
    back = load_label_network(path)
    assert back.config == WIDE
    with safe_open(path, "pt") as file:
        assert json.loads(file.metadata()["about"]) == {"steps": 3}
    assert not back.training
    shares, keypoints = torch.rand(2, NUM_CHANNELS, 64, 64), torch.rand(2, len(LANDMARKS), 3)
    want, have = network(shares, keypoints, torch.zeros(2, 4)), back(shares, keypoints, torch.zeros(2, 4))
    assert torch.allclose(want.rotations, have.rotations, atol={32: 1e-6, 16: 1e-2, 8: 3e-2}[bits])


def test_a_file_is_read_once_while_it_stays_as_it_is(network, tmp_path):
    path = tmp_path / "network.safetensors"
    save_label_network(path, network.state_dict(), SMALL, {}, bits=32)
    first = known_network(path, "cpu")
    assert known_network(str(path), "cpu") is first
    save_label_network(path, network.state_dict(), SMALL, {}, bits=16)
    assert known_network(path, "cpu") is not first
    assert known_network(None, "cpu") is packaged_network("cpu")
    path.unlink()
    with pytest.raises(InputError, match="No such file"):
        known_network(path, "cpu")


def test_weights_in_bytes_are_as_near_as_their_row_allows(wide_network, tmp_path):
    path, weights = tmp_path / "network.safetensors", wide_network.state_dict()
    large = {name for name, value in weights.items() if value.ndim > 1 and value.numel() >= 2**16}
    assert large
    for name in large:
        weights[name][::2] *= 100  # rows differ
        weights[name][1] = 0
    save_label_network(path, weights, WIDE, {}, bits=8)
    with safe_open(path, "pt") as file:
        assert {name for name in file.keys() if file.get_tensor(name).dtype == torch.int8} == large  # noqa: SIM118
    back = load_label_network(path).state_dict()
    assert back.keys() == weights.keys()
    for name in large:
        rows, error = weights[name].flatten(1), (back[name] - weights[name]).flatten(1).abs()
        assert (error <= rows.abs().amax(1, keepdim=True) * (0.501 / 127)).all(), name
    with pytest.raises(InputError, match="bits: 4; expected 8, 16 or 32"):
        save_label_network(path, weights, WIDE, {}, bits=4)


def test_files_that_are_no_networks_are_named(network, tmp_path):
    path, weights = tmp_path / "network.safetensors", network.state_dict()

    def refused(said: str) -> None:
        with pytest.raises(InputError, match=said):
            load_label_network(path)

    refused("network.safetensors: No such file")
    path.write_bytes(b"\x80\x04\x95nonsense")
    refused("expected a network")
    torch.save(weights, path)  # a pickle
    refused("expected a network")
    save_file({"weight": torch.zeros(3)}, path)
    refused("format None")
    save_label_network(path, weights, replace(SMALL, places=5), {})
    refused("size mismatch")
    for number in (float("nan"), float("inf"), float("-inf")):
        bias = torch.zeros(32)
        bias[7] = number
        save_label_network(path, {**weights, "keypoints.0.bias": bias}, SMALL, {})
        refused("NaN")
    for sizes, said in (
        ({"size": "64"}, "size: '64'; expected a whole number"),
        ({"places": -1}, "expected a network"),
    ):
        save_file(weights, path, {"format": "warp-partdr label network 2", "config": json.dumps(sizes)})
        refused(said)
    path.write_bytes(path.read_bytes()[:-100])
    refused("expected a network")


def test_a_file_too_large_is_refused_unread(tmp_path):
    """A network has at most 1 GiB; of a larger file nothing is read."""
    path = tmp_path / "network.safetensors"
    with path.open("wb") as file:
        file.truncate(2**30 + 1)  # takes no room on the disk
    with pytest.raises(InputError, match="more than 1024 MiB; expected a network"):
        load_label_network(path)
    with path.open("r+b") as file:
        file.truncate(2**30)
    with pytest.raises(InputError) as refused:
        load_label_network(path)
    assert "more than" not in str(refused.value)


def test_predict_writes_a_body_for_each_picture(network, tmp_path, capsys):
    example = resources.files("warp_partdr") / "assets/example"
    folder = tmp_path / "pictures"
    folder.mkdir()
    for suffix, source in (("png", "photo.png"), ("keypoints.json", "keypoints.json"), ("parts.png", "parts.png")):
        for name in ("a", "b"):
            (folder / f"{name}.{suffix}").write_bytes((example / source).read_bytes())
    save_label_network(tmp_path / "n.safetensors", network.state_dict(), SMALL, {})
    options = ["--labels", "cdcl14", "--network", tmp_path / "n.safetensors", "--out", tmp_path / "out"]
    assert not app(["predict", *map(str, [folder, *options])], standalone_mode=False)
    assert "2 people" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"a.npz", "b.npz", "predictions.json"}
    assert json.loads((tmp_path / "out/predictions.json").read_text())["files"].keys() == {"a.npz", "b.npz"}
    bodies = [load_body(tmp_path / f"out/{name}.npz") for name in ("a", "b")]
    assert np.array_equal(bodies[0].rotations, bodies[1].rotations)


def test_predict_places_bodies_before_a_camera(network, tmp_path):
    """It does as a fit without stages, for the picture's own camera and for its EXIF data."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for suffix, source in (("png", "photo.png"), ("keypoints.json", "keypoints.json"), ("parts.png", "parts.png")):
        (folder / f"a.{suffix}").write_bytes((EXAMPLE / source).read_bytes())
    save_label_network(tmp_path / "n.safetensors", network.state_dict(), SMALL, {})
    options = ["--labels", "cdcl14", "--network", str(tmp_path / "n.safetensors")]
    fov = ["--fov", "50"]
    assert not app(["predict", str(folder), *options, *fov, "--out", str(tmp_path / "out")], standalone_mode=False)
    body = load_body(tmp_path / "out/a.npz")
    parts = read_parts(folder / "a.parts.png", label_set("cdcl14"))
    person = choose_person(read_keypoints(folder / "a.keypoints.json"), parts.groups)
    given = FitOptions(stages=(), search=(), network=str(tmp_path / "n.safetensors"))
    camera = Perspective.of_picture(parts.groups.shape, fov=50)
    fitted = fit_body(person, parts, options=given, camera=camera)
    np.testing.assert_allclose(body.translation, fitted.posed.joints[0, 0], rtol=1e-4)
    np.testing.assert_allclose(body.global_orient, fitted.parameters.global_orient()[0], atol=1e-5)
    np.testing.assert_allclose(body.camera().intrinsics, camera.intrinsics, rtol=1e-5)
    with pytest.raises(InputError, match=r"a.png: .*EXIF"):
        app(["predict", str(folder), *options, "--focal", "exif", "--out", str(tmp_path / "e")], standalone_mode=False)
