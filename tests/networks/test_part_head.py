"""Part head on the landmark network: parts and joints of people, on CPU and CUDA."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_photo

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.networks.detection import heavy_network
from warp_partdr.networks.detection.asset import load_heavy_landmarks, packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops
from warp_partdr.networks.detection.graph import OperatorGraph
from warp_partdr.networks.detection.heavy import look_twice, see_landmarks
from warp_partdr.networks.detection.heavy_network import (
    HeavyNetwork,
    join_features,
    load_part_head,
    save_part_head,
    with_features,
)
from warp_partdr.networks.detection.look import NUM_LANDMARKS
from warp_partdr.networks.detection.part_head import PartHead, PartHeadConfig, draw_limbs
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.detection.person import FoundPerson, LikeliestParts
from warp_partdr.networks.predictors.parts import seen_parts

NAMES = skeleton("blazepose33").landmarks
SIDE = 256  # of maps of parts
# Ends of the bones whose middles show the part. The example's person holds the right hand before the left upper arm.
BONES = {
    f"{side}_{part}": (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for part, start, end in (
        ("upper_arm", "shoulder", "elbow"),
        ("forearm", "elbow", "wrist"),
        ("upper_leg", "hip", "knee"),
        ("lower_leg", "knee", "ankle"),
    )
    if (side, part) != ("left", "upper_arm")
}


@cache
def example_person(device: str) -> FoundPerson:
    (person,) = find_people(example_photo(), device=device, landmarks="heavy")
    return person


def heavy(device: str, *, half: bool = False) -> HeavyNetwork:
    network = packaged_people_networks(device, half=half, landmarks="heavy").heavy
    assert network is not None
    return network


def likeliest(parts: LikeliestParts, person: FoundPerson, places: np.ndarray) -> list[str]:
    """Names of the likeliest parts at places of the picture (N, 2)."""
    cells = (person.crop.from_picture(places[None])[0] * SIDE).astype(int)
    return [PART_NAMES[int(parts.labels[row, column]) - 1] for column, row in cells]


def middles() -> np.ndarray:
    truth = example_keypoints()
    places = dict(zip(truth.format.landmarks, truth.points.astype(float), strict=True))
    return np.array([(places[start] + places[end]) / 2 for start, end in BONES.values()])


def test_each_limb_shows_its_part_on_its_side(device: str) -> None:
    person = example_person(device)
    assert person.parts is not None
    assert person.parts.labels.shape == person.parts.background.shape == (SIDE, SIDE)
    assert likeliest(person.parts, person, middles()) == list(BONES)
    shown = person.parts.background.cpu() < 128
    mask = person.mask.cpu() > 0.5
    assert (shown & mask).sum() / (shown | mask).sum() > 0.85


def test_the_smaller_landmark_network_sees_no_parts() -> None:
    (person,) = find_people(example_photo(), landmarks="full")
    assert person.parts is None


def test_a_mirrored_picture_shows_mirrored_parts() -> None:
    picture = example_photo()
    height, width = picture.shape[:2]
    crop = TurnedCrops(np.array([[width / 2, height / 2]]), np.array([1.1 * height]), np.zeros(1), np.zeros(1, int))
    pyramids = [[Pyramid(np.ascontiguousarray(each), "cpu")] for each in (picture, picture[:, ::-1])]
    seen, turned = (look_twice(heavy("cpu"), each, crop) for each in pyramids)
    assert seen.parts is not None
    assert turned.parts is not None
    table = torch.full((256,), IGNORE, dtype=torch.uint8)
    table[1 : len(PART_NAMES) + 1] = torch.tensor([1 + PART_NAMES.index(exchanged(name)) for name in PART_NAMES])
    mirrored = table[turned.parts.labels.long()].flip(-1)
    assert (seen.parts.labels == mirrored).float().mean() > 0.998
    apart = seen.parts.background.int() - turned.parts.background.flip(-1).int()
    assert apart.abs().max() <= 8
    moved = turned.own[0, [NAMES.index(exchanged(name)) for name in NAMES], :2] * [-1, 1] + [1, 0]
    np.testing.assert_allclose(seen.turned[0, :NUM_LANDMARKS, :2], moved, atol=2e-3)


def exchanged(name: str) -> str:
    return name.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")


def test_float16_sees_nearly_the_same(device: str) -> None:
    crop, pyramids = example_person(device).crop, [Pyramid(example_photo(), device)]
    expected, found = (look_twice(heavy(device, half=half), pyramids, crop) for half in (False, True))
    assert expected.parts is not None
    assert found.parts is not None
    assert (expected.parts.background.int() - found.parts.background.int()).abs().float().mean() < 0.5
    shown = expected.parts.background < 128
    assert (expected.parts.labels == found.parts.labels)[shown].float().mean() > 0.97


def test_few_pictures_need_no_library_for_convolutions(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading cuDNN, and its plans for each shape, would take most of a first call on CUDA."""
    network = heavy(device)
    pictures = torch.rand(2, 3, 256, 256, generator=torch.Generator().manual_seed(0)).to(device)
    many = torch.cat([pictures] * 5)  # more than are made products of windows
    expected = [values[:2] for values in network(many).values()]
    if device == "cuda":

        def fail(*_: object, **__: object) -> None:
            raise AssertionError("conv2d was called")

        monkeypatch.setattr(torch.nn.functional, "conv2d", fail)
    for _ in range(3):  # the second call is captured on CUDA
        found = network(pictures)
        for values, wanted in zip(found.values(), expected, strict=True):
            torch.testing.assert_close(values, wanted, rtol=1e-3, atol=2e-3 * float(wanted.abs().max()))


def test_threads_on_the_cpu_change_none_of_torch_s_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several threads look at a time: each would put back what it found, and another's setting would stay."""

    def fail() -> None:
        raise AssertionError("settings were changed")

    monkeypatch.setattr(heavy_network, "exact_convolutions", fail)
    assert heavy("cpu")(torch.zeros(1, 3, 256, 256))["parts"].shape == (1, 21, 128, 128)


class Said(OperatorGraph):
    """Network whose landmarks lie at the left above and whose joints lie at the right below, in any picture."""

    def __init__(self) -> None:
        super().__init__(256, 0, {}, (), {})

    def forward(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        landmarks = torch.full((len(pictures), 39, 5), 64.0)
        heat = torch.full((len(pictures), 39, 64, 64), -9.0)
        joints = torch.full((len(pictures), len(JOINT_NAMES), 2), 0.75)
        joints[:, JOINT_NAMES.index("left_knee")] = torch.tensor([0.5, 1.0])
        return {"landmarks": landmarks.flatten(1), "heat": heat, "joints": joints}


def test_limbs_are_means_of_landmarks_and_joints_and_hips_are_joints() -> None:
    crop = example_person("cpu").crop
    found = see_landmarks(Said(), [Pyramid(example_photo(), "cpu")], crop, mirror=False)[0, :, :2]
    expected = {"left_hip": (0.75, 0.75), "right_elbow": (0.5, 0.5), "left_knee": (0.375, 0.625), "nose": (0.25, 0.25)}
    for name, place in expected.items():
        np.testing.assert_allclose(found[NAMES.index(name)], place, atol=1e-6, err_msg=name)
    assert (found[NUM_LANDMARKS:] == 0.25).all()  # the points that place the next crop


def test_a_graph_shows_more_of_its_values() -> None:
    graph = load_heavy_landmarks()
    pictures = torch.rand(2, 3, 256, 256, generator=torch.Generator().manual_seed(0))
    plain, more = graph(pictures), with_features(graph)(pictures)
    torch.testing.assert_close(more["landmarks"], plain["landmarks"])
    assert {side: maps.shape[2:] for side, maps in join_features(more).items()} == {
        side: (side, side) for side in (8, 16, 32, 64, 128)
    }
    assert set(heavy("cpu")(pictures)) == {*plain, "parts", "joints"}


def test_normalisations_are_within_the_convolutions_of_answers() -> None:
    torch.manual_seed(0)
    head = PartHead(PartHeadConfig(channels=(8, 8, 8, 8, 8)))
    graph, pictures = with_features(load_heavy_landmarks()), torch.rand(2, 3, 256, 256)
    values = graph(pictures)
    given = join_features(values), values["landmarks"], pictures
    head.train()(*given)  # so that statistics are not 0 and 1
    expected, found = head.eval()(*given), head.folded()(*given)
    torch.testing.assert_close(found.logits, expected.logits, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.joints, expected.joints, atol=1e-4, rtol=1e-4)
    assert not any(isinstance(each, torch.nn.BatchNorm2d) for each in head.folded().modules())
    assert any(isinstance(each, torch.nn.BatchNorm2d) for each in head.modules())


def test_joints_lie_in_the_middle_of_their_heat() -> None:
    """A head whose heat is hot at one cell says that cell's middle, x first."""
    head = PartHead(PartHeadConfig(channels=(4, 4, 4, 4, 4))).eval()
    with torch.no_grad():
        head.heat.weight.zero_()
        head.heat.bias.zero_()
    features = {side: torch.zeros(1, count, side, side) for side, count in {8: 560, 16: 352, 32: 152}.items()}
    features |= {64: torch.zeros(1, 80, 64, 64), 128: torch.zeros(1, 24, 128, 128)}
    hot = torch.zeros(1, len(JOINT_NAMES), 64, 64)
    hot[:, :, 10, 40] = 30.0
    head.heat.register_forward_hook(lambda module, inputs, output: hot)
    seen = head(features, torch.zeros(1, 195), torch.zeros(1, 3, 256, 256))
    torch.testing.assert_close(seen.joints[0, 0], torch.tensor([40.5 / 64, 10.5 / 64]))
    assert seen.spreads.max() < 0.01


def landmarks_at(places: dict[str, tuple[float, float, float, float]]) -> torch.Tensor:
    """Numbers (1, 195) of a network that sees landmarks at x, y and depth [px], with a logit of visibility."""
    numbers = torch.full((1, 39, 5), -1000.0)
    for name, values in places.items():
        numbers[0, NAMES.index(name), :4] = torch.tensor(values)
    return numbers.flatten(1)


def test_limbs_are_drawn_where_they_are_with_their_depth() -> None:
    seen = {"left_shoulder": (64.0, 128.0, -128.0, 9.0), "left_elbow": (192.0, 128.0, 0.0, 9.0)}
    limbs = draw_limbs(landmarks_at(seen))[0]
    near, depth = limbs[0], limbs[len(limbs) // 2]  # the left upper arm is the first line
    assert near[32, 16:48].min() > 0.9
    assert near[50].max() < 0.01
    assert near[32, 55].item() < 0.1
    assert depth[32, 16].item() == pytest.approx(-0.98, abs=0.05)  # twice a depth of half the picture's side
    assert abs(depth[32, 47].item()) < 0.05
    hidden = draw_limbs(landmarks_at({name: (*values[:3], -9.0) for name, values in seen.items()}))[0]
    assert hidden[0, 32, 32].item() == pytest.approx(0.3 * near[32, 32].item(), rel=0.02)
    assert torch.isfinite(limbs).all()  # of limbs without a length, too


def person_with(shares: torch.Tensor) -> FoundPerson:
    """Person whose crop is a picture of 256 x 256 px, with these probabilities (21, 256, 256)."""
    crop = TurnedCrops(np.full((1, 2), SIDE / 2), np.array([float(SIDE)]), np.zeros(1), np.zeros(1, int))
    return replace(example_person("cpu"), crop=crop, parts=LikeliestParts.of(shares[None])[0])


def test_parts_are_taken_within_the_mask_where_both_agree() -> None:
    """Columns of 32 px: sure, unsure, another thing, another person's, beside the mask, and background."""
    shares = torch.zeros(21, SIDE, SIDE)
    shares[0] = 1.0
    for first, values in ((0, {3: 0.9, 0: 0.1}), (32, {3: 0.5, 4: 0.5, 0: 0.0}), (64, {3: 0.1, 0: 0.9})):
        for part in range(21):
            shares[part, :, first : first + 32] = values.get(part, 0.0)
    shares[:, :, 96:160] = shares[:, :, :1]
    shares[:, :, 128:160] = torch.eye(21)[5][:, None, None]
    groups = np.zeros((SIDE, SIDE), np.uint8)
    groups[:, :96], groups[:, 96:128] = 1, IGNORE
    found = seen_parts(person_with(shares), PartLabels(label_set("full1"), groups))
    assert found is not None
    assert found.label_set == label_set("ellipbody20")
    assert found.groups[64, 16 : 16 + 6 * 32 : 32].tolist() == [3, IGNORE, IGNORE, IGNORE, IGNORE, 0]
    assert seen_parts(replace(example_person("cpu"), parts=None), PartLabels(label_set("full1"), groups)) is None
    nothing = torch.full((21, SIDE, SIDE), 1e-4)
    nothing[0] = 1.0
    assert seen_parts(person_with(nothing), PartLabels(label_set("full1"), groups)) is None


def test_files_of_other_networks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "head.safetensors"
    config = PartHeadConfig(channels=(4, 4, 4, 4, 4))
    save_part_head(path, PartHead(config).state_dict(), config, {})
    assert load_part_head(path).config == config
    path.write_bytes(b"no weights")
    with pytest.raises(InputError, match=r"head\.safetensors.*partdr train parts"):
        load_part_head(path)
    with pytest.raises(ValueError, match=r"channels\[2\]: 0"):
        PartHeadConfig(channels=(4, 4, 0, 4, 4))
