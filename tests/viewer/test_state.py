"""The demo without a picture: bodies, targets, settings, steps, forces and what was tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import viewer
from helpers.example import example_mask
from helpers.files import EXAMPLE
from helpers.viewer import SMALL, cropped, make_state, play, read_target
from PIL import Image

from warp_partdr import PART_NAMES, InputError, load_body
from warp_partdr.body.template import LENGTH_NAMES
from warp_partdr.files.sections import read_section
from warp_partdr.inputs.observation import resize_nearest
from warp_partdr.metrics import confusion, part_f1
from warp_partdr.solve.ellipsoids.stepper import Refinement
from warp_partdr.viewer.settings import CHOICES, Settings
from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import PRESETS, RANDOM, body_of, body_target, read_body, target_labels
from warp_partdr.viewer.tradeoff import Tradeoff
from warp_partdr.viewer.view import VIEW, seen_as, view_of

one_thread = viewer.one_thread  # a fixture
FOREARM, KNEE = LENGTH_NAMES.index("forearm"), PART_NAMES.index("left_lower_leg")
each_supervision = pytest.mark.parametrize("supervision", CHOICES["supervision"])


def start_beside_target(**settings: str) -> DemoState:
    """The target is the same body, farther right and down."""
    body = body_of("t-pose")
    target = body_target(replace(body, shift=body.shift + torch.tensor([[0.08, 0.05]])))
    return DemoState(body, target, replace(SMALL, **settings))


@pytest.mark.parametrize("name", [*PRESETS, RANDOM])
def test_bodies_are_in_the_picture(name):
    target = body_target(body_of(name))
    assert target.observation.points.abs().max() < 1
    labels = target.observation.labels
    assert labels is not None
    assert (labels[[0, -1]] == 0).all()
    assert len(labels.unique()) > 14  # a limb may hide another


def test_random_bodies_differ_by_seed_and_repeat():
    first, again, other = (body_of(RANDOM, seed) for seed in (1, 1, 2))
    assert torch.equal(first.rotations, again.rotations)
    assert not torch.equal(first.rotations, other.rotations)


@each_supervision
def test_steps_lower_the_loss_and_the_error(supervision):
    state = make_state(supervision=supervision)
    before = state.joint_error(), state.part_f1
    play(state, 30)
    assert len(state.history) == 30
    assert state.history[-1] < 0.7 * state.history[0]
    assert state.joint_error() < before[0]
    assert state.part_f1 > before[1]
    assert state.milliseconds() > 0


def test_steps_are_those_of_a_run():
    state = make_state()
    settings = state.settings
    run = Refinement(state.start, state.energy, iterations=6, learning_rate=settings.learning_rate).run()
    state.configure(steps=6)
    play(state, 6)
    assert state.history == run.history[:, 0].tolist()


@pytest.mark.parametrize("renderer", ["E0", "E2"])
def test_meshes_play_too(renderer):
    exact, state = make_state(), make_state(renderer=renderer)
    assert 0 < (state.drawn != exact.drawn).mean() < 0.1
    play(state, 10)
    assert state.history[-1] < state.history[0]


def test_the_z_gradient_is_what_parts_pull_in_depth_with():
    state = make_state("crossed arms", "crossed arms")
    state.set_number("rotations", (PART_NAMES.index("left_forearm"), 1), -0.3)
    for depth in (True, False):
        state.configure(depth_gradient=depth)
        assert (state.forces()[1][:, 2] != 0).any() == depth


@each_supervision
def test_forces_pull_toward_the_target(supervision):
    assert (start_beside_target(supervision=supervision).forces()[1][:, :2].sum(0) > 0).all()


@pytest.mark.parametrize("renderer", ["exact", "E0"])
def test_outlines_are_pulled_toward_the_target(renderer):
    state = start_beside_target(renderer=renderer)
    points, forces = state.outline_forces()
    assert points.shape == forces.shape == (len(points), 3)
    assert len(points) > 50
    assert (forces[:, :2].sum(0) > 0).all()
    assert (np.abs(forces[:, 2]) > 0).any()
    state.configure(supervision="keypoints")
    assert len(state.outline_forces()[0]) == 0


def test_restart_goes_back_and_repeats():
    state = make_state()
    play(state, 5)
    first, history = state.body.rotations.detach().clone(), list(state.history)
    state.restart()
    assert torch.equal(state.body.rotations, state.start.rotations)
    play(state, 5)
    assert state.history == history
    assert torch.equal(state.body.rotations, first)


def test_edits_stay_within_bounds_and_are_the_new_start():
    state = make_state()
    play(state, 1)
    state.set_number("lengths", FOREARM, 9.0)
    state.set_number("rotations", (KNEE, 0), 9.0)
    assert state.body.lengths[0, FOREARM].item() == pytest.approx(float(state.bounds("lengths")[1][FOREARM]))
    assert state.body.rotations[0, KNEE, 0].item() == pytest.approx(float(state.prior.upper_limits[KNEE, 0]))
    assert state.history == []
    assert torch.equal(state.start.lengths, state.body.lengths)
    assert float(state.prior.joint_limits(state.body.rotations.detach())) == 0


def test_pictures_of_a_body_that_is_there_differ_nowhere():
    state = make_state("walking", "walking", size=128)  # labels are kept at an odd multiple of it
    pictures = state.pictures()
    assert np.array_equal(pictures["body"], pictures["target"])
    assert len(np.unique(pictures["difference"].reshape(-1, 3), axis=0)) == 2
    assert state.part_f1 == 1
    assert state.joint_error() == pytest.approx(0, abs=1e-3)


def test_a_saved_body_is_loaded_as_it_was(tmp_path):
    state, other = make_state(), make_state()
    play(state, 3)
    state.save(tmp_path / "body.npz", tmp_path / "body.glb")
    assert (tmp_path / "body.glb").read_bytes()[:4] == b"glTF"
    assert load_body(tmp_path / "body.npz").image_size.tolist() == [64, 64]
    other.reset(read_body(tmp_path / "body.npz"))
    assert (other.drawn != state.drawn).mean() < 1e-3
    for name, tensor in state.body.tensors().items():
        if name != "orientation":
            torch.testing.assert_close(other.body.tensors()[name], tensor.detach(), atol=1e-5, rtol=1e-4)


def test_a_photo_with_labels_is_a_target():
    target = read_target(EXAMPLE / "photo.png", parts=EXAMPLE / "parts.png", labels="cdcl14")
    state = DemoState(body_of("t-pose"), target, SMALL)
    assert target.photo.pixels.shape == (512, 384, 3)
    before = state.part_f1
    play(state, 30)
    assert state.part_f1 > before
    assert state.joint_error() is None
    labels = target_labels(target, 64)
    assert (labels == 255).any()
    assert state.part_f1 == pytest.approx(float(part_f1(confusion(state.drawn, labels, 15))))


def test_the_photo_is_cut_as_its_labels_are(tmp_path):
    person = example_mask()
    Image.fromarray(np.repeat(person[..., None] * np.uint8(255), 3, axis=-1)).save(tmp_path / "white.png")
    target = read_target(tmp_path / "white.png", parts=EXAMPLE / "parts.png", labels="cdcl14")
    photo = cropped(target.photo, 256)
    labels = resize_nearest(target.observation.labels, len(photo)).numpy()
    seen = labels != 255
    assert 0.5 < seen.mean() < 1
    assert ((photo[..., 0] > 127) == (labels > 0))[seen].mean() > 0.99


def test_a_photo_without_labels_says_what_works():
    target = read_target(EXAMPLE / "photo.png")
    with pytest.raises(InputError, match=r"supervision: parts, without part labels; expected --parts FILE, or keyp"):
        DemoState(body_of("t-pose"), target, SMALL)
    state = DemoState(body_of("t-pose"), target, replace(SMALL, supervision="keypoints"))
    with pytest.raises(InputError, match="without part labels"):
        state.configure(supervision="silhouette")
    play(state, 10)
    assert state.history[-1] < state.history[0]
    assert state.part_f1 is None
    assert (state.pictures()["difference"] == state.pictures()["difference"][0, 0]).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"supervision": "colours"}, "supervision: 'colours'; expected 'keypoints' or 'silhouette' or 'parts'"),
        ({"size": 100}, "size: 100; expected 64 or 128 or 256 or 512"),
        ({"steps": 0}, "steps: 0; expected 1 or more"),
        ({"learning_rate": float("nan")}, "learning_rate: nan; expected"),
    ],
)
def test_bad_settings_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        read_section(Settings, changes)


def test_bad_bodies_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"body: 'dancing'; expected one of t-pose"):
        body_of("dancing")
    (tmp_path / "broken.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"broken\.npz: not readable"):
        read_body(tmp_path / "broken.npz")


@pytest.mark.parametrize("name", PRESETS)
def test_a_view_is_what_it_was_set_to(name):
    body = body_of(name)
    again = seen_as(body, view_of(body))
    torch.testing.assert_close(again.global_orient(), body.global_orient())
    wanted = dict(zip(VIEW, (90.0, 10.0, -20.0, 30.0, -150.0, 70.0), strict=True))
    assert view_of(seen_as(body, wanted)) == pytest.approx(wanted, abs=1e-3)


def test_view_sliders_move_the_picture_by_what_they_say():
    state = make_state()
    before = state.drawn
    state.set_view("shift x", 8.0)  # of 256: 2 of 64
    assert np.array_equal(state.drawn[:, 2:], before[:, :-2])
    state.set_view("shift x", 0.0)
    state.set_view("scale", 64.0)
    assert np.ptp(np.nonzero(state.drawn)[0]) == pytest.approx(np.ptp(np.nonzero(before)[0]) / 2, abs=1.5)
    state.set_view("scale", 1e6)
    assert view_of(state.body)["scale"] == pytest.approx(260, rel=1e-5)


def test_a_view_slider_changes_nothing_but_its_own_number():
    state = make_state()
    state.reset(seen_as(state.body, view_of(state.body) | {"scale": 400.0, "shift x": -200.0}))
    state.set_view("shift y", 1e6)
    assert list(view_of(state.body).values())[:3] == pytest.approx([400, -200, 128])


def test_the_trade_remembers_what_was_tried():
    state = make_state(gradient="coverage")
    tradeoff = Tradeoff(state)
    for renderer in ("exact", "E0", "E2"):
        state.configure(renderer=renderer)
        tradeoff.update(measure=True)
    play(state, 5)
    tradeoff.update(measure=False)
    exact, coarse, fine = tradeoff.rows.values()
    assert [row.drawn for row in (exact, coarse, fine)] == ["exact, coverage", "mesh E0", "mesh E2"]
    assert exact.outline == 0 < fine.outline < coarse.outline
    assert exact.angle < fine.angle  # PartDR's gradient is no derivative
    assert all(row.milliseconds > 0 for row in tradeoff.rows.values())
    assert (exact.iterations, coarse.iterations, fine.iterations) == (0, 0, 5)
    assert (fine.f1, fine.joints) == (state.part_f1, state.joint_error())
    assert tradeoff.rows[tradeoff.current] is fine
    state.set_number("lengths", FOREARM, 0.3)
    tradeoff.update(measure=False)
    assert tradeoff.rows == {}


def test_the_gradient_is_compared_only_where_all_of_it_is_followed():
    state = make_state()
    tradeoff = Tradeoff(state)
    for changes, followed, is_compared in (
        ({}, "parts + z", True),
        ({"depth_gradient": False}, "parts", False),  # the angle is that of all of the gradient
        ({"gradient": "coverage"}, "parts", True),  # of which nothing can be left out
        ({"supervision": "silhouette"}, "silhouette", False),
        ({"supervision": "keypoints", "depth_gradient": True}, "keypoints", False),
    ):
        state.configure(**changes)
        tradeoff.update(measure=True)
        row = tradeoff.rows[tradeoff.current]
        assert (row.followed, row.angle is not None) == (followed, is_compared)


def test_it_has_converged_when_the_mean_energy_stands_still():
    """The mean of the last 20 iterations is less than 1 % below that of the 20 before."""
    state = make_state()
    for history, converged in (
        ([100.0] * 39, False),
        ([100.0] * 40, True),
        ([100.0] * 20 + [99.2] * 20, True),
        ([100.0] * 20 + [98.8] * 20, False),
        ([900.0] * 50 + [100.0] * 20 + [99.5] * 20, True),
        ([100.0, 90.0] * 20, True),  # it swings
        (list(np.linspace(100, 60, 40)), False),
    ):
        state.history = history
        assert state.converged == converged, history


def test_shares_are_of_the_mean_adult_and_within_bounds():
    state = make_state()
    assert state.share("lengths") == pytest.approx(1.0)
    state.set_share("lengths", 1.05)
    assert state.share("lengths") == pytest.approx(1.05)
    state.set_share("lengths", 9.0)
    assert (state.body.lengths[0] <= state.bounds("lengths")[1] + 1e-6).all()
    assert state.history == []


def test_a_photo_s_body_is_drawn_through_the_lens_of_its_energy():
    """Else the labels that are compared would not be those that are seen: it would be drawn 5 % too small."""
    target = read_target(EXAMPLE / "photo.png", parts=EXAMPLE / "parts.png", labels="cdcl14")
    state = DemoState(body_of("t-pose"), target, replace(SMALL, size=128, steps=100))
    assert state.lens is not None
    play(state, 120)
    assert state.part_f1 > 0.8
    joints = state.posed.joints[0].numpy()
    placed, camera = state.energy.place(state.body.detach(), state.posed, 2)
    np.testing.assert_allclose(state.in_crop(joints), camera.project(placed.joints)[0, :, :2] - 1, atol=1e-5)
