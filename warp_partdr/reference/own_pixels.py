"""Own pixels of one person in a part label image, and the person's crop, by the distances of every pixel.

A mask is a label image of one group: 1 where the person is, 255 where others are. Lengths are shares of the person's
height in the picture, h, unless they are in pixels. A pixel is where its centre is.

1. A labelled pixel is near the person within max(0.25 h, 1.5 px) of a bone, or within 0.6 h of a loose end.
2. It is another's if that person's bones are within max(0.25 h, 1.5 px), and nearer.
3. Pixels within max(0.03 h, 1.5 px) of a bone are the person's, and all that hangs together with them, corners
   included, by pixels of rules 1 and 2. Everybody else's labels become 255, ignore.
4. Labels of a group are stray if at least 1 % of the person's pixels are of that group and more than 0.1 h beyond its
   flesh, and a quarter as many are within. What hangs together with those, beyond the flesh, becomes 255.
5. Left and right of arms, or legs, are exchanged if at least 24 of 48 places along each bone's middle 80 % show the
   limbs' own groups or the mirror images', and three quarters of these the latter.
6. A limb is missing if at least a third of 64 places along its bone show background. Background about it becomes 255.
7. The crop is the square about the box of confident keypoints and own pixels, with a tenth of the longer side around.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

BACKGROUND, IGNORE = 0, 255


@dataclass(frozen=True)
class Limb:
    """Bone of a limb.

    Attributes:
        ends: Start and end (x, y) of the bone [px], shape (2, 2).
        half_width: Half of the limb's width, as a share of the person's height.
        beyond: Length by which the limb goes on beyond the bone, as a share of the bone's length.
        own: Group of the limb; 0 if sides are not told apart.
        mirrored: Group of its mirror image.
        pair: Pair of the limb, 0 for arms, 1 for legs.
    """

    ends: np.ndarray
    half_width: float
    beyond: float
    own: int
    mirrored: int
    pair: int


@dataclass(frozen=True)
class KeypointBody:
    """Body as keypoints tell it, in pixels of the label image.

    Attributes:
        height: Height of the person [px].
        bones: Starts and ends of the bones, shape (S, 2, 2); a joint at no bone is a bone of no length.
        loose: Joints whose next joint is missing, (L, 2, 2).
        theirs: Bones of others, (T, 2, 2).
        flesh: Segments of each group whose keypoints are all known, (K, 2, 2), and their radii as shares of the height.
        limbs: Limbs whose keypoints are known.
        points: Confident keypoints, (J, 2).
    """

    height: float
    bones: np.ndarray
    loose: np.ndarray
    theirs: np.ndarray
    flesh: dict[int, tuple[np.ndarray, np.ndarray]]
    limbs: list[Limb]
    points: np.ndarray


def distances(x: np.ndarray, y: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distances of places (P,) from segments (S, 2, 2), shape (S, P)."""
    (x0, y0), (x1, y1) = segments[:, 0].T[..., None], segments[:, 1].T[..., None]
    along_x, along_y = x1 - x0, y1 - y0
    squares = np.maximum(along_x**2 + along_y**2, 1e-12)
    share = np.clip(((x - x0) * along_x + (y - y0) * along_y) / squares, 0.0, 1.0)
    return np.sqrt((x - x0 - share * along_x) ** 2 + (y - y0 - share * along_y) ** 2)


def _is_labelled(groups: np.ndarray) -> np.ndarray:
    """True where a part is labelled."""
    return (groups != BACKGROUND) & (groups != IGNORE)


def own_pixels(groups: np.ndarray, body: KeypointBody) -> tuple[np.ndarray, bool]:
    """The image without others' labels (rules 1 to 3), and if a labelled pixel lies along a bone."""
    rows, columns = np.nonzero(_is_labelled(groups))
    x, y = columns + 0.5, rows + 0.5
    own, loose, other = (
        distances(x, y, each).min(axis=0, initial=np.inf) for each in (body.bones, body.loose, body.theirs)
    )
    reach = max(0.25 * body.height, 1.5)
    own, other = (np.where(each <= reach, each, np.inf) for each in (own, other))
    near = (np.isfinite(own) | (loose <= 0.6 * body.height)) & ~(own > other)
    along = own <= max(0.03 * body.height, 1.5)
    kept = _spread(_mask(groups, rows, columns, near), _mask(groups, rows, columns, near & along))
    return np.where(_is_labelled(groups) & ~kept, IGNORE, groups).astype(np.uint8), bool(along.any())


def _mask(groups: np.ndarray, rows: np.ndarray, columns: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    mask = np.zeros(groups.shape, dtype=bool)
    mask[rows[chosen], columns[chosen]] = True
    return mask


def _spread(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Pixels of a mask that hang together with seeds, at corners, too."""
    reached = np.pad(mask & seeds, 1)
    free = np.pad(mask, 1) & ~reached
    waiting = deque(zip(*np.nonzero(reached), strict=True))
    while waiting:
        row, column = waiting.popleft()
        for near in np.ndindex(3, 3):
            place = row + near[0] - 1, column + near[1] - 1
            if free[place]:
                free[place] = False
                reached[place] = True
                waiting.append(place)
    return reached[1:-1, 1:-1]


def flesh_distances(groups: np.ndarray, body: KeypointBody, group: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns of a group's pixels, and their distances beyond its flesh, at most 0 within, as shares of h."""
    segments, radii = body.flesh[group]
    rows, columns = np.nonzero(groups == group)
    away = distances(columns + 0.5, rows + 0.5, segments) / body.height - radii[:, None]
    return rows, columns, away.min(axis=0)


def stray_groups(own: np.ndarray, body: KeypointBody) -> list[int]:
    """Groups that have stray labels (rule 4), by every so many-th pixel of a person's own, at most 192 a side."""
    thin = _thin(own)
    found = []
    for group in sorted(body.flesh):
        away = flesh_distances(thin, body, group)[2]
        far = np.count_nonzero(away > 0.1)
        if far >= max(0.01 * _is_labelled(thin).sum(), 1.0) and np.count_nonzero(away <= 0.0) >= 0.25 * far:
            found.append(group)
    return found


def _thin(own: np.ndarray) -> np.ndarray:
    """The image with nothing but background between the pixels that are looked at."""
    stride = max(-(-max(own.shape) // 192), 1)
    thin = np.zeros_like(own)
    thin[::stride, ::stride] = own[::stride, ::stride]
    return thin


def without_stray(own: np.ndarray, body: KeypointBody, groups: list[int]) -> np.ndarray:
    """The image without the stray labels of some groups (rule 4)."""
    found = own.copy()
    for group in groups:
        rows, columns, away = flesh_distances(own, body, group)
        mask, seeds = _mask(own, rows, columns, away > 0.0), _mask(own, rows, columns, away > 0.1)
        found[_spread(mask, seeds)] = IGNORE
    return found


def side_counts(own: np.ndarray, body: KeypointBody) -> np.ndarray:
    """Places along arms' and legs' bones that show their own groups, the mirror images', and others: (2, 3), rule 5."""
    counts = np.zeros((2, 3), dtype=np.int64)
    for limb in body.limbs:
        if limb.own != limb.mirrored and limb.own:
            shown = _shown_along(own, limb, np.linspace(0.1, 0.9, 48))
            on_own, mirrored = shown == limb.own, shown == limb.mirrored
            other = _is_labelled(shown) & ~on_own & ~mirrored
            counts[limb.pair] += [np.count_nonzero(each) for each in (on_own, mirrored, other)]
    return counts


def _shown_along(own: np.ndarray, limb: Limb, shares: np.ndarray) -> np.ndarray:
    """Groups at places along a limb's bone that are in the image."""
    start, end = limb.ends
    columns, rows = np.floor(start + shares[:, None] * (end - start)).astype(int).T
    inside = (rows >= 0) & (rows < own.shape[0]) & (columns >= 0) & (columns < own.shape[1])
    return own[rows[inside], columns[inside]]


def exchanged(counts: np.ndarray) -> np.ndarray:
    """True for arms, and legs, whose sides differ between labels and keypoints (rule 5)."""
    own, mirrored, _ = counts.T
    return (own + mirrored >= 24) & (mirrored >= 0.75 * (own + mirrored))


def disagreement(own: np.ndarray, body: KeypointBody) -> float:
    """Share of other labels along limbs, plus four times that of pixels more than 0.05 h beyond flesh.

    Above 1, the ids mean something else.
    """
    counts, thin = side_counts(own, body), _thin(own)
    away = np.concatenate([np.zeros(0), *(flesh_distances(thin, body, group)[2] for group in body.flesh)])
    other = counts[:, 2].sum() / counts.sum() if counts.sum() >= 48 else 0.0
    return float(other + 4 * np.count_nonzero(away > 0.05) / max(len(away), 1))


def without_missing_limbs(own: np.ndarray, body: KeypointBody) -> np.ndarray:
    """The image with background ignored along limbs that it misses (rule 6)."""
    rows, columns = np.nonzero(own == BACKGROUND)
    found = own.copy()
    for limb in body.limbs:
        if np.count_nonzero(_shown_along(own, limb, np.linspace(0, 1, 64)) == BACKGROUND) >= 64 / 3:
            start, end = limb.ends
            whole = np.array([[start, end + limb.beyond * (end - start)]])
            near = distances(columns + 0.5, rows + 0.5, whole)[0] <= limb.half_width * body.height
            found[rows[near], columns[near]] = IGNORE
    return found


def crop_square(own: np.ndarray, body: KeypointBody) -> tuple[np.ndarray, float]:
    """Middle (x, y) of the crop, and half its side [px] (rule 7)."""
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    rows, columns = np.nonzero(_is_labelled(own))
    if len(rows):
        low = np.minimum(low, [columns.min(), rows.min()])
        high = np.maximum(high, [columns.max() + 1, rows.max() + 1])
    margin = 0.1 * max((high - low).max(), 1.0)
    low, high = np.floor(low - margin), np.ceil(high + margin)
    return (low + high) / 2, float((high - low).max() / 2)


def draw_target(
    picture: np.ndarray, own: np.ndarray, window: tuple[float, float, float], box: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Groups in a box of the picture, resampled to (H, W): each pixel shows what is under its centre.

    Args:
        picture: Group ids, (H, W); what is labelled beyond the window becomes 255, and so does what is beyond it.
        own: The person's groups in the window.
        window: Left and top of the window in the picture [px], and its pixels for each pixel of the picture.
        box: Left, top, right and bottom in the picture [px].
        size: Size (H, W) [px].
    """
    left, top, zoom = window
    x = box[0] + (np.arange(size[1]) + 0.5) * (box[2] - box[0]) / size[1]
    y = box[1] + (np.arange(size[0]) + 0.5) * (box[3] - box[1]) / size[0]
    others = _at(np.where(picture == BACKGROUND, BACKGROUND, IGNORE), y, x)
    in_window = _at(own, (y - top) * zoom, (x - left) * zoom)
    covered = _at(np.ones(own.shape, dtype=np.uint8), (y - top) * zoom, (x - left) * zoom) == 1
    return np.where(covered, in_window, others).astype(np.uint8)


def _at(image: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Pixels of an image where rows y and columns x meet; 255 beyond it."""
    padded = np.pad(image, 1, constant_values=IGNORE)
    rows, columns = (
        np.clip(np.floor(each).astype(int) + 1, 0, side + 1) for each, side in zip((y, x), image.shape, strict=True)
    )
    return padded[np.ix_(rows, columns)]
