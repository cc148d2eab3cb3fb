"""The demo's window, driven without a screen: its pictures, sliders, buttons and keys."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import viewer
from helpers.files import EXAMPLE
from helpers.viewer import SMALL, box, buttons, click, image, make_state, middle, play, read_target, said, send
from PIL import Image

from warp_partdr.body.template import LENGTH_NAMES, PART_NAMES
from warp_partdr.cli.options import PersonFiles
from warp_partdr.errors import InputError
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.results.shading import SKIN_COLOUR
from warp_partdr.viewer.buttons import Slider
from warp_partdr.viewer.plotted import Look
from warp_partdr.viewer.scene import PlottedScene
from warp_partdr.viewer.settings import QUALITIES
from warp_partdr.viewer.sliders import PAGES
from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import RANDOM, body_of, body_target, network_body, person_target

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
    assert changed[box(window, "body")].any()
    assert not changed[box(window, "target")].any()


def test_pictures_are_upright_and_not_mirrored(open_window):
    window = open_window(make_state("t-pose", "t-pose"))
    shown = window.scene.screenshot().astype(int)
    for name in ("solid", "body", "target"):  # in 3D with the wall, and labels
        view = shown[box(window, name)]

        def middle(part: str, view: np.ndarray = view) -> np.ndarray:
            colour = PART_COLOURS[PART_NAMES.index(part) + 1].astype(int)
            return np.argwhere(np.abs(view - colour).sum(-1) < 20).mean(0) / len(view)

        head, foot = middle("head"), middle("left_foot")
        assert head[0] < foot[0] - 0.2
        assert middle("left_hand")[1] > head[1] + 0.1 > middle("right_hand")[1] + 0.2


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
    assert "iteration 3 " in said(window)


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
    (slider,) = (
        placed for placed in window.panel.entries if getattr(placed.entry, "title", "") == "upper leg length [cm]"
    )
    row = 800 - round((slider.top + slider.bottom) / 2)
    send(window, "LeftButtonPressEvent", (round(slider.left) + 40, row))
    pressed = window.state.body.lengths[0, 6].item()
    send(window, "MouseMoveEvent", (round(slider.left) + 80, row))
    send(window, "LeftButtonReleaseEvent", (round(slider.left) + 80, row))
    send(window, "MouseMoveEvent", (round(slider.left) + 10, row))
    low, high = (float(bound[6]) for bound in window.state.bounds("lengths"))
    share = (80 - window.panel.letter / 2) / (slider.right - slider.left - window.panel.letter)
    assert window.state.body.lengths[0, 6].item() == pytest.approx(low + share * (high - low), rel=0.02)
    assert window.state.body.lengths[0, 6].item() > pressed
    assert pressed != before


def test_a_click_chooses_a_part(window):
    window._picked(window.scene.parts[PART_NAMES.index("right_foot")])
    assert window.page().sliders[0].title == "right foot, x [deg]"
    window._picked(window.scene.parts[PART_NAMES.index("left_hip")])
    assert window.scene.message == "left hip doesn't turn by itself"
    assert window.controls.part == "right_foot"


def test_buttons_do_what_they_say(window):
    state, camera = window.state, window.scene.body_view.camera
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
    lit = {button.text for button in buttons(window) if button.is_on()}
    assert lit == {"t-pose", "walking", "parts", "z gradient", "exact", "partdr", "64", "lengths"}
    (button,) = [button for button in buttons(window) if button.text == "E2"]
    send(window, "MouseMoveEvent", middle(window, button))
    assert window.panel.over is button
    over = window.scene.screenshot()
    window.click(button)
    on = window.scene.screenshot()
    x, y = middle(window, button)
    around = np.s_[800 - y - 12 : 800 - y + 12, x - 10 : x + 10]
    assert (before[around] != over[around]).any()
    assert (over[around] != on[around]).any()
    assert "draw with E2" in said(window)
    send(window, "MouseMoveEvent", (700, 400))
    assert "draw with E2" not in said(window)
    assert window.panel.at(700, 400) is None


def test_pictures_cannot_be_turned_and_the_body_can(window):
    window.scene.screenshot()
    cameras = [window.scene.view(name).camera for name in ("solid", "body", "target", "gradient")]
    before = [camera.position for camera in cameras]
    for place in ((1100, 600), (700, 320)):
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
    camera = window.scene.body_view.camera.position
    for key in "wv":
        interactor.SetKeySym(key)
        interactor.SetKeyCode(key)
        interactor.InvokeEvent("KeyPressEvent")
        interactor.InvokeEvent("CharEvent")
    assert window.scene.parts[0].prop.style == "Surface"
    assert window.scene.body_view.camera.position == camera


def test_outline_arrows_are_drawn(window):
    before = window.scene.screenshot()
    window.press("i")
    after = window.scene.screenshot()
    changed = (before != after).any(-1)
    assert changed[box(window, "gradient")].sum() > 200
    assert not changed[box(window, "body")].any()
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
        return any(button.is_on() for button in buttons(window) if button.text == "z gradient")

    assert lit()
    for text, hint, has in (("coverage", "", False), ("E1", "", True), ("silhouette", "", False), ("parts", "", True)):
        click(window, text, hint)
        assert lit() is has is window.state.settings.has_depth, text
    assert "with z gradient" in said(window)
    window.press("z")
    assert "without z gradient" in said(window)
    window.press("z")
    click(window, "exact", "draw with")
    assert "z gradient" not in said(window)
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
    assert (window.scene.screenshot() != before)[box(window, "solid")].any()


def test_qualities_are_tried_from_the_start_and_told_in_the_table(window):
    before = window.scene.screenshot()
    window.press("n")
    for k in range(len(QUALITIES)):
        window.press(f"F{6 + k}")
        assert window.state.history == []
    assert [row.size for row in window.tradeoff.rows.values()] == [64, 64, 128, 256, 256, 512]  # the first is SMALL's
    changed = (window.scene.screenshot() != before).any(-1)
    assert changed[box(window, "table")].any()


def test_the_detailed_body_follows_and_is_registered_at_rest(window):
    before = window.scene.screenshot()
    window.press("a")
    assert re.search(r"its shape takes about \d+ s \.\.\.", said(window))
    assert window.scene.detailed
    assert not window.scene.parts[0].visibility
    roughly = np.array(window.scene._skin.mapper.dataset.points)
    assert np.ptp(roughly[:, 1]) == pytest.approx(1.7, abs=0.2)
    window._moved -= 1  # [s]
    window.tick()
    assert re.search(r"anny, registered in \d+\.\d s", said(window))
    points = np.array(window.scene._skin.mapper.dataset.points)
    assert 1e-4 < np.abs(points - roughly).max() < 0.3
    worn, view = window.scene.screenshot(), box(window, "solid")
    changed = (before[view] != worn[view]).any(-1)
    assert changed.sum() > 5000
    share = worn[view].astype(float) / worn[view].sum(-1, keepdims=True).clip(1)
    skin = SKIN_COLOUR / SKIN_COLOUR.sum()
    assert ((np.abs(share - skin).sum(-1) < 0.02) & changed).sum() > 3000  # one even colour
    window.press("m")
    window._moved -= 1
    window.tick()
    assert np.array_equal(window.scene._skin.mapper.dataset.points, points)  # the body has not moved
    window.press("n")
    assert window.scene.detailed
    assert np.abs(window.scene._skin.mapper.dataset.points - points).max() > 1e-3
    window.press("a")
    assert window.scene.parts[0].visibility


@pytest.fixture(scope="module")
def photo_target():
    return read_target(EXAMPLE / "photo.png", parts=EXAMPLE / "parts.png", labels="cdcl14")


def test_the_first_screen_has_a_sentence_play_and_three_sliders(open_window, photo_target):
    window = open_window(DemoState(body_of("t-pose"), photo_target, SMALL), more=False, detailed=True)
    assert said(window) == "Press play: the grey body moves until it stands on the person in the photo."
    sliders = [placed.entry for placed in window.panel.entries if isinstance(placed.entry, Slider)]
    assert [button.text for button in buttons(window)] == ["play", "more"]
    assert len(sliders) == 3
    lengths, thicknesses = window.state.body.lengths.clone(), window.state.body.thicknesses.clone()
    window.pull(sliders[0], 110.0)
    torch.testing.assert_close(window.state.body.lengths, 1.1 * lengths)
    window.pull(sliders[1], 80.0)
    torch.testing.assert_close(window.state.body.thicknesses, 0.8 * thicknesses)
    window.pull(sliders[2], 60.0)
    assert window.scene.turned == pytest.approx(60.0)
    window.press("r")
    assert window.scene.turned == pytest.approx(0.0)
    click(window, "more")
    assert {"less", "E2", "coverage", "512", "skeleton", "network"} <= {button.text for button in buttons(window)}
    assert window.scene.view("table").GetDraw()
    click(window, "less")
    assert not window.scene.view("table").GetDraw()


def test_it_stops_by_itself_and_play_begins_anew(window):
    window.press("space")
    for _ in range(400):
        window.tick()
        if not window.controls.playing:
            break
    count = len(window.state.history)
    assert window.state.converged
    assert 40 <= count < 400
    assert f"Done: it stopped by itself after {count} iterations" in said(window)
    for _ in range(3):
        window.tick()
    assert len(window.state.history) == count
    window.press("space")
    window.tick()
    assert len(window.state.history) == 1


def test_in_a_photo_the_body_stands_where_the_target_s_camera_sees_it(open_window, photo_target):
    """The first view shows the same places of the photo as the labels that are compared."""
    window = open_window(DemoState(body_of("walking"), photo_target, SMALL), more=False)
    scene, state = window.scene, window.state
    assert state.lens is not None
    drawn = state.drawn
    place = scene.body_view
    for name in ("head", "left_foot", "right_foot"):
        centre = state.posed.centres[0, PART_NAMES.index(name)].numpy()
        (x, y), *_ = state.in_crop(centre[None])
        row, column = ((np.array([y, x]) + 1) / 2 * len(drawn)).astype(int)
        assert drawn[row, column] > 0, name
        place.SetWorldPoint(*scene.parts[PART_NAMES.index(name)].center, 1)
        place.WorldToDisplay()
        shown = place.GetDisplayPoint()[:2]
        low, high = photo_target.photo.low, photo_target.photo.high
        corners = []
        for corner in ((-1, 1, 0), (1, -1, 0)):  # upper left and lower right of the photo that hangs on the wall
            hung = scene._wall.user_matrix @ np.array([*corner, 1.0])
            place.SetWorldPoint(*hung)
            place.WorldToDisplay()
            corners.append(place.GetDisplayPoint()[:2])
        expected = corners[0] + (np.array([x, y]) - low) / (high - low) * np.subtract(corners[1], corners[0])
        np.testing.assert_allclose(shown, expected, atol=0.5)


def test_a_photo_keeps_its_pixels_on_the_screen(open_window, tmp_path):
    """Stripes of one pixel of the photo are told apart; in a crop of 256 pixels they would be gray."""
    stripes = np.zeros((1024, 768, 3), np.uint8)
    stripes[:, ::4] = stripes[:, 1::4] = 255
    Image.fromarray(stripes).save(tmp_path / "photo.png")
    keypoints = json.loads((EXAMPLE / "keypoints.json").read_text())
    keypoints["keypoints"] = [[2 * x, 2 * y, c] for x, y, c in keypoints["keypoints"]]
    (tmp_path / "keypoints.json").write_text(json.dumps(keypoints))
    target = person_target(PersonFiles(tmp_path / "keypoints.json").read(tmp_path / "photo.png"))
    window = open_window(DemoState(body_of("t-pose"), target, replace(SMALL, supervision="keypoints")), more=False)
    window.arrange(Look((1600, 1300)))
    window.refresh()
    shown = window.scene.screenshot()[20:60, 700:900, 0].astype(int)
    assert np.ptp(shown) > 150


@pytest.mark.parametrize("size", [(1280, 800), (400, 300), (640, 480), (390, 844), (1920, 1080)])
@pytest.mark.parametrize("more", [True, False])
def test_nothing_collides_at_any_size(window, size, more):
    window.more = more
    window.scene.arrange(Look(size, more, controls=True))
    window.refresh()
    panel = window.scene.panel
    entries = window.panel.entries
    assert len(entries) > 4
    for placed in entries:
        assert placed.left >= 0
        assert placed.right <= panel.width
        assert placed.bottom <= panel.height + 1
    for one, other in itertools.combinations(entries, 2):
        apart = one.right <= other.left or other.right <= one.left or one.bottom <= other.top or other.bottom <= one.top
        assert apart, (one, other)
    shown = [(name, box(window, name)) for name in window.scene._views if window.scene.view(name).GetDraw()]
    taken = np.zeros(size[::-1], int)
    for name, place in shown:
        if name != "ground":
            taken[place] += 1
    assert taken.max() == 1
    for name, (text, _) in window.scene._titles.items():
        if window.scene.view(name).GetDraw():
            wide = np.zeros(4)
            text.GetBoundingBox(window.scene.view(name), wide)
            assert wide[1] <= window.scene.view(name).GetSize()[0], name


def test_arrows_shrink_as_the_pull_does(window):
    def longest() -> float:
        points = window.scene._centre_arrows._mesh.points.reshape(-1, 7, 3)
        return float(np.linalg.norm(points[:, 5] - points[:, :2].mean(1), axis=-1).max())

    first, before = longest(), np.linalg.norm(window.state.forces()[1][:, :2], axis=1).max()
    for _ in range(60):
        window.press("n")
    share = np.linalg.norm(window.state.forces()[1][:, :2], axis=1).max() / before
    assert share < 0.9
    assert longest() == pytest.approx(share * first, rel=0.02)
    window.press("BackSpace")
    assert longest() == pytest.approx(first)


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
        return said(window)

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


def test_the_picture_follows_the_size_of_the_window(window):
    window.scene.plotter.render_window.SetSize(700, 500)
    window.scene.plotter.iren.interactor.InvokeEvent("TimerEvent")
    assert window.scene.look_now.size == (700, 500)
    assert window.scene.screenshot().shape == (500, 700, 3)
    click(window, "E2")
    assert window.state.settings.renderer == "E2"


def test_edges_are_smooth_at_rest_and_fast_to_draw_while_it_moves(window):
    view = window.scene.body_view
    assert view.GetUseFXAA()
    window.press("n")
    assert not view.GetUseFXAA()
    window._moved -= 1  # [s]
    window.tick()
    assert view.GetUseFXAA()


def test_nobody_is_registered_to_a_body_on_its_way_to_a_photo(open_window, photo_target):
    """On its way, single parts are much too thin or too thick, and a registered body would be, too."""
    window = open_window(DemoState(body_of("t-pose"), photo_target, SMALL), more=False, detailed=True)
    for _ in range(3):
        window.state.step()
    assert not window.state.settled
    assert not window.controls.settle()
    assert not window.scene.skin.rests
    window.state.history = [1.0] * 100  # an energy that no longer falls
    assert window.state.settled
    assert window.controls.settle()
    assert window.scene.skin.rests
