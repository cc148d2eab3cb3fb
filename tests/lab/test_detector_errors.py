"""People get errors of those whom the detector saw alike: near in shape, in the same states, mirrored as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from warp_partdr.body.landmarks import mirror_order
from warp_partdr.body.template import JOINT_NAMES
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic import detector_errors
from warp_partdr.lab.synthetic.detector_errors import BEYOND, HIDDEN, SEEN, DetectorErrors, move_joints
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.networks.regression.landmarks import LANDMARKS

ROWS, COUNT = 8, 40  # as many rows as one is drawn of
ORDER = mirror_order(LANDMARKS)


def write(path: Path, kinds: list[dict[str, np.ndarray]]) -> Path:
    """A file with eight equal rows of each kind."""
    rows = [{"confidence": np.full(24, 0.5), "states": np.full(24, SEEN), **kind} for kind in kinds]
    arrays = {name: np.stack([row[name] for row in rows for _ in range(ROWS)]) for name in rows[0]}
    halves = {name: values.astype(np.uint8 if name == "states" else np.float16) for name, values in arrays.items()}
    np.savez(path, allow_pickle=False, **halves)
    return path


def tensor(values: np.ndarray, device: str) -> torch.Tensor:
    """COUNT times the same."""
    return torch.from_numpy(np.asarray(values)).to(device).expand(COUNT, *np.shape(values))


def drawn(
    path: Path, points: np.ndarray, states: np.ndarray, stature: float, device: str
) -> tuple[torch.Tensor, torch.Tensor]:
    people = tensor(points.astype(np.float32), device), tensor(states, device)
    return DetectorErrors(TorchRng(0, device), path).keypoints(*people, torch.full((COUNT,), stature, device=device))


@pytest.fixture
def pose(rng: np.random.Generator) -> dict[str, np.ndarray]:
    points, errors = rng.uniform(-0.5, 0.5, (24, 2)), 0.02 * rng.standard_normal((24, 2))
    return {"points": points.astype(np.float16), "errors": errors.astype(np.float16)}


def test_errors_are_added_in_statures_wherever_people_are(pose, device: str, tmp_path: Path) -> None:
    confidence, shift = np.linspace(0, 1, 24), np.array([0.3, -0.4])
    there = pose["points"] + shift / 1.7 + 0.1 * np.eye(24, 2)  # another person, in the same place
    others = [{"points": points, "errors": np.ones((24, 2))} for points in (1.7 * pose["points"], there)]
    path = write(tmp_path / "rows.npz", [*others, pose | {"confidence": confidence}])
    points = (pose["points"] * 1.7 + shift).astype(np.float32)
    keypoints, errors = drawn(path, points, np.full(24, SEEN), 1.7, device)
    expected = tensor(1.7 * pose["errors"].astype(np.float32), device)
    torch.testing.assert_close(errors, expected)
    torch.testing.assert_close(keypoints[:, 1:, :2], (tensor(points, device) + expected)[:, 1:])
    torch.testing.assert_close(keypoints[..., 2], tensor(confidence.astype(np.float16), device).float())
    assert (keypoints[:, 0] == 0).all()  # not known


def test_mirrored_people_get_mirrored_errors(pose, device: str, tmp_path: Path) -> None:
    path = write(tmp_path / "rows.npz", [pose | {"confidence": np.arange(24) / 32}])
    flip = np.array([-1.0, 1.0])
    mirrored = (pose["points"] * flip)[ORDER]
    keypoints, errors = drawn(path, mirrored, np.full(24, SEEN), 1.0, device)
    torch.testing.assert_close(errors, tensor((pose["errors"] * flip)[ORDER].astype(np.float32), device))
    assert torch.equal(keypoints[..., 2], tensor(ORDER / 32, device).float())


def test_whoever_is_hidden_or_cut_off_alike_is_nearer(pose, device: str, tmp_path: Path) -> None:
    states = [np.where(np.arange(24) < 6, state, SEEN) for state in (SEEN, HIDDEN, BEYOND)]
    kinds = [pose | {"states": some, "errors": np.full((24, 2), index)} for index, some in enumerate(states)]
    path = write(tmp_path / "rows.npz", kinds)
    for index, some in enumerate(states):
        moved = pose["points"] + 0.02 * np.eye(24, 2)
        assert (drawn(path, moved, some, 1.0, device)[1].abs() == index).all()
    # Hidden by something else than the border is less unlike than seen to the border's.
    partly = np.where(np.arange(24) < 3, HIDDEN, SEEN)
    assert (drawn(path, pose["points"], partly, 1.0, device)[1] < BEYOND).all()


def test_all_of_the_nearest_are_drawn_however_many_people_there_are(device: str) -> None:
    """Two of whom one is repeated so often that people are compared in parts."""
    errors, many = DetectorErrors(TorchRng(3, device)), 5000
    points = torch.rand(2, 24, 2, generator=torch.Generator().manual_seed(0)).to(device)
    points = torch.cat([points[:1].expand(many, -1, -1), points[1:]])
    people = points, torch.zeros(many + 1, 24, dtype=torch.int64, device=device), torch.ones(many + 1, device=device)
    found = errors.keypoints(*people)[1][:, 0, 0]
    assert len(found[:many].unique()) == len(found[4100:many].unique()) == 8
    assert found[many] not in found[:many]
    nobody = [each[:0] for each in people]
    assert DetectorErrors(TorchRng(3, device)).keypoints(*nobody)[0].shape == (0, 24, 3)


def test_packaged_rows_are_of_a_good_detector_and_of_many_people(device: str) -> None:
    errors = DetectorErrors(TorchRng(0, device))
    assert len(errors) > 4000
    unknown = {LANDMARKS[place] for place in (~errors.known).nonzero()[:, 0].tolist()}
    assert unknown == {"neck", "head_top", "mid_hip"}
    path = Path(detector_errors.__file__).parents[2] / "assets" / "detector_errors.npz"
    assert path.stat().st_size < 720_000
    with np.load(path, allow_pickle=False) as rows:
        off = np.linalg.norm(rows["errors"].astype(np.float32), axis=2)
        sure, seen = rows["confidence"] > 0.9, rows["states"] == SEEN
        assert np.abs(rows["points"].mean(1, dtype=np.float32)).max() < 1e-3
        spans = np.ptp(rows["points"].astype(np.float32), axis=1).max(1)
        assert 0.6 < np.median(spans) < 1.0  # statures
        assert 0.01 < np.median(off[sure & seen]) < 0.03
        assert np.median(off[rows["states"] == BEYOND]) > 2 * np.median(off[seen & sure])
        assert rows["confidence"][seen].mean() > rows["confidence"][rows["states"] == BEYOND].mean() + 0.3


def test_joints_move_as_landmarks_about_them(device: str) -> None:
    errors = torch.zeros(1, 24, 2, device=device)
    for name, error in {"left_wrist": 1.0, "left_hip": 0.4, "right_hip": 0.2, "right_shoulder": 0.6}.items():
        errors[0, LANDMARKS.index(name)] = error
    moved = move_joints(torch.zeros(1, 21, 2, device=device), errors)[0]
    expected = {"left_wrist": 1.0, "left_fingertip": 1.0, "pelvis": 0.3, "spine": 0.3, "neck": 0.3}
    expected |= {"left_hip": 0.4, "right_hip": 0.2, "right_shoulder": 0.6}
    for name, row in zip(JOINT_NAMES, moved.tolist(), strict=True):
        assert row == pytest.approx([expected.get(name, 0.0)] * 2), name


@pytest.mark.parametrize("broken", ["short", "bent", "empty"])
def test_other_files_are_refused(pose, broken: str, tmp_path: Path) -> None:
    path = write(tmp_path / "rows.npz", [pose])
    with np.load(path) as file:
        arrays = dict(file)
    if broken == "short":
        arrays["errors"] = arrays["errors"][:, :23]
    elif broken == "bent":
        arrays["points"][0, 0, 0] = np.nan
    else:
        arrays = {name: values[:4] for name, values in arrays.items()}
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="learn_detector_errors"):
        DetectorErrors(TorchRng(0, "cpu"), path)
