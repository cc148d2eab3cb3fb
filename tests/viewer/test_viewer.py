"""The demo, driven without a screen: its model, its pictures, its sliders and keys, and what it records."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

from warp_partdr import load_body
from warp_partdr.body.template import LENGTH_NAMES, PART_NAMES
from warp_partdr.cli.main import app
from warp_partdr.clothing.registration import RegistrationOptions
from warp_partdr.errors import InputError
from warp_partdr.inputs.person_files import read_person
from warp_partdr.metrics import confusion, part_f1
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.viewer.clothing import Clothing
from warp_partdr.viewer.film import Film
from warp_partdr.viewer.recording import check_format, frames, write
from warp_partdr.viewer.scene import Scene
from warp_partdr.viewer.settings import QUALITIES, Settings
from warp_partdr.viewer.sliders import PAGES
from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import (
    PRESETS,
    RANDOM,
    Target,
    body_of,
    body_target,
    network_body,
    person_target,
    read_body,
)
from warp_partdr.viewer.trade import Trade
from warp_partdr.viewer.view import VIEW, seen_as, view_of
from warp_partdr.viewer.window import Window

EXAMPLE = Path(__file__).resolve().parents[2] / "warp_partdr" / "assets" / "example"
SMALL = Settings(size=64, steps=40)


def make_state(target: str = "walking", start: str = "t-pose") -> DemoState:
    return DemoState(body_of(start), body_target(body_of(target)), SMALL)


def read_target(photo: Path, **labels: Any) -> Target:
    return person_target(read_person(EXAMPLE / "keypoints.json", photo=photo, **labels))


@pytest.fixture(autouse=True)
def _one_thread():
    """As the command has it: the tensors are small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def window(can_draw, tmp_path):
    made = Window(make_state(), tmp_path / "saved", off_screen=True)
    made.controls.clothing = Clothing(RegistrationOptions(iterations=2))  # which is near enough, and fast
    yield made
    made.scene.close()


def send(window: Window, event: str, place: tuple[int, int]) -> None:
    """An event of the mouse, as the window system would send it."""
    interactor = window.scene.plotter.iren.interactor
    interactor.SetEventPosition(*place)
    interactor.InvokeEvent(event)


def click(window: Window, text: str, hint: str = "") -> None:
    """Click on the button that says ``text``; of two, on that with ``hint`` in its hint."""
    (button,) = (button for button in window.panel.buttons if button.text == text and hint in button.hint)
    send(window, "LeftButtonPressEvent", window.panel.place(button))
    send(window, "LeftButtonReleaseEvent", window.panel.place(button))


def image(window: Window, name: str) -> np.ndarray:
    return window.scene._images[name].point_data["rgb"].copy()


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


@pytest.mark.parametrize("supervision", ["keypoints", "silhouette", "parts"])
def test_steps_lower_the_loss_and_the_error(supervision):
    state = make_state()
    state.configure(supervision=supervision)
    before = state.joint_error(), state.part_f1()
    state.play(30)
    assert len(state.history) == 30
    assert state.history[-1] < 0.7 * state.history[0]
    assert state.joint_error() < before[0]
    assert state.part_f1() > before[1]
    assert state.milliseconds() > 0


@pytest.mark.parametrize("renderer", ["E0", "E2"])
def test_meshes_play_too(renderer):
    state = make_state()
    exact = state.drawn()
    state.configure(renderer=renderer)
    assert 0 < (state.drawn() != exact).mean() < 0.1
    state.play(10)
    assert state.history[-1] < state.history[0]


def test_the_z_gradient_is_what_parts_pull_in_depth_with():
    state = make_state("crossed arms", "crossed arms")
    state.set_rotation("left_forearm", 1, -0.3)
    pulls = []
    for depth in (True, False):
        state.configure(depth_gradient=depth)
        pulls.append(state.forces()[1][:, 2])
    assert np.abs(pulls[0]).max() > 0
    assert np.abs(pulls[1]).max() == 0


@pytest.mark.parametrize("supervision", ["keypoints", "silhouette", "parts"])
def test_forces_pull_toward_the_target(supervision):
    body = body_of("t-pose")
    right_and_down = body_target(replace(body, shift=body.shift + torch.tensor([[0.08, 0.05]])))
    state = DemoState(body, right_and_down, replace(SMALL, supervision=supervision))
    assert (state.forces()[1][:, :2].sum(0) > 0).all()


def test_restart_goes_back_and_repeats():
    state = make_state()
    state.play(5)
    first, history = state.body.rotations.detach().clone(), list(state.history)
    state.restart()
    assert torch.equal(state.body.rotations, state.start.rotations)
    state.play(5)
    assert state.history == history
    assert torch.equal(state.body.rotations, first)


def test_edits_stay_within_bounds_and_are_the_new_start():
    state = make_state()
    state.history.append(1.0)
    state.set_length("forearm", 9.0)
    state.set_rotation("left_lower_leg", 0, 9.0)
    assert state.body.lengths[0, LENGTH_NAMES.index("forearm")].item() == pytest.approx(
        float(state.bounds("lengths")[1][0, LENGTH_NAMES.index("forearm")])
    )
    knee = PART_NAMES.index("left_lower_leg")
    assert state.body.rotations[0, knee, 0].item() == pytest.approx(float(state.prior.upper_limits[knee, 0]))
    assert state.history == []
    assert torch.equal(state.start.lengths, state.body.lengths)
    assert float(state.prior.joint_limits(state.body.rotations.detach())) == 0


def test_pictures_of_a_body_that_is_there_differ_nowhere():
    state = make_state("walking", "walking")
    state.configure(size=512)  # what labels are kept at
    pictures = state.pictures()
    assert np.array_equal(pictures["body"], pictures["target"])
    assert len(np.unique(pictures["difference"].reshape(-1, 3), axis=0)) == 2
    assert state.part_f1() == 1
    assert state.joint_error() == pytest.approx(0, abs=1e-3)


def test_save_and_load(tmp_path):
    state = make_state()
    state.play(3)
    state.save(tmp_path / "body.npz")
    state.save(tmp_path / "body.glb")
    assert (tmp_path / "body.glb").read_bytes()[:4] == b"glTF"
    assert load_body(tmp_path / "body.npz").image_size.tolist() == [64, 64]
    other = make_state()
    other.load(tmp_path / "body.npz")
    assert (other.drawn() != state.drawn()).mean() < 1e-3
    for name, tensor in state.body.tensors().items():
        if name != "orientation":
            torch.testing.assert_close(other.body.tensors()[name], tensor.detach(), atol=1e-5, rtol=1e-4)


def test_a_photo_with_labels_is_a_target():
    target = read_target(EXAMPLE / "photo.png", parts=EXAMPLE / "parts.png", labels="cdcl14")
    state = DemoState(body_of("t-pose"), target, SMALL)
    assert target.photo.shape == (256, 256, 3)
    before = state.part_f1()
    state.play(30)
    assert state.part_f1() > before
    assert state.joint_error() is None
    wanted = state.wanted()
    assert (wanted == 255).any()
    assert state.part_f1() == pytest.approx(float(part_f1(confusion(state.drawn(), wanted, 15))))


def test_the_photo_is_cut_as_its_labels_are(tmp_path):
    person = np.asarray(Image.open(EXAMPLE / "parts.png")) > 0
    Image.fromarray(np.repeat(person[..., None] * np.uint8(255), 3, axis=-1)).save(tmp_path / "white.png")
    target = read_target(tmp_path / "white.png", parts=EXAMPLE / "parts.png", labels="cdcl14")
    labels = target.observation.labels[::2, ::2].numpy()
    seen = labels != 255
    assert 0.5 < seen.mean() < 1
    assert ((target.photo[..., 0] > 127) == (labels > 0))[seen].mean() > 0.99


def test_a_photo_without_labels_says_what_works():
    target = read_target(EXAMPLE / "photo.png")
    with pytest.raises(InputError, match=r"supervision: parts, without part labels; expected --parts FILE, or keyp"):
        DemoState(body_of("t-pose"), target, SMALL)
    state = DemoState(body_of("t-pose"), target, replace(SMALL, supervision="keypoints"))
    with pytest.raises(InputError, match="without part labels"):
        state.configure(supervision="silhouette")
    state.play(10)
    assert state.history[-1] < state.history[0]
    assert state.part_f1() is None
    assert (state.pictures()["difference"] == state.pictures()["difference"][0, 0]).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"supervision": "colours"}, "supervision: colours; expected one of keypoints, silhouette, parts"),
        ({"renderer": "E4"}, "renderer: E4; expected one of exact, E0"),
        ({"size": 100}, "size: 100; expected one of 64"),
        ({"steps": 0}, "steps: 0; expected 1 or more"),
        ({"learning_rate": float("nan")}, "learning_rate: nan; expected"),
    ],
)
def test_bad_settings(changes, said):
    with pytest.raises(InputError, match=said):
        Settings(**changes)


def test_bad_names(tmp_path):
    with pytest.raises(InputError, match=r"body: 'dancing'; expected one of t-pose"):
        body_of("dancing")
    with pytest.raises(InputError, match="expected one of hip"):
        make_state().set_length("nose", 1.0)
    (tmp_path / "broken.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"broken\.npz: not readable"):
        read_body(tmp_path / "broken.npz")
    with pytest.raises(InputError, match="expected a file in a folder that is there"):
        make_state().save(tmp_path / "nowhere" / "body.npz")


def test_a_slider_changes_what_it_should(window):
    forearm, before = LENGTH_NAMES.index("forearm"), window.scene.screenshot()
    body, target, place = image(window, "body"), image(window, "target"), window.scene.parts[16].user_matrix.copy()
    while "forearm length [cm]" not in [slider[0] for slider in window.page()]:
        window.press("bracketright")
    index = [slider[0] for slider in window.page()].index("forearm length [cm]")
    window.slide(index, window.page()[index][2])
    assert window.state.body.lengths[0, forearm].item() == pytest.approx(window.page()[index][3] / 100)
    assert (image(window, "body") != body).any()
    assert np.array_equal(image(window, "target"), target)
    assert not np.allclose(window.scene.parts[16].user_matrix, place)
    after = window.scene.screenshot()
    changed = (before != after).any(-1)
    assert changed[:400, 700:960].any()  # the body's labels
    assert not changed[20:280, 970:].any()  # the target's


def test_pictures_are_upright_and_not_mirrored(can_draw):
    scene = Scene(make_state("t-pose", "t-pose"), smooth=False)
    shown = scene.screenshot().astype(int)
    scene.close()
    for columns in (slice(0, 640), slice(640, 960), slice(960, 1280)):  # in 3D with the wall, body, target
        view = shown[: 600 if columns.start == 0 else 300, columns]

        def middle(part: str, view: np.ndarray = view) -> np.ndarray:
            colour = PART_COLOURS[PART_NAMES.index(part) + 1].astype(int)
            return np.argwhere(np.abs(view - colour).sum(-1) < 20).mean(0)

        head, foot = middle("head"), middle("left_foot")
        assert head[0] < foot[0] - 60
        assert middle("left_hand")[1] > head[1] + 30 > middle("right_hand")[1] + 60


def test_every_key_and_slider_does_something(window):
    for key in window.keys:
        window.press(key)
        assert "expected" not in window.scene.message, key
    assert (window.folder / "body.npz").exists()
    assert (window.folder / "ellipbody.glb").exists()
    assert Image.open(window.folder / "demo.png").size == (1280, 800)
    for _ in PAGES:
        window.press("bracketright")
        for index, (title, low, high, _, _) in enumerate(window.page()):
            window.slide(index, (low + 3 * high) / 4)
            assert window.page()[index][3] == pytest.approx((low + 3 * high) / 4, abs=1e-3), title


def test_play_and_pause(window):
    window.press("space")
    for _ in range(3):
        window.tick()
    window.press("space")
    window.tick()
    assert len(window.state.history) == 3
    assert "iteration 3" in window.scene._said()


def test_ticks_draw_only_while_it_plays(window):
    window.scene.screenshot()
    drawn = []
    window.scene.plotter.render_window.AddObserver("EndEvent", lambda *_: drawn.append(1))
    interactor = window.scene.plotter.iren.interactor
    interactor.InvokeEvent("TimerEvent")
    assert drawn == []
    window.controls.playing = True
    interactor.InvokeEvent("TimerEvent")
    assert drawn == [1]


def test_events_of_the_window_arrive(window):
    interactor = window.scene.plotter.iren.interactor
    for key in ("space", "bracketright"):
        interactor.SetKeySym(key)
        interactor.InvokeEvent("KeyPressEvent")
    assert window.controls.playing
    assert window.page()[0][0] == "upper leg length [cm]"
    interactor.InvokeEvent("TimerEvent")
    assert len(window.state.history) == 1
    before = window.state.body.lengths[0, 6].item()
    slider = window._sliders.widgets[0]
    slider.GetRepresentation().SetValue(100 * before + 2)
    slider.InvokeEvent("InteractionEvent")
    assert window.state.body.lengths[0, 6].item() == pytest.approx(before + 0.02, abs=1e-4)


def test_a_click_chooses_a_part(window):
    window._picked(window.scene.parts[PART_NAMES.index("right_foot")])
    assert window.page()[0][0] == "right foot, x [deg]"
    window._picked(window.scene.parts[PART_NAMES.index("left_hip")])
    assert window.scene.message == "left hip doesn't turn by itself"
    assert window.part == "right_foot"


def test_faults_are_told_in_the_window(window, tmp_path):
    (tmp_path / "saved").write_text("a file where a folder is wanted")
    window.press("d")
    assert "expected a folder to write to" in " ".join(window.scene._status.input.split())


def test_buttons_do_what_they_say(window):
    state, camera = window.state, window.scene.plotter.renderers[0].camera
    before = camera.position
    for text, hint, now in (
        ("silhouette", "", lambda: state.settings.supervision == "silhouette"),
        ("keypoints", "", lambda: state.settings.supervision == "keypoints"),
        ("parts", "", lambda: state.settings.supervision == "parts"),
        ("z gradient", "", lambda: not state.settings.depth_gradient),
        ("E2", "", lambda: state.settings.renderer == "E2"),
        ("coverage", "", lambda: state.settings.gradient == "coverage"),
        ("128", "", lambda: state.settings.size == 128),
        ("fast", "", lambda: (state.settings.gradient, state.settings.renderer) == ("edges", "exact")),
        ("sitting", "start from", lambda: torch.equal(state.start.rotations, body_of("sitting").rotations)),
        (
            "crossed arms",
            "target:",
            lambda: torch.equal(state.target.truth.rotations, body_of("crossed arms").rotations),
        ),
        ("step", "", lambda: len(state.history) == 1),
        ("restart", "", lambda: not state.history),
        ("skeleton", "", lambda: window.scene.skeleton_only),
        ("outline arrows", "", lambda: window.scene.outline_arrows),
        ("camera", "", lambda: window.page()[0][0] == "scale [px/m]"),
        (">", "", lambda: window.page()[0][0].endswith(", x [deg]")),
        ("next part", "", lambda: window.part == "right_upper_arm"),
        ("thicknesses", "", lambda: window.page()[0][0].endswith("[cm]")),
        ("play", "", lambda: window.controls.playing),
    ):
        assert not now(), text
        click(window, text, hint)
        assert now(), text
        assert window.scene.message == "", text
    assert camera.position == before  # a click on a button is no grip on the view


def test_buttons_show_what_is_so(window):
    before = window.scene.screenshot()
    lit = {button.text for button in window.panel.buttons if button.is_on()}
    assert lit == {"t-pose", "walking", "parts", "z gradient", "exact", "partdr", "64", "lengths"}
    (button,) = [button for button in window.panel.buttons if button.text == "E2"]
    send(window, "MouseMoveEvent", window.panel.place(button))
    assert window.panel.over is button
    over = window.scene.screenshot()
    window.click(button)
    on = window.scene.screenshot()
    x, y = window.panel.place(button)
    around = np.s_[800 - y - 12 : 800 - y + 12, x - 10 : x + 10]
    assert (before[around] != over[around]).any()
    assert (over[around] != on[around]).any()
    assert (before[770:, :200] != over[770:, :200]).any()  # the hint
    assert window.panel.at(700, 400) is None


def test_pictures_cannot_be_turned_and_the_body_can(window):
    window.scene.screenshot()
    cameras = [renderer.camera for renderer in window.scene.plotter.renderers]
    before = [camera.position for camera in cameras]
    for place in ((800, 600), (400, 320)):
        send(window, "LeftButtonPressEvent", place)
        send(window, "MouseMoveEvent", (place[0] + 60, place[1] + 40))
        held = cameras[0].position
        window.scene.plotter.iren.interactor.InvokeEvent("TimerEvent")
        assert cameras[0].position == held  # VTK would turn it on while the button is held
        send(window, "LeftButtonReleaseEvent", (place[0] + 60, place[1] + 40))
    after = [camera.position for camera in cameras]
    assert after[1:] == before[1:]
    assert after[0] != before[0]
    window.press("r")
    assert cameras[0].position == pytest.approx(before[0])


def test_keys_of_vtk_do_nothing(window):
    window.scene.screenshot()
    interactor = window.scene.plotter.iren.interactor
    camera = window.scene.plotter.renderers[0].camera.position
    for key in "wv":
        interactor.SetKeySym(key)
        interactor.SetKeyCode(key)
        interactor.InvokeEvent("KeyPressEvent")
        interactor.InvokeEvent("CharEvent")
    assert window.scene.parts[0].prop.style == "Surface"
    assert window.scene.plotter.renderers[0].camera.position == camera


@pytest.mark.parametrize("name", PRESETS)
def test_a_view_is_what_it_was_set_to(name):
    body = body_of(name)
    again = seen_as(body, view_of(body))
    torch.testing.assert_close(again.global_orient(), body.global_orient())
    wanted = dict(zip(VIEW, (90.0, 10.0, -20.0, 30.0, -150.0, 70.0), strict=True))
    assert view_of(seen_as(body, wanted)) == pytest.approx(wanted, abs=1e-3)


def test_view_sliders_move_the_picture_by_what_they_say():
    state = make_state()
    before = state.drawn()
    state.set_view("shift x", 8.0)  # of 256: 2 of 64
    assert np.array_equal(state.drawn()[:, 2:], before[:, :-2])
    state.set_view("shift x", 0.0)
    state.set_view("scale", 64.0)
    assert np.ptp(np.nonzero(state.drawn())[0]) == pytest.approx(np.ptp(np.nonzero(before)[0]) / 2, abs=1.5)
    state.set_view("scale", 1e6)
    assert state.view()["scale"] == pytest.approx(260, rel=1e-5)
    with pytest.raises(InputError, match="view: 'zoom'; expected one of scale"):
        state.set_view("zoom", 1.0)


def test_a_view_slider_changes_nothing_but_its_own_number():
    body = body_of("t-pose")
    state = DemoState(seen_as(body, view_of(body) | {"scale": 400.0, "shift x": -200.0}), make_state().target, SMALL)
    state.set_view("shift y", 1e6)
    assert [state.view()[name] for name in ("scale", "shift x", "shift y")] == pytest.approx([400, -200, 128])


@pytest.mark.parametrize("renderer", ["exact", "E0"])
def test_outlines_are_pulled_toward_the_target(renderer):
    body = body_of("t-pose")
    right_and_down = body_target(replace(body, shift=body.shift + torch.tensor([[0.08, 0.05]])))
    state = DemoState(body, right_and_down, replace(SMALL, renderer=renderer))
    points, forces = state.outline_forces()
    assert points.shape == forces.shape == (len(points), 3)
    assert len(points) > 50
    assert (forces[:, :2].sum(0) > 0).all()
    assert (np.abs(forces[:, 2]) > 0).any()
    state.configure(supervision="keypoints")
    assert len(state.outline_forces()[0]) == 0


def test_outline_arrows_are_drawn(window):
    before = window.scene.screenshot()
    window.press("i")
    after = window.scene.screenshot()
    changed = (before != after).any(-1)
    assert changed[310:580, 970:].sum() > 500
    assert not changed[:290].any()
    window.press("c")
    assert window.state.settings.supervision == "keypoints"
    window.press("i")
    window.press("i")
    assert "keypoints pull on no outline" in window.scene.message


def test_the_trade_remembers_what_was_tried():
    state = DemoState(body_of("t-pose"), body_target(body_of("walking")), replace(SMALL, gradient="coverage"))
    trade = Trade(state)
    for renderer in ("exact", "E0", "E2"):
        state.configure(renderer=renderer)
        trade.update(measure=True)
    state.play(5)
    trade.update(measure=False)
    exact, coarse, fine = trade.rows.values()
    assert [row.drawn for row in (exact, coarse, fine)] == ["exact, coverage", "mesh E0", "mesh E2"]
    assert exact.outline == 0 < fine.outline < coarse.outline
    assert exact.angle < fine.angle  # PartDR's gradient is no derivative
    assert all(row.milliseconds > 0 for row in trade.rows.values())
    assert (exact.iterations, coarse.iterations, fine.iterations) == (0, 0, 5)
    assert (fine.f1, fine.joints) == (state.part_f1(), state.joint_error())
    assert trade.rows[trade.current] is fine
    state.set_length("forearm", 0.3)
    trade.update(measure=False)
    assert trade.rows == {}


def test_the_gradient_is_compared_only_where_all_of_it_is_followed():
    state = make_state()
    trade = Trade(state)
    for changes in ({}, {"depth_gradient": False}, {"gradient": "coverage"}, {"supervision": "silhouette"}):
        state.configure(**changes)
        trade.update(measure=True)
    state.configure(supervision="keypoints", depth_gradient=True)
    trade.update(measure=True)
    assert [(row.followed, row.angle is not None) for row in trade.rows.values()] == [
        ("parts + z", True),
        ("parts", False),  # the angle is that of all of the gradient
        ("parts", True),  # of coverage nothing can be left out
        ("silhouette", False),
        ("keypoints", False),
    ]


def test_rows_are_of_runs_from_the_start(window):
    """A row that began where another setting had come to would tell of two settings."""
    window.press("F4")
    for press, ticks in (("space", 4), ("g", 3), ("g", 0), ("g", 2)):  # back at partdr, which then is behind itself
        window.press(press)
        for _ in range(ticks):
            window.tick()
    click(window, "partdr")  # is lit
    click(window, "sitting", "start from")  # so is this; back to the start
    click(window, "walking", "target:")
    click(window, "64")
    assert window.state.history == []
    assert [(row.drawn, row.iterations) for row in window.trade.rows.values()] == [
        ("exact, partdr", 4),
        ("exact, edges", 3),
        ("exact, coverage", 0),
    ]
    for row, gradient in zip(window.trade.rows.values(), ("partdr", "edges"), strict=False):
        alone = DemoState(body_of("sitting"), body_target(body_of("walking")), replace(SMALL, gradient=gradient))
        alone.play(row.iterations)
        assert (row.f1, row.joints) == (alone.part_f1(), alone.joint_error())


def test_what_is_lit_goes_on(window):
    window.press("n")
    for text, hint in (("partdr", ""), ("64", ""), ("parts", ""), ("exact", "draw with"), ("walking", "target:")):
        click(window, text, hint)
        assert len(window.state.history) == 1, text


def test_partdrs_z_is_lit_only_where_it_counts(window):
    def lit() -> bool:
        return any(button.is_on() for button in window.panel.buttons if button.text == "z gradient")

    assert lit()
    for text, hint, has in (("coverage", "", False), ("E1", "", True), ("silhouette", "", False), ("parts", "", True)):
        click(window, text, hint)
        assert lit() is has is window.state.settings.has_depth, text
    assert "with z gradient" in window.scene._said()
    window.press("z")
    assert "without z gradient" in window.scene._said()
    window.press("z")
    click(window, "exact", "draw with")
    assert "z gradient" not in window.scene._said()
    window.press("z")
    assert window.scene.message == "PartDR's z gradient: only of parts, with partdr or E0 to E3"
    assert window.state.settings.depth_gradient


def test_random_bodies_of_buttons_go_on_from_the_seed(can_draw, tmp_path):
    state = DemoState(body_of(RANDOM, 5), body_target(body_of(RANDOM, 6)), SMALL)
    window = Window(state, tmp_path, off_screen=True, seed=6)
    window.press("F5")
    assert torch.equal(window.state.start.rotations, body_of(RANDOM, 7).rotations)
    window.scene.close()


def test_pictures_are_of_now_where_only_what_is_sent_is_drawn(window):
    before = window.scene.screenshot()
    window.scene.plotter.suppress_rendering = True
    window.press("F4")
    assert (window.scene.screenshot()[:600, :640] != before[:600, :640]).any()


def test_qualities_are_tried_from_the_start_and_told_in_the_table(window):
    before = window.scene.screenshot()
    window.press("n")
    for k in range(len(QUALITIES)):
        window.press(f"F{6 + k}")
        assert window.state.history == []
    assert [row.size for row in window.trade.rows.values()] == [64, 64, 128, 256, 256, 512]  # the first is SMALL's
    changed = (window.scene.screenshot() != before).any(-1)
    assert changed[620:760, 910:].any()


def test_the_detailed_body_is_worn_until_the_body_moves(window):
    before = window.scene.screenshot()
    window.press("a")
    assert "anny, registered in" in window.scene.message
    assert window.scene.detailed
    assert not window.scene.parts[0].visibility
    worn = window.scene.screenshot()
    points = np.asarray(window.scene._skin.mapper.dataset.points)
    assert np.ptp(points[:, 1]) == pytest.approx(1.7, abs=0.2)
    face = PART_COLOURS[PART_NAMES.index("head") + 1].astype(int)
    view = np.s_[60:560, 150:640]
    assert (before[view] != worn[view]).any(-1).sum() > 5000
    assert (
        np.abs(worn[view] / worn[view].sum(-1, keepdims=True).clip(1) - face / face.sum()).sum(-1) < 0.05
    ).sum() > 300
    window.press("m")
    assert window.scene.detailed  # the renderer has changed, the body has not
    window.press("n")
    assert not window.scene.detailed
    assert window.scene.parts[0].visibility


def test_loading_starts_from_what_was_saved(window):
    window.press("n")
    saved = window.state.body.rotations.detach().clone()
    window.press("d")
    window.press("F4")
    click(window, "load")
    torch.testing.assert_close(window.state.start.rotations, saved, atol=1e-5, rtol=1e-4)
    assert window.scene.message == f"starts from {window.folder / 'body.npz'}"


def test_more_faults_are_told_in_the_window(window):
    def told() -> str:
        return " ".join(window.scene._status.input.split())

    window.controls.playing = True
    window.press("l")
    assert "body.npz: No such file" in told()
    assert not window.controls.playing
    window.press("space")
    window.press("d")
    window.tick()
    assert "saved body.npz" in told()  # it can be read while it plays
    window.press("space")
    (window.folder / "body.npz").write_bytes(b"PK")
    start = window.state.start
    window.press("l")
    assert "not readable" in told()
    assert window.state.start is start
    window.press("n")
    assert window.scene.message == ""


def test_a_target_without_labels_takes_keypoints_alone(can_draw, tmp_path):
    target = read_target(EXAMPLE / "photo.png")
    window = Window(
        DemoState(body_of("t-pose"), target, replace(SMALL, supervision="keypoints")), tmp_path, off_screen=True
    )
    click(window, "parts")
    assert window.scene.message.startswith("supervision: parts, without part labels; expected --parts FILE")
    assert window.state.settings.supervision == "keypoints"
    click(window, "walking", "target:")
    assert window.state.target.photo is None
    click(window, "given")
    assert window.state.target is target
    (row,) = window.trade.rows.values()
    assert row.angle is None
    window.scene.close()


def test_profile_tells_of_drawn_pictures(window):
    took = window.profile(2)
    assert list(took) == [
        "slider hip length [cm]",
        "slider scale [px/m]",
        "slider left upper arm, x [deg]",
        "iteration",
        "quality",
    ]
    assert all(0 < value < 5000 for value in took.values())


def test_a_window_that_nobody_sees_is_a_fault(window):
    if window.scene.plotter.render_window.GetClassName() not in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"):
        pytest.skip("VTK reaches a display here")
    with pytest.raises(InputError, match=r"the display can't be reached .*; expected one, or --record out\.gif"):
        window.show()


@pytest.mark.parametrize("name", ["out.gif", "out.html"])
def test_record(can_draw, tmp_path, name):
    scene = Scene(make_state(), window_size=(320, 200), smooth=False)
    write(list(frames(scene, 4)), tmp_path / name)
    scene.close()
    if name == "out.gif":
        with Image.open(tmp_path / name) as film:
            assert (film.n_frames, film.size) == (3, (320, 200))
    else:
        page = (tmp_path / name).read_text()
        assert page.count("data:image/webp;base64,") == 3
        assert "http" not in page  # it needs no network


def test_record_checks_the_name(tmp_path, monkeypatch):
    for path, said in (
        (tmp_path / "out.avi", r"out\.avi; expected a name that ends with \.gif"),
        (tmp_path / "nowhere" / "out.gif", "expected a file in a folder that is there"),
    ):
        with pytest.raises(InputError, match=said):
            check_format(path)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install imageio-ffmpeg\), or \.gif or \.html"):
        check_format(tmp_path / "out.mp4")


def test_no_opengl_is_one_line(monkeypatch):
    import pyvista

    def fail(*args, **kwargs):
        raise RuntimeError("no\nOpenGL")

    monkeypatch.setattr(pyvista, "Plotter", fail)
    with pytest.raises(
        InputError, match=r"^demo: VTK can't draw here \(no OpenGL\); expected OpenGL: .* needs neither$"
    ):
        Scene(make_state())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no display"),
        (["--set", "port=80"], "port: without --web; expected both, or neither"),
        (["--set", "browser=false"], "browser: without --web"),
        (["--record", "out.gif", "--photo", "photo.png"], "--keypoints: none with --photo"),
        (["--record", "out.gif", "--target", "dancing"], "'dancing'; expected one of"),
        (["--record", "out.gif", "--start", "nowhere.npz"], "nowhere.npz: No such file"),
    ],
)
def test_command_faults(arguments, said, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    done = CliRunner().invoke(app, ["demo", *arguments])
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)


def test_command_records(can_draw, tmp_path):
    done = CliRunner().invoke(
        app, ["demo", "--record", str(tmp_path / "out.gif"), "--set", "steps=2", "--set", "size=64"]
    )
    assert done.exit_code == 0, done.output
    assert "2 pictures" in done.output


def test_film(window, monkeypatch):
    click(window, "film")
    for _ in range(3):
        window.press("n")
    window.slide(0, window.page()[0].high)
    click(window, "film")
    assert window.scene.message == f"5 pictures in {window.folder / 'demo.gif'}"
    with Image.open(window.folder / "demo.gif") as film:
        assert film.size == (640, 400)
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames - 1)
        assert (np.abs(np.asarray(film.convert("RGB")) - first).max(-1) > 40).mean() > 0.01
    monkeypatch.setattr("warp_partdr.viewer.film._MOST", 2)  # then it ends by itself
    window.press("f")
    window.press("n")
    assert not window.controls.film.running
    assert "2 pictures" in window.scene.message
    window.folder.joinpath("demo.gif").unlink()
    window.folder.joinpath("demo.gif").mkdir()
    window.press("f")
    window.press("n")
    assert "Is a directory" in window.scene.message
    window.folder.joinpath("demo.gif").rmdir()
    window.press("f")
    assert "2 pictures" in window.scene.message  # those of before


def test_a_film_of_a_window_that_changes_its_size(tmp_path):
    film = Film()
    for height, width in ((800, 1281), (900, 1280), (400, 500)):
        film.take(np.full((height, width, 3), 90, np.uint8))
    assert film.write(tmp_path) == 3
    with Image.open(tmp_path / "demo.gif") as written:
        assert (written.size, written.n_frames) == ((427, 267), 3)
    assert film.write(tmp_path) == 0


def test_a_film_is_written_when_the_window_closes(window):
    assert window.finish() == ""
    window.press("f")
    window.press("n")
    assert window.finish() == f"{window.folder / 'demo.gif'}: 2 pictures"


def test_the_network_starts_near_the_target(window):
    window.press("t")
    far = window.state.joint_error()
    window.press("k")
    assert window.state.joint_error() < 0.5 * far
    assert window.state.history == []
    state = make_state(start="t-pose")
    near = DemoState(network_body(state.target), state.target, SMALL)
    assert near.part_f1() > state.part_f1() + 0.2
