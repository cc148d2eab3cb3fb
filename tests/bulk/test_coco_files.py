"""COCO files of other tools and later hands as data sets: sizes, names of keypoints, ids, and annotations at fault."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import commands
from helpers.commands import Run
from helpers.datasets import rows, write_coco
from helpers.shards import members, write_beside, write_tar
from PIL import ExifTags, Image

from warp_partdr.body.skeletons import SKELETONS, describe_skeleton, skeleton
from warp_partdr.bulk.coco import CocoPictures
from warp_partdr.bulk.opening import open_source
from warp_partdr.bulk.rows import PeopleRows, RowPart, columns, people_table
from warp_partdr.errors import InputError

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
LINE = "dataset coco/people.json --quality network --device cpu"
COCO = list(SKELETONS["coco17"].landmarks)
TURNS = {  # of the upright picture to the stored one, by EXIF's orientation
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


def coco(change: Callable[[dict[str, Any]], None] | None = None, count: int = 1, **changes: Any) -> CocoPictures:
    """Pictures of ``write_coco``, whose file is changed."""
    path = write_coco(Path("coco"), count=count, **changes)
    data = json.loads(path.read_text())
    for image in data["images"]:
        with Image.open(Path("coco") / image["file_name"]) as picture:
            image |= {"width": picture.width, "height": picture.height}
    if change is not None:
        change(data)
    path.write_text(json.dumps(data))
    source = open_source(path)
    assert isinstance(source, CocoPictures)
    return source


def move(data: dict[str, Any], points: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move all keypoints, boxes and polygons by a function of points (N, 2)."""
    for entry in data["annotations"]:
        numbers = np.array(entry["keypoints"], dtype=float).reshape(-1, 3)
        numbers[:, :2] = points(numbers[:, :2])
        entry["keypoints"] = numbers.ravel().tolist()
        left, top, width, height = entry["bbox"]
        corners = points(np.array([[left, top], [left + width, top + height]]))
        entry["bbox"] = [*corners.min(axis=0), *np.ptp(corners, axis=0)]
        entry["segmentation"] = [points(np.reshape(each, (-1, 2))).ravel().tolist() for each in entry["segmentation"]]


def run_lengths(mask: np.ndarray) -> dict[str, Any]:
    edges = np.flatnonzero(np.diff(mask.T.ravel().astype(int))) + 1
    return {"size": [*mask.shape], "counts": np.diff([0, *edges, mask.size]).tolist()}


def turn_file(name: str, orientation: int, ending: str = "png") -> tuple[int, int]:
    """Store a picture turned, with EXIF data that turn it upright again; (H, W) as it is stored."""
    with Image.open(Path("coco") / name) as image:
        stored = image.transpose(TURNS[orientation])
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    stored.save(Path("coco") / name, ending, exif=exif)
    return stored.height, stored.width


def stored_points(points: np.ndarray, orientation: int, size: tuple[int, int]) -> np.ndarray:
    """Points of an upright picture (H, W) where it is stored turned."""
    x, y, right, below = points[:, 0], points[:, 1], size[1] - points[:, 0], size[0] - points[:, 1]
    return np.stack(
        {
            2: (right, y), 3: (right, below), 4: (x, below), 5: (y, x), 6: (y, right), 7: (below, right), 8: (below, x)
        }[orientation],
        axis=-1,
    )  # fmt: skip


def test_annotations_of_a_larger_picture_are_scaled() -> None:
    plain = coco().read("000.jpg")
    (expected,) = plain.people

    def enlarge(data: dict[str, Any]) -> None:
        move(data, lambda points: 3 * points)
        for side in ("width", "height"):
            data["images"][0][side] *= 3

    seen = coco(enlarge).read("000.jpg")
    (person,) = seen.people
    np.testing.assert_allclose(person.keypoints.points, expected.keypoints.points, atol=1e-4)
    np.testing.assert_allclose(person.box, expected.box, atol=1e-4)
    np.testing.assert_array_equal(seen.owners, plain.owners)
    height, width = seen.size
    told = f"annotations: made at {3 * width} x {3 * height} px, scaled to the picture's {width} x {height}"
    assert (expected.warnings, person.warnings) == ((), (told,))

    def enlarge_runs(data: dict[str, Any]) -> None:
        enlarge(data)
        mask = np.kron(plain.owners.numpy(), np.ones((3, 3), dtype=int)) > 0
        data["annotations"][0]["segmentation"] = run_lengths(mask)

    np.testing.assert_array_equal(coco(enlarge_runs).read("000.jpg").owners, plain.owners)

    def runs_of_the_picture(data: dict[str, Any]) -> None:
        enlarge(data)
        data["annotations"][0]["segmentation"] = run_lengths(plain.owners.numpy() > 0)

    np.testing.assert_array_equal(coco(runs_of_the_picture).read("000.jpg").owners, plain.owners)


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_annotations_of_the_stored_picture_are_turned(orientation: int) -> None:
    plain = coco().read("000.jpg")

    def turn(data: dict[str, Any]) -> None:
        move(data, lambda points: stored_points(points, orientation, plain.size))
        height, width = turn_file("000.jpg", orientation)
        data["images"][0] |= {"width": width, "height": height}

    seen = coco(turn).read("000.jpg")
    assert seen.size == plain.size
    (person,), (expected,) = seen.people, plain.people
    np.testing.assert_allclose(person.keypoints.points, expected.keypoints.points, atol=1e-4)
    np.testing.assert_allclose(person.box, expected.box, atol=1e-4)
    assert (np.asarray(seen.owners) != np.asarray(plain.owners)).mean() < 0.02  # a polygon's border
    assert f"turned by its EXIF orientation {orientation} to the picture's" in person.warnings[0]

    def upright(data: dict[str, Any]) -> None:
        turn_file("000.jpg", orientation)

    (person,) = coco(upright).read("000.jpg").people
    np.testing.assert_allclose(person.keypoints.points, expected.keypoints.points, atol=1e-4)
    assert person.warnings == ()

    def runs(data: dict[str, Any]) -> None:
        turn(data)
        with Image.fromarray(plain.owners.numpy().astype(np.uint8)) as mask:
            stored = np.asarray(mask.transpose(TURNS[orientation]))
        data["annotations"][0]["segmentation"] = run_lengths(stored > 0)

    np.testing.assert_array_equal(coco(runs).read("000.jpg").owners, plain.owners)


@pytest.mark.parametrize("orientation", [2, 3, 4])
def test_a_turn_that_the_size_does_not_show_is_a_warning(orientation: int) -> None:
    def turn(data: dict[str, Any]) -> None:
        turn_file("000.jpg", orientation)

    (person,) = coco(turn).read("000.jpg").people
    assert f"turned by its EXIF orientation {orientation}, and no size tells" in person.warnings[0]


def test_sizes_are_told_in_rows_and_at_the_end(run: Run) -> None:
    """One picture is as annotated, one is scaled, and nothing explains the size of the third."""
    coco(count=3)
    assert run(f"{LINE} --out plain")[0] == 0

    def change(data: dict[str, Any]) -> None:
        one, other, third = data["images"]
        for side in ("width", "height"):
            one[side] *= 2
            del other[side]
        entry = data["annotations"][0]
        entry["keypoints"] = [
            number * 2 if place % 3 < 2 else number for place, number in enumerate(entry["keypoints"])
        ]
        entry["bbox"] = [2 * number for number in entry["bbox"]]
        entry["segmentation"] = [[2 * number for number in entry["segmentation"][0]]]
        third["width"] += 40

    coco(change, count=3)
    code, _, complaint = run(f"{LINE} --out out")
    assert code == 0
    scaled, silent, wrong = rows("out")
    before = rows("plain")
    np.testing.assert_allclose(scaled["joints_2d"], before[0]["joints_2d"], atol=0.05)
    np.testing.assert_allclose(scaled["box"], before[0]["box"], atol=1e-3)
    assert scaled["warnings"][0].startswith("annotations: made at ")
    assert scaled["warnings"][1:] == before[0]["warnings"]
    assert silent["warnings"] == before[1]["warnings"]
    height, width = wrong["height"] or 128, before[2]["width"]
    assert wrong["joints"] is None
    assert wrong["error"].startswith(f"002.jpg: annotated at {width + 40} x {height} px, picture {width} x {height}")
    assert "warning: 1 row with an error, first 002.jpg: annotated at " in complaint
    assert "warning: 1 row with a warning about annotations, first 000.jpg: annotations: made at " in complaint


def test_warnings_of_the_input_and_of_the_fit_are_joined() -> None:
    given = PeopleRows.of([{"picture": "a", "file_warnings": ["one"], "warnings": []}, {"picture": "b"}])
    given.parts.append(RowPart(np.array([0, 1]), {"warnings": [["two", "three"], ["four"]], "picture": ["c", "d"]}))
    found = people_table(given, columns("coco17"), {}).to_pylist()
    assert [row["warnings"] for row in found] == [["one", "two", "three"], ["four"]]
    assert [row["picture"] for row in found] == ["c", "d"]


def with_names(names: list[str], order: list[int], category: str = "person") -> Callable[[dict[str, Any]], None]:
    """Keypoints in another order, and their names in a category."""

    def change(data: dict[str, Any]) -> None:
        data["categories"] = [{"id": 1, "name": category, "keypoints": names}]
        for entry in data["annotations"]:
            numbers = np.reshape(entry["keypoints"], (-1, 3))
            entry["keypoints"] = numbers[order].ravel().tolist()

    return change


def test_names_decide_the_joints() -> None:
    (expected,) = coco().read("000.jpg").people
    order = [16, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 0, 15]
    names = [COCO[place].replace("_", " ").title() for place in order]
    source = coco(with_names(names, order))
    (person,) = source.read("000.jpg").people
    assert (source.skeleton, person.keypoints.skeleton, source.warnings) == ("coco17", "coco17", ())
    np.testing.assert_array_equal(person.keypoints.points, expected.keypoints.points)
    np.testing.assert_array_equal(person.keypoints.confidence, expected.keypoints.confidence)


def test_names_that_are_no_landmarks_are_left_out(run: Run) -> None:
    """The rows have the file's own skeleton, and the report draws it."""
    order = [0, 1, 2, *range(5, 17)]
    names = ["nose", "spine", "navel", *COCO[5:]]  # no known format has both nose and spine
    source = coco(with_names(names, order), count=2)
    assert len(skeleton(source.skeleton)) == 14
    assert source.warnings == ("coco/people.json: keypoints: navel left out; expected names of landmarks of the body",)
    code, _, complaint = run(f"{LINE} --out out")
    assert code == 0
    assert complaint.count("navel left out") == 1
    table = pq.read_table("out")
    field = table.schema.field("keypoints").metadata
    landmarks = json.loads(field[b"names"])
    assert sorted(landmarks) == sorted(["nose", "spine", *COCO[5:]])
    (expected,) = coco().read("000.jpg").people
    found = np.reshape(table["keypoints"][0].as_py(), (-1, 3))
    for landmark, row in zip(landmarks, found, strict=True):
        place = 1 if landmark == "spine" else COCO.index(landmark)
        np.testing.assert_allclose(row[:2], expected.keypoints.points[place], atol=1e-3)
    assert run("report out --pictures coco/people.json --worst 1 --out page.html")[0] == 0
    assert b"navel" not in Path("page.html").read_bytes()


@pytest.mark.parametrize(
    "form", [*SKELETONS, {"name": "mine", "landmarks": ["nose", "coco_left_hip", "coco_right_hip"]}]
)
def test_a_skeleton_is_told_in_json(form: Any) -> None:
    own = skeleton(form)
    again = skeleton(json.loads(json.dumps(describe_skeleton(own))))
    assert (again.name, again.landmarks, again.marks) == (own.name, own.landmarks, own.marks)
    assert (describe_skeleton(own) == own.name) == isinstance(form, str)
    with pytest.raises(InputError, match="skeleton: point 0: 'knee'; expected null or one of"):
        skeleton({"landmarks": ["knee"]})


def test_other_categories_are_left_out_and_counted(run: Run) -> None:
    def change(data: dict[str, Any]) -> None:
        data["categories"] = [
            {"id": "1", "name": "person", "keypoints": COCO},
            {"id": 2, "name": "dog", "keypoints": ["nose", "tail"]},
        ]
        data["annotations"][1]["category_id"] = 2
        del data["annotations"][2]["category_id"]  # one category of people is there

    source = coco(change, count=3)
    assert [len(source.read(name).people) for name in source.names] == [1, 0, 1]
    (told,) = source.warnings
    assert told == (
        "coco/people.json: category 'dog'; expected keypoints of people, not of animals; 1 of 3 annotations of such "
        "categories left out"
    )

    def all_dogs(data: dict[str, Any]) -> None:
        change(data)
        for entry in data["annotations"]:
            entry["category_id"] = 2

    with pytest.raises(InputError, match="category 'dog'; expected keypoints of people, not of animals"):
        coco(all_dogs, count=3)
    code, _, complaint = run(f"{LINE} --out out")
    assert (code, complaint.count("\n")) == (2, 1)
    with pytest.raises(InputError, match="not of animals"):
        open_source(Path("coco/people.json"), keypoint_format="coco17")


def test_annotations_without_a_category_have_the_only_one() -> None:
    """This also holds for annotations with the id of another."""
    order = [*range(16, -1, -1)]
    change = with_names([COCO[place] for place in order], order)
    (expected,) = coco().read("000.jpg").people
    for category in (None, 0, "x", [1]):
        (person,) = coco(change, category_id=category).read("000.jpg").people
        np.testing.assert_array_equal(person.keypoints.points, expected.keypoints.points)


def test_the_smaller_of_two_masks_is_in_front() -> None:
    for sides in ((60, 20), (20, 60)):

        def change(data: dict[str, Any], sides: tuple[int, int] = sides) -> None:
            data["annotations"].append({**data["annotations"][0], "id": 101})
            for entry, side in zip(data["annotations"], sides, strict=True):
                entry["segmentation"] = [[10, 10, 10 + side, 10, 10 + side, 10 + side, 10, 10 + side]]

        owners = coco(change).read("000.jpg").owners
        assert owners is not None
        front = 1 + int(np.argmin(sides))
        assert owners[20, 20] == front
        assert owners[50, 50] == 3 - front


def test_people_of_two_skeletons_are_both_fitted() -> None:
    def change(data: dict[str, Any]) -> None:
        data["categories"] = [
            {"id": 1, "name": "person", "keypoints": COCO},
            {"id": 2, "name": "person without a face", "keypoints": COCO[5:]},
        ]
        entry = data["annotations"][0]
        entry["category_id"], entry["keypoints"] = 2, entry["keypoints"][15:]

    source = coco(change, count=3)
    assert source.skeleton == "coco17"
    (told,) = source.warnings
    assert told.endswith(
        "1 of 3 annotations have other keypoints than most; the column keypoints holds what coco17 has"
    )
    (person,) = source.read("000.jpg").people
    assert int(person.keypoints.visible.sum()) == 12
    assert not {"nose", "left_eye"} & set(person.keypoints.format.landmarks)
    assert source.read("000.jpg").faults == ()


def test_ids_are_compared_as_numbers() -> None:
    def change(data: dict[str, Any]) -> None:
        data["images"][0]["id"] = "10"
        data["annotations"][1]["image_id"] = "0011"
        data["annotations"][2]["image_id"] = 12.0
        data["annotations"][2]["id"] = "102"
        data["annotations"][3]["image_id"] = data["images"][3]["file_name"]
        data["annotations"][3]["id"] = "abc"
        del data["annotations"][4]["id"]
        data["annotations"][5]["id"] = 2**70

    source = coco(change, count=6)
    assert source.warnings == ()
    people = [source.read(name).people for name in source.names]
    assert [[each.annotation for each in some] for some in people] == [[100], [101], [102], [None], [None], [None]]


def test_orphans_are_counted(run: Run) -> None:
    def change(data: dict[str, Any]) -> None:
        data["annotations"][1]["image_id"] = 999
        data["annotations"] += [None, {"id": 7}, {"image_id": [10]}, {"image_id": True}, {"image_id": float("nan")}]

    source = coco(change, count=2)
    (told,) = source.warnings
    assert told.startswith("coco/people.json: 6 of 7 annotations left out, first annotations: {")
    assert told.endswith("; expected the image_id of one of the images")
    code, _, complaint = run(f"{LINE} --out out")
    assert code == 0
    assert f"partdr: warning: {told}\n" in complaint
    first, second = rows("out")
    assert first["joints"] is not None
    assert (second["people"], second["person"], second["error"]) == (0, None, None)


def test_pictures_may_be_listed_twice_but_no_id_is_of_two() -> None:
    def twice(data: dict[str, Any]) -> None:
        data["images"] += [dict(data["images"][0]), {**data["images"][0], "id": 77}, {"id": 5}, "none"]
        data["annotations"].append({**data["annotations"][0], "image_id": 77, "id": 8})

    source = coco(twice)
    assert source.names == ("000.jpg",)
    assert [each.annotation for each in source.read("000.jpg").people] == [100, 8]
    assert source.warnings == ("coco/people.json: 2 of 5 images left out, first {'id': 5}; expected id and file_name",)

    def of_two(data: dict[str, Any]) -> None:
        data["images"].append({"id": "10", "file_name": "other.jpg"})

    with pytest.raises(
        InputError, match=r"images: id '10' is of '000.jpg' and of 'other.jpg'; expected one picture an"
    ):
        coco(of_two)
    with pytest.raises(InputError, match=r"images: {'id': 10}; expected id and file_name"):
        coco(lambda data: data["images"].__setitem__(0, {"id": 10}))


def test_optional_entries_may_be_missing() -> None:
    def change(data: dict[str, Any]) -> None:
        entry = data["annotations"][0]
        for key in ("category_id", "id", "bbox", "segmentation"):
            del entry[key]
        entry |= {"score": None}
        data["annotations"][1] |= {"bbox": [0, 0, 0, 0], "segmentation": [], "score": 0.25, "iscrowd": 0}

    source = coco(change, count=2)
    (first,), (second,) = (source.read(name).people for name in source.names)
    assert (first.score, second.score) == (1.0, 0.25)
    for person in (first, second):
        low, high = (end(person.keypoints.points[person.keypoints.visible], axis=0) for end in (np.min, np.max))
        assert person.box == (*low, *high)
    assert source.read("000.jpg").owners is None


def test_annotations_without_keypoints_are_counted() -> None:
    def change(data: dict[str, Any]) -> None:
        entries = data["annotations"]
        entries[0]["keypoints"] = [0] * 51
        del entries[1]["keypoints"]
        entries[2]["keypoints"] = []
        entries[3]["keypoints"] = [[30 + x, 40, 0] for x in range(17)]
        entries[4]["keypoints"] = [number for x in range(17) for number in (30 + x, 40, 0)]

    source = coco(change, count=6)
    assert source.warnings == ("coco/people.json: 5 of 6 annotations without visible keypoints left out",)
    assert [len(source.read(name).people) for name in source.names] == [0, 0, 0, 0, 0, 1]
    assert not any(source.read(name).faults for name in source.names)


def test_keypoints_may_be_rows_or_pairs() -> None:
    def change(data: dict[str, Any]) -> None:
        for entry, width in zip(data["annotations"], (3, 2), strict=True):
            given = np.reshape(entry["keypoints"], (-1, 3))[:, :width]
            entry["keypoints"] = given.tolist() if width == 3 else given.ravel().tolist()

    (expected,) = coco().read("000.jpg").people
    source = coco(change, count=2)
    for index, name in enumerate(source.names):
        (person,) = source.read(name).people
        np.testing.assert_allclose(person.keypoints.points - [index, 0], expected.keypoints.points, atol=1e-4)


def test_results_are_one_line(run: Run) -> None:
    Path("results.json").write_text(json.dumps([{"image_id": 3, "keypoints": [1, 2, 1] * 17, "score": 0.5}]))
    code, said, complaint = run("dataset results.json --out out --device cpu")
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert "results.json: a list of results, without the names of their pictures; expected COCO's annot" in complaint


def test_results_may_name_their_pictures() -> None:
    """AlphaPose's results do."""
    data = json.loads(write_coco(Path("coco"), count=2).read_text())
    (expected,) = open_source(Path("coco/people.json")).read("001.jpg").people or ()
    names = {image["id"]: image["file_name"] for image in data["images"]}
    results = [
        {"image_id": names[entry["image_id"]], "category_id": 1, "keypoints": entry["keypoints"], "score": 2.5}
        for entry in data["annotations"]
    ]
    Path("coco/results.json").write_text(json.dumps([*results, results[1]]))
    source = open_source(Path("coco/results.json"))
    assert source.names == ("000.jpg", "001.jpg")
    first, second = source.read("001.jpg").people or ()
    assert first.score == second.score == 2.5
    np.testing.assert_array_equal(first.keypoints.points, expected.keypoints.points)


FAULTS = [
    ({"keypoints": [1.0, 2.0, 2]}, "annotation 100: 3 numbers; expected 3 (x, y, confidence)"),
    ({"keypoints": "none"}, "annotation 100: no list of keypoints"),
    ({"keypoints": [[1, 2, "x"]] * 17}, "annotation 100: keypoint 0 (nose): 'x'; expected numbers"),
    ({"bbox": [1, 2]}, "annotation 100: bbox: [1, 2]; expected four numbers"),
    ({"bbox": [1, 2, float("nan"), 4]}, "annotation 100: bbox: [1, 2, nan, 4]; expected pixels"),
    ({"bbox": [1, 2, 10**400, 4]}, "expected four numbers"),
    ({"score": 10**400}, "expected a number"),
    ({"score": "high"}, "annotation 100: score: 'high'; expected a number"),
    ({"score": float("inf")}, "annotation 100: score: inf; expected a number"),
    ({"segmentation": [[1, 2, 3, 4]]}, "annotation 100: segmentation: [1, 2, 3, 4]; expected polygons"),
    ({"segmentation": [[1, 2, 3, 4, 5, None]]}, "segmentation: [1, 2, 3, 4, 5, None]; expected polygons"),
    ({"segmentation": [[1, 2, 3, 4, 5, 1e30]]}, "segmentation: [1, 2, 3, 4, 5, 1e+30]; expected polygons"),
    (
        {"segmentation": {"size": [30, 30], "counts": [900]}},
        "segmentation: size [30, 30]; expected the picture's, [128",
    ),
    ({"segmentation": {"size": "x", "counts": [900]}}, "segmentation: size 'x'; expected the picture's, [128"),
    ({"segmentation": {"size": [128, 97], "counts": [3]}}, "counts: [3]; expected run lengths of 12416 pixels"),
]


@pytest.mark.parametrize(("wrong", "says"), FAULTS)
def test_one_bad_annotation_loses_nobody_else(wrong: dict[str, Any], says: str) -> None:
    def change(data: dict[str, Any]) -> None:
        data["annotations"].append({**data["annotations"][0], "id": 101})
        data["annotations"][0] |= wrong

    seen = coco(change).read("000.jpg")
    assert [each.annotation for each in seen.people] == [101]
    (fault,) = seen.faults
    assert fault.annotation == 100
    assert says in fault.error
    assert fault.error.startswith("000.jpg: annotation 100: ")
    bad_mask = "segmentation" in wrong
    assert (seen.owners is None) == bad_mask
    masks_are_left_out = "annotations: not everyone in the picture has a mask; masks are left out"
    assert seen.people[0].warnings == ((masks_are_left_out,) if bad_mask else ())


def test_a_bad_annotation_is_a_row_beside_the_others(run: Run) -> None:
    def change(data: dict[str, Any]) -> None:
        data["annotations"].append({**data["annotations"][0], "id": 201, "bbox": "none"})
        data["annotations"].append({**data["annotations"][1], "id": 202, "keypoints": [3.0] * 4})
        data["annotations"].append({**data["annotations"][1], "id": 203})

    coco(change, count=2)
    code, _, complaint = run(f"{LINE} --out out")
    assert code == 0
    assert "warning: 2 rows with an error, first 000.jpg: annotation 201: bbox: 'none'; expected" in complaint
    found = rows("out")
    told = [tuple(row[name] for name in ("picture", "person", "people", "annotation")) for row in found]
    assert told == [
        ("000.jpg", 0, 2, 100),
        ("000.jpg", 1, 2, 201),
        ("001.jpg", 0, 3, 101),
        ("001.jpg", 1, 3, 203),
        ("001.jpg", 2, 3, 202),
    ]
    assert [row["joints"] is not None for row in found] == [True, False, True, True, False]
    assert [row["error"] is None for row in found] == [True, False, True, True, False]
    assert (found[1]["height"], found[1]["box"]) == (128, None)


def test_masks_of_people_without_keypoints_are_others() -> None:
    """Their pixels are nobody's background."""

    def change(data: dict[str, Any]) -> None:
        small = [5, 5, 9, 5, 9, 9, 5, 9]
        data["annotations"].insert(0, {"id": 9, "image_id": 10, "keypoints": [0] * 51, "segmentation": small})

    seen = coco(change).read("000.jpg")
    owners = seen.owners.numpy()
    assert (len(seen.people), np.unique(owners).tolist()) == (1, [0, 1, 2])
    assert (owners[5:10, 5:10] == 2).all()
    assert (owners == 2).sum() == 25


def test_masks_that_some_lack_are_left_out_with_a_word() -> None:
    def change(data: dict[str, Any]) -> None:
        data["annotations"].append({**data["annotations"][0], "id": 101, "segmentation": None})

    seen = coco(change).read("000.jpg")
    assert seen.owners is None
    assert [each.warnings for each in seen.people] == [
        ("annotations: not everyone in the picture has a mask; masks are left out",)
    ] * 2


def test_the_format_may_be_said(run: Run) -> None:
    """COCO files, keypoints beside pictures and those in tar files take it; shards remember it."""
    points = [float(number) for number in range(1, 29)]
    source = open_source(write_coco(Path("coco"), 1), keypoint_format="coco17")
    assert source.skeleton == "coco17"

    def fourteen(data: dict[str, Any]) -> None:
        names = ["navel", "sternum"]
        data["categories"] = [{"id": 1, "name": "person", "keypoints": names}]
        data["annotations"][0]["keypoints"] = [each for pair in np.reshape(points, (-1, 2)) for each in (*pair, 2)]

    with pytest.raises(InputError, match="0 of 2 keypoint names are landmarks of a person"):
        coco(fourteen)
    source = open_source(Path("coco/people.json"), keypoint_format="crowdpose14")
    (person,) = source.read("000.jpg").people
    assert source.skeleton == person.keypoints.skeleton == "crowdpose14"
    Path("mine.json").write_text(json.dumps({"landmarks": [*COCO[5:], None, None]}))
    source = open_source(Path("coco/people.json"), keypoint_format="mine.json")
    (person,) = source.read("000.jpg").people
    np.testing.assert_array_equal(person.keypoints.points[0], [1.0, 2.0])
    assert person.keypoints.format.landmarks == tuple(COCO[5:])

    files = members("000", parts=False)
    files["000.keypoints.json"] = json.dumps([[*pair, 1] for pair in np.reshape(points, (-1, 2)).tolist()]).encode()
    write_beside(Path("folder"), files)
    for form in ("crowdpose14", "mine.json"):
        source = open_source(Path("folder"), keypoint_format=form)
        (person,) = source.read("000.jpg").people
        assert person.keypoints.format.landmarks == skeleton(form).landmarks
        assert skeleton(source.skeleton).landmarks == skeleton(form).landmarks
    line = "dataset folder --quality network --device cpu --out out"
    assert run(f"{line} --format aic14")[0] == 0
    assert pickle.loads(pickle.dumps(source)) == source
    code, _, complaint = run(f"{line} --format crowdpose14")
    assert code == 2
    assert "made with format aic14, not crowdpose14; expected the same options" in complaint
    assert "made with format aic14, not None" in run(line)[2]
    assert "keypoint format: 'coco19'; expected one of" in run(f"{line} --format coco19")[2]
    Path("folder/000.keypoints.json").unlink()
    assert (
        "--format: crowdpose14, without keypoints; expected N.keypoints.json beside N.jpg"
        in (run(f"{line} --format crowdpose14")[2])
    )


def test_keypoints_beside_a_picture_are_scaled_with_it(run: Run) -> None:
    """The scale comes from the size that their file states, such as a COCO file of one picture."""
    files = members("000", parts=False)
    given = json.loads(files["000.keypoints.json"])["keypoints"]
    write_beside(Path("folder"), files)
    (before,) = open_source(Path("folder")).read("000.jpg").people or ()
    with Image.open("folder/000.jpg") as picture:
        size = picture.size
    flat = [number for x, y, _ in given for number in (2 * x, 2 * y, 2)]
    data = {
        "images": [{"id": 1, "file_name": "000.jpg", "width": 2 * size[0], "height": 2 * size[1]}],
        "annotations": [{"image_id": 1, "keypoints": flat}],
    }
    files["000.keypoints.json"] = json.dumps(data).encode()
    write_beside(Path("folder"), files)
    (person,) = open_source(Path("folder")).read("000.jpg").people or ()
    np.testing.assert_allclose(person.keypoints.points, before.keypoints.points, atol=1e-3)
    assert any("made at " in warning for warning in person.keypoints.warnings)
    code, _, complaint = run("dataset folder --quality network --device cpu --out out")
    assert code == 0
    assert "warning: 1 row with a warning about annotations, first 000.jpg: keypoints: made at " in complaint
    (row,) = rows("out")
    assert sum("made at " in warning for warning in row["warnings"]) == 1
    pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")
    write_tar(Path("a.tar"), files)
    (person,) = open_source(Path("a.tar")).read("a.tar#000.jpg").people or ()
    np.testing.assert_allclose(person.keypoints.points, before.keypoints.points, atol=1e-3)


def test_the_format_of_keypoints_in_tar_files_may_be_said() -> None:
    pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")
    files = members("000", parts=False)
    numbers = [[10.0 + place, 20.0 + place, 1] for place in range(14)]
    files["000.keypoints.json"] = json.dumps(numbers).encode()
    write_tar(Path("a.tar"), files)
    for form in ("crowdpose14", "lsp14"):
        source = open_source(Path("a.tar"), keypoint_format=form)
        (person,) = source.read("a.tar#000.jpg").people
        assert source.skeleton == person.keypoints.skeleton == form


def test_scores_names_and_sizes_of_other_programs_count() -> None:
    """They count in data sets as they do in ``partdr fit``."""
    plain = coco().read("000.jpg").people[0].keypoints

    def rewrite(data: dict[str, Any]) -> None:
        numbers = np.array(data["annotations"][0]["keypoints"], dtype=float).reshape(-1, 3)[::-1]
        data["annotations"][0]["keypoints"] = (2 * numbers[:, :2]).tolist()
        data["annotations"][0]["keypoint_scores"] = [0.0, 0.0, *[0.5] * 15]
        data["annotations"][0]["scores"] = []
        image = data["images"][0]
        image |= {"image_width": 2 * image.pop("width"), "image_height": 2 * image.pop("height")}
        data["joints_name"] = COCO[::-1]

    (person,) = coco(rewrite).read("000.jpg").people
    assert person.keypoints.confidence.tolist() == [0.5] * 15 + [0.0, 0.0]
    there = person.keypoints.visible & plain.visible
    np.testing.assert_allclose(person.keypoints.points[there], plain.points[there], atol=1e-4)
    assert "scaled" in person.warnings[0]


def test_annotations_of_no_category_have_the_names_that_categories_share() -> None:
    plain = coco().read("000.jpg").people[0].keypoints

    def rewrite(data: dict[str, Any], orders: list[list[str]]) -> None:
        numbers = np.array(data["annotations"][0]["keypoints"]).reshape(-1, 3)[::-1]
        data["annotations"][0] |= {"keypoints": numbers.ravel().tolist(), "category_id": 9}
        data["categories"] = [{"id": n, "name": f"woman {n}", "keypoints": names} for n, names in enumerate(orders)]

    source = coco(lambda data: rewrite(data, [COCO[::-1], COCO[::-1]]))
    np.testing.assert_array_equal(source.read("000.jpg").people[0].keypoints.points, plain.points)
    assert source.warnings == ()
    source = coco(lambda data: rewrite(data, [COCO[::-1], COCO]))
    assert "of none of the categories 'woman 0', 'woman 1', whose orders differ" in source.warnings[0]


def test_whole_bodies_are_joined_and_paths_of_windows_found() -> None:
    def rewrite(data: dict[str, Any]) -> None:
        data["annotations"][0]["foot_kpts"] = [30, 40, 2] * 6
        Path("coco/sub").mkdir(exist_ok=True)
        (Path("coco") / "000.jpg").rename("coco/sub/a.jpg")
        data["images"][0]["file_name"] = "D:\\shoot\\sub\\a.jpg"

    source = coco(rewrite)
    assert source.names == ("sub/a.jpg",)
    (person,) = source.read("sub/a.jpg").people
    assert person.keypoints.skeleton == "wholebody133"
    toe = person.keypoints.format.landmarks.index("left_big_toe")
    assert (person.keypoints.points[toe].tolist(), person.keypoints.confidence[toe]) == ([30, 40], 1)


def test_annotations_outside_their_picture_are_told() -> None:
    source = coco(lambda data: move(data, lambda points: points + 5000))
    (person,) = source.read("000.jpg").people
    assert any("confident ones lie outside the picture" in told for told in person.keypoints.warnings)


@pytest.mark.parametrize("orientation", [3, 6])
def test_keypoints_in_tar_files_are_turned_as_those_in_folders(orientation: int) -> None:
    """They are turned by the photo's EXIF data. If the file has many pictures' people, those of the photo are read."""
    coco()
    height, width = turn_file("000.jpg", orientation, "jpeg")
    points = np.array([[30 + k, 20 + 2 * k] for k in range(17)], dtype=float)
    image = {"id": 1, "file_name": "a.jpg", "width": width, "height": height}
    flat = np.column_stack([points, np.full(17, 2.0)]).ravel().tolist()
    annotations = [{"image_id": 1, "keypoints": flat}, {"image_id": 2, "keypoints": [9.0] * 51}]
    data = {"images": [image, {"id": 2, "file_name": "b.jpg"}], "annotations": annotations}
    files = {"a.jpg": Path("coco/000.jpg").read_bytes(), "a.keypoints.json": json.dumps(data).encode()}
    write_tar(Path("all/a.tar"), files)
    write_beside(Path("plain"), files)
    (packed,) = open_source(Path("all")).read("a.tar#a.jpg").people
    (plain,) = open_source(Path("plain")).read("a.jpg").people
    np.testing.assert_array_equal(packed.keypoints.points, plain.keypoints.points)
    assert packed.keypoints.warnings == plain.keypoints.warnings
    assert "EXIF orientation" in packed.keypoints.warnings[0]
