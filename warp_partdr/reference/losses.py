"""Losses of training and of refinement (paper, eq. 3 to 6 and 19)."""

from __future__ import annotations

import numpy as np

IGNORE = 255  # label of pixels that count nowhere


def learning_objective(terms: dict[str, float], weights: dict[str, float]) -> float:
    """Eq. 3: L = lambda_3D L_3D + lambda_proj L_proj + lambda_seg L_seg.

    Args:
        terms: Losses L by name.
        weights: Weight lambda of each term by name, 0 for terms without truth in a picture.

    EllipBodyNet's training adds L_l and L_t of eq. 19 and cross entropies of its heads.
    """
    return sum(weights[name] * term for name, term in terms.items())


def joint_loss(joints: np.ndarray, wanted: np.ndarray, weights: np.ndarray | None = None) -> float:
    """Eq. 4: L_3D = sum over joints of ‖S - Ŝ‖².

    Args:
        joints: Joints S [m], shape (N, 3).
        wanted: True joints Ŝ [m], shape (N, 3).
        weights: Weight of each joint, shape (N,). The paper has none.

    Training takes the mean over the known joints, in centimetres, of positions from the middle of
    the hips.
    """
    squares = ((joints - wanted) ** 2).sum(1)
    return float((np.ones(len(joints)) if weights is None else weights) @ squares)


def projection_loss(points: np.ndarray, wanted: np.ndarray, votes: np.ndarray | None = None) -> float:
    """Eq. 5: L_proj = sum over keypoints of ‖S_2D - Ŝ_2D‖_1.

    Args:
        points: Projected joints S_2D, shape (L, 2), in pixels of a crop of 256 px.
        wanted: Keypoints Ŝ_2D at which the joints are seen, shape (L, 2).
        votes: Weight of each keypoint, shape (L,). The paper has none. Ours is a detector's
            confidence, and the landmarks of one part share one.
    """
    distances = np.abs(points - wanted).sum(1)
    return float((np.ones(len(points)) if votes is None else votes) @ distances)


def segmentation_loss(maps: np.ndarray, wanted: np.ndarray, known: np.ndarray | None = None) -> float:
    """Eq. 6: L_seg = sum over parts k and pixels (i, j) of (A^k - Â^k)².

    Args:
        maps: Maps A of the parts, shape (K, H, W).
        wanted: Maps Â of labels or probabilities, shape (K, H, W).
        known: Mask, 0 at pixels that count nowhere (label 255), shape (H, W). The paper knows all.

    Kernels find it from two label images, without maps.
    """
    squares = ((maps - wanted) ** 2).sum(0)
    return float((squares if known is None else squares * known).sum())


def label_gradient(labels: np.ndarray, target: np.ndarray, num_labels: int) -> np.ndarray:
    """Derivative of eq. 6, g = dL_seg/dA, for a label image and its target, as maps (K, H, W).

    Args:
        labels: Labels that are shown, shape (H, W).
        target: Labels that are wanted, shape (H, W); 255 is ignored.
        num_labels: Number of parts K.
    """
    index = np.arange(1, num_labels + 1)[:, None, None]
    g = 2.0 * ((labels == index).astype(float) - (target == index))
    return np.where(target == IGNORE, 0.0, g)


def size_loss(sizes: np.ndarray, usual: np.ndarray) -> float:
    """L_l or L_t of eq. 19: ‖l - l_mean‖², in square millimetres of sizes in metres."""
    return float((((sizes - usual) * 1000) ** 2).sum())


def refinement_energy(l_seg: float, l_proj: float, l_l: float, l_t: float, weights: dict[str, float]) -> float:
    """Eq. 19: E(r, l, t, c) = lambda_seg L_seg + lambda_proj L_proj + lambda_l L_l + lambda_t L_t.

    Args:
        l_seg: Eq. 6 [px of a crop of 256 px, whatever size is drawn].
        l_proj: Eq. 5 [px of the same].
        l_l: Term ‖l - l_mean‖² of the 12 lengths l [mm²], see ``size_loss``.
        l_t: Term ‖t - t_mean‖² of the 15 thicknesses t [mm²].
        weights: Weight lambda of "seg", "proj", "l" and "t". The paper has 1e-2, 1, 1e-3, 1e-3, and
            no units.

    r are rotations and c the camera. A fit adds a pose prior, joint limits and a hold in depth.
    """
    return weights["seg"] * l_seg + weights["proj"] * l_proj + weights["l"] * l_l + weights["t"] * l_t
