"""``partdr export``: files of single rows are those of the fit; rows are named by shard, by count, or as the worst."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers import commands
from helpers.commands import Run
from helpers.datasets import write_coco, write_folder
from helpers.people_rows import body_row, write_shards
from PIL import Image

from warp_partdr.bulk import people
from warp_partdr.bulk.export import WRITERS, folder_name
from warp_partdr.bulk.reading import Address, PeopleFiles
from warp_partdr.cli.dataset_files import FormatName
from warp_partdr.errors import InputError
from warp_partdr.results.body_file import load_body
from warp_partdr.results.further_files import FURTHER
from warp_partdr.results.result_sets import check_result
from warp_partdr.results.save import save_fit, save_registered
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.mesh_stage import MeshFit

pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
# USD needs an extra, FBX Blender.
ALL = " ".join(f"--to {name}" for name in WRITERS if name not in FURTHER)


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Fits, as the data set's rows were made of them, in their order: of one thread."""
    seen: list[Any] = []
    describe = people.describe_bodies

    def noted(some: Any) -> Any:
        seen.extend(some)
        return describe(some)

    monkeypatch.setattr(people, "describe_bodies", noted)
    monkeypatch.setattr(people.PeopleFitter, "workers", 1)
    return seen


def arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as data:
        return dict(data)


def assert_same_arrays(one: Path, other: Path, besides: str = "") -> None:
    """The arrays agree to the precision of float32."""
    first, second = arrays(one), arrays(other)
    assert first.keys() == second.keys()
    first.pop(besides, None)
    for name, values in first.items():
        assert (values.dtype, values.shape) == (second[name].dtype, second[name].shape), name
        if values.dtype.kind == "U":
            assert (values == second[name]).all(), name
        else:
            np.testing.assert_allclose(values, second[name], rtol=3e-6, atol=3e-7, err_msg=name)


def assert_same_meshes(one: Path, other: Path) -> None:
    first, second = (trimesh.load_scene(path, process=False) for path in (one, other))
    assert list(first.geometry) == list(second.geometry)
    for name, mesh in first.geometry.items():
        np.testing.assert_allclose(mesh.vertices, second.geometry[name].vertices, atol=2e-6)
        assert (mesh.faces == second.geometry[name].faces).all()


@pytest.mark.parametrize("camera", ["", "--fov 40"])
def test_ellipsoids_come_back(camera: str, run: Run, fits: list[FitResult]) -> None:
    """Each row gives the body of its fit."""
    write_coco(Path("coco"), count=2)
    assert run(f"dataset coco/people.json --shard 1 --quality fast --device cpu --out people {camera}")[0] == 0
    code, said, complaint = run("export people --rows 0: --to glb --to npz --to json --out out")
    assert (code, said, complaint) == (0, "2 people written to out\n", "")
    for shard, fit in enumerate(fits):
        save_fit(fit, "fit")
        own = Path("out", folder_name(Address(shard, 0)))
        assert {path.name for path in own.iterdir()} == {"body.npz", "body.json", "ellipbody.glb", "report.json"}
        with Image.open(f"coco/00{shard}.jpg") as photo:
            assert load_body(own / "body.npz").image_size.tolist() == [photo.height, photo.width]
        assert_same_arrays(own / "body.npz", Path("fit/body.npz"), besides="image_size")  # this fit has no picture
        assert_same_meshes(own / "ellipbody.glb", Path("fit/ellipbody.glb"))
        one, other = (json.loads((folder / "body.json").read_text()) for folder in (own, Path("fit")))
        assert one["camera"].pop("model") == other["camera"].pop("model")
        for name, numbers in other["camera"].items():
            assert one["camera"][name] == pytest.approx(numbers, abs=0.0011), name
        assert one["measurements_cm"] == pytest.approx(other["measurements_cm"], abs=0.011)
        np.testing.assert_allclose(one["joints"]["points_m"], other["joints"]["points_m"], atol=1.1e-4)
        np.testing.assert_allclose(one["joints"]["pixels"], other["joints"]["pixels"], atol=0.011)
        check_result(own / "body.npz")


def test_detailed_bodies_come_back(run: Run, fits: list[MeshFit], monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(Path("photos"))
    Path("photos/more/two.png").unlink()
    assert run("dataset photos --quality mesh --device cpu --out people")[0] == 0
    assert run(f"export people --rows 0/1 {ALL} --out out")[0] == 0
    (fit,) = fits
    save_registered(fit.body, "fit", fit.camera, (256, 168), clothes=fit.clothes)
    own = Path("out/00000-000001")
    assert_same_arrays(own / "detailed.npz", Path("fit/detailed.npz"))
    for name in ("detailed.glb", "detailed.obj"):
        assert_same_meshes(own / name, Path("fit", name))
    if find_spec("pxr") is not None:
        assert run("export people --rows 0/1 --to usda --out usd")[0] == 0
        assert Path("usd/00000-000001/detailed.usda").read_text().startswith("#usda")
    monkeypatch.setenv("PATH", "")
    code, _, said = run("export people --rows 0/1 --to fbx --out fbx")
    assert (code, "--to: fbx: no command 'blender'" in said, Path("fbx").exists()) == (2, True, False)
    report = json.loads((own / "report.json").read_text())
    assert (report["row"], report["picture"], report["person"]) == ("0/1", "b_one.png", 0)
    assert report["made"]["options"]["quality"] == "mesh"
    assert "expected that of the data set: anny" in run("export people --rows 0/1 --model notes.npz")[2]


def write_people() -> PeopleFiles:
    first = [body_row(f"{index}.png", keypoint_error=0.01 * index) for index in range(3)]
    second = [{"picture": "3.png", "people": 0}, body_row("4.png", keypoint_error=0.5)]
    third = [{"picture": "5.png", "error": "5.png: broken"}]
    write_shards(Path("people"), [first, second, third])
    return PeopleFiles.open(Path("people"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1/0", {1: [0]}),
        ("2/0, 0/2,0/1,0/2", {0: [1, 2], 2: [0]}),
        ("2:4", {0: [2], 1: [0]}),
        (":", {0: [0, 1, 2], 1: [0, 1], 2: [0]}),
        ("3:100", {1: [0, 1], 2: [0]}),
        (":1,1/1", {0: [0], 1: [1]}),
    ],
)
def test_rows_are_named(text: str, expected: dict[int, list[int]]) -> None:
    files = write_people()
    assert files.select(text) == expected
    found = [
        (address, row["picture"]) for shard, places in expected.items() for address, row in files.rows(shard, places)
    ]
    names = iter(range(6))
    pictures = {(shard, row): f"{next(names)}.png" for shard, count in enumerate((3, 2, 1)) for row in range(count)}
    assert dict(found) == {address: pictures[address] for address, _ in found}
    assert len(found) == sum(map(len, expected.values()))


@pytest.mark.parametrize("text", ["3", "0/3", "7/0", "6:9", "2:2", "3:1", "-1:2", "a/b", "", "0/1;0/2"])
def test_other_names_are_refused(text: str) -> None:
    files = write_people()
    with pytest.raises(InputError, match="expected"):
        files.select(text)


def test_rows_without_a_body_are_left_out(run: Run) -> None:
    write_people()
    code, said, complaint = run("export people --rows 2: --out out")
    assert (code, said) == (0, "2 people written to out\n")
    assert complaint == "partdr: warning: 2 without a body, first 1/0 (nobody in it)\n"
    assert sorted(path.name for path in Path("out").iterdir()) == ["00000-000002", "00001-000001"]
    assert "no body in rows such as 2/0 (5.png: broken)" in run("export people --rows 2/0 --out out")[2]


def test_the_worst_are_written(run: Run) -> None:
    write_people()
    assert run("export people --worst 2 --by keypoint_error --to json --out out")[0] == 0
    assert sorted(path.name for path in Path("out").iterdir()) == ["00000-000002", "00001-000001"]


def test_a_later_export_replaces_an_earlier_one(run: Run) -> None:
    write_people()
    run("export people --rows 0/1 --to npz --to glb --out out")
    run("export people --rows 0/1 --to json --out out")
    assert {path.name for path in Path("out/00000-000001").iterdir()} == {"body.json", "report.json"}


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("export people", "--rows: missing; expected one of both"),
        ("export people --rows 0/1 --worst 2", "--worst: with --rows; expected one of both"),
        ("export people --rows 0/1 --to obj", "--to: obj: rows hold ellipsoids alone; expected glb, npz or json"),
        ("export people --rows 0/1 --to stl", "--to"),
        ("export people --rows 0/1 --model anny", "--model: anny; expected none"),
        ("export people --rows 0/1 --out people/out", "--out: people/out, in the data set"),
        ("export people --rows 0/0", "rotations: matrix"),
    ],
)
def test_faults_are_one_line(line: str, says: str, run: Run) -> None:
    write_shards(Path("people"), [[body_row("0.png", rotations=np.ones((20, 3, 3))), body_row("1.png")]])
    code, said, complaint = run(line)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert says in complaint
    assert not Path("out").exists()


def test_formats_are_those_that_can_be_written() -> None:
    assert [each.value for each in FormatName] == list(WRITERS)
