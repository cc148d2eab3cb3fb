"""Everyone in a photo that comes with nothing else."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_mask, example_photo
from helpers.pages import read_page
from PIL import Image

from warp_partdr import metrics
from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import Perspective, UsualLens
from warp_partdr.errors import InputError
from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.models.anny import anny
from warp_partdr.models.model import detailed_mesh
from warp_partdr.networks.detection import crops
from warp_partdr.pipelines import photo as photo_fit
from warp_partdr.pipelines.photo import PACKAGED, PACKAGED_PARTS, PhotoFit, fit_photo, mask_labels, person_in_photo
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.results.overlays import GRAY, draw_detailed
from warp_partdr.results.person_pictures import draw_side_view
from warp_partdr.results.photo_page import PAGE, draw_pictures, in_order, person_surface
from warp_partdr.results.placements import place_on_ground
from warp_partdr.results.result_sets import check_result
from warp_partdr.results.save import DETAILED_FILES, RESULT_FILES, save_fit
from warp_partdr.results.save_photo import PHOTO_FILES, save_photo_fit
from warp_partdr.results.shading import BodySurface
from warp_partdr.solve.confidence.judge import LimbConfidence
from warp_partdr.solve.confidence.limbs import guessed_parts
from warp_partdr.solve.ellipsoids import fitting
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.mesh.mesh_options import MeshOptions

EXAMPLE = Path(__file__).resolve().parents[2] / "warp_partdr" / "assets" / "example"
FAST = FitOptions.at("fast")
FADING = ("left_shoulder", "chest", "left_hip", "abdomen")  # parts in which a pale left arm ends or before which it is


def two_people() -> np.ndarray:
    """The example's photo, and the same person again, half as large."""
    photo = Image.fromarray(example_photo())
    wide = Image.new("RGB", (photo.width * 2, photo.height), photo.getpixel((5, 5)))
    wide.paste(photo, (0, 0))
    wide.paste(photo.resize((photo.width // 2, photo.height // 2)), (photo.width + 60, 120))
    return np.asarray(wide)


@pytest.fixture(scope="module")
def everyone() -> tuple[np.ndarray, PhotoFit]:
    photo = two_people()
    return photo, fit_photo(photo, options=FAST)


def test_the_example_s_person_is_near_the_truth(device):
    photo = example_photo()
    found = fit_photo(photo, options=FAST, device=device)
    assert list(found.fits) == [0]
    mesh, truth = found.fits[0], json.loads((EXAMPLE / "truth.json").read_text())
    joints = truth["joints"]["lsp14"]
    error = metrics.pa_mpjpe(mesh.landmarks(joints["names"]), np.array(joints["points_m"]))
    assert 1000 * float(error) < 110
    drawn = mesh.draw(photo.shape[:2]).labels[0].cpu().numpy() > 0
    person = example_mask()
    assert (drawn & person).sum() / (drawn | person).sum() > 0.8
    assert found.hidden_by(0) == []


def test_half_a_body_of_a_real_photo_is_fitted(device):
    photo = read_photo(EXAMPLE / "astronaut.jpg")
    found = fit_photo(photo, options=FAST, device=device)
    assert list(found.fits) == [0]
    mesh = found.fits[0]
    drawn = mesh.draw(photo.shape[:2]).labels[0].cpu().numpy() > 0
    seen = found.owners == 1
    # The mask shows a space suit, which the body within does not fill. Keypoints count more.
    assert (drawn & seen).sum() / drawn.sum() > 0.95
    assert (drawn & seen).sum() / seen.sum() > 0.7
    keypoints, names = found.people[0].keypoints, ("nose", "left_shoulder", "right_shoulder")
    points = torch.from_numpy(mesh.landmarks(names))[None].to(device)
    rows = [keypoints.format.landmarks.index(name) for name in names]
    distances = mesh.ellipbody.camera.project(points)[0, :, :2].cpu().numpy() - keypoints.points[rows]
    assert np.linalg.norm(distances, axis=1).max() < 8  # [px], of 188 between the shoulders
    assert {"left leg", "right leg"} <= set(found.confidences[0].guessed)
    assert _pixels(draw_pictures(found, 0, photo, person_surface(found, 0)).body).shape[0] == 320


def test_everyone_stands_before_the_same_usual_lens_also_who_is_asked_for_alone(tmp_path):
    photo = two_people()
    options = replace(FAST, stages=(), search=(), mesh=MeshOptions(iterations=1))
    found = fit_photo(photo, options=options)
    lens = UsualLens.of_size(photo.shape[:2])
    for fit in found.fits.values():
        assert fit.ellipbody.camera_guessed
        torch.testing.assert_close(fit.camera.intrinsics, lens.intrinsics, rtol=1e-4, atol=1e-2)
    alone = fit_photo(photo, options=options, person=1)
    torch.testing.assert_close(alone.fits[1].camera.intrinsics, found.fits[1].camera.intrinsics)
    np.testing.assert_allclose(alone.fits[1].vertices, found.fits[1].vertices, atol=5e-3)
    report = save_photo_fit(found, tmp_path, photo=photo)
    assert {person["distance"] for person in report["people"]} == {"for an assumed lens"}


def test_everyone_is_fitted_where_they_stand(everyone):
    photo, found = everyone
    assert list(found.fits) == [0, 1]
    assert found.owners.shape == photo.shape[:2]
    for place, mesh in found.fits.items():
        drawn = mesh.draw(photo.shape[:2]).labels[0].numpy() > 0
        own = found.owners == place + 1
        assert (drawn & own).sum() / (drawn | own).sum() > 0.75
    near, far = (float(mesh.ellipbody.posed.joints[0, 0, 2]) for mesh in found.fits.values())
    assert 1.5 < far / near < 2.7  # the smaller one is pasted at half the size


def test_one_of_them_may_be_asked_for(everyone):
    photo, found = everyone
    alone = fit_photo(photo, options=FAST, person=1)
    assert list(alone.fits) == [1]
    np.testing.assert_allclose(alone.fits[1].vertices, found.fits[1].vertices, atol=5e-3)
    with pytest.raises(InputError, match="person: 2; expected 0 to 1"):
        fit_photo(photo, options=FAST, person=2)
    with pytest.raises(InputError, match="person: -1; expected an integer of 0 or more"):
        fit_photo(photo, options=FAST, person=-1)


def test_options_of_the_mesh_stage_reach_it(everyone):
    told = []
    few = replace(FAST, mesh=MeshOptions(iterations=3))
    fit_photo(everyone[0], options=few, person=1, progress=lambda *step: told.append(step))
    assert told[-1] == ("mesh", 3, 3)


def test_nobody_is_an_error_that_names_the_file_where_it_is_known(tmp_path):
    empty, path = np.full((200, 300, 3), 128, dtype=np.uint8), tmp_path / "empty.png"
    with pytest.raises(InputError, match=r"^photo: nobody found in it; expected a person"):
        fit_photo(empty)
    Image.fromarray(empty).save(path)
    for given in (path, str(path)):
        with pytest.raises(InputError) as raised:
            fit_photo(given)
        assert str(raised.value) == f"{path}: nobody found in it; expected a person, or keypoints of one"
    with pytest.raises(InputError, match=r"nothing\.png: No such file"):
        fit_photo(tmp_path / "nothing.png")
    with pytest.raises(TypeError, match="photo: list; expected ndarray"):
        fit_photo([[0]])


def test_a_file_is_read(everyone, tmp_path):
    photo, found = everyone
    Image.fromarray(photo).save(tmp_path / "both.png")
    again = fit_photo(str(tmp_path / "both.png"), options=FAST, person=1)
    np.testing.assert_allclose(again.fits[1].vertices, found.fits[1].vertices, atol=5e-3)


def test_a_known_camera_puts_them_in_one_scene():
    photo = two_people()
    found = fit_photo(photo, options=FAST, camera=Perspective.of_picture(photo.shape[:2], focal=900.0))
    near, far = (float(mesh.landmarks(["pelvis"])[0, 2]) for mesh in found.fits.values())
    assert 1.5 < far / near < 2.7
    assert all(isinstance(mesh.camera, Perspective) for mesh in found.fits.values())


def test_others_pixels_are_unknown_not_background():
    owners = np.array([[0, 1], [2, 1]])
    found = mask_labels(owners, 0)
    assert found is not None
    assert found.groups.tolist() == [[0, 1], [255, 1]]
    assert mask_labels(owners, 2) is None


def test_the_part_head_sees_parts_unless_the_mask_is_asked_for(device):
    photo, heavy = example_photo(), replace(FAST, landmarks="heavy")
    seen = fit_photo(photo, options=heavy, device=device)
    assert seen.sources[0]["parts"] == PACKAGED_PARTS
    assert fit_photo(photo, options=heavy, device=device, parts_from="mask").sources[0]["parts"] == PACKAGED
    assert fit_photo(photo, options=FAST, device=device, parts_from="none").sources[0]["parts"] is None
    assert fit_photo(photo, options=FAST, device=device).sources[0]["parts"] == PACKAGED  # whose network sees no parts
    with pytest.raises(TypeError, match=r"parts_from: str; expected .*'packaged', 'mask' or 'none'"):
        fit_photo(photo, options=FAST, device=device, parts_from="maks")


def test_inputs_of_one_person_have_the_parts_that_are_asked_for():
    names = {
        source: person_in_photo(example_photo(), parts_from=source).parts.label_set.name
        for source in ("packaged", "mask")
    }
    assert names == {"packaged": "ellipbody20", "mask": "full1"}


def test_a_person_hidden_by_another_is_told(everyone):
    _, found = everyone
    owners = found.owners.copy()
    drawn = found.fits[0].draw(owners.shape).labels[0].numpy() > 0
    rows = np.flatnonzero(drawn.any(1))
    owners[rows[len(rows) // 2] :][drawn[rows[len(rows) // 2] :]] = 2
    assert replace(found, owners=owners).hidden_by(0) == [1]
    assert found.hidden_by(1) == []


def test_guessed_limbs_are_pale(everyone) -> None:
    """Nearer to the photo than the rest of the body, which stays as it is."""
    photo, found = everyone
    body, camera, size = found.fits[0].body, found.fits[0].camera, photo.shape[:2]
    whole = np.asarray(draw_detailed(body, camera, size, photo)).astype(int)
    pale = np.asarray(draw_detailed(body, camera, size, photo, guessed_parts(("left arm",)))).astype(int)
    labels = draw_mesh(body.detailed.vertices, detailed_mesh(body.model), camera, size).labels[0].numpy()
    arm = guessed_parts(("left arm",))[labels]
    assert arm.sum() > 100
    beside = guessed_parts(("left arm",)) | np.isin(np.arange(21), [1 + PART_NAMES.index(name) for name in FADING])
    away = np.ones_like(arm)
    rows, columns = np.nonzero(beside[labels])
    for down, across in np.ndindex(5, 5):
        away[(rows + down - 2).clip(0, size[0] - 1), (columns + across - 2).clip(0, size[1] - 1)] = False
    np.testing.assert_array_equal(pale[away], whole[away])
    assert np.abs(pale - photo)[arm].mean() < 0.5 * np.abs(whole - photo)[arm].mean()


def test_files_of_everyone_are_saved_and_older_ones_go(everyone, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    photo, found = everyone
    old = tmp_path / "person7"
    old.mkdir()
    (old / "body.npz").write_text("of an older run")
    (tmp_path / "person8").mkdir()
    (tmp_path / "person8" / "notes.txt").write_text("mine")
    save_fit(found.fits[0].ellipbody, tmp_path)  # of one person, in the same folder
    report = save_photo_fit(found, tmp_path, photo=photo)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {*PHOTO_FILES, "person0", "person1", "person8"}
    for place in (0, 1):
        assert {path.name for path in (tmp_path / f"person{place}").iterdir()} == {*RESULT_FILES, *DETAILED_FILES}
    assert json.loads((tmp_path / "people.json").read_text()) == report
    check_result(tmp_path / "overlay.png")
    first, second = report["people"]
    assert first["sources"] == second["sources"] == {"keypoints": PACKAGED, "parts": PACKAGED}
    assert json.loads((tmp_path / "person1" / "report.json").read_text())["sources"] == second["sources"]
    assert first["score"] > 0.5
    assert first["confidence"] == round(found.confidences[0].probability, 3)
    assert json.loads((tmp_path / "person0" / "report.json").read_text())["confidence"] == first["confidence"]
    assert 1.5 < second["distance_m"] / first["distance_m"] < 2.7
    assert len(first["keypoints"]) == 33
    scene = trimesh.load(tmp_path / "scene.glb")
    sizes = [np.ptp(mesh.vertices[:, 1]) for mesh in scene.geometry.values()]
    assert all(1.2 < size < 2.2 for size in sizes)  # metres, not shares of the picture
    left, right = (scene.geometry[f"person{place}"].vertices.mean(0) for place in (0, 1))
    assert left[0] < right[0]
    assert left[2] > right[2]  # nearer, seen along -z
    overlay = np.asarray(Image.open(tmp_path / "overlay.png"))
    assert overlay.shape == photo.shape
    assert (overlay != photo).any()
    save_fit(found.fits[0].ellipbody, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*RESULT_FILES, "person0", "person1", "person8"}


def test_guessed_limbs_are_pale_over_everyone_and_not_in_a_person_s_own_picture(everyone, tmp_path):
    photo, found = everyone
    limbs = {**found.confidences[0].limbs, "left arm": LimbConfidence(0.3, "hidden")}
    guessed = replace(found, confidences={**found.confidences, 0: replace(found.confidences[0], limbs=limbs)})
    pictures = []
    for name, fit in (("whole", found), ("guessed", guessed)):
        save_photo_fit(fit, tmp_path / name, photo=photo)
        files = tmp_path / name / "person0" / "detailed.png", tmp_path / name / "overlay.png"
        pictures.append([np.asarray(Image.open(file)) for file in files])
    (own, overlay), (pale_own, pale_overlay) = pictures
    np.testing.assert_array_equal(own, pale_own)
    assert (overlay != pale_overlay).any()


def test_the_page_shows_everyone_the_least_confident_first(everyone, tmp_path):
    photo, found = everyone
    sure, unsure = found.confidences[0], replace(found.confidences[1], probability=0.12)
    limbs = {**unsure.limbs, "left arm": LimbConfidence(0.31, "hidden"), "right leg": LimbConfidence(0.2, "outside")}
    judged = replace(found, confidences={0: replace(sure, probability=0.6), 1: replace(unsure, limbs=limbs)})
    save_photo_fit(judged, tmp_path, photo=photo, name="<b>'s & mine.png")
    check_result(tmp_path / PAGE)
    page = read_page(tmp_path / PAGE)
    assert page.anchors == ["person1", "person0"]
    assert len(page.images) == 2 + 2 * 3  # everyone over the photo and from four sides, and three of each
    for words in (
        "2 people in <b>'s & mine.png",
        "1 of 2 bodies has a confidence below 0.40.",
        "person1 confidence 0.12: likely wrong",
        "person0 confidence 0.60: more likely right than wrong",
        "left armhidden, guessed0.31",
        "right legoutside the picture, guessed0.20",
        "m, for an assumed lens",
    ):
        assert words in page.text, words
    within = [link[1:] for link in page.links if link.startswith("#")]
    assert sorted(within) == ["person0", "person0", "person1", "person1"]
    assert within[2:] == page.anchors  # the list is in the same order
    files = {link for link in page.links if not link.startswith("#")}
    assert all((tmp_path / link).exists() for link in files)
    assert {"overlay.png", "views.png", "people.json", "person1/body.json", "person0/detailed.glb"} <= files


def test_bodies_of_equal_confidence_are_in_their_order(everyone):
    people = [{"person": index, "confidence": sure} for index, sure in enumerate((0.5, 0.7, 0.5, 0.1))]
    assert [person["person"] for person in in_order(people)] == [3, 0, 2, 1]


def test_the_page_of_one_person_is_small_and_has_no_list(everyone, tmp_path):
    photo, found = everyone
    alone = replace(found, fits={1: found.fits[1]})
    save_photo_fit(alone, tmp_path, photo=photo)
    page = read_page(tmp_path / PAGE)
    assert page.anchors == ["person1"]
    assert len(page.images) == 1 + 3
    assert "1 person in the photo" in page.text
    assert "comes first" not in page.text
    assert not any(link.startswith("#") for link in page.links)
    assert (tmp_path / PAGE).stat().st_size < 200_000


def test_warnings_are_on_the_page(everyone, tmp_path):
    photo, found = everyone
    warned = found.fits[0].with_warnings(["labels: <odd>; expected others"])
    save_photo_fit(replace(found, fits={0: warned}), tmp_path, photo=photo)
    assert "labels: <odd>; expected others" in read_page(tmp_path / PAGE).text


def test_pictures_of_a_person_show_the_photo_and_pale_guessed_limbs(everyone):
    photo, found = everyone
    limbs = {
        **found.confidences[0].limbs,
        "left arm": LimbConfidence(0.3, "hidden"),
        "right arm": LimbConfidence(0.3, "hidden"),
    }
    guessed = replace(found, confidences={0: replace(found.confidences[0], limbs=limbs)})
    drawn = [draw_pictures(each, 0, photo, person_surface(each, 0)) for each in (found, guessed)]
    (seen, whole, side), (_, pale, pale_side) = ([_pixels(each) for each in vars(one).values()] for one in drawn)
    assert seen.shape == whole.shape
    assert max(seen.shape[:2]) == max(side.shape[:2]) == 320
    assert 0.1 < (np.abs(whole - seen).max(-1) > 30).mean() < 0.7
    for one, other in ((pale, whole), (pale_side, side)):  # arms alone are paler
        assert 0.01 < (np.abs(one - other).max(-1) > 20).mean() < 0.15
    assert np.abs(pale - seen).sum() < np.abs(whole - seen).sum()
    assert np.abs(pale_side - GRAY).sum() < np.abs(side - GRAY).sum()


def test_guessed_limbs_do_not_make_the_photo_small(everyone):
    """The window holds the rest of the body alone; the view from the side shows all of it."""
    photo, found = everyone
    box = found.people[1].box
    people = (found.people[0], replace(found.people[1], box=(box[0], box[1], box[2], (box[1] + box[3]) / 2)))
    limbs = {name: LimbConfidence(0.3, "outside") for name in ("left leg", "right leg")}
    cut = replace(found.confidences[1], limbs={**found.confidences[1].limbs, **limbs})
    shapes = []
    for confidence in (found.confidences[1], cut):
        one = replace(found, people=people, confidences={1: confidence})
        shapes.append(_pixels(draw_pictures(one, 1, photo, person_surface(one, 1)).photo).shape)
    assert shapes[0][0] == 320  # a person who stands is higher than wide
    assert shapes[1][1] / shapes[1][0] > 1.25 * shapes[0][1] / shapes[0][0]


def test_a_body_is_upright_from_the_side_and_the_camera_is_at_the_left(device):
    """A body that leans toward the camera has its head, the top of the picture, at the left."""
    model = anny().to(device)
    vertices = model.rest_vertices[None] * model.rest_vertices.new_tensor([1.0, -1.0, -1.0])  # y down
    head = vertices[..., 1].min()
    lean = vertices.clone()
    lean[..., 2] += 0.5 * (lean[..., 1] - head)
    for points, leans in ((vertices, False), (lean, True)):
        picture = draw_side_view(BodySurface.of_body(points, model), 200).astype(int)
        assert max(picture.shape[:2]) == 200
        rows, columns = np.nonzero(np.abs(picture - GRAY).max(-1) > 12)
        assert rows.max() - rows.min() > 160
        tall, deep = (float(np.ptp(points[0, :, axis].cpu().numpy())) for axis in (1, 2))
        assert np.ptp(columns) / np.ptp(rows) == pytest.approx(deep / tall, abs=0.03)
        top, bottom = (columns[some].mean() for some in (rows < 40, rows > 150))
        assert (top < bottom - 30) == leans


def _pixels(file: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(file))).astype(int)


def test_bodies_grow_about_the_camera_to_one_ground(everyone):
    photo, found = everyone
    fits, keypoints = list(found.fits.values()), [each.keypoints for each in found.people]
    places = place_on_ground(fits, keypoints, photo.shape[:2])
    assert all(0.6 < each.scale < 1.6 for each in places)
    assert max(abs(each.scale - 1) for each in places) > 1e-4
    hidden = [replace(each, confidence=0 * each.confidence) for each in keypoints]
    alone = [place_on_ground([fit], [each], photo.shape[:2])[0] for fit, each in zip(fits, keypoints, strict=True)]
    for others in (place_on_ground(fits, hidden, photo.shape[:2]), alone):  # nothing tells the ground
        for fit, place, other in zip(fits, places, others, strict=True):
            assert other.scale == pytest.approx(1, abs=1e-9)
            assert place.distance == pytest.approx(other.distance * place.scale)
            here, there = place.apply(fit.vertices), other.apply(fit.vertices)
            np.testing.assert_allclose(here[:, :2] / here[:, 2:], there[:, :2] / there[:, 2:], atol=1e-5)


def test_a_usual_lens_says_how_far_people_of_a_weak_perspective_are():
    photo = two_people()
    options = replace(FAST, guess_camera=False, stages=(), search=(), mesh=MeshOptions(iterations=1))
    found = fit_photo(photo, options=options, person=1)
    fit = found.fits[1]
    (place,) = place_on_ground([fit], [found.people[1].keypoints], photo.shape[:2])
    lens = UsualLens.of_size(photo.shape[:2])
    scale, _, *centre = fit.camera.intrinsics[0].tolist()
    assert place.distance == pytest.approx(float(lens.focal[0, 0]) / scale, rel=1e-5)
    seen = lens.project(torch.as_tensor(place.apply(np.zeros((1, 3))), dtype=torch.float32)[None])[0, 0, :2]
    assert seen.tolist() == pytest.approx(centre, abs=0.01)


def test_wrong_arguments_are_named(everyone, tmp_path):
    photo, found = everyone
    with pytest.raises(TypeError, match="fit"):
        save_photo_fit(found.fits, tmp_path, photo=photo)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="photo"):
        save_photo_fit(found, tmp_path, photo=torch.zeros(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="person: -1"):
        fit_photo(photo, person=-1)


def test_evidence_is_weighed_once_and_halves_of_the_photo_are_made_once(everyone, monkeypatch):
    photo, before = everyone
    calls: list[str] = []

    def count(owner: object, name: str) -> None:
        real = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *given: calls.append(name) or real(*given))

    count(fitting, "weigh_evidence")
    count(photo_fit, "weigh_evidence")
    count(crops.Pyramid, "__init__")
    again = fit_photo(photo, options=FAST)
    assert sorted(calls) == ["__init__", "weigh_evidence", "weigh_evidence"]
    for place, mesh in before.fits.items():
        np.testing.assert_array_equal(again.fits[place].vertices, mesh.vertices)
        parts = mask_labels(again.owners, place)
        alone = fitting.fit_body(again.people[place].keypoints, parts, options=FAST)
        assert torch.equal(alone.posed.joints, again.fits[place].first.posed.joints)
