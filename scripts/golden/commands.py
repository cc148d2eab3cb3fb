"""Results of the command, from its inputs to its files."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from differences import Found
from files import read_results
from inputs import EXAMPLE, make_crowd, write_coco, write_crowd_film, write_labelled_photos, write_photos, write_views
from PIL import Image

_PERSON = f"--keypoints {EXAMPLE / 'keypoints.json'} --parts {EXAMPLE / 'parts.png'} --labels cdcl14"
_FEW_MESH_STEPS = "--set mesh.iterations=5 --set mesh.learning_rate=0.0005"
_FEW_LABEL_STEPS = "--set labels.iterations=5 --set labels.learning_rate=0.0005"
_FEW_OUTLINE_STEPS = "--set outline.iterations=5 --set outline.learning_rate=0.0005"
_FEW_STEPS = f"{_FEW_MESH_STEPS} {_FEW_LABEL_STEPS}"


def saved_by_default() -> Found:
    """Files of fits with the default options: of a person, also without labels, and everyone in a photo.

    And those of a registration, which goes on from the first of them.
    """
    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(make_crowd()).save(Path(folder) / "photo.png")
        return {
            **_run(folder, f"fit {EXAMPLE / 'photo.png'} {_PERSON} --set threads=1", "person"),
            **_run(folder, f"fit --keypoints {EXAMPLE / 'keypoints.json'}", "keypoints"),
            **_run(folder, f"register person/body.npz --photo {EXAMPLE / 'photo.png'}", "registered"),
            **_run(folder, "fit photo.png", "photo"),
        }


def saved_person() -> Found:
    """Files of one person's fit, also before a known camera, and without a detailed body."""
    photo = EXAMPLE / "photo.png"
    with tempfile.TemporaryDirectory() as folder:
        return {
            **_run(folder, f"fit {photo} {_PERSON} {_FEW_STEPS}", "all"),
            **_run(folder, f"fit {photo} {_PERSON} {_FEW_STEPS} --fov 50", "known camera"),
            **_run(folder, f"fit {photo} {_PERSON} {_FEW_LABEL_STEPS} {_FEW_OUTLINE_STEPS} --model none", "ellipsoids"),
        }


def saved_photo() -> Found:
    """Files of everyone in a photo, of whom two overlap; of one of them; and of a real photo of half a body."""
    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(make_crowd()).save(Path(folder) / "photo.png")
        return {
            **_run(folder, f"fit photo.png {_FEW_STEPS}", "everyone"),
            **_run(folder, f"fit photo.png {_FEW_STEPS} --person 1", "one"),
            **_run(folder, f"fit {EXAMPLE / 'astronaut.jpg'} {_FEW_STEPS}", "half a body"),
        }


def saved_film() -> Found:
    """Files of everyone in a film of several windows."""
    with tempfile.TemporaryDirectory() as folder:
        write_crowd_film(Path(folder) / "film.mp4")
        windows = "--set window=5 --set overlap=2 --set shape_frames=3"
        return _run(folder, f"fit film.mp4 {windows} {_FEW_MESH_STEPS}", "film")


def saved_views() -> Found:
    """Files of a person before two cameras, which are known or are found."""
    with tempfile.TemporaryDirectory() as folder:
        write_views(Path(folder))
        line = f"scene left.mp4 right.mp4 {_FEW_MESH_STEPS}"
        return {**_run(folder, f"{line} --cameras rig.json", "known"), **_run(folder, line, "found")}


def dataset() -> Found:
    """Rows of people who are found, who are annotated with outlines, and whose keypoints and labels are known."""
    with tempfile.TemporaryDirectory() as folder:
        write_photos(Path(folder) / "photos")
        write_coco(Path(folder) / "coco")
        write_labelled_photos(Path(folder) / "labelled")
        found: Found = {}
        for source in ("photos", "coco/people.json", "labelled --labels cdcl14"):
            for quality in (f"fast {_FEW_LABEL_STEPS}", f"mesh {_FEW_STEPS}"):
                name = f"{source.split()[0]}, {quality.split()[0]}"
                found |= _run(folder, f"dataset {source} --quality {quality}", name)
        return found


def predict() -> Found:
    """Bodies that the network predicts for found people, of a film, and for people whose keypoints are known."""
    with tempfile.TemporaryDirectory() as folder:
        write_photos(Path(folder) / "photos")
        write_crowd_film(Path(folder) / "photos" / "film.mp4")
        write_labelled_photos(Path(folder) / "labelled")
        return {
            **_run(folder, "predict photos", "found"),
            **_run(folder, "predict labelled --labels cdcl14", "labelled"),
        }


def _run(folder: str, line: str, out: str) -> Found:
    """Run the command in a folder; its files, and its warnings, by the name of the folder for them."""
    arguments: Sequence[str] = [*line.split(), "--out", out, "--device", "cpu"]
    ran = subprocess.run(
        [sys.executable, "-m", "warp_partdr", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    if ran.returncode:
        raise RuntimeError(f"partdr {line}: exit code {ran.returncode}: {ran.stderr}")
    warnings = "\n".join(each for each in ran.stderr.splitlines() if each.startswith("partdr:"))
    found = read_results(Path(folder) / out)
    return {f"{out}, {name}": value for name, value in found.items()} | {f"{out}, warnings": np.array(warnings)}
