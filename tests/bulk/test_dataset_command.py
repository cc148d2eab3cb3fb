"""``partdr dataset``: rows of all pictures, read without this package; nothing lost and nothing twice when it ends."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import HANG
from helpers import commands
from helpers.commands import Run
from helpers.datasets import rows, write_coco, write_folder

from warp_partdr import FitOptions
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.bulk import batches, people
from warp_partdr.bulk import run as bulk_run
from warp_partdr.bulk.rows import columns
from warp_partdr.errors import InputError
from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.interop import precision
from warp_partdr.models.anny import anny
from warp_partdr.pipelines.photo import fit_photo
from warp_partdr.solve.mesh.mesh_options import MeshOptions

pa = pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
COCO = "dataset coco/people.json --quality network --shard 2 --device cpu"
FOLDER = "dataset photos --device cpu"


def parts(folder: str) -> list[str]:
    return sorted(path.name for path in Path(folder).iterdir())


def arrays(table: Any, name: str) -> np.ndarray:
    """A column as arrays, by what its metadata say."""
    column = table[name].combine_chunks().drop_null()
    shape = json.loads(table.schema.field(name).metadata[b"shape"])
    return column.flatten().to_numpy().reshape(-1, *shape)


def test_every_picture_has_its_rows(run: Run) -> None:
    write_folder(Path("photos"))
    code, said, complaint = run(f"{FOLDER} --out out --shard 3 --quality fast --focal none")
    assert code == 0
    assert re.match(r"3 people in 4 pictures; [\d.]+ people, [\d.]+ pictures a second, cpu\n", said)
    assert said.endswith("out has 2 of 2 shards\n")
    assert "warning: 1 row with an error, first c_broken.jpg: " in complaint
    assert parts("out") == ["part-00000-of-00002.parquet", "part-00001-of-00002.parquet"]
    found = rows("out")
    names = ["a_empty.png", "b_one.png", "c_broken.jpg", "more/two.png", "more/two.png"]
    assert [row["picture"] for row in found] == names
    assert [row["person"] for row in found] == [None, 0, None, 0, 1]
    assert [row["people"] for row in found] == [0, 1, None, 2, 2]
    assert [row["error"] is None for row in found] == [True, True, False, True, True]
    assert [row["joints"] is None for row in found] == [True, False, True, False, False]
    assert (found[0]["height"], found[0]["width"]) == (120, 160)
    assert all(0.5 < row["score"] <= 1 for row in found if row["person"] is not None)
    assert all(0 < row["keypoint_error"] < 0.05 and row["energy"] > 0 for row in found if row["joints"])

    table = pq.read_table("out")
    table = table.filter(table["person"].is_valid())
    joints, pixels, boxes = (arrays(table, name) for name in ("joints", "joints_2d", "box"))
    scale = np.array(table["camera_scale"])[:, None, None]
    np.testing.assert_allclose(
        pixels, joints[..., :2] * scale + arrays(table, "camera_translation")[:, None], atol=1e-2
    )
    wrists = pixels[:, json.loads(table.schema.field("joints").metadata[b"names"]).index("left_wrist")]
    assert ((wrists > boxes[:, :2] - 5) & (wrists < boxes[:, 2:] + 5)).all()
    names = "global_orient", "translation", "rotations", "lengths", "thicknesses"
    body = EllipBody.from_numpy(**{name: arrays(table, name) for name in names}, device="cpu")
    np.testing.assert_allclose(body.pose().joints.numpy(), joints, atol=1e-4)


def test_rows_are_those_of_single_fits(run: Run) -> None:
    """The mesh stage is part of it, in a batch as alone. Single fits are in float32, with no guessed camera."""
    write_folder(Path("photos"))
    assert run(f"{FOLDER} --out out --quality mesh --batch 2 --set half=false --set mesh.iterations=20")[0] == 0
    table = pq.read_table("out")
    table = table.filter(table["person"].is_valid())
    few = MeshOptions(iterations=20)  # more steps multiply what a batch rounds otherwise
    options = replace(FitOptions.at("balanced"), mesh=few, landmarks="full")
    alone = fit_photo(read_photo("photos/more/two.png"), options=options).fits
    for row, place in ((1, 0), (2, 1)):
        assert table["person"][row].as_py() == place
        expected = alone[place]
        np.testing.assert_allclose(arrays(table, "joints")[row], expected.ellipbody.posed.joints[0], atol=5e-3)
        np.testing.assert_allclose(arrays(table, "mesh_shape")[row], expected.body.shape[0], atol=0.05)
        np.testing.assert_allclose(arrays(table, "mesh_rotations")[row], expected.body.rotations[0], atol=0.05)
    assert np.array(table["stature"]) == pytest.approx(1.68, abs=0.15)


def test_settings_change_the_fits_and_are_remembered(run: Run) -> None:
    write_folder(Path("photos"))
    assert run(f"{FOLDER} --out out --quality network")[0] == 0
    assert run(f"{FOLDER} --out alone --quality network --set mirror=false")[0] == 0
    plain, alone = (arrays(pq.read_table(folder), "joints") for folder in ("out", "alone"))
    assert 1e-4 < np.abs(plain - alone).max() < 0.3
    metadata = pq.read_schema("alone/" + parts("alone")[0]).metadata
    assert any(b'"settings": {"mirror": false}' in value for value in metadata.values())
    code, _, complaint = run(f"{FOLDER} --out alone --quality network")
    assert code != 0
    assert "settings" in complaint


@pytest.mark.parametrize("quick", [False, True])
def test_bfloat16_is_taken_where_it_is_quick_and_told(quick: bool, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(Path("photos"))
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda device: quick)
    told = {}
    for name, setting in (("out", ""), ("true", "--set half=true"), ("false", "--set half=false")):
        assert run(f"{FOLDER} --out {name} --quality network {setting}")[0] == 0
        told[name] = json.loads(pq.read_schema(f"{name}/{parts(name)[0]}").metadata[b"warp-partdr"])["options"]
    assert (told["true"]["half"], told["false"]["half"]) == (True, False)
    assert told["out"] == told[str(quick).lower()]
    joints = {name: arrays(pq.read_table(name), "joints") for name in told}
    np.testing.assert_array_equal(joints["out"], joints[str(quick).lower()])
    assert 0 < np.abs(joints["true"] - joints["false"]).max() < 0.02
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda device: not quick)
    code, _, complaint = run(f"{FOLDER} --out out --quality network")  # as of another machine
    assert code == 2
    assert f"made with half {quick}, not {not quick}; expected the same options" in complaint
    assert "nothing to do" in run(f"{FOLDER} --out out --quality network --set half={str(quick).lower()}")[1]


def test_annotations_are_taken(run: Run) -> None:
    write_coco(Path("coco"))
    assert run(f"{COCO} --out out")[0] == 0
    table = pq.read_table("out")
    assert table["annotation"].to_pylist() == [100, 101, 102, 103, 104]
    assert table["picture"].to_pylist() == [f"{index:03}.jpg" for index in range(5)]
    keypoints = arrays(table, "keypoints")
    assert keypoints.shape == (5, 17, 3)
    np.testing.assert_allclose(keypoints[4, :, 0] - keypoints[0, :, 0], 4.0, atol=1e-3)
    assert (np.array(table["keypoint_error"]) < 0.1).all()
    moved = arrays(table, "joints_2d")
    np.testing.assert_allclose((moved[4] - moved[0]).mean(0), [4.0, 0.0], atol=2.0)


def test_a_camera_puts_bodies_before_it(run: Run) -> None:
    write_coco(Path("coco"), count=2)
    assert run(f"{COCO} --fov 40 --out out")[0] == 0
    table = pq.read_table("out")
    joints, centre = arrays(table, "joints"), arrays(table, "camera_translation")
    assert table["camera_perspective"].to_pylist() == [True, True]
    assert (arrays(table, "translation")[:, 2] > 1).all()
    focal = np.array(table["camera_scale"])[:, None, None]
    seen = focal * joints[..., :2] / joints[..., 2:] + centre[:, None]
    np.testing.assert_allclose(arrays(table, "joints_2d"), seen, atol=1e-2)


def test_an_ended_run_goes_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends it in the middle of the second shard of three. The first is not made again."""
    write_coco(Path("coco"))
    run(f"{COCO} --out whole")
    fitted: list[int] = []
    fit_people = people.PeopleFitter.bodies

    def counted(self: people.PeopleFitter, some: Any) -> Any:
        fitted.append(len(some))
        if len(fitted) == 2:
            raise KeyboardInterrupt
        return fit_people(self, some)

    monkeypatch.setattr(people.PeopleFitter, "bodies", counted)
    monkeypatch.setattr(people.PeopleFitter, "workers", 1)  # the shards' people in their order
    code, _, complaint = run(f"{COCO} --out out")
    assert code == 130
    assert "out has 1 of 3 shards, the same command goes on" in complaint
    assert parts("out") == ["part-00000-of-00003.parquet"]
    first = Path("out", parts("out")[0]).stat()
    before = len(fitted)  # people of the third shard may have been in work
    code, said, complaint = run(f"{COCO} --out out")
    assert (code, fitted[before:]) == (0, [2, 1])
    assert "1 of 3 shards are there; going on" in complaint
    assert "3 people in 3 pictures" in said
    assert Path("out", parts("out")[0]).stat().st_mtime_ns == first.st_mtime_ns
    assert pq.read_table("out").equals(pq.read_table("whole"))
    assert run(f"{COCO} --out out")[1] == "out has 3 of 3 shards; nothing to do\n"


KILLED = """
import os, signal, sys
import pyarrow.parquet as pq
write = pq.write_table
def write_half(table, path, **options):
    write(table, path, **options)
    if "part-00001" in str(path):
        os.truncate(path, os.path.getsize(path) // 2)
        os.kill(os.getpid(), signal.SIGKILL)
pq.write_table = write_half
from warp_partdr.cli.main import main
main()
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_killed_run_leaves_whole_shards_alone(run: Run) -> None:
    """The run is killed when half of a shard's file was written."""
    write_coco(Path("coco"))
    run(f"{COCO} --out whole")
    done = subprocess.run([sys.executable, "-c", KILLED, *COCO.split(), "--out", "out"], timeout=HANG)
    assert done.returncode == -signal.SIGKILL
    left = parts("out")
    assert "part-00000-of-00003.parquet" in left
    assert len([name for name in left if name.startswith("part")]) == 1
    assert len(rows("out")) == 2  # readers don't see what was left behind
    assert run(f"{COCO} --out out")[0] == 0
    assert parts("out") == parts("whole")
    assert pq.read_table("out").equals(pq.read_table("whole"))


def test_groups_and_batches_change_no_row(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coco(Path("coco"))
    run(f"{COCO} --shard 5 --out whole")
    monkeypatch.setattr(batches, "PICTURES", {"cpu": 1, "cuda": 1})
    run(f"{COCO} --shard 5 --batch 1 --out out")
    one, other = pq.read_table("out"), pq.read_table("whole")
    for name in ("picture", "person", "annotation"):
        assert one[name] == other[name]
    for name in ("keypoints", "joints", "rotations", "camera_translation"):
        np.testing.assert_allclose(arrays(one, name), arrays(other, name), atol=1e-3)


def test_machines_share_the_work(run: Run) -> None:
    write_coco(Path("coco"))
    run(f"{COCO} --out whole")
    assert "out has 1 of 3 shards" in run(f"{COCO} --out out --share 1/2")[1]
    assert parts("out") == ["part-00001-of-00003.parquet"]
    assert "out has 3 of 3 shards" in run(f"{COCO} --out out --share 0/2")[1]
    assert pq.read_table("out").equals(pq.read_table("whole"))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("--quality fast", "made with quality network, not fast; expected the same options, or another folder"),
        ("--fov 40", "made with fov None, not 40.0; expected the same"),
        ("--shard 4", "of another data set; expected 2 shards of 4 pictures there, or another folder"),
    ],
)
def test_other_options_are_refused(change: str, says: str, run: Run) -> None:
    write_coco(Path("coco"))
    run(f"{COCO} --out out")
    before = [(path.name, path.stat().st_mtime_ns) for path in Path("out").iterdir()]
    code, said, complaint = run(f"{COCO} --out out {change}")
    assert (code, said) == (2, "")
    assert complaint.count("\n") == 1
    assert says in complaint
    assert [(path.name, path.stat().st_mtime_ns) for path in Path("out").iterdir()] == before


def test_other_pictures_and_annotations_are_refused(run: Run) -> None:
    path = write_coco(Path("coco"))
    run(f"{COCO} --out out")
    data = json.loads(path.read_text())
    data["annotations"][0]["bbox"][0] += 1
    path.write_text(json.dumps(data))
    assert "made with people " in run(f"{COCO} --out out")[2]
    Path("list.txt").write_text("coco/000.jpg\n\ncoco/001.jpg\n")
    line = "dataset list.txt --out listed --quality network --min-score 0.9 --device cpu"
    assert run(line)[0] == 0
    Path("list.txt").write_text("coco/000.jpg\ncoco/002.jpg\n")
    assert "of other pictures; expected those of this run" in run(line)[2]
    Path("listed", "part-00000-of-00001.parquet").write_bytes(b"PAR1")
    assert "no shard of partdr dataset" in run(line)[2]


def test_a_full_disk_is_one_line_and_nothing_half(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coco(Path("coco"))
    write = pq.write_table

    def full(table: Any, path: Path, **options: Any) -> None:
        write(table, path, **options)
        if "part-00001" in path.name:
            os.truncate(path, 100)
            raise OSError(errno.ENOSPC, "Error writing bytes to file. Detail: [errno 28] No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pq, "write_table", full)
        code, said, complaint = run(f"{COCO} --out out")
    assert (code, said) == (2, "")
    assert complaint.splitlines()[-1] == (
        "partdr: out: No space left on device; expected room for shard 1 of 3: the same command goes on there"
    )
    assert parts("out") == ["part-00000-of-00003.parquet"]
    assert run(f"{COCO} --out out")[0] == 0
    assert len(rows("out")) == 5


def test_a_person_at_fault_is_a_row_with_an_error(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The others of the batch are fitted."""
    write_coco(Path("coco"))
    fit_people = people.fit_people

    def fails(some: Any, *how: Any) -> Any:
        if any(abs(person.crop.left - worst) < 1e-6 for person in some):
            raise RuntimeError("out of\nmemory")
        return fit_people(some, *how)

    lefts: list[float] = []

    def noted(some: Any, *how: Any) -> Any:
        lefts.extend(person.crop.left for person in some)
        return fit_people(some, *how)

    monkeypatch.setattr(people, "fit_people", noted)
    run(f"{COCO} --out whole --shard 5")
    worst = lefts[3]
    monkeypatch.setattr(people, "fit_people", fails)
    code, _, complaint = run(f"{COCO} --out out --shard 5")
    assert code == 0
    assert "warning: 1 row with an error, first 003.jpg: RuntimeError: out of memory" in complaint
    for row, expected in zip(rows("out"), rows("whole"), strict=True):
        fine = row["picture"] != "003.jpg"
        assert (row["joints"] is not None) == fine
        assert row["keypoints"] == expected["keypoints"]
        if fine:
            np.testing.assert_allclose(row["joints"], expected["joints"], atol=1e-4)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("nowhere", "nowhere: No such file or folder; expected a folder of photos"),
        ("coco --share 2/2", "--share: '2/2'; expected I/N"),
        ("coco --min-score 1", "--min-score: 1.0; expected 0 to below 1"),
        ("coco --fov 400", "--fov: 400"),
        ("coco --images coco", "--images: coco, with coco; expected a COCO file"),
        ("empty", "empty: no pictures in it; expected some: .jpg"),
        ("twice.txt", "twice.txt: a.jpg twice; expected each picture once"),
        ("bad.json", "bad.json: no lists images and annotations; expected COCO's annotations"),
        ("lost.json", "expected the image_id of one of the images"),
        ("coco --set mirrored=false", "mirrored: unknown; expected one of"),
        ("coco --quality mesh --set outline=labels-first", "outline: settings of a stage that no quality of a data"),
        ("coco --quality fast --set mesh.iterations=3", "mesh: settings, with --quality fast; expected --quality mesh"),
        ("coco --set network=mine", "network: a setting; expected the option --network"),
        ("coco --network none.safetensors", "none.safetensors: No such file"),
    ],
)
def test_faults_are_one_line(line: str, says: str, run: Run) -> None:
    write_coco(Path("coco"), count=1)
    Path("empty").mkdir()
    Path("twice.txt").write_text("a.jpg\na.jpg\n")
    Path("bad.json").write_text("[]")
    Path("lost.json").write_text('{"images": [], "annotations": [{"image_id": 3}]}')
    code, said, complaint = run(f"dataset {line} --device cpu --out out")
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert says in complaint
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"keypoints": [1.0, 2.0, 2]}, "annotation 100: 3 numbers; expected 3 (x, y, confidence)"),
        ({"bbox": [1, 2]}, "annotation 100: bbox: [1, 2]; expected four numbers"),
        ({"segmentation": [[1, 2]]}, "expected polygons x, y, x, y"),
        ({"segmentation": {"counts": "abc", "size": [1, 1]}}, "segmentation: size [1, 1]; expected the picture's, ["),
        (
            {"segmentation": {"counts": [3, 4], "size": [128, 97]}},
            "counts: [3, 4]; expected run lengths of 12416 pixels",
        ),
    ],
)
def test_annotations_at_fault_are_rows_with_errors(change: dict[str, Any], says: str, run: Run) -> None:
    write_coco(Path("coco"), count=1, **change)
    assert run(f"{COCO} --out out")[0] == 1  # most rows failed
    (row,) = rows("out")
    assert says in row["error"]


def test_annotations_may_lack_masks_and_keypoints(run: Run) -> None:
    path = write_coco(Path("coco"), count=2, segmentation=None, bbox=None)
    data = json.loads(path.read_text())
    data["annotations"][1]["keypoints"] = [0] * 51
    path.write_text(json.dumps(data))
    assert run(f"{COCO} --quality fast --out out")[0] == 0
    first, second = rows("out")
    assert first["joints"] is not None
    assert first["box"][2] > first["box"][0]
    assert (second["people"], second["person"], second["error"]) == (0, None, None)


def test_help_teaches_the_columns(run: Run) -> None:
    code, said, _ = run("dataset --help", COLUMNS="100")
    assert code == 0
    for column in columns("coco17", anny()):
        assert column.name in said, column


def test_without_pyarrow_it_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warp_partdr.cli.dataset.find_spec", lambda name: None)
    assert run("dataset photos")[2] == (
        "partdr: partdr dataset: without pyarrow; expected it: pip install 'pyarrow>=20' 'webdataset>=1.0.2'\n"
    )


def test_no_more_pictures_are_decoded_than_are_soon_asked_for() -> None:
    read: list[str] = []

    class Endless:
        def read(self, name: str) -> Any:
            read.append(name)
            raise InputError("nothing")

    with bulk_run.ThreadPoolExecutor(2) as pool:
        pictures = bulk_run._read_ahead(Endless(), map(str, range(1000)), pool, 2)  # type: ignore[arg-type]
        assert [next(pictures)[0] for _ in range(3)] == ["0", "1", "2"]
    assert len(read) <= 3 + bulk_run._AHEAD * 2
