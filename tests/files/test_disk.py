"""Files that are none: pipes, sockets and devices are refused by all readers, and nobody waits for them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from warp_partdr.body.labels import label_set
from warp_partdr.bulk.containers import index_tar, read_member
from warp_partdr.bulk.opening import open_source
from warp_partdr.errors import InputError, printable
from warp_partdr.files.array_files import read_npy, read_npz
from warp_partdr.files.disk import check_regular, file_sha256
from warp_partdr.files.json_files import read_json
from warp_partdr.files.opencv_files import read_opencv
from warp_partdr.files.sections import read_toml
from warp_partdr.inputs.films import FilmFrames, film_facts
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.models.load import load_model
from warp_partdr.networks.regression.checkpoint import load_label_network
from warp_partdr.results.body_file import load_body

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pipes with names")

READERS: dict[str, Callable[[Path], Any]] = {
    "x.json": lambda path: read_json(path, "JSON"),
    "x.keypoints.json": read_keypoints,
    "labels.json": label_set,
    "x.yml": read_opencv,
    "x.toml": lambda path: read_toml(path, str(path), "TOML"),
    "x.npz": lambda path: read_npz(path, ["a"], expected="arrays"),
    "x.npy": lambda path: read_npy(path, expected="an array", check=lambda header: None),
    "body.npz": load_body,
    "model.npz": load_model,
    "model.safetensors": load_model,
    "network.safetensors": load_label_network,
    "x.tar": index_tar,
    "member.tar": lambda path: read_member(str(path), 0, 1, str(path)),
    "list.txt": open_source,
}


@pytest.mark.parametrize("name", READERS)
def test_no_reader_waits_for_a_pipe(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=r": a pipe, no regular file; expected ") as caught:
        READERS[name](tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))


@pytest.mark.parametrize("reader", [film_facts, FilmFrames])
def test_only_a_file_is_opened_as_a_film(reader: Callable[[Path], Any], tmp_path: Path) -> None:
    pytest.importorskip("av", reason="needs PyAV, the extra film")
    os.mkfifo(tmp_path / "x.mp4")
    with pytest.raises(InputError, match=r"x\.mp4: a pipe, no regular file; expected a film"):
        reader(tmp_path / "x.mp4")
    with pytest.raises(InputError, match=r"No such file or directory; expected a film"):
        reader(Path("http://127.0.0.1:9/x.mp4"))  # which libav would open


def test_only_regular_files_and_folders_are_opened(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="a device, no regular file") as caught:
        check_regular("/dev/null")
    assert caught.value.errno is None  # tomorrow it will be one, too
    with pytest.raises(FileNotFoundError):
        check_regular(tmp_path / "nothing")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="a pipe"):
        file_sha256(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    (tmp_path / "file").write_bytes(b"")
    check_regular(tmp_path / "link")
    check_regular(str(tmp_path))  # whoever opens a folder tells


def test_a_pipe_of_the_shell_is_read() -> None:
    """``--keypoints <(jq . file.json)``: there is a writer."""
    read, write = os.pipe()

    def fill() -> None:
        with os.fdopen(write, "w") as file:
            file.write('{"a": [1, 2]}')

    writer = threading.Thread(target=fill)
    writer.start()
    try:
        assert read_json(f"/dev/fd/{read}", "JSON") == {"a": [1, 2]}
    finally:
        writer.join()
        os.close(read)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("plain.jpg", "plain.jpg"),
        ("häßlich 写真 👩‍👩‍👧.jpg", "häßlich 写真 👩‍👩‍👧.jpg"),
        ("at 1.00\u202fPM.png", "at 1.00\u202fPM.png"),  # macOS's own
        (os.fsdecode(b"caf\xe9.jpg"), r"caf\xe9.jpg"),
        ("two\nlines\t.jpg", r"two\x0alines\x09.jpg"),
        ("\u2028\x85\x7f\x1b[31m", r"\u2028\x85\x7f\x1b[31m"),
        ("\ud800", r"\ud800"),
    ],
)
def test_any_name_can_be_printed(name: str, told: str) -> None:
    assert printable(name) == told
    printable(name).encode()
