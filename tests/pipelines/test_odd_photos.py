"""``fit_photo`` on photos that are not a whole upright person: each a sensible body, or one clear line."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import HANG
from helpers.example import example_mask, example_photo
from helpers.people import crowd
from PIL import Image

from warp_partdr.cameras import Perspective
from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.pipelines.photo import fit_photo, person_evidence
from warp_partdr.results import overlays
from warp_partdr.results.body_file import load_body
from warp_partdr.results.save_photo import save_photo_fit
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.mesh.mesh_stage import MeshFit

FAST = FitOptions.at("fast")


@cache
def example() -> tuple[np.ndarray, np.ndarray]:
    """Photo and true silhouette."""
    return example_photo(), example_mask()


@cache
def whole() -> MeshFit:
    return fit_photo(example()[0], options=FAST).fits[0]


def joints_seen(mesh: MeshFit) -> np.ndarray:
    """Joints in the picture [px], shape (J, 2)."""
    body = mesh.ellipbody
    return body.camera.project(body.posed.joints)[0, :, :2].detach().cpu().numpy()


def overlap(mesh: MeshFit, silhouette: np.ndarray) -> float:
    drawn = mesh.draw(silhouette.shape).labels[0].numpy() > 0
    return (drawn & silhouette).sum() / (drawn | silhouette).sum()


@pytest.mark.parametrize(
    ("name", "box"), [("left side", (195, 0, 384, 512)), ("legs", (0, 0, 384, 260)), ("right side", (0, 0, 205, 512))]
)
def test_half_bodies_at_the_border_lie_beyond_it_where_they_would_be(name: str, box: tuple[int, ...]) -> None:
    """A person has lost the ``name``; unseen parts lie beyond the border, about where they are."""
    left, top, right, bottom = box
    picture, silhouette = (np.ascontiguousarray(each[top:bottom, left:right]) for each in example())
    (mesh,) = fit_photo(picture, options=FAST).fits.values()
    assert overlap(mesh, silhouette) > 0.7
    apart = np.linalg.norm(joints_seen(mesh) + np.array([left, 0]) - joints_seen(whole()), axis=1)
    assert np.median(apart) < 30
    assert apart.max() < 250  # no limb goes astray


@pytest.mark.parametrize("turns", [1, 2])
def test_people_upside_down_and_lying_are_fitted_as_upright_ones(turns: int) -> None:
    picture, silhouette = (np.ascontiguousarray(np.rot90(each, turns)) for each in example())
    (mesh,) = fit_photo(picture, options=FAST).fits.values()
    assert overlap(mesh, silhouette) > 0.75
    x, y = joints_seen(whole()).T
    height, width = example()[1].shape
    expected = np.stack([y, width - x] if turns == 1 else [width - x, height - y], axis=1)
    assert np.linalg.norm(joints_seen(mesh) - expected, axis=1).mean() < 20


def _exif(image: Image.Image, path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned clockwise
    image.rotate(90, expand=True).save(path, exif=exif, quality=95)


SAVED: dict[str, tuple[str, Callable[[Image.Image, Path], object]]] = {
    "exif": ("a.jpg", _exif),
    "gray": ("a.png", lambda image, path: image.convert("L").save(path)),
    "transparent": ("a.png", lambda image, path: image.convert("RGBA").save(path)),
    "16 bit": (
        "a.png",
        lambda image, path: Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257).save(path),
    ),
}


@pytest.mark.parametrize("kind", SAVED)
def test_pictures_of_any_kind_give_the_same_body(kind: str, tmp_path: Path) -> None:
    name, write = SAVED[kind]
    write(Image.fromarray(example()[0]), tmp_path / name)
    (mesh,) = fit_photo(read_photo(tmp_path / name), options=FAST).fits.values()
    assert np.linalg.norm(joints_seen(mesh) - joints_seen(whole()), axis=1).mean() < 10


def test_everyone_in_a_small_crowd_gets_a_body_of_their_own() -> None:
    picture, places = crowd(6)
    fits = fit_photo(picture, options=FAST).fits
    assert len(fits) == 6
    pelvises = np.stack([joints_seen(mesh)[0] for mesh in fits.values()])
    nearest = np.linalg.norm(pelvises[:, None] - places, axis=2)
    assert sorted(nearest.argmin(axis=1)) == list(range(6))
    assert nearest.min(axis=1).max() < 40


def test_who_is_nearly_hidden_keeps_their_keypoints() -> None:
    """A corner of the picture is all that others' masks left of the person."""
    found = fit_photo(example()[0], options=FAST).people[0]
    owners = np.zeros(example()[1].shape, np.int32)
    owners[:8, :8] = 1
    evidence = person_evidence(found.keypoints, owners, 0)
    assert (evidence.groups, evidence.picture) == (None, None)
    owners[100:300, 150:250] = 1
    assert person_evidence(found.keypoints, owners, 0).picture is not None


def test_files_of_a_large_photo_are_as_large_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = np.asarray(Image.fromarray(example()[0]).resize((960, 1280)))
    found = fit_photo(picture, options=FAST, camera=Perspective.of_picture((1280, 960), fov=40))
    monkeypatch.setattr(overlays, "OVERLAY_SIDE", 256)
    assert found.hidden_by(0) == []
    save_photo_fit(found, tmp_path, photo=picture)
    for name in ("overlay.png", "people.png", "person0/overlay.png", "person0/detailed.png"):
        with Image.open(tmp_path / name) as image:
            assert image.size == (192, 256), name
    assert load_body(tmp_path / "person0" / "body.npz").image_size.tolist() == [1280, 960]
    with Image.open(tmp_path / "people.png") as image:
        tinted = np.abs(np.asarray(image).astype(int) - np.asarray(Image.fromarray(picture).resize((192, 256)))).max(2)
    owned = np.asarray(Image.fromarray((found.owners > 0).astype(np.uint8)).resize((192, 256), 0)) > 0
    assert (tinted[owned] > 20).mean() > 0.6 > 0.1 > (tinted[~owned] > 20).mean()


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is told in kB on Linux")
def test_a_photo_of_100_megapixels_takes_a_few_gigabytes(tmp_path: Path) -> None:
    """A person of 8000 pixels' height; torch and Warp alone take half a gigabyte."""
    picture = Image.new("RGB", (11547, 8660), tuple(example()[0][3, 3].tolist()))
    picture.paste(Image.fromarray(example()[0]).resize((6000, 8000)), (2500, 300))
    picture.save(tmp_path / "large.jpg", quality=90)
    code = (
        "import resource, sys\nfrom warp_partdr.cli.main import main\n"
        f"sys.argv = ['partdr', 'fit', {str(tmp_path / 'large.jpg')!r}, '--out', {str(tmp_path / 'out')!r}, "
        "'--device', 'cpu']\ntry: main()\n"
        "except SystemExit as left: assert not left.code\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.splitlines()[-1]) < 3.5e6  # [kB], with both landmark networks
    (person,) = json.loads((tmp_path / "out" / "people.json").read_text())["people"]
    left, top, right, bottom = person["box"]
    assert (bottom - top) > 6500
    assert person["measurements_cm"]
    assert 2500 < left < right < 8500
