"""Accuracy of part labels, joints and meshes, as the field computes it, and how sure one can be of it.

Labels are counted into matrices, joints and vertices give distances. Both take tensors, on any device, or NumPy arrays.
Counts come back as NumPy, for they are small, and are pooled and resampled there; distances as tensors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import torch

from .body.labels import BACKGROUND, IGNORE
from .errors import check_whole
from .interop.checks import check_finite

__all__ = [
    "accuracy",
    "bootstrap_sum",
    "confusion",
    "f1_scores",
    "foreground_counts",
    "mpjpe",
    "pa_mpjpe",
    "part_f1",
    "pooled",
    "pve",
]

Array = np.ndarray | torch.Tensor

RESAMPLES = 10_000  # of the bootstrap
CONFIDENCE = 0.95
_MANY = 1_000  # people; above it resamples become fewer, so that the work stays the same,
_ENOUGH = 1_000  # down to this many
_BLOCK = 1 << 22  # numbers that are resampled at a time


def confusion(predicted: Array, target: Array, num_classes: int, *, ignored_is_background: bool = False) -> np.ndarray:
    """Counts of (target class, predicted class) of each picture, shape (..., C, C), int64.

    Add those of several pictures (``pooled``) before taking an F1, as the LSP segmentation metric does.

    Args:
        predicted: Class ids, integers of shape (..., H, W); 255 counts as background.
        target: True class ids, the same shape; 0 is background, and 255 is ignored.
        num_classes: Number of classes C, including background.
        ignored_is_background: True counts pixels whose target is 255 as background, as LSP's part accuracy does. By
            default they do not count, as in its F1.

    Raises:
        ValueError: If the shapes differ, or ``num_classes`` or a class is out of range.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import confusion
        >>> confusion(np.array([[0, 1, 2]]), np.array([[0, 1, 1]]), num_classes=3)
        array([[1, 0, 0],
               [0, 1, 1],
               [0, 0, 0]])
    """
    num_classes = check_whole("num_classes", num_classes, 1)
    want = _tensor("target", target).to(torch.int64)
    have = _tensor("predicted", predicted).to(want)
    if have.shape != want.shape:
        raise ValueError(f"predicted: shape {tuple(have.shape)}; expected {tuple(want.shape)}, as target")
    if want.ndim < 2:
        raise ValueError(f"target: shape {tuple(want.shape)}; expected (..., H, W)")
    have = have.masked_fill(have == IGNORE, BACKGROUND)
    if ignored_is_background:
        want = want.masked_fill(want == IGNORE, BACKGROUND)
    counted = want != IGNORE
    for name, values in (("predicted", have), ("target", want)):
        wrong = counted & ((values < 0) | (values >= num_classes))
        if bool(wrong.any()):
            found = int(values[wrong][0])
            raise ValueError(f"{name}: class {found}; expected 0 to {num_classes - 1}, or {IGNORE} = ignore")
    batch = want.shape[:-2]
    num_counts = batch.numel() * num_classes**2
    pictures = torch.arange(batch.numel(), device=want.device).reshape(*batch, 1, 1)
    index = ((pictures * num_classes + want) * num_classes + have).masked_fill_(~counted, num_counts)
    counts = torch.bincount(index.flatten(), minlength=num_counts + 1)[:num_counts]
    return counts.reshape(*batch, num_classes, num_classes).cpu().numpy()


def pooled(matrices: Iterable[np.ndarray]) -> np.ndarray:
    """Sum of confusion counts over pictures.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import confusion, pooled
        >>> target = np.array([[0, 1, 1]])
        >>> pictures = [np.array([[0, 1, 2]]), np.array([[0, 1, 1]])]
        >>> pooled(confusion(picture, target, num_classes=3) for picture in pictures)
        array([[2, 0, 0],
               [0, 3, 1],
               [0, 0, 0]])
    """
    return np.sum(list(matrices), axis=0)


def foreground_counts(counts: np.ndarray) -> np.ndarray:
    """Merge all parts of confusion counts (..., K, K) into one class, shape (..., 2, 2).

    Class 0 stays the background.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import confusion, foreground_counts
        >>> counts = confusion(np.array([[0, 1, 2]]), np.array([[0, 1, 1]]), num_classes=3)
        >>> foreground_counts(counts)
        array([[1, 0],
               [0, 2]])
    """
    rows = np.stack([counts[..., 0, :], counts[..., 1:, :].sum(-2)], axis=-2)
    return np.stack([rows[..., 0], rows[..., 1:].sum(-1)], axis=-1)


def f1_scores(counts: np.ndarray) -> np.ndarray:
    """2 TP / (2 TP + FP + FN) of each class, shape (..., C); NaN for a class that is nowhere.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import confusion, f1_scores
        >>> counts = confusion(np.array([[0, 1, 2]]), np.array([[0, 1, 1]]), num_classes=3)
        >>> f1_scores(counts).round(2)
        array([1.  , 0.67, 0.  ])
    """
    hits = np.diagonal(counts, axis1=-2, axis2=-1).astype(np.float64)
    total = counts.sum(-1) + counts.sum(-2)
    return np.divide(2 * hits, total, out=np.full(hits.shape, np.nan), where=total > 0)


def part_f1(counts: np.ndarray) -> Any:
    """Unweighted mean F1 over all classes that occur, background included, shape (...): a float for one matrix.

    Foreground F1, the mean of background and person, is that of ``foreground_counts``.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import confusion, part_f1
        >>> counts = confusion(np.array([[0, 1, 2]]), np.array([[0, 1, 1]]), num_classes=3)
        >>> f"{part_f1(counts):.2f}"
        '0.56'
    """
    return np.nanmean(f1_scores(counts), axis=-1)


def accuracy(counts: np.ndarray) -> Any:
    """Share of pixels that are right, shape (...): a float for one matrix.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import accuracy, confusion
        >>> counts = confusion(np.array([[0, 1, 2]]), np.array([[0, 1, 1]]), num_classes=3)
        >>> f"{accuracy(counts):.2f}"
        '0.67'
    """
    return np.trace(counts, axis1=-2, axis2=-1) / np.maximum(counts.sum((-2, -1)), 1)


def mpjpe(points: Array, target: Array, *, centre_on: Sequence[int] = (), valid: Array | None = None) -> torch.Tensor:
    """Mean distance of joints [as given], shape (...).

    Args:
        points: Joints, shape (..., J, 3).
        target: True joints, the same shape.
        centre_on: Joints whose mean, the pelvis, is moved to the origin in both. Without any, joints stay where they
            are.
        valid: Mask of the joints that count, shape (..., J), bool. The others may be NaN. If none counts, the result is
            NaN.

    Raises:
        ValueError: If shapes differ, a joint that counts is NaN or infinite, or one of ``centre_on`` is not valid.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import mpjpe
        >>> target = np.zeros((2, 14, 3))
        >>> points = target + [0.0, 0.0, 0.05]  # 5 cm too far away
        >>> mpjpe(points, target)
        tensor([0.0500, 0.0500], dtype=torch.float64)
        >>> mpjpe(points, target, centre_on=(2, 3))  # pelvises at one point
        tensor([0., 0.], dtype=torch.float64)
    """
    points, target, weights = _checked(points, target, valid)
    if joints := list(centre_on):
        if not all(0 <= joint < points.shape[-2] for joint in joints):
            raise ValueError(f"centre_on: {joints}; expected some of {points.shape[-2]} joints")
        if not bool((weights[..., joints] > 0).all()):
            raise ValueError(f"valid: not all of joints {joints}; expected those that the body is centred on")
        points, target = (joint - joint[..., joints, :].mean(-2, keepdim=True) for joint in (points, target))
    return _mean_distance(points, target, weights)


def pa_mpjpe(points: Array, target: Array, *, valid: Array | None = None) -> torch.Tensor:
    """Mean distance of joints after the similarity (proper rotation, scale, translation) that brings them nearest.

    A mirror image stays one. Points that do not say how to turn (all on a line, or in one place) take one of the turns
    that are equally good.

    Args:
        points: Joints, shape (..., J, 3).
        target: True joints, the same shape.
        valid: Mask of the joints that are aligned and counted, shape (..., J), bool. The others may be NaN.

    Returns:
        Distances [as given], shape (...).

    Raises:
        ValueError: If shapes differ or a joint that counts is NaN or infinite.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import pa_mpjpe
        >>> target = np.random.default_rng(0).normal(size=(14, 3))
        >>> bool(pa_mpjpe(2 * target + 1, target) < 1e-6)  # larger and elsewhere, but the same pose
        True
    """
    points, target, weights = _checked(points, target, valid)
    return _mean_distance(_aligned(points, target, weights), target, weights)


def pve(vertices: Array, target: Array, *, pelvis: Array, target_pelvis: Array) -> torch.Tensor:
    """Mean distance of a mesh's vertices when the pelvises meet [as given], shape (...).

    Args:
        vertices: Vertices, shape (..., V, 3).
        target: True vertices in the same order, the same shape.
        pelvis: Position of the pelvis, shape (..., 3).
        target_pelvis: Position of the true pelvis, the same shape.

    Raises:
        ValueError: If shapes differ or something is NaN or infinite.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import pve
        >>> target = np.zeros((1, 100, 3))
        >>> points = target + [0.0, 0.0, 0.05]
        >>> pve(points, target, pelvis=points[:, 0] - [0.0, 0.02, 0.0], target_pelvis=target[:, 0])
        tensor([0.0200], dtype=torch.float64)
    """
    vertices, target, weights = _checked(vertices, target, None)
    pelvis, target_pelvis, _ = _checked(pelvis, target_pelvis, None)
    return _mean_distance(vertices - pelvis[..., None, :], target - target_pelvis[..., None, :], weights)


def _tensor(name: str, values: Array) -> torch.Tensor:
    """Dense numbers, where they are."""
    if not isinstance(values, torch.Tensor | np.ndarray):
        raise TypeError(f"{name}: {type(values).__name__}; expected a tensor or an array")
    tensor = torch.as_tensor(values)
    if tensor.layout != torch.strided or tensor.is_meta or tensor.is_complex():
        raise ValueError(f"{name}: {tensor.dtype}, {tensor.layout} on {tensor.device}; expected dense numbers")
    return tensor


def _checked(points: Array, target: Array, valid: Array | None) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Both as tensors of one kind, 0 where invalid, and the weight of each point, 0 or 1, shape (..., J)."""
    have = _tensor("points", points)
    have = have if have.dtype == torch.float64 else have.float()
    want = _tensor("target", target).to(have)
    if have.shape != want.shape or have.ndim < 1 or have.shape[-1] != 3:
        raise ValueError(f"points: shape {tuple(have.shape)}; expected (..., 3), as target: {tuple(want.shape)}")
    weights = have.new_ones(have.shape[:-1])
    if valid is not None:
        kept = _tensor("valid", valid).to(have.device, torch.bool)
        if kept.shape != weights.shape:
            raise ValueError(f"valid: shape {tuple(kept.shape)}; expected {tuple(weights.shape)}")
        weights = kept.to(have.dtype)
        have, want = (values.masked_fill(~kept[..., None], 0.0) for values in (have, want))
    check_finite(points=have, target=want)
    return have, want, weights


def _mean_distance(points: torch.Tensor, target: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    return ((points - target).norm(dim=-1) * weights).sum(-1) / weights.sum(-1)


def _aligned(points: torch.Tensor, target: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    weights = weights[..., None]
    count = weights.sum(-2, keepdim=True).clamp(min=1.0)
    centre, target_centre = ((weights * joints).sum(-2, keepdim=True) / count for joints in (points, target))
    source, image = points - centre, target - target_centre
    u, s, vt = torch.linalg.svd((weights * image).mT @ source)
    sign = torch.ones_like(s)
    sign[..., -1] = torch.linalg.det(u @ vt).sign()
    rotation = (u * sign[..., None, :]) @ vt
    spread = (weights * source**2).sum((-1, -2)).clamp(min=torch.finfo(points.dtype).tiny)
    scale = (s * sign).sum(-1) / spread
    return scale[..., None, None] * (source @ rotation.mT) + target_centre


def bootstrap_sum(
    values: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], seed: int = 0
) -> tuple[float, float]:
    """Percentile interval (95 %) of a statistic of what people add up to, such as ``part_f1`` of pooled counts.

    Resamples in which the statistic is not defined (no class occurs) do not count.

    Args:
        values: Counts or sums of N independent people, shape (N, ...).
        statistic: Function from the sums of R resamples, shape (R, ...), to R numbers.
        seed: Seed of the resampling.

    Raises:
        ValueError: If there are no values, or one is NaN or infinite.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.metrics import bootstrap_sum, confusion, part_f1
        >>> generator = np.random.default_rng(0)
        >>> target = generator.integers(0, 3, (10, 32, 32))  # ten people's labels
        >>> predicted = np.where(generator.random(target.shape) < 0.9, target, 0)  # a tenth of the pixels are lost
        >>> counts = confusion(predicted, target, 3)
        >>> low, high = bootstrap_sum(counts, part_f1)
        >>> bool(low < part_f1(counts.sum(0)) < high)
        True
    """
    values = np.asarray(values, dtype=np.float64)
    if not values.size or not np.isfinite(values).all():
        raise ValueError(f"values: shape {values.shape}, or NaN or infinity in them; expected finite numbers")
    people, rng, results = len(values), np.random.default_rng(seed), []
    resamples = min(RESAMPLES, max(_ENOUGH, RESAMPLES * _MANY // people))
    step = max(_BLOCK // values.size, 1)
    for start in range(0, resamples, step):
        rows = min(step, resamples - start)
        drawn = rng.integers(0, people, (rows, people)) + people * np.arange(rows)[:, None]
        times = np.bincount(drawn.ravel(), minlength=rows * people).reshape(rows, people)
        results.append(statistic((times @ values.reshape(people, -1)).reshape(rows, *values.shape[1:])))
    low, high = np.nanquantile(np.concatenate(results), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)
