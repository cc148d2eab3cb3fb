"""Keypoint and label files in all their shapes, faulty ones, and one person out of a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import HANG
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from warp_partdr.body.labels import IGNORE
from warp_partdr.body.skeletons import SKELETONS, convert
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoint_files import parse_keypoints, read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, choose_person, person_height
from warp_partdr.inputs.part_labels import check_sizes, read_label_set, read_parts, read_photo
from warp_partdr.inputs.person import connected, crop_keypoints, crop_nearest, crop_size, person_crop, select_person

NAN, INF = math.nan, math.inf
PHOTOS = ("000000032081", "000000203864", "000000468632")

# Left half of a standing person facing the camera, 1 unit tall: x to the picture's right, y down from the head's top.
HALF = {
    "eye": (0.02, 0.065),
    "ear": (0.045, 0.07),
    "shoulder": (0.1, 0.19),
    "elbow": (0.13, 0.34),
    "wrist": (0.15, 0.48),
    "hip": (0.06, 0.46),
    "knee": (0.07, 0.7),
    "ankle": (0.08, 0.947),
}
STANDING = {
    "nose": (0.0, 0.08),
    **{f"left_{name}": point for name, point in HALF.items()},
    **{f"right_{name}": (-x, y) for name, (x, y) in HALF.items()},
}


def rows(count: int, width: int = 3) -> list[list[float]]:
    """Distinct keypoints of confidence 0.5."""
    return [[10.0 + 3 * k, 20.0 + 5 * k, 0.5][:width] for k in range(count)]


def flat(values: list[list[float]]) -> list[float]:
    return [value for row in values for value in row]


def standing(x: float = 100, y: float = 10, height: float = 200) -> Keypoints2D:
    """COCO keypoints of the standing person, head's top at (x, y)."""
    points = [STANDING[name] for name in SKELETONS["coco17"].landmarks]
    return Keypoints2D("coco17", (np.array(points) * height + [x, y]).astype(np.float32), np.ones(17, dtype=np.float32))


def paint(keypoints: Keypoints2D, size: tuple[int, int], thickness: float = 0.04) -> np.ndarray:
    """Labels 1 (legs) and 2 (the rest) within ``thickness`` of the person's height from the bones."""
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    groups = np.zeros(size, dtype=np.uint8)
    for start, end in SKELETONS[keypoints.skeleton].edges:
        a, b = keypoints.points[start], keypoints.points[end]
        t = np.clip(((u - a[0]) * (b - a)[0] + (v - a[1]) * (b - a)[1]) / ((b - a) @ (b - a)), 0, 1)
        near = np.hypot(u - a[0] - t * (b - a)[0], v - a[1] - t * (b - a)[1]) < thickness * person_height(keypoints)
        groups[near] = 1 if "ankle" in SKELETONS[keypoints.skeleton].landmarks[end] else 2
    return groups


def write(path: Path, data: Any) -> Path:
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


# --- keypoints ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(SKELETONS))
@pytest.mark.parametrize("width", [2, 3])
@pytest.mark.parametrize("shape", ["object", "flat", "list", "bare"])
def test_every_format_reads_back(name: str, width: int, shape: str, tmp_path: Path) -> None:
    values = rows(len(SKELETONS[name]), width)
    data: Any = {"format": name, "keypoints": flat(values) if shape == "flat" else values}
    if shape == "list":
        data = [data]
    path = write(tmp_path / "k.json", values if shape == "bare" else data)
    (keypoints,) = read_keypoints(path, name if shape == "bare" and name == "h36m17" else None)
    assert keypoints.skeleton == name
    assert keypoints.points.dtype == keypoints.confidence.dtype == np.float32
    np.testing.assert_allclose(keypoints.points, np.array(values)[:, :2])
    np.testing.assert_allclose(keypoints.confidence, 0.5 if width == 3 else 1.0)
    # What the format has in common with another survives the way there and back.
    there = convert(keypoints.points, name, "body25")
    back = convert(there, "body25", name)
    shared = ~np.isnan(back[:, 0])
    assert shared.sum() >= 12
    np.testing.assert_array_equal(back[shared], keypoints.points[shared])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("BlazePose33 x,y,visibility px", "blazepose33"),
        ("MediaPipe", "blazepose33"),
        ("BODY_25", "body25"),
        ("OpenPose BODY_25", "body25"),
        ("COCO-17", "coco17"),
        ("Human3.6M", "h36m17"),
        ("Human3.6M 17", "h36m17"),
        ("LSP", "lsp14"),
        ("mpii", "mpii16"),
    ],
)
def test_spellings_of_formats(text: str, name: str) -> None:
    values = rows(len(SKELETONS[name]))
    assert parse_keypoints({"format": text, "keypoints": values})[0].skeleton == name
    assert parse_keypoints(values, text)[0].skeleton == name


def test_openpose_json() -> None:
    first, second = rows(25), [[x + 100, y, 0.9] for x, y, _ in rows(25)]
    second[3] = [0, 0, 0]
    data = {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": flat(p)} for p in (first, second)]}
    people = parse_keypoints(data)
    assert [person.skeleton for person in people] == ["body25", "body25"]
    np.testing.assert_allclose(people[1].points[2], second[2][:2])
    assert np.flatnonzero(~people[1].visible).tolist() == [3]


def test_coco_json() -> None:
    values = [[10 + k, 20 + 2 * k, k % 3] for k in range(17)]
    annotation = {"image_id": 5, "category_id": 1, "num_keypoints": 11, "keypoints": flat(values)}
    for data in (annotation, [annotation], {"images": [], "annotations": [annotation, annotation]}):
        keypoints = parse_keypoints(data)[0]
        assert keypoints.skeleton == "coco17"
        assert keypoints.confidence[:4].tolist() == [0.0, 0.5, 1.0, 0.0]
    with pytest.raises(InputError, match="people of 2 pictures; expected those of one"):
        parse_keypoints([annotation, annotation | {"image_id": 6}])


def test_mmpose_json() -> None:
    instance = {"keypoints": rows(17, 2), "keypoint_scores": [0.25] * 16 + [1.2]}
    for data in ([instance, instance], {"instances": [instance, instance]}):
        people = parse_keypoints(data)
        assert len(people) == 2
        assert people[0].confidence[[0, 16]].tolist() == [0.25, 1.0]


def test_lists_of_several_people() -> None:
    assert len(parse_keypoints([rows(17), rows(17)])) == 2
    assert len(parse_keypoints([flat(rows(17)), flat(rows(17)), flat(rows(17))])) == 3
    assert len(parse_keypoints({"format": "h36m17", "keypoints": [rows(17), rows(17)]})) == 2
    people = parse_keypoints([rows(17), [[0, 0, 0]] * 17])
    assert len(people) == 1  # Who has no visible keypoint is left out.


def test_missing_keypoints() -> None:
    values: list[Any] = rows(17)
    values[1:6] = [[NAN, NAN, 0], [5, 5, 0], [None, None, None], [NAN, NAN, NAN], None]
    (keypoints,) = parse_keypoints(values)
    assert np.flatnonzero(~keypoints.visible).tolist() == [1, 2, 3, 4, 5]
    assert not keypoints.points[1:6].any()
    pairs: list[Any] = rows(17, 2)
    pairs[1:4] = [[0, 0], [None, None], [NAN, NAN]]
    assert np.flatnonzero(~parse_keypoints(pairs)[0].visible).tolist() == [1, 2, 3]


def changed(joint: int, row: Any) -> list[Any]:
    values: list[Any] = rows(17)
    values[joint] = row
    return values


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("3", "int; expected an object or a list of keypoints"),
        ("[]", "nobody in it; expected keypoints of at least one person"),
        ({"people": []}, "nobody in it; expected keypoints of at least one person"),
        ({"people": [3]}, "person 0: int; expected an object or a list"),
        ({}, "no list of keypoints; expected one under keypoints or pose_keypoints_2d"),
        ({"keypoints": "abc"}, "no list of keypoints; expected one under"),
        ({"format": "dance", "keypoints": rows(17)}, "format: 'dance'; expected one of coco17, body25"),
        ({"format": "lsp14", "keypoints": rows(17)}, "17 keypoints; expected 14 of lsp14"),
        ({"format": "lsp14", "keypoints": flat(rows(17))}, "51 numbers; expected 3 (x, y, confidence) or 2 a keypoint"),
        (rows(18), "18 keypoints; expected 14 (lsp14), 16 (mpii16), 17 (coco17)"),
        (
            {"people": [{"pose_keypoints_2d": flat(rows(18))}]},
            "54 numbers; expected 3 (x, y, confidence) or 2 a keypoint",
        ),
        ([[1, 2, 3, 4]] * 17, "4 numbers; expected 3 (x, y, confidence) or 2"),
        ({"keypoints": [[1], *rows(16)]}, "rows of 1 or 3 numbers; expected [x, y] or [x, y, confidence] each"),
        ({"keypoints": [*rows(16), 5]}, "rows of 3 numbers; expected [x, y]"),
        ({"keypoints": rows(17, 2), "keypoint_scores": [1.0]}, "keypoint_scores: not one a keypoint; expected 17"),
        (changed(4, [1, NAN, 0.5]), "keypoint 4 (right_ear): [1, nan, 0.5]; expected finite numbers"),
        (changed(4, [INF, 1, 0.5]), "keypoint 4 (right_ear): [inf, 1, 0.5]; expected finite numbers"),
        (changed(4, [3, 1, NAN]), "keypoint 4 (right_ear): [3, 1, nan]; expected finite numbers"),
        (changed(4, [10**400, 1, 1]), "keypoint 4 (right_ear): [inf, 1, 1]; expected finite numbers"),
        (changed(4, [1e300, 1, 1]), "keypoint 4 (right_ear): [1e+300, 1]; expected pixels, up to 1e+06"),
        ([rows(17), changed(4, [1, -1e30, 1])], "person 1: keypoint 4 (right_ear): [1, -1e+30]; expected pixels"),
        (changed(4, ["1", 1, 1]), "keypoint 4 (right_ear): '1'; expected numbers"),
        (changed(4, [True, 1, 1]), "keypoint 4 (right_ear): True; expected numbers"),
        (changed(0, [1, 1, 37.5]), "keypoint 0 (nose): confidence 37.5; expected 0 to 1"),
        (changed(0, [1, 1, -1]), "keypoint 0 (nose): confidence -1; expected 0 to 1"),
        ([[5, 6, 0]] * 17, "no visible keypoint; expected some with confidence above 0"),
        ([[0, 0]] * 17, "no visible keypoint; expected some with confidence above 0"),
        ([[[5, 6, 0]] * 17] * 2, "person 0: no visible keypoint"),
        ([[5, 6, 1]] * 17, "all visible keypoints in one point (5, 6); expected a person"),
        ([[5, 6, 1]] + [[0, 0, 0]] * 16, "all visible keypoints in one point (5, 6); expected a person"),
        ([[k / 17, 0.5, 1] for k in range(17)], "all keypoints between 0 and 1; expected pixels, not shares"),
    ],
)
def test_bad_keypoint_files(data: Any, message: str, tmp_path: Path) -> None:
    path = write(tmp_path / "bad.json", data)
    with pytest.raises(InputError) as raised:
        read_keypoints(path)
    error = str(raised.value)
    assert error.startswith(str(path))
    assert message in error
    assert "\n" not in error


def test_unreadable_keypoint_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json: No such file or directory; expected keypoints in JSON"):
        read_keypoints(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"Is a directory; expected keypoints in JSON"):
        read_keypoints(tmp_path)
    (tmp_path / "binary.json").write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match=r"binary\.json: not JSON"):
        read_keypoints(tmp_path / "binary.json")
    with pytest.raises(InputError, match=r"keypoint format: 'dance'; expected one of coco17"):
        read_keypoints(write(tmp_path / "k.json", rows(17)), "dance")


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["people", "keypoints", "format", "annotations", "keypoint_scores"]), inner)
    ),
    max_leaves=20,
)


@given(JSON_VALUES)
def test_any_json_is_read_or_refused(data: Any) -> None:
    try:
        people = parse_keypoints(data)
    except InputError:
        return
    assert all(np.isfinite(person.points).all() for person in people)


@pytest.mark.parametrize("name", PHOTOS)
def test_keypoints_of_the_shared_photos(name: str, shared: Path) -> None:
    (keypoints,) = read_keypoints(shared / f"data/people/{name}.keypoints.json")
    assert keypoints.skeleton == "blazepose33"
    assert keypoints.visible.all()
    assert 250 < person_height(keypoints) < 400


# --- the person's height, and which person -----------------------------------------------------------------------


def test_person_height() -> None:
    keypoints = standing(height=200)
    assert person_height(keypoints) == pytest.approx(200, rel=0.03)
    seated = keypoints.points.copy()
    seated[13:15] = seated[11:13] + np.array([0, 5])  # Thighs toward the camera.
    seated[15:17] = seated[13:15] + np.array([0, 0.247 * 200])
    assert person_height(Keypoints2D("coco17", seated, keypoints.confidence)) == pytest.approx(200, rel=0.06)
    arms = np.zeros(17, dtype=np.float32)
    arms[[5, 7, 9]] = 1
    assert person_height(Keypoints2D("coco17", keypoints.points, arms)) == pytest.approx(200, rel=0.06)
    face = np.zeros(17, dtype=np.float32)
    face[:5] = 1
    assert person_height(Keypoints2D("coco17", keypoints.points, face)) == pytest.approx(0.09 * 200, rel=0.01)


def test_choose_person() -> None:
    small, large = standing(30, 10, 60), standing(100, 10, 150)
    faint = Keypoints2D("coco17", large.points + 200, large.confidence / 10)
    people = [small, large, faint]
    assert choose_person(people) is large
    assert choose_person(people, index=2) is faint
    assert choose_person([small]) is small
    only_small = paint(small, (200, 200))
    assert choose_person(people, only_small) is small
    for index in (3, -1):
        with pytest.raises(InputError, match=f"person: {index}; expected an integer from 0 to 2"):
            choose_person(people, index=index)
    with pytest.raises(InputError, match="keypoints: nobody; expected at least one person"):
        choose_person([])


# --- part labels -------------------------------------------------------------------------------------------------

PALETTE = [value for k in range(256) for value in (k, 255 - k, (7 * k) % 256)]


def label_picture() -> np.ndarray:
    picture = np.zeros((12, 16), dtype=np.uint8)
    picture[2:6, 4:9] = 2
    picture[6:11, 4:6] = 9
    picture[0, 0] = 255
    return picture


def save_palette(path: Path, picture: np.ndarray) -> None:
    image = Image.fromarray(picture, mode="L").convert("L")
    image = image.convert("P")
    image.putdata(picture.ravel().tolist())
    image.putpalette(PALETTE)
    image.save(path)


def save_16_bit(path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture.astype(np.uint16)).save(path)


@pytest.mark.parametrize(
    ("name", "save"),
    [
        ("gray.png", lambda path, picture: Image.fromarray(picture).save(path)),
        ("palette.png", save_palette),
        ("deep.png", save_16_bit),
        ("LABELS.PNG", lambda path, picture: Image.fromarray(picture).save(path, "PNG")),
        ("bytes.npy", np.save),
        ("longs.npy", lambda path, picture: np.save(path, picture.astype(np.int64))),
        ("fortran.npy", lambda path, picture: np.save(path, np.asfortranarray(picture))),
    ],
)
def test_label_files(name: str, save: Callable[[Path, np.ndarray], None], tmp_path: Path) -> None:
    save(tmp_path / name, label_picture())
    parts = read_parts(tmp_path / name, read_label_set("cdcl14"))
    expected = label_picture()
    expected[expected == 9] = parts.label_set.group_names.index("right_upper_leg") + 1
    np.testing.assert_array_equal(parts.groups, expected)
    assert parts.groups.dtype == np.uint8
    assert parts.maps is None


@pytest.mark.parametrize("mode", ["1", "L"])
def test_silhouettes(mode: str, tmp_path: Path) -> None:
    mask = label_picture() % 255 > 0
    Image.fromarray((mask * 255).astype(np.uint8)).convert(mode).save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_parts(tmp_path / "mask.png", read_label_set("full1")).groups, mask)


@pytest.mark.parametrize("layout", [(0, 1, 2), (1, 2, 0)])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_probability_maps(layout: tuple[int, int, int], dtype: type, tmp_path: Path, rng: np.random.Generator) -> None:
    logits = rng.normal(size=(20, 12, 16)) * 3
    probabilities = (np.exp(logits) / np.exp(logits).sum(axis=0)).astype(dtype)
    np.save(tmp_path / "soft.npy", probabilities.transpose(layout))
    labels = read_label_set("lip20")
    parts = read_parts(tmp_path / "soft.npy", labels)
    assert parts.maps is not None
    assert parts.maps.dtype == np.float32
    np.testing.assert_array_equal(parts.maps, labels.to_group_maps(probabilities.astype(np.float32)))
    ignored = 1 - parts.maps.sum(axis=0)
    np.testing.assert_array_equal(parts.groups == IGNORE, ignored > parts.maps.max(axis=0))
    sure = parts.groups != IGNORE
    np.testing.assert_array_equal(parts.groups[sure], parts.maps.argmax(axis=0)[sure])


def with_value(value: int) -> np.ndarray:
    picture = label_picture()
    picture[3, 3] = value
    return picture


def one_part(picture: np.ndarray) -> np.ndarray:
    return (picture > 0).astype(np.uint8) * 2


def soft(channels: int = 15, scale: float = 1.0) -> np.ndarray:
    return np.full((channels, 4, 5), scale / channels, dtype=np.float32)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (with_value(15), "labels: ids 15 not in cdcl14; expected 0 to 14 (255 = ignore)"),
        (with_value(0).astype(np.int16) - 1, "labels: ids -1, 254 not in cdcl14; expected 0 to 14"),
        (np.zeros((4, 5), dtype=np.uint8), "empty, no pixel of a body part; expected a person in the labels of cdcl14"),
        (np.full((4, 5), 255, dtype=np.uint8), "empty, no pixel of a body part"),
        (one_part(label_picture()), "one part only (torso); expected several of cdcl14, or the label set full1"),
        (np.full((4, 5), 1, dtype=np.uint8), "one part only (head); expected several"),
        (np.zeros((0, 5), dtype=np.uint8), "shape (0, 5); expected pixels"),
        (np.zeros(5, dtype=np.uint8), "shape (5,); expected (H, W), or (K, H, W) probabilities"),
        (np.zeros((2, 3, 4, 5), dtype=np.uint8), "shape (2, 3, 4, 5); expected (H, W)"),
        (np.zeros((4, 5), dtype=np.float32), "labels: float32; expected integers"),
        (np.zeros((4, 5), dtype=np.complex64), "complex64; expected integers, or probabilities"),
        (np.zeros((4, 5), dtype="U3"), "<U3; expected integers, or probabilities"),
        (np.zeros((4, 5, 3), dtype=np.uint8), "uint8 of shape (4, 5, 3); expected (H, W) ids, or float probabilities"),
        (soft(14), "shape (14, 4, 5); expected (15, H, W) or (H, W, 15), one map per id of cdcl14"),
        (soft() * NAN, "values from nan to nan; expected probabilities, 0 to 1"),
        (soft() - 1, "values from -0.933333 to -0.933333; expected probabilities"),
        (soft(scale=7.5), "class probabilities add up to 7.5 to 7.5; expected 1 at each pixel"),
        (np.array([[None, {}]]), "holds pickled Python objects, which could run code"),
    ],
)
def test_bad_label_arrays(array: np.ndarray, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(InputError) as raised:
        read_parts(path, read_label_set("cdcl14"))
    error = str(raised.value)
    assert error.startswith(str(path))
    assert message in error
    assert "\n" not in error


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA"])
def test_coloured_labels(mode: str, tmp_path: Path) -> None:
    path = tmp_path / "colours.png"
    Image.fromarray(label_picture()).convert(mode).save(path)
    with pytest.raises(InputError, match=rf"colours\.png: {mode} picture; expected one channel of label ids"):
        read_parts(path, read_label_set("cdcl14"))


@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_unreadable_label_files(suffix: str, tmp_path: Path) -> None:
    labels = read_label_set("cdcl14")
    path = tmp_path / f"parts{suffix}"
    with pytest.raises(InputError, match=rf"parts\{suffix}: No such file or directory; expected a"):
        read_parts(path, labels)
    path.write_bytes(b"not at all")
    with pytest.raises(InputError, match=rf"parts\{suffix}: .*; expected a"):
        read_parts(path, labels)
    picture = np.random.default_rng(0).integers(0, 15, (64, 64)).astype(np.uint8)
    Image.fromarray(picture).save(path) if suffix == ".png" else np.save(path, picture)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=rf"parts\{suffix}: .*; expected a"):
        read_parts(path, labels)


def test_other_label_files_and_sets(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"parts\.jpg: \.jpg; expected \.png or \.npy part labels"):
        read_parts(tmp_path / "parts.jpg", read_label_set("cdcl14"))
    with pytest.raises(InputError, match=r"labels: 'cdcl'; expected one of .*cdcl14"):
        read_label_set("cdcl")


def test_photo_and_sizes(tmp_path: Path) -> None:
    image = Image.new("RGB", (6, 4), (1, 2, 3))
    exif = image.getexif()
    exif[0x0112] = 6  # Held upright, stored lying.
    image.save(tmp_path / "photo.jpg", exif=exif)
    photo = read_photo(tmp_path / "photo.jpg")
    assert photo.shape == (6, 4, 3)
    assert photo.dtype == np.uint8
    check_sizes(photo=(480, 640), parts=(480, 640))
    check_sizes(photo=None, parts=(480, 640))
    with pytest.raises(InputError, match=r"^photo: 640x480; parts: 320x240; expected one size$"):
        check_sizes(photo=(480, 640), parts=(240, 320))
    (tmp_path / "photo.jpg").write_text("no")
    with pytest.raises(InputError, match=r"photo\.jpg: cannot identify image file .*; expected a picture"):
        read_photo(tmp_path / "photo.jpg")
    with pytest.raises(InputError, match=r"none\.jpg: No such file or directory; expected a picture"):
        read_photo(tmp_path / "none.jpg")


# --- one person out of a picture ---------------------------------------------------------------------------------


def test_select_person_ignores_others_and_blobs() -> None:
    me, other = standing(100), standing(300)
    size = (230, 400)
    mine = paint(me, size)
    groups = mine + paint(other, size)
    groups[100:104, 20:24] = 1  # A stray blob, near me but not part of me.
    groups[5, 200] = IGNORE
    selected = select_person(groups, me)
    assert selected.dtype == np.uint8
    np.testing.assert_array_equal(selected[mine > 0], mine[mine > 0])
    np.testing.assert_array_equal(selected == 0, groups == 0)
    assert (selected[(groups > 0) & (mine == 0)] == IGNORE).all()
    np.testing.assert_array_equal(select_person(selected, me), selected)


def test_select_person_keeps_loose_limbs_along_the_bones() -> None:
    me = standing(100)
    mine = paint(me, (230, 200))
    cut = mine.copy()
    cut[158:166] = 0  # No label at the knees: shins and feet hang on nothing.
    np.testing.assert_array_equal(select_person(cut, me), cut)


def test_select_person_where_people_touch() -> None:
    me, other = standing(100), standing(146)
    size = (230, 300)
    mine, theirs = paint(me, size), paint(other, size)
    groups = np.maximum(mine, theirs)
    far = paint(standing(246), size)  # A row of people hand in hand.
    groups[105, 60:290] = 2
    groups = np.maximum(groups, far)
    alone = select_person(groups, me)
    assert (alone[(far > 0) & (theirs == 0)] == IGNORE).all()
    assert (alone[(mine > 0)] == groups[mine > 0]).all()
    told = select_person(groups, me, others=[other])
    assert (told[:, 146:][groups[:, 146:] > 0] == IGNORE).all()
    assert (told[:, :108][mine[:, :108] > 0] != IGNORE).all()


def test_select_person_with_missing_keypoints() -> None:
    me = standing(100)
    mine = paint(me, (230, 200))
    for missing in ([13, 15], [9], list(range(5)), [7, 9, 8, 10], [0, 1, 2, 3, 4, 13, 14, 15, 16]):
        confidence = me.confidence.copy()
        confidence[missing] = 0
        points = me.points.copy()
        points[missing] = 0
        np.testing.assert_array_equal(select_person(mine, Keypoints2D("coco17", points, confidence)), mine)


def test_select_person_cut_off_by_the_border() -> None:
    me = standing(5, -60)
    mine = paint(me, (100, 60))
    assert 0 < (mine > 0).sum() < mine.size
    np.testing.assert_array_equal(select_person(mine, me), mine)


def test_select_person_without_labels_on_the_bones() -> None:
    groups = np.zeros((230, 400), dtype=np.uint8)
    groups[100:140, 300:340] = 1
    for keypoints in (standing(100), standing(5000), standing(-5000)):
        with pytest.raises(InputError, match="keypoints: no labelled pixel along the person's bones; expected"):
            select_person(groups, keypoints)


@pytest.mark.parametrize("name", PHOTOS)
def test_select_person_on_the_shared_photos(name: str, shared: Path) -> None:
    folder = shared / "data/people"
    (keypoints,) = read_keypoints(folder / f"{name}.keypoints.json")
    parts = read_parts(folder / f"{name}.parts.png", read_label_set("cdcl14"))
    check_sizes(photo=read_photo(folder / f"{name}.jpg").shape[:2], parts=parts.groups.shape)
    selected = select_person(parts.groups, keypoints)
    kept = (selected > 0) & (selected < IGNORE)
    # Counted by eye: nothing of the lone player is lost; of the others, about these shares are the main person's.
    share = kept.sum() / (parts.groups > 0).sum()
    assert share == pytest.approx({"000000032081": 1.0, "000000203864": 0.722, "000000468632": 0.379}[name], abs=0.005)
    x0, y0, x1, y1 = person_crop(keypoints, selected)
    assert kept[max(y0, 0) : y1, max(x0, 0) : x1].sum() == kept.sum()
    assert 0.9 < (y1 - y0) / person_height(keypoints) < 1.5


@given(seed=st.integers(0, 10**6), density=st.floats(0.05, 0.95))
def test_connected_pixels(seed: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    mask, seeds = rng.random((9, 13)) < density, rng.random((9, 13)) < 0.03
    reached = seeds & mask
    while True:
        padded = np.pad(reached, 1)
        grown = mask & np.any(
            [padded[1 + dv : 10 + dv, 1 + du : 14 + du] for dv in (-1, 0, 1) for du in (-1, 0, 1)], axis=0
        )
        if (grown == reached).all():
            break
        reached = grown
    np.testing.assert_array_equal(connected(mask, seeds), reached)


# --- crops -------------------------------------------------------------------------------------------------------


def test_person_crop_covers_labels_and_keypoints() -> None:
    me = standing(100)
    groups = paint(me, (230, 200))
    groups[:, 190:] = IGNORE  # Somebody else.
    x0, y0, x1, y1 = person_crop(me, groups, margin=0.1)
    rows_, columns = np.nonzero(groups % IGNORE)
    extent = rows_.max() + 1 - rows_.min()
    assert y0 == pytest.approx(rows_.min() - 0.1 * extent, abs=1)
    assert y1 == pytest.approx(rows_.max() + 1 + 0.1 * extent, abs=1)
    assert x0 == pytest.approx(columns.min() - 0.1 * extent, abs=1)
    assert x1 == pytest.approx(columns.max() + 1 + 0.1 * extent, abs=1)
    assert person_crop(me, np.zeros((230, 200), dtype=np.uint8), margin=0.0)[1] == math.floor(me.points[:, 1].min())


def test_crop_beyond_the_picture_is_ignored() -> None:
    groups = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(crop_nearest(groups, (0, 0, 4, 3), (3, 4)), groups)
    beyond = crop_nearest(groups, (-1, -2, 5, 4), (6, 6))
    np.testing.assert_array_equal(beyond[2:5, 1:5], groups)
    assert (beyond == IGNORE).sum() == 36 - 12
    maps = crop_nearest(np.ones((2, 3, 4), dtype=np.float32), (-4, 0, 4, 3), (3, 8), fill=0)
    assert maps.shape == (2, 3, 8)
    assert maps.sum() == 24
    assert (crop_nearest(groups, (100, 100, 104, 103), (3, 4)) == IGNORE).all()
    np.testing.assert_array_equal(crop_nearest(groups, (0, 0, 4, 3), (6, 8)), groups.repeat(2, 0).repeat(2, 1))
    assert crop_nearest(groups, (0, 0, 4, 3), (1, 1)).item() == groups[1, 2]  # The one at the box's centre.


@given(
    x0=st.floats(-50, 50),
    y0=st.floats(-50, 50),
    width=st.floats(1, 300),
    height=st.floats(1, 300),
    longest=st.integers(1, 300),
)
def test_crop_size_has_square_pixels(x0: float, y0: float, width: float, height: float, longest: int) -> None:
    box, size = crop_size((x0, y0, x0 + width, y0 + height), longest)
    assert max(size) == longest
    assert (box[2] - box[0]) / size[1] == pytest.approx((box[3] - box[1]) / size[0], rel=1e-9)
    assert box[0] <= x0 + 1e-3
    assert box[3] >= y0 + height - 1e-3


def test_keypoints_and_labels_crop_alike() -> None:
    me = standing(100)
    me.confidence[3], me.points[3] = 0, 0
    groups = np.zeros((230, 200), dtype=np.uint8)
    for joint, (x, y) in enumerate(me.points):
        groups[int(y), int(x)] = joint + 1
    box, size = crop_size((20, -30, 180, 240), 540)  # Twice as large.
    cropped = crop_keypoints(me, box, size)
    labels = crop_nearest(groups, box, size)
    seen = [int(labels[int(y), int(x)]) - 1 for x, y in cropped.points[cropped.visible]]
    assert seen == [joint for joint in range(17) if joint != 3]
    assert not cropped.points[3].any()
    assert person_height(cropped) == pytest.approx(2 * person_height(me), rel=1e-5)


def test_importing_inputs_loads_no_picture_library() -> None:
    import subprocess
    import sys

    code = "import warp_partdr.inputs, sys; sys.exit(bool({'PIL', 'torch', 'pyvista'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=HANG).returncode == 0
