"""The files of a fit: complete, readable, right side up, and in place all at once or not at all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from helpers.example import example_keypoints, example_parts, example_photo
from helpers.pictures import draw_on_screen
from helpers.quick import QUICK_SEARCH
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, PART_NAMES
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.models.anny import anny
from warp_partdr.models.model import detailed_mesh
from warp_partdr.models.registration import Registered, RegistrationOptions, register
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.results import overlays, save
from warp_partdr.results.body_file import load_body
from warp_partdr.results.fit_charts import loss_chart, panels
from warp_partdr.results.overlays import draw_detailed
from warp_partdr.results.palette import PART_COLOURS, group_colours
from warp_partdr.results.views import draw_views, place_alone
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.ellipsoids.stages import Stage

PHOTO = example_photo()
KEYPOINTS = example_keypoints()
PARTS = example_parts()


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        image.load()
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def result() -> FitResult:
    return fit_body(KEYPOINTS, PARTS, options=replace(QUICK_SEARCH, guess_camera=False))


@pytest.fixture(scope="module")
def bare() -> FitResult:
    """A fit to keypoints alone."""
    return fit_body(KEYPOINTS, options=QUICK_SEARCH)


@pytest.fixture(scope="module")
def folder(result: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fit") / "new" / "out"
    save.save_fit(result, path, photo=PHOTO)
    return path


@pytest.fixture(scope="module")
def registered(result: FitResult) -> Registered:
    return register(result.posed, anny(), options=RegistrationOptions(iterations=2))


# --- body.npz, body.json, report.json ------------------------------------------------------------------------------


def test_body_file_poses_to_the_fitted_joints(folder: Path, result: FitResult) -> None:
    body = load_body(folder / "body.npz")
    written = save.body_file(result.parameters, result.camera, (512, 384))
    for name in written.__dataclass_fields__:
        assert getattr(body, name).tobytes() == np.asarray(getattr(written, name)).tobytes(), name
    assert body.image_size.tolist() == [512, 384]
    joints = body.body("cpu").pose().torch()["joints"]
    torch.testing.assert_close(joints, result.posed.joints, rtol=0, atol=1e-6)
    torch.testing.assert_close(body.camera().project(joints), result.camera.project(result.posed.joints))


def test_body_json_states_joints_camera_and_measurements(folder: Path, result: FitResult) -> None:
    data = json.loads((folder / "body.json").read_text())
    joints = result.posed.joints[0].numpy()
    assert data["joints"]["names"] == list(JOINT_NAMES)
    np.testing.assert_allclose(data["joints"]["points_m"], joints, atol=1e-4)
    camera = data["camera"]
    seen = camera["scale_px_per_m"] * joints[:, :2] + camera["translation_px"]
    np.testing.assert_allclose(data["joints"]["pixels"], seen, atol=0.05)
    upper_leg = 100 * float(result.parameters.lengths[0, LENGTH_NAMES.index("upper leg")])
    assert data["measurements_cm"]["left upper leg length"] == pytest.approx(upper_leg, abs=0.01)
    assert 20 < upper_leg < 60
    assert all(isinstance(value, float) and value > 0 for value in data["measurements_cm"].values())


def test_the_report_scores_parts_and_keypoints(folder: Path, result: FitResult) -> None:
    report = json.loads((folder / "report.json").read_text())
    assert report["energy_total"] == pytest.approx(sum(result.energy.values()), abs=1e-3)
    assert report["parts"]["label_set"] == "cdcl14"
    assert 0.5 < report["parts"]["part_f1"] < report["parts"]["foreground_f1"] <= 1
    assert set(report["parts"]["f1"]) == {"background", *label_set("cdcl14").group_names}
    assert set(report["parts_lsp6"]["f1"]) == {"background", *label_set("lsp6").group_names}
    assert list(report["seconds"]) == [stage.name for stage in QUICK_SEARCH.stages]
    assert report["keypoints"]["confident"] == 17
    assert 0 < report["keypoints"]["mean_distance_px"] < 30
    assert report["versions"]["torch"] == torch.__version__


def test_label_set_without_lsp_parts_has_no_such_score() -> None:
    target = np.ones((4, 4), dtype=np.uint8)
    scores = save.score_labels(target, target, label_set("full1"))
    assert (list(scores), scores["parts"]["foreground_f1"]) == (["parts"], 1)


# --- ellipbody.glb -------------------------------------------------------------------------------------------------


def test_glb_has_the_fitted_body_in_its_colours_in_metres_on_the_floor(folder: Path, result: FitResult) -> None:
    scene = trimesh.load(folder / "ellipbody.glb")
    assert list(scene.geometry) == list(PART_NAMES)
    for name, colour in zip(PART_NAMES, PART_COLOURS[1:], strict=True):
        mesh = scene.geometry[name]
        assert mesh.is_watertight
        assert mesh.volume > 0  # faces look outward
        # glTF's factors are linear light
        linear = np.asarray(mesh.visual.material.baseColorFactor)[:3] / 255
        shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(255 * shown, colour, atol=8)
    low, high = scene.bounds
    assert low[1] == pytest.approx(0, abs=1e-5)
    assert 1.2 < high[1] < 2.2
    for name in PART_NAMES:
        transform, geometry = scene.graph[name]
        assert geometry == name
        np.testing.assert_array_equal(transform, np.eye(4))
    centres = np.array([scene.geometry[name].bounds.mean(0) for name in PART_NAMES])
    expected = result.posed.centres[0].numpy() * [1, -1, -1]  # y up, toward the viewer at +z, not mirrored
    np.testing.assert_allclose(centres - centres[0], expected - expected[0], atol=1e-4)


# --- pictures ------------------------------------------------------------------------------------------------------


def test_overlay_shows_the_photo_and_the_body_on_it(folder: Path, result: FitResult) -> None:
    overlay = pixels(folder / "overlay.png")
    assert overlay.shape == PHOTO.shape
    changed = (overlay != PHOTO).any(-1)
    body = result.draw(PHOTO.shape[:2]).labels[0].numpy() > 0
    assert changed[body].mean() > 0.98
    assert changed[~body].mean() < 0.05  # outlines and keypoints


def test_the_parts_picture_has_the_colours_of_all_groups(folder: Path) -> None:
    picture = pixels(folder / "parts.png")
    height, width = picture.shape[:2]
    assert 400 < height < 1000
    assert 400 < width < 1600
    colours = {tuple(colour) for colour in picture.reshape(-1, 3)}
    for colour in group_colours(PARTS.label_set.part_groups)[1:15]:
        assert tuple(colour.tolist()) in colours


@pytest.mark.parametrize("size", [(1, 1), (7, 300), (60, 40), (3000, 700)])
def test_panels_fit_a_screen(size: tuple[int, int]) -> None:
    target = np.zeros(size, dtype=np.uint8)
    target[size[0] // 4 : 1 + 3 * size[0] // 4, size[1] // 4 : 1 + 3 * size[1] // 4] = 1
    target[0, 0] = 255
    for shown in (target % 255, np.zeros_like(target)):
        sheet = panels(target, shown, group_colours(label_set("full1").part_groups))
        assert sheet.width < 1600
        assert sheet.height < 700
    assert panels(np.zeros_like(target), np.zeros_like(target), np.zeros((256, 3), dtype=np.uint8)).width > 0


def test_panels_tell_missing_from_too_much() -> None:
    target = np.zeros((100, 100), dtype=np.uint8)
    target[10:90, 10:90] = 1
    shown = target.copy()
    shown[:, :40] = 0  # 30 of 80 columns missing, nothing too much

    def count(*images: np.ndarray) -> tuple[int, int]:
        sheet = np.asarray(panels(*images, np.zeros((256, 3), dtype=np.uint8)))
        return tuple((sheet == colour).all(-1).sum() for colour in ((0, 90, 181), (220, 50, 32)))

    (blue, red), (swapped_blue, swapped_red) = count(target, shown), count(shown, target)
    assert swapped_red - red == blue - swapped_blue > 10_000


@pytest.mark.parametrize(
    "history", [[[5.0]], [[1e9, 3.0], [-1.0, 0.0]], [[0.0], [-2.0]], [[2.0, 2.0, 2.0]], [[3.0, np.inf, np.nan]]]
)
@pytest.mark.filterwarnings("error")
def test_a_loss_chart_is_drawn_of_any_history(history: list[list[float]], result: FitResult) -> None:
    stages = tuple(Stage(f"stage {index}", 1, len(values), 0.1) for index, values in enumerate(history))
    chart = loss_chart(replace(result, history=[np.array(values) for values in history], stages=stages))
    assert chart.width > 500
    assert chart.width > chart.height > 200
    assert np.asarray(chart).std() > 10


# --- the detailed body ---------------------------------------------------------------------------------------------


def test_the_detailed_body_s_files_hold_its_pose_and_overlay(
    registered: Registered, result: FitResult, tmp_path: Path
) -> None:
    folder = tmp_path / "new" / "out"
    save.save_registered(registered, folder, result.camera, PHOTO.shape[:2], photo=PHOTO, seconds=1.235)
    assert {path.name for path in folder.iterdir()} == set(save.DETAILED_FILES)
    report = json.loads((folder / "registration.json").read_text())
    assert (report["model"], report["seconds"]) == ("anny", 1.235)
    assert report["losses"]["joints"] == pytest.approx(float(registered.losses["joints"]), abs=1e-4)
    with np.load(folder / "detailed.npz", allow_pickle=False) as saved:
        assert saved["model"] == "anny"
        for name in ("shape", "rotations", "translation"):
            np.testing.assert_array_equal(saved[name], getattr(registered, name)[0].numpy())

    shown = pixels(folder / "detailed.png")
    assert shown.shape == PHOTO.shape
    mesh = detailed_mesh(registered.model)
    body = draw_mesh(registered.detailed.vertices, mesh, result.camera, PHOTO.shape[:2]).labels[0] > 0
    changed = (shown != PHOTO).any(-1)
    assert 0.05 < body.float().mean() < 0.5
    assert changed[body.numpy()].mean() > 0.98
    assert changed[~body.numpy()].mean() < 0.01  # outlines


def test_the_detailed_body_is_drawn_without_a_photo_too(
    registered: Registered, result: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overlays, "OVERLAY_SIDE", 128)
    save.save_registered(registered, tmp_path, result.camera, (512, 384))
    shown = pixels(tmp_path / "detailed.png")
    assert shown.shape == (128, 96, 3)
    columns = np.flatnonzero((shown != shown[0, 0]).any(-1).any(0)) * 4
    seen = result.camera.project(registered.detailed.vertices)[0, :, 0]
    assert abs(columns.min() - float(seen.min())) < 8
    assert abs(columns.max() - float(seen.max())) < 8
    assert "seconds" not in json.loads((tmp_path / "registration.json").read_text())


def test_the_detailed_body_is_scored_by_its_own_mesh(registered: Registered, result: FitResult, tmp_path: Path) -> None:
    labels, size = label_set("cdcl14"), (512, 384)

    def score(groups: np.ndarray) -> dict[str, Any]:
        seen = replace(result.evidence, picture=PartLabels(labels, groups), groups=groups)
        return save.save_registered(registered, tmp_path, result.camera, size, evidence=seen)

    points = result.camera.project(registered.detailed.vertices)
    drawn = draw_on_screen(points, detailed_mesh(registered.model, at_joints=True), size).labels[0].numpy()
    target = labels.part_groups[drawn]
    target[:100] = 255  # somebody else
    report = score(target)
    assert report == json.loads((tmp_path / "registration.json").read_text())
    assert report["parts"]["label_set"] == "cdcl14"
    assert report["parts"]["part_f1"] == report["parts"]["foreground_f1"] == report["parts_lsp6"]["part_f1"] == 1

    target[100:] = 0
    head = target.copy()
    head[100:][drawn[100:] > 0] = 1
    counts = np.bincount((drawn > 0)[100:].ravel())
    report = score(target)
    background = 2 * counts[0] / (2 * counts[0] + counts[1])
    assert report["parts"]["foreground_f1"] == pytest.approx(background / 2, abs=1e-4)  # nothing of a person there
    assert report["parts"]["left_out"] is None
    left = head.copy()
    left[100:150][drawn[100:150] == 0] = 1
    beyond, inside = (drawn[100:150] == 0).sum(), (drawn[100:] > 0).sum()
    assert score(left)["parts"]["left_out"] == pytest.approx(beyond / (beyond + inside), abs=1e-4)
    report = score(head)
    assert report["parts"]["left_out"] == 0
    assert report["parts"]["foreground_f1"] == 1
    assert report["parts"]["part_f1"] < 0.5


def test_bare_and_clothed_bodies_are_scored_apart(registered: Registered, result: FitResult, tmp_path: Path) -> None:
    """``parts`` are of the bare mesh, ``parts_clothed`` of the body in its clothes."""
    labels, size = label_set("cdcl14"), (512, 384)
    thick = torch.tensor([[0.05, 0.0, 0.05, 0.05, 0.02, 0.0, 0.04, 0.04]])
    mesh = detailed_mesh(registered.model, at_joints=True)

    def drawn(vertices: torch.Tensor) -> np.ndarray:
        return labels.part_groups[draw_on_screen(result.camera.project(vertices), mesh, size).labels[0].numpy()]

    def score(groups: np.ndarray, clothes: torch.Tensor | None) -> dict[str, Any]:
        seen = replace(result.evidence, picture=PartLabels(labels, groups), groups=groups)
        return save.save_registered(
            registered, tmp_path, result.camera, size, evidence=seen, clothes=clothes, bare=True
        )

    report = score(drawn(registered.clothed(thick).vertices), thick)
    assert report["parts_clothed"]["part_f1"] == report["parts_lsp6_clothed"]["part_f1"] == 1
    assert report["parts"]["foreground_f1"] < 0.99
    saved = trimesh.load(tmp_path / "detailed.obj", process=False, maintain_order=True)
    seen = torch.tensor(saved.vertices * [1, -1, -1], dtype=torch.float32)[None]  # y down, z away again
    bare = drawn(seen + (registered.detailed.vertices - seen).mean(1, keepdim=True))
    assert score(bare, thick)["parts"]["part_f1"] > 0.999
    assert not {"parts_clothed", "parts_lsp6_clothed"} & set(score(bare, None))


def test_a_fit_s_set_ends_the_older_detailed_body(
    registered: Registered, result: FitResult, bare: FitResult, tmp_path: Path
) -> None:
    save.save_fit(result, tmp_path)
    report = save.save_registered(registered, tmp_path, result.camera, (512, 384))
    assert report["files"].keys() == set(save.DETAILED_FILES) - {"registration.json"}
    assert {path.name for path in tmp_path.iterdir()} == {*save.RESULT_FILES, *save.DETAILED_FILES}
    (tmp_path / "notes").write_text("mine")
    report = save.save_fit(bare, tmp_path)
    assert report == json.loads((tmp_path / "report.json").read_text())
    assert {path.name for path in tmp_path.iterdir()} == {"notes", *save.RESULT_FILES} - {"parts.png"}


@pytest.mark.parametrize("shape", [(9, 9), (9, 9, 4), (0, 9, 3)])
def test_photos_of_another_kind_are_named(shape: tuple[int, ...], result: FitResult, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"photo: uint8 .*; expected uint8 \(H, W, 3\), as of read_photo"):
        save.save_fit(result, tmp_path, photo=np.zeros(shape, np.uint8))
    with pytest.raises(ValueError, match=r"photo: float32 "):
        save.save_fit(result, tmp_path, photo=np.zeros((9, 9, 3), np.float32))


# --- other inputs --------------------------------------------------------------------------------------------------


def test_without_any_picture_the_overlay_holds_all_keypoints(bare: FitResult, tmp_path: Path) -> None:
    assert "parts" not in save.save_fit(bare, tmp_path)
    overlay = pixels(tmp_path / "overlay.png")
    assert (overlay.shape[1::-1] >= KEYPOINTS.points.max(0)).all()
    assert (overlay[0, 0] == overlay[0, -1]).all()
    assert overlay.std() > 10
    assert load_body(tmp_path / "body.npz").image_size.tolist() == list(overlay.shape[:2])


def test_overlay_of_a_large_photo_is_smaller_and_shows_the_same(
    result: FitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = np.asarray(overlays.draw_overlay(result, PHOTO.shape[:2], PHOTO)).astype(float)
    monkeypatch.setattr(overlays, "OVERLAY_SIDE", 256)
    small = np.asarray(overlays.draw_overlay(result, PHOTO.shape[:2], PHOTO)).astype(float)
    assert small.shape == (256, 192, 3)
    blocks = whole.reshape(256, 2, 192, 2, 3).mean((1, 3))
    assert np.abs(small - blocks).mean() < 6
    empty = np.asarray(overlays.draw_overlay(result, (10**6, 10**5))).shape
    assert empty == (256, 26, 3)


def long_numbers(value: Any) -> list[float]:
    """Numbers with more than six digits after the point in what a JSON file holds."""
    if isinstance(value, dict):
        return [number for each in value.values() for number in long_numbers(each)]
    if isinstance(value, list):
        return [number for each in value for number in long_numbers(each)]
    return [value] if isinstance(value, float) and round(value, 6) != value else []


def test_numbers_in_json_are_rounded_to_what_they_mean(
    registered: Registered, result: FitResult, tmp_path: Path
) -> None:
    """Metres to 0.1 mm, pixels to 0.01, centimetres to 1 mm, seconds to 0.01; none has the digits of float32."""
    save.save_fit(result, tmp_path)
    save.save_registered(registered, tmp_path, result.camera, (512, 384), evidence=result.evidence)
    for name in ("body.json", "report.json", "registration.json"):
        assert long_numbers(json.loads((tmp_path / name).read_text())) == []
    body = json.loads((tmp_path / "body.json").read_text())
    joints = result.posed.joints[0].numpy()
    np.testing.assert_allclose(body["joints"]["points_m"], joints, atol=5.1e-5)
    for number, digits in ((body["joints"]["points_m"][3][0], 4), (body["joints"]["pixels"][3][1], 2)):
        assert number == round(number, digits)
    assert all(value == round(value, 1) for value in body["measurements_cm"].values())
    seconds = json.loads((tmp_path / "report.json").read_text())["seconds"]
    assert all(value == round(value, 2) for value in seconds.values())


@pytest.mark.parametrize("bare", [False, True])
def test_pictures_and_meshes_wear_a_suit_unless_skin_is_asked_for(
    registered: Registered, result: FitResult, tmp_path: Path, bare: bool
) -> None:
    """The arrays are of the body in either case. Views are written for whoever asks for them."""
    size, thick = (512, 384), torch.full((1, 8), 0.02)
    views = place_alone(registered, result.camera, size, result.evidence.keypoints, lens_assumed=True, bare=bare)
    save.save_registered(registered, tmp_path, result.camera, size, clothes=thick, bare=bare, views=views)
    worn, skin = (
        np.asarray(draw_detailed(registered, result.camera, size, clothes=thick, bare=each)) for each in (False, True)
    )
    shown = np.asarray(Image.open(tmp_path / "detailed.png"))
    np.testing.assert_array_equal(shown, skin if bare else worn)
    assert (skin != worn).any()
    assert (b"COLOR_0" in (tmp_path / "detailed.glb").read_bytes()) == (not bare)
    mesh = trimesh.load(tmp_path / "detailed.obj", process=False, maintain_order=True)
    exact = trimesh.load(tmp_path / "detailed.ply", process=False, maintain_order=True)
    height = np.ptp(registered.detailed.vertices[0, :, 1].numpy())
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(height, abs=1e-4)
    np.testing.assert_allclose(mesh.vertices, exact.vertices, atol=1e-5)
    with np.load(tmp_path / "detailed.npz") as saved:
        np.testing.assert_array_equal(saved["rotations"], registered.rotations[0].numpy())
    sheet = np.asarray(Image.open(tmp_path / "views.png"))
    np.testing.assert_array_equal(sheet, np.asarray(draw_views([views], size)))
