"""Networks from checkpoints: found, read, and refused."""

from __future__ import annotations

import builtins
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.checkpoints import class_names, knowing_vitpose, save, tiny_sapiens2, tiny_segformer

from warp_partdr.body.labels import LABEL_SETS
from warp_partdr.body.skeletons import SKELETONS, skeleton
from warp_partdr.errors import InputError
from warp_partdr.networks.predictors.checkpoints import load_keypoint_network, load_part_network
from warp_partdr.networks.predictors.files import find_checkpoint, read_input

transformers = pytest.importorskip("transformers", reason="needs the extra photo")

CELLS = [(1 + k % 13, 1 + k % 10) for k in range(17)]  # not at the border, where heat runs out


@pytest.fixture(scope="module")
def segformer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_segformer(tmp_path_factory.mktemp("segformer"), class_names("atr18"))


@pytest.fixture(scope="module")
def vitpose(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return knowing_vitpose(tmp_path_factory.mktemp("vitpose"), CELLS)


def copy(folder: Path, to: Path, *, without: tuple[str, ...] = (), **config: Any) -> Path:
    """A checkpoint without some files, and with changes to its configuration."""
    to.mkdir()
    for path in folder.iterdir():
        if path.name not in without:
            (to / path.name).write_bytes(path.read_bytes())
    if config:
        data = json.loads((to / "config.json").read_text())
        (to / "config.json").write_text(json.dumps(data | config))
    return to


def test_a_part_network_has_the_label_set_of_its_class_names(segformer: Path, capsys: pytest.CaptureFixture) -> None:
    told: list[str] = []
    network = load_part_network(str(segformer), say=told.append)
    assert network.labels is LABEL_SETS["atr18"]
    assert (network.size, network.stretch) == ((64, 64), 1.5)
    assert told == [f"parts from {network.about}"]
    assert "SegformerForSemanticSegmentation, 0.014 million parameters, 0.0695 MB, labels atr18" in network.about
    said = network.predict(torch.rand(2, 3, 64, 64))
    assert said.shape == (2, 18, 16, 16)
    assert torch.allclose(said.sum(1), torch.ones(2, 16, 16), atol=1e-5)
    assert capsys.readouterr() == ("", "")  # no progress bars


def test_names_match_whatever_their_spelling(segformer: Path, tmp_path: Path) -> None:
    shouted = {source: name.upper().replace("-", " ") for source, name in class_names("atr18").items()}
    folder = copy(segformer, tmp_path / "shouted", id2label=shouted)
    assert load_part_network(str(folder)).labels.name == "atr18"
    moved = class_names("atr18")
    moved[9], moved[10] = moved[10], moved[9]  # other ids: another set
    folder = copy(segformer, tmp_path / "moved", id2label=moved)
    with pytest.raises(InputError, match=r"18 classes, 'Background, Hat.* of no known label set; expected --lab"):
        load_part_network(str(folder))
    assert load_part_network(str(folder), "atr18").labels.name == "atr18"
    with pytest.raises(InputError, match="--labels: lip20, of 20 classes; expected one of 18"):
        load_part_network(str(folder), "lip20")


def test_a_sapiens2_network_is_loaded(tmp_path: Path, device: str) -> None:
    network = load_part_network(str(tiny_sapiens2(tmp_path, class_names("sapiens29"))), device=device)
    assert (network.labels.name, network.size, network.stretch) == ("sapiens29", (64, 48), 1.0)
    assert network.predict(torch.rand(1, 3, 64, 48, device=device)).shape[:2] == (1, 29)


def test_colours_are_those_of_the_image_processor(segformer: Path) -> None:
    """The picture that the library's own processor makes goes into the network."""
    picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    processor = transformers.AutoImageProcessor.from_pretrained(segformer, local_files_only=True)
    model = transformers.SegformerForSemanticSegmentation.from_pretrained(segformer, local_files_only=True).eval()
    with torch.no_grad():
        expected = model(**processor(picture, return_tensors="pt")).logits.softmax(1)
        said = load_part_network(str(segformer)).predict(torch.from_numpy(picture).permute(2, 0, 1)[None] / 255)
    torch.testing.assert_close(said, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("settings", "size", "mean", "deviation"),
    [
        ({"size": {"height": 20, "width": 30}, "do_normalize": False}, (20, 30), 0, 1),
        ({"size": 40, "image_mean": [0.5] * 3, "image_std": [0.25] * 3}, (40, 40), 0.5, 0.25),
        ({"size": {"shortest_edge": 40}, "do_normalize": False, "do_rescale": False}, (40, 40), 0, 1 / 255),
        ({"size": 99, "do_center_crop": True, "crop_size": [8, 9], "do_normalize": False}, (8, 9), 0, 1),
        (
            {"size": 40, "rescale_factor": 2 / 255, "image_mean": [1] * 3, "image_std": [1] * 3},
            (40, 40), 0.5, 0.5,
        ),
        ({"image_processor": {"size": 24, "do_normalize": False}}, (24, 24), 0, 1),
    ],
)  # fmt: skip
def test_each_form_of_an_image_processor_gives_size_mean_and_deviation(
    settings: dict, size: Any, mean: float, deviation: float, tmp_path: Path
) -> None:
    """(x - mean) / deviation of colours from 0 to 1 is what rescaling and normalising make of them."""
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(settings))
    found = read_input(tmp_path, "net")
    assert found.size == size
    assert found.mean == pytest.approx([mean] * 3)
    assert found.deviation == pytest.approx([deviation] * 3)


@pytest.mark.parametrize("settings", [{}, {"size": 0}, {"size": "big"}, {"size": 8}, {"size": 8, "image_mean": 1}, []])
def test_wrong_settings_of_an_image_processor_are_refused(settings: Any, tmp_path: Path) -> None:
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(settings))
    with pytest.raises(InputError, match=r"preprocessor_config\.json"):
        read_input(tmp_path, "net")


def test_keypoints_have_the_format_of_their_number(vitpose: Path, tmp_path: Path) -> None:
    told: list[str] = []
    network = load_keypoint_network(str(vitpose), say=told.append)
    assert skeleton(network.skeleton) is SKELETONS["coco17"]
    assert network.size == (256, 192)
    assert told == [f"keypoints from {network.about}"]
    with torch.no_grad():
        said = network.predict(torch.rand(2, 3, 256, 192))
    centres = torch.tensor([[(column + 0.5) / 12, (row + 0.5) / 16] for row, column in CELLS])
    torch.testing.assert_close(said[0, :, :2], centres, atol=0.01, rtol=0)
    assert (said[..., 2] > 0.7).all()
    assert skeleton(load_keypoint_network(str(vitpose), "h36m17").skeleton).name == "h36m17"
    with pytest.raises(InputError, match="17 keypoints; expected 14 of lsp14"):
        load_keypoint_network(str(vitpose), "lsp14")
    odd = knowing_vitpose(tmp_path, [(1, 1)] * 5)
    with pytest.raises(InputError, match=r"5 keypoints; expected .*17 \(coco17\)"):
        load_keypoint_network(str(odd))


def test_a_vitpose_with_experts_and_whole_body_points_is_loaded(tmp_path: Path, device: str) -> None:
    network = load_keypoint_network(str(knowing_vitpose(tmp_path, [(2, 3)] * 133, experts=6)), device=device)
    assert skeleton(network.skeleton).name == "wholebody133"
    with torch.no_grad():
        assert network.predict(torch.rand(1, 3, 256, 192, device=device)).shape == (1, 133, 3)


def test_checkpoints_without_safe_weights_or_settings_are_refused(
    segformer: Path, vitpose: Path, tmp_path: Path
) -> None:
    bare = copy(segformer, tmp_path / "pickle", without=("model.safetensors",))
    (bare / "pytorch_model.bin").write_bytes(b"\x80")
    with pytest.raises(InputError, match=r"pickle: no model.safetensors; expected weights as safetensors \(pickles"):
        load_part_network(str(bare))
    with pytest.raises(InputError, match=r"a: no config.json"):
        load_part_network(str(copy(segformer, tmp_path / "a", without=("config.json",))))
    with pytest.raises(InputError, match=r"b: no preprocessor_config.json"):
        load_part_network(str(copy(segformer, tmp_path / "b", without=("preprocessor_config.json",))))
    with pytest.raises(InputError, match=r"a vitpose; expected a network of semantic segmentation"):
        load_part_network(str(vitpose), "atr18")
    with pytest.raises(InputError, match=r"a segformer; expected a vitpose"):
        load_keypoint_network(str(segformer))
    broken = copy(segformer, tmp_path / "c")
    (broken / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"c: .*expected a checkpoint for AutoModelForSemanticSegmentation"):
        load_part_network(str(broken))
    (broken / "config.json").write_text("{}")
    with pytest.raises(InputError, match=r"c: config.json: "):
        load_part_network(str(broken))


def test_weights_must_all_be_there(segformer: Path, tmp_path: Path) -> None:
    """A backbone alone would get random weights for the rest, and say anything."""
    model = transformers.SegformerForSemanticSegmentation.from_pretrained(segformer)
    with pytest.raises(InputError, match=r"no weights of decode_head\..*; expected a checkpoint trained for"):
        load_part_network(str(save(model.segformer, tmp_path, (64, 64))))


def test_no_code_of_a_checkpoint_is_run(segformer: Path, tmp_path: Path) -> None:
    """A configuration that names code of its own, of a kind that the library has not."""
    own = {"AutoConfig": "own.Config", "AutoModelForSemanticSegmentation": "own.Model"}
    folder = copy(segformer, tmp_path / "own", model_type="own", auto_map=own)
    (folder / "own.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    with pytest.raises(InputError, match=r"own: config.json"):
        load_part_network(str(folder))
    assert not (tmp_path / "ran").exists()


def test_nothing_is_downloaded_unasked(monkeypatch: pytest.MonkeyPatch, segformer: Path) -> None:
    asked: list[dict[str, Any]] = []

    def snapshot_download(name: str, **how: Any) -> Any:
        asked.append({"name": name, **how})
        if how.get("local_files_only"):
            raise FileNotFoundError("not in the cache")
        sizes = [SimpleNamespace(file_size=3_000_000, will_download=True)] * 2
        return [*sizes, SimpleNamespace(file_size=9, will_download=False)] if how.get("dry_run") else str(segformer)

    monkeypatch.setattr("huggingface_hub.snapshot_download", snapshot_download)
    with pytest.raises(InputError, match=r"org/net: no such folder, and not in the Hub.*expected a folder, or hf:ORG"):
        find_checkpoint("org/net", print)
    with pytest.raises(InputError, match=r"\./net: no such folder; expected a folder, or hf:ORG/NAME"):
        find_checkpoint("./net", print)
    assert asked == [{"name": "org/net", "local_files_only": True}]
    told: list[str] = []
    assert find_checkpoint("hf:org/net", told.append) == segformer
    assert told == ["downloading org/net: 6 MB to the Hub's local cache"]
    patterns = asked[-1]["allow_patterns"]
    assert asked[-1]["name"] == "org/net"
    assert not [each for each in patterns if not each.endswith((".json", ".safetensors"))]  # no pickles, no code


def test_an_older_download_serves_without_a_connection(monkeypatch: pytest.MonkeyPatch, segformer: Path) -> None:
    cached = [str(segformer)]

    def snapshot_download(name: str, **how: Any) -> str:
        if how.get("local_files_only") and cached:
            return cached[0]
        raise ConnectionError("no connection")

    monkeypatch.setattr("huggingface_hub.snapshot_download", snapshot_download)
    assert find_checkpoint("org/net", print) == find_checkpoint("hf:org/net", print) == segformer
    cached.clear()
    with pytest.raises(InputError, match="hf:org/net: no connection; expected a checkpoint that can be downloaded"):
        find_checkpoint("hf:org/net", print)


def test_a_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch, segformer: Path) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "transformers":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.delitem(sys.modules, "transformers")
    monkeypatch.setattr(builtins, "__import__", without)
    for load in (load_part_network, load_keypoint_network):
        with pytest.raises(InputError, match=r"needs transformers \(pip install 'transformers>=5'\)"):
            load(str(segformer))
