"""Arguments of another type, and numbers that are no integers, are named at the border."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import warp_partdr
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.icosphere import icosphere
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.cameras import WeakPerspective
from warp_partdr.errors import check_each, check_type, check_whole, install_command
from warp_partdr.inputs.keypoint_files import parse_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.interop.checks import check_image_size
from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.models.registration import register
from warp_partdr.networks.regression.predict import predict_bodies
from warp_partdr.render.ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.results.save import save_fit
from warp_partdr.solve.ellipsoids.refine import refine
from warp_partdr.solve.ellipsoids.stages import Stage

PEOPLE = parse_keypoints([[[10.0 + k, 20.0 + 2 * k] for k in range(17)]] * 2)
PERSON = PEOPLE[0]
PARTS = PartLabels(label_set("cdcl14"), np.ones((64, 64), dtype=np.uint8))
BODY = BodyParameters.mean(1)
CAMERA = WeakPerspective(torch.tensor([4.0]), torch.tensor([[4.0, 4.0]]))
OUT = Path("never")
CALLS: list[tuple[Callable[[], Any], str]] = [
    (lambda: warp_partdr.fit_body(np.zeros((17, 3))), "keypoints: ndarray; expected Keypoints2D.*read_keypoints"),
    (lambda: warp_partdr.fit_body(PEOPLE), "keypoints: list; expected Keypoints2D.*choose_person"),
    (lambda: warp_partdr.fit_body(None), "keypoints: NoneType; expected Keypoints2D"),
    (lambda: warp_partdr.fit_body(PERSON, PARTS.groups), "parts: ndarray; expected PartLabels or None, of read_parts"),
    (lambda: warp_partdr.fit_body(PERSON, others=PERSON), "others: Keypoints2D; expected a sequence of Keypoints2D"),
    (lambda: warp_partdr.fit_body(PERSON, others=[PERSON, 3]), r"others\[1\]: int; expected Keypoints2D"),
    (lambda: warp_partdr.fit_body(PERSON, options="fast"), "options: str; expected FitOptions or None, such as"),
    (lambda: observe(np.zeros((17, 3)), None), "keypoints: ndarray; expected Keypoints2D"),
    (lambda: choose_person(PERSON), "people: Keypoints2D; expected a sequence of Keypoints2D"),
    (lambda: choose_person([np.zeros((17, 3))]), r"people\[0\]: ndarray; expected Keypoints2D"),
    (lambda: choose_person(PEOPLE, PARTS), "groups: PartLabels; expected ndarray or None"),
    (lambda: save_fit(BODY, OUT), "result: BodyParameters; expected FitResult, of fit_body"),
    (lambda: register(BODY, warp_partdr.anny()), "posed: BodyParameters; expected Posed"),
    (lambda: register(BODY.posed(), "anny"), "model: str; expected DetailedModel, of load_model"),
    (lambda: register(BODY.posed(), warp_partdr.anny(), start=BODY), "start: BodyParameters; expected Registered"),
    (lambda: register(BODY.posed(), warp_partdr.anny(), options=3), "options: int; expected RegistrationOptions"),
    (lambda: refine(BODY.posed(), dict), "start: Posed; expected BodyParameters"),
    (lambda: refine(BODY, 3), "energy: int; expected an Energy or a function"),
    (lambda: predict_bodies(PERSON, None), "observations: Keypoints2D; expected a sequence of Observation"),
    (lambda: predict_bodies([PERSON], None), r"observations\[0\]: Keypoints2D; expected Observation, of observe"),
    (lambda: predict_bodies([], "network.safetensors"), "network: str; expected LabelNetwork, of load_label_network"),
    (lambda: warp_partdr.draw_ellipsoids(BODY, CAMERA, (8, 8)), "ellipsoids: BodyParameters; expected Ellipsoids or"),
    (lambda: warp_partdr.draw_ellipsoids(BODY.posed(), 3.0, (8, 8)), "camera: float; expected WeakPerspective or"),
    (
        lambda: warp_partdr.ellipsoid_label_loss(BODY, CAMERA, torch.zeros(1, 8, 8, dtype=torch.uint8)),
        "ellipsoids: BodyParameters; expected Ellipsoids or Posed",
    ),
    (
        lambda: warp_partdr.draw_mesh(torch.zeros(1, 240, 3), ellipbody_mesh(0).faces, CAMERA, (8, 8)),
        "mesh: Tensor; expected PartMesh",
    ),
]


@pytest.mark.parametrize(("call", "says"), CALLS, ids=[says.split(";")[0] for _, says in CALLS])
def test_other_types_are_named(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(TypeError, match=f"^{says}"):
        call()
    assert not OUT.exists()


def test_no_observation_is_refused() -> None:
    with pytest.raises(ValueError, match="observations: none"):
        predict_bodies([], warp_partdr.load_label_network())


def test_messages_say_the_type_that_was_expected() -> None:
    check_type("value", None, int | None, "of somewhere")
    check_each("values", (1, 2), int, "of somewhere")
    with pytest.raises(TypeError, match=r"^value: str; expected int or None, of somewhere$"):
        check_type("value", "1", int | None, "of somewhere")
    with pytest.raises(TypeError, match=r"^values: str; expected a sequence of str, of somewhere$"):
        check_each("values", "12", str, "of somewhere")


NO_INTEGERS = [1.9, 1.0, True, np.bool_(True), np.float32(1), "1", None]


def draw(**options: Any) -> Any:
    size = options.pop("image_size", (8, 8))
    return draw_ellipsoids(BODY.posed(), CAMERA, size, **options)


def rasterize(**options: Any) -> Any:
    size = options.pop("image_size", (8, 8))
    return draw_mesh(BODY.posed().vertices(0), ellipbody_mesh(0), CAMERA, size, **options)


ARGUMENTS = {
    "part_labels": lambda value: draw(part_labels=[value] * 20),
    "part_labels of a loss": lambda value: ellipsoid_label_loss(
        BODY.posed(), CAMERA, torch.zeros(1, 8, 8, dtype=torch.uint8), part_labels=[value] * 20
    ),
    "num_maps": lambda value: draw(num_maps=value),
    "image_size": lambda value: draw(image_size=(value, 8)),
    "image_size of a mesh": lambda value: rasterize(image_size=(8, value)),
    "num_maps of a mesh": lambda value: rasterize(num_maps=value),
    "subdivisions": icosphere,
    "subdivisions of a mesh": ellipbody_mesh,
    "subdivisions of vertices": BODY.posed().vertices,
    "index": lambda value: EllipBody.mean(2, device="cpu").measure(value),
    "batch_size": BodyParameters.mean,
    "batch_size of EllipBody": lambda value: EllipBody.mean(value, device="cpu"),
    "bodies": lambda value: Stage("some", value, 1, 0.1),
    "size": lambda value: Stage("some", 1, 1, 0.1, size=value),
    "iterations": lambda value: Stage("some", 1, value, 0.1),
    "person": lambda value: choose_person(PEOPLE, None, value),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_integer_arguments_take_integers_of_any_library_and_nothing_else(name: str) -> None:
    call = ARGUMENTS[name]
    call(1)  # first, so that what is kept of it is not found for the others
    for value in (np.int64(1), np.uint8(1), torch.tensor(1)):
        call(value)
    for value in NO_INTEGERS:
        if name == "person" and value is None:
            continue  # whom to take by default
        with pytest.raises(ValueError, match=f"^{name.split()[0]}: .*expected (an|two positive) integer"):
            call(value)


def test_what_comes_back_is_an_int() -> None:
    assert type(check_whole("count", np.int64(3), 0)) is int
    assert [type(size) for size in check_image_size((np.int64(3), np.uint8(4)))] == [int, int]
    stage = Stage("some", np.int64(3), np.int64(4), 0.1, np.int64(5))
    assert [type(value) for value in (stage.bodies, stage.iterations, stage.size)] == [int] * 3


def test_numbers_out_of_range_name_the_range() -> None:
    assert check_whole("count", 3, 3, 3) == 3
    for value in (2, 5, 10**400):
        with pytest.raises(ValueError, match=r"^count: .*; expected an integer from 3 to 4$"):
            check_whole("count", value, 3, 4)
    with pytest.raises(ValueError, match=r"^count: -1; expected an integer of 0 or more$"):
        set_num_threads(-1)
    with pytest.raises(ValueError, match=r"^part_labels: 2 of them; expected 20"):
        draw(part_labels=[1, 2])


def test_hints_name_packages_that_an_index_has(monkeypatch):
    """The package itself is on none; a hint ``pip install warp-partdr[film]`` fails."""
    stated = ["numpy>=1.26", 'av>=18; extra == "film"', 'pandas>=2 ; extra == "ray"', "ray>=2.50; extra == 'ray'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: {"warp-partdr": stated}[name])
    assert install_command("film") == "pip install 'av>=18'"
    assert install_command("ray") == "pip install 'pandas>=2' 'ray>=2.50'"
    assert install_command("other") == "pip install '.[other]' in the folder of warp-partdr"

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.requires", missing)
    assert install_command("film") == "pip install '.[film]' in the folder of warp-partdr"


def test_no_hint_and_no_page_installs_the_package_from_an_index():
    root = Path(__file__).resolve().parents[1]
    if not (root / "pyproject.toml").exists():
        pytest.skip("needs the repository around the tests")
    places = ("*.md", "docs/**/*.md", "warp_partdr/**/*.py", "demos/**/*.py")
    files = [path for place in places for path in root.glob(place) if path.name != "errors.py"]
    assert len(files) > 100
    assert [path.name for path in files if re.search("install '?warp-partdr", path.read_text())] == []
