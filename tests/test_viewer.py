"""The demo, driven without a screen: its model, its pictures, its sliders and keys, and what it records."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

from warp_partdr import load_body
from warp_partdr.body.template import LENGTH_NAMES, PART_NAMES
from warp_partdr.cli import app
from warp_partdr.errors import InputError
from warp_partdr.palette import PART_COLOURS
from warp_partdr.viewer.record import check_format, frames, write
from warp_partdr.viewer.scene import Scene
from warp_partdr.viewer.state import DemoState, Settings
from warp_partdr.viewer.targets import PRESETS, RANDOM, body_of, read_body, read_target, target_of
from warp_partdr.viewer.window import Window

EXAMPLE = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "example"
SMALL = Settings(size=64, steps=40)


@pytest.fixture(scope="session")
def can_draw() -> None:
    """VTK ends the process where it finds no OpenGL at all, so another process tries."""
    code = "import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Sphere()); p.screenshot()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    if done.returncode != 0:
        pytest.skip(f"VTK can't draw here: {done.stderr.strip().splitlines()[-1:]}")


def make_state(target: str = "walking", start: str = "t-pose") -> DemoState:
    return DemoState(body_of(start), target_of(body_of(target)), SMALL)


@pytest.fixture
def window(can_draw, tmp_path):
    made = Window(make_state(), tmp_path / "saved", off_screen=True)
    yield made
    made.scene.close()


def image(window: Window, name: str) -> np.ndarray:
    return window.scene._images[name].point_data["rgb"].copy()


@pytest.mark.parametrize("name", [*PRESETS, RANDOM])
def test_bodies_are_in_the_picture(name):
    target = target_of(body_of(name))
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
    right_and_down = target_of(replace(body, shift=body.shift + torch.tensor([[0.08, 0.05]])))
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
    target = read_target(EXAMPLE / "photo.png", EXAMPLE / "keypoints.json", EXAMPLE / "parts.png", "cdcl14")
    state = DemoState(body_of("t-pose"), target, SMALL)
    assert target.photo.shape == (256, 256, 3)
    before = state.part_f1()
    state.play(30)
    assert state.part_f1() > before
    assert state.joint_error() is None


def test_the_photo_is_cut_as_its_labels_are(tmp_path):
    person = np.asarray(Image.open(EXAMPLE / "parts.png")) > 0
    Image.fromarray(np.repeat(person[..., None] * np.uint8(255), 3, axis=-1)).save(tmp_path / "white.png")
    target = read_target(tmp_path / "white.png", EXAMPLE / "keypoints.json", EXAMPLE / "parts.png", "cdcl14")
    labels = target.observation.labels[::2, ::2].numpy()
    seen = labels != 255
    assert 0.5 < seen.mean() < 1
    assert ((target.photo[..., 0] > 127) == (labels > 0))[seen].mean() > 0.99


def test_a_photo_without_labels_says_what_works():
    target = read_target(EXAMPLE / "photo.png", EXAMPLE / "keypoints.json", None, "cdcl14")
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
    with pytest.raises(InputError, match=r"broken\.npz: not a body file"):
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
    for _ in range(window._num_pages()):
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


def test_events_of_the_window_arrive(window):
    interactor = window.scene.plotter.iren.interactor
    for key in ("space", "bracketright"):
        interactor.SetKeySym(key)
        interactor.InvokeEvent("KeyPressEvent")
    assert window.playing
    assert window.page()[0][0] == "upper leg length [cm]"
    interactor.InvokeEvent("TimerEvent")
    assert len(window.state.history) == 1
    before = window.state.body.lengths[0, 6].item()
    slider = window._widgets[0]
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
        InputError, match=r"^demo: VTK can't draw here \(no OpenGL\); expected OpenGL .* needs neither$"
    ):
        Scene(make_state())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no display"),
        (["--record", "out.gif", "--photo", "photo.png"], "--keypoints: none with --photo"),
        (["--record", "out.gif", "--target", "dancing"], "'dancing'; expected one of"),
        (["--record", "out.gif", "--body", "nowhere.npz"], "nowhere.npz: No such file"),
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
    done = CliRunner().invoke(app, ["demo", "--record", str(tmp_path / "out.gif"), "--steps", "2", "--size", "64"])
    assert done.exit_code == 0, done.output
    assert "2 pictures" in done.output
