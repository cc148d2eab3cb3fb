"""Learn ``warp_partdr/assets/pose_prior.npz`` from motion capture.

    python scripts/learn_pose_prior.py MOCAP_FOLDER [--out FILE]

The mixture is fitted by expectation-maximisation in mirrored pairs of components. Clips of one activity hold the same
few poses thousands of times, so near copies are merged, and activities count by the square root of what is in them.
Run it again when the template's rest directions change: joint rotations are relative to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich import print
from rich.progress import track
from rich.table import Table

from warp_partdr.body.landmarks import without_side
from warp_partdr.body.pose_prior import FREE_PARTS, PosePrior, mirror_features
from warp_partdr.body.template import NUM_PARTS, PART_NAMES, template
from warp_partdr.lab.harness import run_script
from warp_partdr.lab.synthetic import mocap, mocap_files

ORDER, SIGN = mirror_features()

# Poses nearer than this are copies: root mean square distance of joints, heading removed [m].
COPY_DISTANCE = 0.05

# Least standard deviation of a component along a feature [rad]. Mocap freezes what its markers don't see (clavicles,
# one-axis knees and elbows) and hardly knows how wrists and ankles are turned; people and other skeletons are looser.
MIN_DEVIATION = {"shoulder": 0.15, "foot": 0.15, "hand": 0.25}
MIN_DEVIATION_ELSEWHERE = 0.1
# The same for the up direction: 6 degrees, about the tilt of a hand-held camera.
MIN_DEVIATION_UP = 0.1

# Joint limits lie this far outside the percentiles of mocap [rad].
LIMIT_PERCENTILES = (0.5, 99.5)
LIMIT_MARGIN = {"shoulder": 0.35, "foot": 0.2, "hand": 0.3}
LIMIT_MARGIN_ELSEWHERE = 0.15
# How far a knee or an elbow may be overstretched [rad].
OVERSTRETCH = 0.08

# DeepMimic is mostly acrobatics, which photos seldom show.
DEEPMIMIC_WEIGHT = 0.5
# Share of one Gaussian over everything, which keeps the cost of poses that no clip shows from growing without end.
BROAD_WEIGHT = 0.05

# Covariance with which every component starts, as a part of that of all poses.
START_SPREAD = 0.3
PAIRS, ITERATIONS, RESTARTS = 6, 40, 6  # mirrored pairs of Gaussians, of expectation-maximisation; the best is kept
EXEMPLARS = 32  # representative poses


@dataclass
class Mixture:
    """Gaussians with a covariance each; the second half mirrors the first."""

    weights: np.ndarray  # (K,)
    means: np.ndarray  # (K, D)
    covariances: np.ndarray  # (K, D, D)

    def log_joint(self, features: np.ndarray) -> np.ndarray:
        """Log of weight times density, shape (F, K)."""
        columns = []
        for weight, mean, covariance in zip(self.weights, self.means, self.covariances, strict=True):
            factor = np.linalg.cholesky(covariance)
            whitened = np.linalg.solve(factor, (features - mean).T)
            columns.append(np.log(weight) - np.log(np.diag(factor)).sum() - 0.5 * (whitened**2).sum(0))
        return np.stack(columns, axis=1)


def features_of(clip: mocap.Clip) -> np.ndarray:
    """The prior's features, shape (F, 57)."""
    return np.concatenate(
        [clip.rotation_vectors()[:, list(FREE_PARTS)].reshape(len(clip), -1), clip.up_directions()], axis=1
    )


def mirror(features: np.ndarray) -> np.ndarray:
    """Features of the mirrored poses."""
    return features[..., ORDER] * SIGN


def activity(name: str) -> str:
    """Activity of a clip by its name: ``expmap.train.walking_12`` is walking, ``asf.01_03`` subject 01."""
    source, clip = name.split(".", 1)
    if source == "expmap":
        return f"{source}.{clip.split('.')[1].rstrip('_0123456789')}"
    return f"{source}.{clip.split('_')[0]}" if source == "asf" else name


def joint_features(clip: mocap.Clip) -> np.ndarray:
    """Joints with the heading removed, scaled so that Euclidean distance is the root mean square one [m], (F, 60)."""
    forward = clip.global_orient[:, :, 2] * [1.0, 0.0, 1.0]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True) + 1e-9
    up = np.broadcast_to([0.0, 1.0, 0.0], forward.shape)
    heading = np.stack([np.cross(up, forward), up, forward], axis=1)
    joints = mocap.joint_positions(heading @ clip.global_orient, clip.rotations)[:, 1:]
    return joints.reshape(len(joints), -1) / np.sqrt(NUM_PARTS)


def merge_copies(points: np.ndarray, distance: float, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Indices of points no two of which are near, and how many points each stands for."""
    kept = np.empty_like(points)
    counts = np.zeros(len(points))
    indices: list[int] = []
    for index in track(random.permutation(len(points)), "merging near copies"):
        if indices:
            squared = ((kept[: len(indices)] - points[index]) ** 2).sum(1)
            nearest = int(squared.argmin())
            if squared[nearest] < distance**2:
                counts[nearest] += 1
                continue
        kept[len(indices)] = points[index]
        counts[len(indices)] = 1
        indices.append(int(index))
    return np.array(indices), counts[: len(indices)]


def frame_weights(counts: np.ndarray, activities: np.ndarray) -> np.ndarray:
    """Weights of frames, sum 1: activities count by the square root of what is in them, so does a pose in its own."""
    weights = np.sqrt(counts)
    for name in np.unique(activities):
        own = activities == name
        scale = DEEPMIMIC_WEIGHT if name.startswith("deepmimic") else 1.0
        weights[own] *= scale / np.sqrt(weights[own].sum())
    return weights / weights.sum()


def least_variances() -> np.ndarray:
    """Floor of each feature's variance, shape (57,)."""
    deviations = [MIN_DEVIATION.get(without_side(PART_NAMES[part]), MIN_DEVIATION_ELSEWHERE) for part in FREE_PARTS]
    return np.append(np.repeat(deviations, 3), [MIN_DEVIATION_UP] * 3) ** 2


def fit_mixture(data: np.ndarray, weights: np.ndarray, random: np.random.Generator) -> tuple[Mixture, float]:
    """Expectation-maximisation on poses and their mirror images; also returns the mean log-likelihood.

    With mirrored data, what holds for a component holds for its twin.
    """
    floor = np.diag(least_variances())
    _, covariance = moments(data, weights)

    # Start: poses far from each other, drawn as in k-means++.
    scale = 1 / np.sqrt(np.diag(covariance + floor))
    seeds = [random.choice(len(data), p=weights)]
    squared = np.full(len(data), np.inf)
    while len(seeds) < PAIRS:
        for seed in (data[seeds[-1]], mirror(data[seeds[-1]])):
            squared = np.minimum(squared, (((data - seed) * scale) ** 2).sum(1))
        seeds.append(random.choice(len(data), p=squared * weights / (squared @ weights)))
    starts = np.tile(START_SPREAD * covariance + floor, (PAIRS, 1, 1))
    mixture = with_twins(np.full(PAIRS, 0.5 / PAIRS), data[seeds], starts)

    likelihood = -np.inf
    for _ in track(range(ITERATIONS), "fitting"):
        log_joint = mixture.log_joint(data)
        top = log_joint.max(1, keepdims=True)
        shares = np.exp(log_joint - top)
        total = shares.sum(1, keepdims=True)
        likelihood = float(weights @ (top + np.log(total))[:, 0])
        shares *= weights[:, None] / total
        # The twins are mirrored, not fitted: rounding would grow until the two differ.
        sums = shares[:, :PAIRS].sum(0)
        means = (shares[:, :PAIRS].T @ data) / sums[:, None]
        covariances = np.empty((PAIRS, data.shape[1], data.shape[1]))
        for k in range(PAIRS):
            offsets = data - means[k]
            covariances[k] = offsets.T @ (offsets * shares[:, k : k + 1]) / sums[k] + floor
        mixture = with_twins(sums / (2 * sums.sum()), means, covariances)
    return mixture, likelihood


def moments(data: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean, shape (D,), and covariance, shape (D, D), of data (F, D)."""
    mean = weights @ data
    return mean, (data - mean).T @ ((data - mean) * weights[:, None])


def with_twins(weights: np.ndarray, means: np.ndarray, covariances: np.ndarray) -> Mixture:
    mirrored = covariances[:, ORDER][:, :, ORDER] * np.outer(SIGN, SIGN)
    return Mixture(
        np.concatenate([weights, weights]),
        np.concatenate([means, mirror(means)]),
        np.concatenate([covariances, mirrored]),
    )


def with_broad_component(mixture: Mixture, data: np.ndarray, weights: np.ndarray) -> Mixture:
    """The first components of the pairs, and one Gaussian over all poses and mirror images.

    That one is its own mirror image; as every component stands for two, it gets half its share.
    """
    mean, covariance = moments(data, weights)
    return Mixture(
        np.append(mixture.weights[:PAIRS] * (1 - BROAD_WEIGHT), BROAD_WEIGHT / 2),
        np.append(mixture.means[:PAIRS], mean[None], axis=0),
        np.append(mixture.covariances[:PAIRS], (covariance + np.diag(least_variances()))[None], axis=0),
    )


def choose_exemplars(points: np.ndarray, weights: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Weighted k-means on poses and mirror images: indices of the poses nearest the centres, heaviest cluster first."""
    chosen = [random.choice(len(points), p=weights)]
    while len(chosen) < EXEMPLARS:
        squared = ((points[:, None] - points[None, chosen]) ** 2).sum(-1).min(1)
        chosen.append(random.choice(len(points), p=squared * weights / (squared @ weights)))
    centres = points[chosen]
    for _ in track(range(30), "choosing exemplars"):
        squared = ((points**2).sum(1)[:, None] - 2 * points @ centres.T) + (centres**2).sum(1)
        owner = squared.argmin(1)
        for k in range(EXEMPLARS):
            if (owner == k).any():
                centres[k] = np.average(points[owner == k], axis=0, weights=weights[owner == k])
    heaviest = np.argsort(-np.bincount(owner, weights, minlength=EXEMPLARS))
    return squared.argmin(0)[heaviest]


def joint_limits(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest rotation vector components [rad], shape (20, 3) each, the same for both sides.

    Args:
        vectors: Rotation vectors of poses and of their mirror images, shape (F, 20, 3).
    """
    lower, upper = np.percentile(vectors, LIMIT_PERCENTILES, axis=0)
    for part, name in enumerate(PART_NAMES):
        margin = LIMIT_MARGIN.get(without_side(name), LIMIT_MARGIN_ELSEWHERE)
        lower[part] -= margin
        upper[part] += margin
        if without_side(name) == "lower_leg":
            # Knees bend about +x only: the shank goes backward.
            lower[part, 0] = -OVERSTRETCH
        elif without_side(name) == "forearm":
            # Elbows bring the hand forward: a left one turns about (0, -0.87, 0.5) in CMU's skeleton, a right one about
            # the mirror image.
            if name.startswith("left"):
                upper[part, 1], lower[part, 2] = OVERSTRETCH, -OVERSTRETCH
            else:
                lower[part, 1], upper[part, 2] = -OVERSTRETCH, OVERSTRETCH
    return lower, upper


def report(prior: PosePrior, learned: mocap.Clip, held_out: mocap.Clip) -> None:
    """Print the prior's values of poses it learned from, of others, and of impossible ones."""
    table = Table("poses", "NLL mean", "median", "90 %", "limits mean [rad²]", "over limits", title="pose prior")
    turns = held_out.rotation_vectors()
    knee, elbow, chest = (PART_NAMES.index(name) for name in ("left_lower_leg", "right_forearm", "chest"))
    knees = held_out[np.abs(turns[:, knee, 0]) > 0.5]
    elbows = held_out[np.linalg.norm(turns[:, elbow], axis=1) > 0.5]
    upright = held_out[held_out.up_directions()[:, 1] > 0.95]

    def add(name: str, clip: mocap.Clip, vectors: np.ndarray | None = None, up: np.ndarray | None = None) -> None:
        vectors = torch.from_numpy(clip.rotation_vectors() if vectors is None else vectors).float()
        nll = prior(vectors, torch.from_numpy(clip.up_directions() if up is None else up).float()).numpy()
        excess = prior.joint_limits(vectors).numpy()
        values = [f"{value:.1f}" for value in (nll.mean(), np.median(nll), np.percentile(nll, 90))]
        table.add_row(name, *values, f"{excess.mean():.4f}", f"{100 * (excess > 0).mean():.0f} %")

    def turned(clip: mocap.Clip, part: int, factor: float = 1.0, added: tuple[float, ...] = (0.0,)) -> np.ndarray:
        vectors = clip.rotation_vectors()
        vectors[:, part] = vectors[:, part] * factor + added
        return vectors

    def leaning(clip: mocap.Clip, axis: int, degrees: float) -> np.ndarray:
        return clip.up_directions() @ mocap.rotation_matrices(np.radians(degrees) * np.eye(3)[axis]).T

    add("learned from (weighted frames)", learned)
    add("held-out clips", held_out)
    add("held out, left knee bent over 0.5 rad", knees)
    add("   that knee reversed", knees, turned(knees, knee, -1.0))
    add("held out, right elbow bent over 0.5 rad", elbows)
    add("   that elbow reversed", elbows, turned(elbows, elbow, -1.0))
    add("held out, pelvis upright", upright)
    add("   leaning 40° forward", upright, up=leaning(upright, 0, -40))
    add("   leaning 40° backward", upright, up=leaning(upright, 0, 40))
    add("   leaning 40° to the side", upright, up=leaning(upright, 2, 40))
    add("   chest twisted by 60°", upright, turned(upright, chest, added=(0.0, np.pi / 3, 0.0)))
    print(table)


DEFAULT = Path(__file__).parents[1] / "warp_partdr" / "assets" / "pose_prior.npz"


def main(folder: Path, /, *, out: Path = DEFAULT) -> None:
    """Learn and write.

    Args:
        folder: Folder with cmu_expmap.npz, cmu_asfamc/, deepmimic/ (any of them).
        out: File to write; by default the package's own.
    """
    random = np.random.default_rng(0)

    clips = [mocap.without_errors(clip) for clip in mocap_files.load_clips(folder)]
    learned = [clip for clip in clips if not mocap.is_held_out(clip)]
    all_frames = mocap.concatenate(learned, "learned")
    labels = np.concatenate([np.full(len(clip), activity(clip.name), dtype=object) for clip in learned])
    indices, counts = merge_copies(joint_features(all_frames), COPY_DISTANCE, random)
    frames = all_frames[indices]
    weights = frame_weights(counts, labels[indices].astype(str))
    held_out_count = sum(len(clip) for clip in clips) - len(all_frames)
    print(f"{len(all_frames)} frames, {len(frames)} of them different; {held_out_count} held out")

    # Every pose and its mirror image, at half its weight each.
    both_weights = np.concatenate([weights, weights]) / 2
    features = features_of(frames)
    data = np.concatenate([features, mirror(features)])
    fits = [fit_mixture(data, both_weights, random) for _ in range(RESTARTS)]
    best, likelihood = max(fits, key=lambda fit: fit[1])
    mixture = with_broad_component(best, data, both_weights)
    print("mean log-likelihoods " + ", ".join(f"{fit[1]:.2f}" for fit in fits) + f"; kept {likelihood:.2f}")

    both = mocap.concatenate([frames, frames.mirrored()], "both")
    vectors, ups = both.rotation_vectors(), both.up_directions()
    exemplars = choose_exemplars(joint_features(both), both_weights, random)
    lower, upper = joint_limits(vectors)
    mean_up = both_weights @ ups
    arrays = {
        "weights": mixture.weights,
        "means": mixture.means,
        "whitening": np.linalg.inv(np.linalg.cholesky(mixture.covariances)),
        "mean_pose": np.tensordot(both_weights, vectors, 1),
        "mean_up": mean_up / np.linalg.norm(mean_up),
        "lower_limits": lower,
        "upper_limits": upper,
        "rest_directions": template().rest_directions,
    }
    np.savez_compressed(
        out,
        allow_pickle=False,
        **{name: values.astype(np.float32) for name, values in arrays.items()},
        exemplars=vectors[exemplars].astype(np.float16),
        exemplar_ups=ups[exemplars].astype(np.float16),
        credit=np.array(
            "Learned from motion capture of mocap.cs.cmu.edu (created with funding from NSF EIA-0196217) "
            "and from DeepMimic's clips (MIT)."
        ),
    )
    print(f"{out}: {out.stat().st_size / 1024:.0f} KiB")

    shown = random.choice(len(frames), size=2000, p=weights)
    with torch.no_grad():
        report(PosePrior(out), frames[shown], mocap_files.held_out_frames(folder, 2000))


if __name__ == "__main__":
    run_script(main)
