"""The demo's window, driven without a screen: its pictures, sliders, buttons and keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import viewer
from helpers.files import EXAMPLE
from helpers.viewer import SMALL, click, image, make_state, middle, play, read_target, send
from PIL import Image

from warp_partdr.body.template import LENGTH_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.viewer.scene import PlottedScene
from warp_partdr.viewer.settings import QUALITIES
from warp_partdr.viewer.sliders import PAGES
from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import RANDOM, body_of, body_target, network_body

one_thread, open_window, window = viewer.one_thread, viewer.open_window, viewer.window  # fixtures


def test_a_slider_changes_what_it_should(window):
    before = window.scene.screenshot()
    body, target, place = image(window, "body"), image(window, "target"), window.scene.parts[16].user_matrix.copy()
    window.press("bracketright")
    index = [slider.title for slider in window.page().sliders].index("forearm length [cm]")
    window.slide(index, window.page().sliders[index].high)
    shown = window.page().sliders[index].value / 100
    assert window.state.body.lengths[0, LENGTH_NAMES.index("forearm")].item() == pytest.approx(shown)
    assert (image(window, "body") != body).any()
    assert np.array_equal(image(window, "target"), target)
    assert not np.allclose(window.scene.parts[16].user_matrix, place)
    after = window.scene.screenshot()
    changed = (before != after).any(-1)
    assert changed[:400, 700:960].any()  # the body's labels
    assert not changed[20:280, 970:].any()  # the target's


def test_pictures_are_upright_and_not_mirrored(can_draw):
    scene = PlottedScene(make_state("t-pose", "t-pose"), smooth=False)
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
        for index, (title, low, high, _, _) in enumerate(window.page().sliders):
            window.slide(index, (low + 3 * high) / 4)
            assert window.page().sliders[index][3] == pytest.approx((low + 3 * high) / 4, abs=1e-3), title


def test_ticks_step_and_draw_only_while_it_plays(window):
    window.scene.screenshot()
    drawn, interactor = [], window.scene.plotter.iren.interactor
    window.scene.plotter.render_window.AddObserver("EndEvent", lambda *_: drawn.append(len(window.state.history)))
    interactor.InvokeEvent("TimerEvent")
    assert drawn == []
    window.press("space")
    for _ in range(3):
        interactor.InvokeEvent("TimerEvent")
    window.press("space")
    interactor.InvokeEvent("TimerEvent")
    assert drawn == [0, 1, 2, 3, 3]
    assert "iteration 3" in window.scene._said()


def test_events_of_the_window_arrive(window):
    interactor = window.scene.plotter.iren.interactor
    for key in ("space", "bracketright"):
        interactor.SetKeySym(key)
        interactor.InvokeEvent("KeyPressEvent")
    assert window.controls.playing
    assert window.page().sliders[0].title == "upper leg length [cm]"
    interactor.InvokeEvent("TimerEvent")
    assert len(window.state.history) == 1
    before = window.state.body.lengths[0, 6].item()
    slider = window._sliders.widgets[0]
    slider.GetRepresentation().SetValue(100 * before + 2)
    slider.InvokeEvent("InteractionEvent")
    assert window.state.body.lengths[0, 6].item() == pytest.approx(before + 0.02, abs=1e-4)


def test_a_click_chooses_a_part(window):
    window._picked(window.scene.parts[PART_NAMES.index("right_foot")])
    assert window.page().sliders[0].title == "right foot, x [deg]"
    window._picked(window.scene.parts[PART_NAMES.index("left_hip")])
    assert window.scene.message == "left hip doesn't turn by itself"
    assert window.controls.part == "right_foot"


def test_buttons_do_what_they_say(window):
    state, camera = window.state, window.scene.plotter.renderers[0].camera
    before = camera.position
    for text, now, *hint in (
        ("silhouette", lambda: state.settings.supervision == "silhouette"),
        ("keypoints", lambda: state.settings.supervision == "keypoints"),
        ("parts", lambda: state.settings.supervision == "parts"),
        ("z gradient", lambda: not state.settings.depth_gradient),
        ("E2", lambda: state.settings.renderer == "E2"),
        ("coverage", lambda: state.settings.gradient == "coverage"),
        ("128", lambda: state.settings.size == 128),
        ("fast", lambda: (state.settings.gradient, state.settings.renderer) == ("edges", "exact")),
        ("sitting", lambda: torch.equal(state.start.rotations, body_of("sitting").rotations), "start from"),
        ("sitting", lambda: torch.equal(state.target.truth.rotations, body_of("sitting").rotations), "target:"),
        ("step", lambda: len(state.history) == 1),
        ("restart", lambda: not state.history),
        ("skeleton", lambda: window.scene.skeleton_only),
        ("outline arrows", lambda: window.scene.outline_arrows),
        ("camera", lambda: window.page().sliders[0].title == "scale [px/m]"),
        (">", lambda: window.page().sliders[0].title.endswith(", x [deg]")),
        ("next part", lambda: window.controls.part == "right_upper_arm"),
        ("thicknesses", lambda: window.page().sliders[0].title.endswith("[cm]")),
        ("play", lambda: window.controls.playing),
    ):
        assert not now(), text
        click(window, text, *hint)
        assert now(), text
        assert window.scene.message == "", text
    assert camera.position == before  # a click on a button is no grip on the view


def test_buttons_show_what_is_so(window):
    before = window.scene.screenshot()
    lit = {button.text for button in window.panel.boxes if button.is_on()}
    assert lit == {"t-pose", "walking", "parts", "z gradient", "exact", "partdr", "64", "lengths"}
    (button,) = [button for button in window.panel.boxes if button.text == "E2"]
    send(window, "MouseMoveEvent", middle(window, button))
    assert window.panel.over is button
    over = window.scene.screenshot()
    window.click(button)
    on = window.scene.screenshot()
    x, y = middle(window, button)
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
    assert [(row.drawn, row.iterations) for row in window.tradeoff.rows.values()] == [
        ("exact, partdr", 4),
        ("exact, edges", 3),
        ("exact, coverage", 0),
    ]
    for row, gradient in zip(window.tradeoff.rows.values(), ("partdr", "edges"), strict=False):
        alone = DemoState(body_of("sitting"), body_target(body_of("walking")), replace(SMALL, gradient=gradient))
        play(alone, row.iterations)
        assert (row.f1, row.joints) == (alone.part_f1, alone.joint_error())


def test_what_is_lit_goes_on(window):
    window.press("n")
    for text, hint in (("partdr", ""), ("64", ""), ("parts", ""), ("exact", "draw with"), ("walking", "target:")):
        click(window, text, hint)
        assert len(window.state.history) == 1, text


def test_partdrs_z_is_lit_only_where_it_counts(window):
    def lit() -> bool:
        return any(button.is_on() for button in window.panel.boxes if button.text == "z gradient")

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


def test_random_bodies_of_buttons_go_on_from_the_seed(open_window):
    window = open_window(make_state(), seed=6)
    window.press("F5")
    assert torch.equal(window.state.start.rotations, body_of(RANDOM, 7).rotations)


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
    assert [row.size for row in window.tradeoff.rows.values()] == [64, 64, 128, 256, 256, 512]  # the first is SMALL's
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


def test_faults_are_told_in_the_window(window):
    def told() -> str:
        return " ".join(window.scene._status.input.split())

    window.folder.write_text("a file where a folder is wanted")
    window.press("d")
    assert "expected a folder to write to" in told()
    window.folder.unlink()
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


def test_a_target_without_labels_takes_keypoints_alone(open_window):
    target = read_target(EXAMPLE / "photo.png")
    window = open_window(DemoState(body_of("t-pose"), target, replace(SMALL, supervision="keypoints")))
    click(window, "parts")
    assert window.scene.message.startswith("supervision: parts, without part labels; expected --parts FILE")
    assert window.state.settings.supervision == "keypoints"
    click(window, "walking", "target:")
    assert window.state.target.photo is None
    click(window, "given")
    assert window.state.target is target
    (row,) = window.tradeoff.rows.values()
    assert row.angle is None


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


def test_no_opengl_is_one_line(monkeypatch):
    import pyvista

    def fail(*args, **kwargs):
        raise RuntimeError("no\nOpenGL")

    monkeypatch.setattr(pyvista, "Plotter", fail)
    with pytest.raises(
        InputError, match=r"^demo: VTK can't draw here \(no OpenGL\); expected OpenGL: .* needs neither$"
    ):
        PlottedScene(make_state())


def test_the_network_starts_near_the_target(window):
    window.press("t")
    far = window.state.joint_error()
    window.press("k")
    assert window.state.joint_error() < 0.5 * far
    assert window.state.history == []
    state = make_state(start="t-pose")
    near = DemoState(network_body(state.target), state.target, SMALL)
    assert near.part_f1 > state.part_f1 + 0.2
