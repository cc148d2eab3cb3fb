"""Files from outside: JSON that would be read otherwise than meant, and arrays that would fill the memory."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from warp_partdr.body import pose_prior
from warp_partdr.body.labels import label_set
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.errors import InputError, shown
from warp_partdr.files.array_files import read_npz
from warp_partdr.files.json_files import parse_json, read_json
from warp_partdr.files.opencv_files import read_opencv
from warp_partdr.files.sections import read_toml
from warp_partdr.inputs.keypoint_files import parse_keypoints, read_keypoints
from warp_partdr.inputs.part_labels import read_parts
from warp_partdr.lab.synthetic.pose_sampler import PoseBank
from warp_partdr.lab.training.config import read_config
from warp_partdr.models.load import load_model
from warp_partdr.networks.regression.checkpoint import load_ellipbodynet, load_label_network, save_label_network
from warp_partdr.networks.regression.label_network import LabelNetworkConfig
from warp_partdr.results.body_file import load_body

DEFLATED = zipfile.ZIP_DEFLATED
DEEP = "[" * 100_000
READERS: dict[str, Callable[[Path], Any]] = {"keypoints": read_keypoints, "labels": label_set}


def one_line(caught: pytest.ExceptionInfo[InputError]) -> str:
    said = str(caught.value)
    assert len(said.splitlines()) == 1
    assert len(said) < 500
    return said


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (DEEP, r"file\.json: not JSON \(nested too deeply\); expected"),
        ('{"a":' * 100_000, r"not JSON \(nested too deeply\)"),
        ('{"groups": {"a": ["head"], "b": ["neck"], "a": ["chest"]}, "ids": {}}', "key 'a' twice in one object"),
        ('{"ids": {}, "ids": {}}', "key 'ids' twice in one object"),
        ('[{"keypoints": [], "keypoints": []}]', "key 'keypoints' twice in one object"),
        ("{", "not JSON"),
    ],
)
def test_json_that_is_too_deep_or_ambiguous_is_refused(reader: str, text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        READERS[reader](path)
    assert one_line(caught).startswith(str(path))


def test_usual_json_is_read_with_or_without_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text('{"a": {"b": 1}, "b": [{"a": 1}, {"a": 2}]}')
    assert read_json(path, "numbers") == {"a": {"b": 1}, "b": [{"a": 1}, {"a": 2}]}
    path.write_bytes('{"a": 1}'.encode("utf-8-sig"))  # as some programs of Windows write it
    assert read_json(path, "numbers") == {"a": 1}
    path.write_bytes("a = 1".encode("utf-8-sig"))
    assert read_toml(path, "file.toml", "numbers") == {"a": 1}
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not JSON"):
        read_json(path, "numbers")
    with pytest.raises(InputError, match=r"text: not JSON .*; expected numbers"):
        parse_json("1" * 5000, "text", "numbers")  # longer than Python turns into a number


@pytest.mark.parametrize(
    ("text", "says"), [(DEEP, "nested too deeply"), ('{"size": 1, "size": 2}', "key 'size' twice in one object")]
)
def test_network_metadata_at_fault_is_refused(text: str, says: str, tmp_path: Path) -> None:
    from safetensors import safe_open

    path = tmp_path / "network.safetensors"
    save_label_network(path, {}, LabelNetworkConfig(), {})
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() | {"config": text}
    save_file({"weights": np.zeros(1, dtype=np.float32)}, path, metadata)
    with pytest.raises(InputError, match=f"{path.name}: config: .*{says}") as caught:
        load_label_network(path)
    one_line(caught)


@pytest.mark.parametrize(
    ("sizes", "says"),
    [
        ({"attention_layers": 10**9}, "attention_layers: 1000000000; expected an integer from 0 to 16"),
        ({"channels": [8] * 1000}, r"len\(channels\): 1000; expected"),
        ({"channels": [8, 8, 10**9]}, r"channels\[2\]: 1000000000; expected"),
        ({"size": 10**9}, "size: 1000000000; expected"),
        ({"size": 512, "channels": [8, 8, 8], "places": 200}, "places: 200, of 64 x 64 places; expected at most"),
        ({"regressor": {"iterations": 10**9}}, "iterations: 1000000000; expected an integer from 1 to 32"),
        ({"regressor": {"blocks": 10**9}}, "blocks: 1000000000; expected"),
        ({"regressor": {"width": 10**9}}, "width: 1000000000; expected"),
    ],
)
def test_network_sizes_that_would_fill_the_memory_are_refused(sizes: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "network.safetensors"
    metadata = {"format": "warp-partdr label network 2", "config": json.dumps(sizes)}
    save_file({"weights": np.zeros(1, dtype=np.float32)}, path, metadata)
    with pytest.raises(InputError, match=says) as caught:
        load_label_network(path)
    one_line(caught)


@pytest.mark.parametrize(
    ("architecture", "says"),
    [
        ({"model_type": "resnet", "depths": [3, 10**9]}, r"architecture.depths\[1\]: 1000000000; expected"),
        ({"model_type": "resnet", "hidden_sizes": [10**9] * 4}, "architecture.hidden_sizes.*: 1000000000; expected"),
        ({"model_type": "resnet", "depths": [1] * 1000}, "1000; expected"),
        ({"model_type": "resnet", "hidden_sizes": [65536] * 4}, "weights; expected at most 268,435,456"),
    ],
)
def test_backbones_that_would_fill_the_memory_are_refused(
    architecture: dict[str, Any], says: str, tmp_path: Path
) -> None:
    pytest.importorskip("transformers")
    path = tmp_path / "network.safetensors"
    metadata = {"format": "warp-partdr ellipbodynet 1", "config": json.dumps({"architecture": architecture})}
    save_file({"weights": np.zeros(1, dtype=np.float32)}, path, metadata)
    with pytest.raises(InputError, match=says) as caught:
        load_ellipbodynet(path)
    one_line(caught)


def bomb() -> str:
    """YAML of 250 bytes that stands for a million numbers; three lines more would fill the memory."""
    first = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    return first + "".join(f"{to}: &{to} [{', '.join([f'*{one}'] * 10)}]\n" for one, to in pairwise("abcdef"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (bomb(), "line 2: an alias"),
        ("%YAML:1.0\na: " + "[" * 50_000, "line 1: nested more than 32 levels deep"),
        ("a: " + "{b: " * 50_000, "nested more than 32 levels deep"),
        ("- " * 50_000, "nested more than 32 levels deep"),
        ("? " * 50_000, "nested more than 32 levels deep"),
        ("\n".join(" " * depth + "a:" for depth in range(1000)), "nested more than 32 levels deep"),
        (
            "a: 1\n" * 1_000_000,
            "5,000,000 bytes of YAML; expected .*, of at most 4,194,304",
        ),
    ],
)
def test_yaml_that_would_take_minutes_is_refused(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        read_opencv(path)
    one_line(caught)


def test_usual_yaml_is_read_without_conversions_of_times_and_base_60(tmp_path: Path) -> None:
    path = tmp_path / "file.yml"
    path.write_text(
        "%YAML:1.0\n---\na: { b: [ [ 1, 2. ], [ -3.0e-01, .Inf ] ] }\ntime: 12:30\nlong: " + ":".join("1" * 9)
    )
    found = read_opencv(path)
    assert found["a"] == {"b": [[1, 2.0], [-0.3, float("inf")]]}
    assert (found["time"], found["long"]) == ("12:30", "1:1:1:1:1:1:1:1:1")  # base 60 in YAML 1.1
    path.write_text("a: " + ":".join("1" * 200_000))  # takes half a minute as a number
    assert len(read_opencv(path)["a"]) == 399_999


def test_a_config_that_is_nested_too_deeply_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text(f"steps = {DEEP}")
    with pytest.raises(InputError, match=r"deep\.toml: .*; expected TOML") as caught:
        read_config(path)
    one_line(caught)


def test_values_in_messages_are_short() -> None:
    deep: Any = []
    for _ in range(100_000):
        deep = [deep]
    for value in (deep, "x" * 10_000, list(range(10_000)), {"a": deep}):
        assert len(shown(value)) < 200
    row: list[Any] = [[1.0, 2.0, 1.0]] * 16
    with pytest.raises(InputError, match="keypoint 16") as caught:
        parse_keypoints([*row, [deep, 1.0, 1.0]])
    one_line(caught)


# --- arrays ----------------------------------------------------------------------------------------------------------


def lying(shape: tuple[int, ...], member: str, path: Path, held: int = 1000, packed: int = DEFLATED) -> Path:
    """An archive of an array that says it has a shape, and holds so many bytes."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(path, "a", packed) as archive:
        archive.writestr(f"{member}.npy", header.getvalue() + bytes(held))
    return path


@pytest.fixture
def headers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np.lib.format, "read_array", lambda *_, **__: pytest.fail("unpacked"))


def test_a_body_that_unpacks_to_gigabytes_is_refused_by_its_header(tmp_path: Path, headers_alone: None) -> None:
    path = tmp_path / "body.npz"
    names = ["global_orient", "translation", "lengths", "thicknesses"]
    names += ["camera_scale", "camera_translation", "camera_perspective"]
    np.savez(path, format=np.array("x"), image_size=np.zeros(2), **dict.fromkeys(names, np.zeros(3)))
    lying((500_000, 3), "rotations", path, held=12_000_000)
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match=r"12\.0 MB when unpacked; expected a body\.npz .*, at most 1\.0 MB"):
        load_body(path)


@pytest.mark.parametrize("shape", [(10**9, 3), (-1,), (-2, -3)])
def test_headers_that_lie_are_refused(shape: tuple[int, ...], tmp_path: Path, headers_alone: None) -> None:
    path = lying(shape, "rotations", tmp_path / "poses.npz")
    with pytest.raises(InputError, match=r"rotations: says that its shape is .* but holds \d+ bytes"):
        read_npz(path, ("rotations",), expected="poses")
    path = lying(shape, "rotations", tmp_path / "other.npz", packed=zipfile.ZIP_BZIP2)
    with pytest.raises(InputError, match=r"rotations: compressed in a way"):
        read_npz(path, ("rotations",), expected="poses")


def test_every_reader_looks_at_the_header(tmp_path: Path, headers_alone: None) -> None:
    for name in ("rotations", "ups", "held_out"):
        lying((10**9, 3), name, tmp_path / "poses.npz")
    for name in pose_prior._SHAPES:
        lying((10**9, 3), name, tmp_path / "prior.npz")
    lying((10**9, 3), "v_template", tmp_path / "model.npz")
    array = tmp_path / "labels.npy"
    with array.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": (9000, 9000)})
        file.write(bytes(1000))
    for read in (
        lambda: PoseBank.read(tmp_path / "poses.npz"),
        lambda: PosePrior(tmp_path / "prior.npz"),
        lambda: load_model(tmp_path / "model.npz"),
        lambda: read_parts(array, label_set("cdcl14")),
    ):
        with pytest.raises(InputError, match="says that its shape is"):
            read()


def test_arrays_that_are_not_asked_for_may_be_anything(tmp_path: Path) -> None:
    path = tmp_path / "some.npz"
    np.savez(path, wanted=np.arange(3))
    lying((10**9, 3), "other", path)
    found = read_npz(path, ("wanted",), ("missing",), expected="some")
    assert list(found) == ["wanted"]
    assert found["wanted"].tolist() == [0, 1, 2]


def test_json_of_the_docs_has_no_key_twice() -> None:
    """Examples of pages can be read."""
    page = Path(__file__).resolve().parents[2] / "docs/reference/inputs.md"
    for block in page.read_text().split("```json\n")[1:]:
        assert parse_json(block.split("```")[0], "page", "JSON") == json.loads(block.split("```")[0])
