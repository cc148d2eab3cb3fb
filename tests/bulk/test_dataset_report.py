"""``partdr report``: everything in a data set is counted, the worst people are found and drawn, on one whole page."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import numpy as np
import pytest
from helpers import commands
from helpers.commands import Run
from helpers.pages import read_page
from helpers.people_rows import SIZE, body_row, write_shards
from PIL import Image

from warp_partdr.bulk import survey
from warp_partdr.bulk.reading import Address, PeopleFiles
from warp_partdr.bulk.rows import columns
from warp_partdr.bulk.survey import Kinds, kind_of, survey_people, worst_people
from warp_partdr.cli.dataset_files import ByName
from warp_partdr.models.anny import anny

pa = pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
FAR = "keypoints: the body ends {} px of 512 from them; expected at most 24"


def write_people(**changes: dict[int, Any]) -> PeopleFiles:
    """Three shards: bodies, a picture with nobody, one that is broken, and someone who can't be fitted."""
    names = "1.png", "2.png", "2.png", "4.png"  # two people in the second
    first = [body_row(name, keypoint_error=0.01 * place, energy=9.0 - place) for place, name in enumerate(names, 1)]
    first[1]["warnings"] = [FAR.format(30)]
    first[3]["warnings"] = [FAR.format(55), "labels: head and left_foot also far from any such bone; ignored there"]
    second = [
        {"picture": "5.png", "people": 0, "height": 9, "width": 9},
        {"picture": "6.png", "error": "6.png: image file is truncated (60 bytes)"},
        {"picture": "7.png", "error": "7.png: image file is truncated (7 bytes)"},
    ]
    lost = {name: body_row("8.png")[name] for name in ("picture", "person", "people", "score", "box", "warnings")}
    third = [lost | {"error": "RuntimeError: out of memory"}, body_row("9.png", 4.0, keypoint_error=0.5, score=0.2)]
    write_shards(Path("people"), [first, second, third], **changes)
    return PeopleFiles.open(Path("people"))


def test_everything_is_counted() -> None:
    told: list[str] = []
    found = survey_people(write_people(), progress=told.append)
    assert (found.rows, found.people, found.bodies, found.pictures, found.nobody) == (9, 6, 5, 8, 1)
    assert (found.rows_at_fault, found.warned) == (3, 2)
    assert [(count, where) for count, _, where in found.errors.sorted()] == [(2, (1, 1)), (1, (2, 0))]
    assert [(count, text, where) for count, text, where in found.warnings.sorted()] == [
        (2, FAR.format(30), (0, 1)),
        (1, "labels: head and left_foot also far from any such bone; ignored there", (0, 3)),
    ]
    assert found.rate == pytest.approx(5 / 1.5)
    assert (found.differing, found.faults.counts) == ([], {})
    assert told == [f"part-0000{index}-of-00003.parquet" for index in range(3)]


def test_scores_are_those_of_the_rows() -> None:
    seen = survey_people(write_people()).distributions
    expected = {  # lowest, median, highest, and how many
        "keypoint_error": (1.0, 3.0, 50.0, 5),
        "energy": (2.0, 6.0, 8.0, 5),
        "score": (20.0, 90.0, 90.0, 5),
        "depth": (5.0, 5.0, 5.0, 5),
        "distance": (4.0, 4.0, 4.0, 1),
    }
    for name, (low, median, high, count) in expected.items():
        assert seen[name].total == count, name
        assert (seen[name].low, seen[name].high) == pytest.approx((low, high)), name
        assert seen[name].quantile(0.5) == pytest.approx(median, rel=1e-3), name
    box = body_row("")["box"]
    assert seen["size"].low == pytest.approx(box[3] - box[1], rel=1e-5)
    assert "stature" not in seen


def test_lengths_are_shown_in_the_unit_that_they_are_said_to_have() -> None:
    units = {column.name: column.unit for column in columns("coco17", anny())}
    factors = {("m", "m"): 1, ("m", "cm"): 100, ("px", "px"): 1}
    shown = [score for score in survey.SCORES if score.unit in ("m", "cm", "px")]
    assert {score.name for score in shown} >= {"depth", "size", "stature", "distance"}
    for score in shown:
        assert score.factor == factors[units[score.columns[-1]], score.unit], score.name


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ("keypoint_error", [(2, 1), (0, 3), (0, 2)]),
        ("score", [(2, 1), (0, 0), (0, 1)]),  # the lowest; others are alike, and in their order
        ("energy", [(0, 0), (0, 1), (0, 2)]),
    ],
)
def test_the_worst_are_found_across_shards(by: str, expected: list[tuple[int, int]]) -> None:
    files = write_people()
    found = worst_people(files, by, 3)
    assert found.addresses == expected
    assert survey_people(files, by, 3).worst.addresses == expected
    worst_first = sorted(found.values.tolist(), reverse=by != "score")
    assert found.values.tolist() == worst_first


def test_the_least_confident_are_the_worst_unless_rows_lack_confidence(run: Run) -> None:
    """Then those whose keypoints are farthest off are, also if a single shard lacks it."""
    errors_and_confidences = ((0.01, 0.6), (0.02, 0.12), (0.03, 0.3))
    rows = [body_row(f"{error}.png", keypoint_error=error, confidence=sure) for error, sure in errors_and_confidences]
    write_shards(Path("people"), [rows, [body_row("4.png", keypoint_error=0.02)]])
    files = PeopleFiles.open(Path("people"))
    assert worst_people(files, None, 3).addresses == [(0, 1), (0, 2), (0, 0)]
    assert run("report people --worst 3")[0] == 0
    found = re.findall(r"confidence 0\.\d\d: [a-z ]+", read_page().text)
    assert found == [
        "confidence 0.12: likely wrong",
        "confidence 0.30: more likely wrong than right",
        "confidence 0.60: more likely right than wrong",
    ]
    path = files.path(1)
    pq.write_table(pq.read_table(path).drop_columns("confidence"), path)
    assert survey_people(files, count=3).worst.addresses == [(0, 2), (0, 1), (1, 0)]
    assert run("report people --worst 4")[0] == 0
    assert len(re.findall("confidence 0", read_page().text)) == 3


def test_rows_of_several_batches_are_counted_once() -> None:
    """Four thousand times two pictures, with two people and one, whose errors rise; the last picture is broken."""
    rows = [body_row(name) for name in ("1.png", "1.png", "2.png")]  # a batch ends between the first two
    write_shards(Path("people"), [[*rows, {"picture": "3.png", "error": "3.png: image file is truncated (60 bytes)"}]])
    (path,) = Path("people").glob("*.parquet")
    short = pq.read_table(path)
    table = pa.concat_tables([*[short.slice(0, 3)] * 4000, short.slice(3)])
    errors = pa.array([*np.linspace(0.001, 0.02, 12_000, dtype=np.float32).tolist(), None], pa.float32())
    place = table.schema.get_field_index("keypoint_error")
    pq.write_table(table.set_column(place, table.schema.field(place), errors), path)
    found = survey_people(PeopleFiles.open(Path("people")), "keypoint_error", 3)
    assert (found.rows, found.pictures, found.bodies) == (12_001, 8001, 12_000)
    assert found.worst.addresses == [(0, 11_999), (0, 11_998), (0, 11_997)]
    assert [(count, where) for count, _, where in found.errors.sorted()] == [(1, (0, 12_000))]


def test_sentences_of_a_kind_differ_in_numbers_and_parts_alone() -> None:
    alike = [
        ["labels: head and left_foot also far", "labels: left_hand, torso and head also far"],
        ["labels: left and right of arms exchanged", "labels: left and right of legs exchanged"],
        ["1.2 px of 3", "-1e-05 px of 44"],
        ["format: 'a'; expected one", "format: 'bc d'; expected one"],
    ]
    assert [len({kind_of(each) for each in same}) for same in alike] == [1] * len(alike)
    assert len({kind_of(same[0]) for same in alike}) == len(alike)


def test_kinds_are_bounded() -> None:
    kinds = Kinds()
    names = [f"file {one}{other}" for one in ascii_lowercase for other in ascii_lowercase]
    for name in (*names, names[0]):
        kinds.add(name, 1, Address(0, 0))
    assert [(count, name) for count, name, _ in kinds.sorted()][:2] == [(2, names[0]), (1, names[1])]
    assert len(kinds.counts) == 300
    assert kinds.others == len(names) - 300


def test_shards_at_odds_are_marked(run: Run) -> None:
    write_people(pictures={1: 4}, device={2: "cuda"})
    Path("people/part-00000-of-00003.parquet").unlink()
    assert run("report people --worst 1")[0] == 0
    marks = re.findall(r"<p class=mark>(.*?)</p>", Path("report.html").read_text())
    assert marks == [
        "1 of 3 shards are not there: 0",
        "Rows of 3 pictures, but made of 4: 1 so, first shard 1",
        "Not the same in all shards: device",
    ]


def test_the_page_is_whole_and_needs_nothing_else(run: Run) -> None:
    write_people()
    code, said, _ = run("report people --out new/page.html --worst 3 --by energy")
    assert (code, said) == (0, "new/page.html: 9 rows, 5 bodies, 3 errors, 2 warned; the worst 3 are drawn\n")
    text = Path("new/page.html").read_text()
    page = read_page("new/page.html")
    assert len(page.images) == 3
    assert "http" not in text.replace("http-equiv", "")
    plots = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(plots) == 7
    for plot in plots:
        bars = ElementTree.fromstring(plot).findall("rect")
        assert sum(int(bar[0].text.rpartition(": ")[2].replace(",", "")) for bar in bars) in (1, 5)
    for told in ("0/0 8", "1.png, person 0", "partdr export people --rows 0/0", "image file is truncated (60 bytes)"):
        assert told in page.text, told
    assert list(Path("new").iterdir()) == [Path("new/page.html")]


def test_names_are_no_markup(run: Run) -> None:
    name = "<b>&'x.png"
    write_shards(Path("people"), [[body_row(name, warnings=["<script>alert(1)</script>"])]])
    run("report people")
    assert f"{name}, person 0" in read_page().text


def test_people_are_drawn_over_their_photo(run: Run) -> None:
    """The photo with keypoints is on the left, and the body on the right. Another size is another picture."""
    photos = Path("photos")
    photos.mkdir()
    for name, size in (("1.png", SIZE), ("2.png", (60, 60))):
        Image.new("RGB", size[::-1], (30, 160, 60)).save(photos / name)
    far = body_row("3.png", keypoint_error=0.4)
    write_shards(Path("people"), [[body_row("1.png", 3.0), body_row("2.png", keypoint_error=0.3), far]])
    for name in ("3.png",):
        (photos / name).write_bytes(b"broken")
    assert run("report people --pictures photos --by keypoint_error")[0] == 0
    page = read_page()
    assert "1 of 3 photos could be read" in page.text
    gone, other, shown = page.images  # the worst first
    assert gone.size == other.size
    seen = np.asarray(shown).astype(int)
    half = seen.shape[1] // 2
    left, right = seen[:, : half - 3], seen[:, half + 3 :]
    green = [(np.abs(each - (30, 160, 60)).max(-1) < 30).mean() for each in (left, right)]
    assert green[0] > 0.75
    assert 0.1 < green[1] < green[0] - 0.1
    drawn = [np.argwhere(np.abs(each - (30, 160, 60)).max(-1) > 60) for each in (left, right)]
    assert np.ptp(drawn[1][:, 0]) > 0.8 * seen.shape[0]
    for edge in (np.min, np.max):  # the skeleton lies on the body
        np.testing.assert_allclose(edge(drawn[0], axis=0), edge(drawn[1], axis=0), atol=0.12 * seen.shape[0])
    np.testing.assert_allclose(drawn[0][:, 1].mean(), drawn[1][:, 1].mean(), atol=4)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("report nowhere", "nowhere: No such folder; expected a data set of partdr dataset"),
        ("report empty", "empty: no shards in it"),
        ("report people --out people/page.html", "--out: people/page.html, in the data set"),
        ("report people --by stature", "--by"),
        ("report people --images photos", "--images: photos, without --pictures"),
        ("report people --pictures photos", "photos: No such file"),
        ("report people --out empty", "empty: Is a directory"),
        ("report two", "two: shards of 1 and of 3; expected those of one data set"),
        ("report old", "old/part-00000-of-00001.parquet: format 'people 0'; expected 'warp-partdr people 1'"),
        ("report half", "part-00000-of-00001.parquet: no shard of partdr dataset"),
    ],
)
def test_faults_are_one_line(line: str, says: str, run: Run) -> None:
    write_people()
    Path("empty").mkdir()
    write_shards(Path("two"), [[body_row("1.png")]])
    name = "part-00000-of-00003.parquet"
    Path("two", name).write_bytes(Path("people", name).read_bytes())
    write_shards(Path("old"), [[body_row("1.png")]], format={0: "people 0"})
    Path("half").mkdir()
    whole = Path("two/part-00000-of-00001.parquet").read_bytes()
    Path("half/part-00000-of-00001.parquet").write_bytes(whole[: len(whole) // 2])
    code, said, complaint = run(line)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert says in complaint
    assert not Path("report.html").exists()


@pytest.mark.parametrize("command", ["report", "export"])
def test_without_pyarrow_they_say_what_to_install(command: str, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warp_partdr.cli.dataset_files.find_spec", lambda name: None)
    assert run(f"{command} people")[2] == (
        f"partdr: partdr {command}: without pyarrow; expected it: pip install 'pyarrow>=20' 'webdataset>=1.0.2'\n"
    )


def test_options_are_those_of_the_survey() -> None:
    assert tuple(each.value for each in ByName) == survey.RANKED


def test_the_rate_is_that_of_bodies_whose_time_is_known() -> None:
    seen = survey.Survey(survey.Worst.by("energy", 1), bodies=10, timed=4, seconds=2.0)
    assert seen.rate == 2.0
    assert survey.Survey(survey.Worst.by("energy", 1), bodies=10).rate is None
