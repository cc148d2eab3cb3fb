"""The exact ellipsoids' definition in float64 NumPy: slow, obvious, the quadric solved for each ray.

Forward
    1. A pixel shows what its centre's ray meets first: in the space where the ellipsoid is the unit sphere, the ray
       comes as near to the sphere's centre as sqrt(1 - margin), and meets it where the margin is positive.
    2. Of equal depths, the lower index shows. An ellipsoid that reaches the near plane, or the camera, is not drawn.
    3. Label 255 hides what is behind it and means nothing.

Backward, "coverage"
    The loss is the integral over the picture of costs[label shown at (x, y)] of the pixel that holds (x, y), which is
    ``area_cost``, and the gradient is its derivative. Central differences of ``area_cost`` would be that, but pixels
    whose costs differ make kinks, and opposite sides of an ellipsoid nearly cancel: 1 % of noise and more. So
    ``coverage_gradient`` sums over the borders on many lines a pixel, and differences check it where they can.

Backward, "partdr": x and y. Here g^i(P) is the loss gradient of label i's map at pixel P; the result is linear in g.
    4. Every row (for x) and column (for y) of the picture whose centre line crosses an ellipsoid's outline crosses it
       twice; there the discriminant of the quadric is 0. The crossing moves along the line by as much as it is pushed:
       the way to a pixel at distance d is max(d, 1).
    5. Where the first pixel outside shows the same label, the outline lies inside its own label's picture: it does
       nothing.
    6. Outward, pixels up to the picture's border, or to the next pixel that shows the label, switch on (dI = +1) if
       they show background; with ``over_farther`` also if what they show is farther away than the outline at its
       crossing. Inward, pixels up to the first that shows background switch off (dI = -1) if they show the label. A
       pixel that shows another label gives 0 and does not end the walk. ``max_distance`` [px] ends both walks.
    7. The sum of g dI / way, signed by the direction, is a force in the picture on that point of the surface.

Backward, "partdr": z
    8. At a pixel P that shows label j, for a label i != j that is there but hidden, the nearest ellipsoid of label i
       comes forward and the one that shows goes back: forces -lambda log(1/dz + 1) g^i(P) and +lambda log(1/dz + 1)
       g^i(P) along z on their front points at P, with dz >= 1e-4 m the depth between the two.

Forces on surface points X = c + A diag(a) u, u on the unit sphere, become gradients by the chain rule, u held fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

MIN_DELTA_Z = 1e-4


@dataclass(frozen=True)
class Scene:
    """P ellipsoids of one body and their camera (f_x, f_y, c_x, c_y)."""

    centres: np.ndarray
    axes: np.ndarray
    semi_axes: np.ndarray
    camera: np.ndarray
    labels: np.ndarray
    perspective: bool = False
    near: float = -np.inf


def ray(scene, x, y):
    """Origin and direction (3, ...) of the rays through places of the picture; a ray's parameter is its depth."""
    fx, fy, cx, cy = scene.camera
    across = np.stack([(x - cx) / fx, (y - cy) / fy, np.zeros_like(x)])
    ahead = np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)])
    return (np.zeros_like(across), across + ahead) if scene.perspective else (across, ahead)


def ray_in_unit_space(scene, k, x, y):
    """The same where ellipsoid k is the unit sphere."""
    origin, direction = ray(scene, x, y)
    to_unit = (scene.axes[k] / scene.semi_axes[k]).T
    shape = (3,) + (1,) * (origin.ndim - 1)
    return np.tensordot(to_unit, origin - scene.centres[k].reshape(shape), 1), np.tensordot(to_unit, direction, 1)


def meet(scene, k, x, y):
    """Margin (positive where rays meet ellipsoid k) and depth of its front there; elsewhere, of its nearest point."""
    origin, direction = ray_in_unit_space(scene, k, x, y)
    length2 = (direction**2).sum(0)
    closest = -(origin * direction).sum(0) / length2
    margin = 1 - ((origin + closest * direction) ** 2).sum(0)
    return margin, closest - np.sqrt(np.maximum(margin, 0) / length2)


def front_near(scene, k, x, y, depth):
    """Depth of ellipsoid k's front, to first order, where it is nearly ``depth``: smooth across its outline too."""
    origin, direction = ray_in_unit_space(scene, k, x, y)
    place = origin + depth * direction
    return depth - ((place**2).sum(0) - 1) / (2 * (place * direction).sum(0))


def half_extents(scene):
    """Half of each ellipsoid's size along x, y and z, (P, 3)."""
    return np.sqrt(((scene.axes * scene.semi_axes[:, None]) ** 2).sum(2))


def drawable(scene):
    """Which ellipsoids lie behind the near plane and do not hold the camera, (P,)."""
    return scene.centres[:, 2] - half_extents(scene)[:, 2] > max(scene.near, 0.0 if scene.perspective else -np.inf)


def fronts(scene, x, y, which=None):
    """Depth of every ellipsoid's front, inf where it is not, (P, ...)."""
    depths = np.full((len(scene.centres), *x.shape), np.inf)
    for k in np.flatnonzero(drawable(scene)) if which is None else which:
        margin, front = meet(scene, k, x, y)
        depths[k] = np.where(margin > 0, front, np.inf)
    return depths


def pixel_centres(size):
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    return x, y


def draw(scene, size):
    """Labels, parts (index + 1) and depth of one body."""
    depths = fronts(scene, *pixel_centres(size))
    depth = depths.min(0)
    parts = np.where(np.isfinite(depth), depths.argmin(0) + 1, 0)
    return np.r_[0, scene.labels][parts], parts, depth


def doubt(scene, size):
    """How sure the picture is: the smallest |margin| of any ellipsoid at each pixel, and the nearest's lead [m]."""
    x, y = pixel_centres(size)
    margins = [np.abs(meet(scene, k, x, y)[0]) for k in np.flatnonzero(drawable(scene))]
    depths = np.sort(fronts(scene, x, y), 0)
    with np.errstate(invalid="ignore"):
        lead = depths[1] - depths[0] if len(depths) > 1 else np.full(size, np.inf)
    return np.min([np.full(size, np.inf), *margins], 0), np.where(np.isfinite(depths[0]), lead, np.inf)


# --- Costs and map gradients -------------------------------------------------------------------------------------


def label_gradient(labels, target, num_labels, weights=None):
    """g of L_seg (paper, eq. 6) for a label target, as maps (K, H, W)."""
    weights = np.ones(num_labels + 1) if weights is None else weights
    index = np.arange(1, num_labels + 1)[:, None, None]
    g = 2.0 * weights[1 : num_labels + 1, None, None] * ((labels == index).astype(float) - (target == index))
    return np.where(target == 255, 0.0, g)


def dense_costs(maps):
    """What area costs that shows background, label 1 to K, or anything else: (K + 2, H, W)."""
    nothing = np.zeros((1, *maps.shape[1:]))
    return np.concatenate([nothing, maps, nothing])


def target_costs(target, num_labels):
    """The same for L_seg: a wrong place misses one map and dirties another; 0 and 255 have no map."""
    shown = np.arange(num_labels + 2)[:, None, None]
    has_map = (shown > 0) & (shown <= num_labels)
    costs = np.where(shown == target, 0.0, has_map.astype(float) + (target > 0))
    return np.where(target == 255, 0.0, costs)


# --- The gradient of covered area --------------------------------------------------------------------------------


def boxes(scene):
    """A box (left, top, right, bottom) [px] that holds each drawn ellipsoid's picture, (P, 4)."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(8, 3)
    corners = scene.centres[:, None] + signs * half_extents(scene)[:, None]
    places = corners[..., :2] / (corners[..., 2:] if scene.perspective else 1.0) * scene.camera[:2] + scene.camera[2:]
    return np.concatenate([places.min(1), places.max(1)], 1)


@dataclass(frozen=True)
class Borders:
    """Places where lines along one axis of the picture leave the part ``before`` and enter ``after`` (0 = background).

    ``kind`` says which surface bounds: 1 = the outline of ``before``, -1 = that of ``after``, 0 = a crease, where both
    are there and equally deep, at ``depth``.
    """

    x: np.ndarray
    y: np.ndarray
    before: np.ndarray
    after: np.ndarray
    kind: np.ndarray
    depth: np.ndarray


def find_borders(scene, size, axis, lines, spacing=1 / 32, halvings=24):
    """All borders on ``lines`` lines a pixel along ``axis``: looked for between places ``spacing`` px apart."""
    along = np.arange(size[1 - axis] / spacing + 1) * spacing
    across = (np.arange(size[axis] * lines) + 0.5) / lines
    depth, shown = np.full((len(across), len(along)), np.inf), np.zeros((len(across), len(along)), dtype=int)
    bounds = boxes(scene)
    for k in np.flatnonzero(drawable(scene)):
        spot = tuple(
            slice(*np.searchsorted(places, (bounds[k, way], bounds[k, way + 2])))
            for places, way in ((across, 1 - axis), (along, axis))
        )
        front = fronts(scene, *on_line(axis, *np.meshgrid(along[spot[1]], across[spot[0]])), [k])[k]
        shown[spot] = np.where(front < depth[spot], k + 1, shown[spot])
        depth[spot] = np.minimum(front, depth[spot])

    def shown_at(along, across):
        depths = fronts(scene, *on_line(axis, along, across))
        return np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0)

    row, place = np.nonzero(shown[:, 1:] != shown[:, :-1])
    todo = along[place], along[place + 1], across[row], shown[row, place], shown[row, place + 1]
    found = []
    while len(todo[0]):
        low, high, across, before, after = todo
        end = high
        for _ in range(halvings):
            middle = (low + high) / 2
            same = shown_at(middle, across) == before
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        entered = shown_at(high, across)
        found.append((low, high, across, before, entered))
        rest = entered != after  # something narrow lies in between
        todo = tuple(values[rest] for values in (high, end, across, entered, after))
    low, high, across, before, after = (np.concatenate(values) for values in zip(*found, strict=True))
    kind = np.zeros(len(low), dtype=int)
    for k in range(len(scene.centres)):
        kind[(after == k + 1) & ~np.isfinite(fronts(scene, *on_line(axis, low, across), [k])[k])] = -1
        kind[(before == k + 1) & ~np.isfinite(fronts(scene, *on_line(axis, high, across), [k])[k])] = 1
    x, y = on_line(axis, (low + high) / 2, across)
    return Borders(x, y, before, after, kind, fronts(scene, x, y).min(0))


def on_line(axis, along, across):
    """(x, y) of places on lines along an axis."""
    return (along, across) if axis == 0 else (across, along)


def cost_index(scene, costs):
    """Which of ``costs`` each part takes, 0 = background."""
    return np.minimum(np.r_[0, scene.labels], len(costs) - 1)


def area_cost(scene, costs, lines=16):
    """Integral of costs[label shown] over the picture: exact along x, by the midpoint rule along y."""
    size = costs.shape[1:]
    borders = find_borders(scene, size, 0, lines)
    label_of = cost_index(scene, costs)
    summed = np.concatenate([np.zeros((*costs.shape[:2], 1)), costs.cumsum(2)], 2)

    def cost_left_of(part, x, y):
        """Of the line through y from the picture's left border to x, if it showed this part."""
        label, row, column = label_of[part], y.astype(int), np.minimum(x.astype(int), size[1] - 1)
        return summed[label, row, column] + costs[label, row, column] * (x - column)

    # A line that shows a, b, c up to x1, x2, W costs a(x1) - a(0) + b(x2) - b(x1) + c(W) - c(x2).
    y = (np.arange(size[0] * lines) + 0.5) / lines
    depths = fronts(scene, np.full_like(y, size[1]), y)
    last = np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0)
    total = cost_left_of(last, np.full_like(y, size[1]), y).sum()
    for part, sign in ((borders.before, 1.0), (borders.after, -1.0)):
        total += sign * cost_left_of(part, borders.x, borders.y).sum()
    return total / lines


def border_value(scene, borders, x, y):
    """A function that is 0 on each border and positive on the side of ``before``."""
    value = np.zeros_like(x)
    for k in range(len(scene.centres)):
        for parts, sign in ((borders.before, 1.0), (borders.after, -1.0)):
            mine = (parts == k + 1) & (borders.kind == sign)
            value[mine] += sign * meet(scene, k, x[mine], y[mine])[0]
            mine = (parts == k + 1) & (borders.kind == 0)
            value[mine] -= sign * front_near(scene, k, x[mine], y[mine], borders.depth[mine])
    return value


def turned(axes, turn):
    """Axes turned by a rotation vector (Rodrigues)."""
    angle = np.linalg.norm(turn)
    K = np.cross(np.eye(3), turn / angle)  # K v = turn x v / angle
    return (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K) @ axes


NAMES = ("centres", "turns", "semi_axes", "camera")  # turns: small rotations from the left


def moved(scene, name, index, step):
    """The scene with one of the numbers changed that ``coverage_gradient`` is about."""
    if name == "turns":
        axes = scene.axes.copy()
        axes[index[0]] = turned(axes[index[0]], step * np.eye(3)[index[1]])
        return replace(scene, axes=axes)
    values = getattr(scene, name).copy()
    values[index] += step
    return replace(scene, **{name: values})


def coverage_gradient(scene, costs, lines=16, tiny=1e-6):
    """Derivative of the area's cost with respect to NAMES: (P, 3), (P, 3), (P, 3) and (4,).

    Where phi = 0 is a border, a change of phi moves it by -dphi / |grad phi| along its normal, and what the loss then
    gains on a bit of border is (cost before - cost after) times way times length. Lines along x take the share n_x^2 of
    each bit and lines along y the share n_y^2, so that none has to divide by how steeply it meets the border.
    """
    label_of = cost_index(scene, costs)
    gradients = {name: np.zeros(4 if name == "camera" else scene.centres.shape) for name in NAMES}
    for axis in (0, 1):
        borders = find_borders(scene, costs.shape[1:], axis, lines)
        x, y = borders.x, borders.y
        row, column = np.minimum(y.astype(int), costs.shape[1] - 1), np.minimum(x.astype(int), costs.shape[2] - 1)
        excess = costs[label_of[borders.before], row, column] - costs[label_of[borders.after], row, column]
        step = tiny / scene.camera[0] * np.linalg.norm(scene.camera[:2])
        slope_x = (border_value(scene, borders, x + step, y) - border_value(scene, borders, x - step, y)) / (2 * step)
        slope_y = (border_value(scene, borders, x, y + step) - border_value(scene, borders, x, y - step)) / (2 * step)
        across = np.abs(slope_x if axis == 0 else slope_y)
        weight = excess * across / (slope_x**2 + slope_y**2) / lines
        for name, gradient in gradients.items():
            for index in np.ndindex(gradient.shape):
                ahead, back = (border_value(moved(scene, name, index, s), borders, x, y) for s in (tiny, -tiny))
                gradient[index] += (weight * (ahead - back)).sum() / (2 * tiny)
    return gradients


# --- PartDR's rule -----------------------------------------------------------------------------------------------


class Forces:
    """Gradients, gathered from forces on surface points."""

    def __init__(self, scene):
        self.scene = scene
        self.centres, self.axes = np.zeros_like(scene.centres), np.zeros_like(scene.axes)
        self.semi_axes, self.camera = np.zeros_like(scene.semi_axes), np.zeros(4)

    def push(self, k, point, force):
        """Add dL/dX = force of a surface point."""
        axes, semi_axes = self.scene.axes[k], self.scene.semi_axes[k]
        unit = axes.T @ (point - self.scene.centres[k]) / semi_axes
        self.centres[k] += force
        self.axes[k] += np.outer(force, semi_axes * unit)
        self.semi_axes[k] += (axes.T @ force) * unit

    def push_image(self, k, point, force):
        """Add dL/d(u, v) = force of a surface point's picture."""
        fx, fy = self.scene.camera[:2]
        X, Y, Z = point
        if self.scene.perspective:
            jacobian = np.array([[fx / Z, 0, -fx * X / Z**2], [0, fy / Z, -fy * Y / Z**2]])
            plane = np.array([X / Z, Y / Z])
        else:
            jacobian = np.array([[fx, 0, 0], [0, fy, 0]])
            plane = np.array([X, Y])
        self.push(k, point, force @ jacobian)
        self.camera += np.concatenate([force * plane, force])


def surface_point(scene, x, y, depth):
    origin, direction = ray(scene, np.float64(x), np.float64(y))
    return origin + depth * direction


def crossings(scene, k, axis, line):
    """Where a row's (axis 0) or column's centre line crosses an outline, low end first; none where it does not."""

    def discriminant(place):
        centre = np.full_like(place, line + 0.5)
        origin, direction = ray_in_unit_space(scene, k, *((place, centre) if axis == 0 else (centre, place)))
        length2 = (direction**2).sum(0)
        closest = origin - (origin * direction).sum(0) / length2 * direction
        return length2 * (1 - (closest**2).sum(0))  # a difference of squares would cancel where thickness is small

    # A quadratic along the line: three values tell it.
    bounds = boxes(scene)[k]
    middle, half = (bounds[axis] + bounds[2 + axis]) / 2, (bounds[2 + axis] - bounds[axis]) / 2
    before, here, after = discriminant(middle + half * np.array([-1.0, 0.0, 1.0]))
    a, b, c = (after + before) / 2 - here, (after - before) / 2, here
    if b * b - 4 * a * c <= 0:
        return []
    root = np.sqrt(b * b - 4 * a * c)
    return [middle + half * t for t in sorted([(-b - root) / (2 * a), (-b + root) / (2 * a)])]


def outline_depth(scene, k, x, y):
    """Depth at which a ray touches ellipsoid k."""
    origin, direction = ray_in_unit_space(scene, k, np.float64(x), np.float64(y))
    return -(origin @ direction) / (direction @ direction)


def partdr_gradient(scene, parts, g, *, over_farther=True, max_distance=np.inf, depth_weight=1.0):
    """Gradients of centres, axes, semi_axes and camera, from the picture of parts and g of shape (K, H, W)."""
    parts = parts.astype(int)
    forces = Forces(scene)
    shown = np.r_[0, scene.labels][parts]
    depth = fronts(scene, *pixel_centres(parts.shape))
    depth = np.where(parts > 0, np.take_along_axis(depth, np.maximum(parts - 1, 0)[None], 0)[0], np.inf)
    for k in np.flatnonzero(drawable(scene)):
        if scene.labels[k] > len(g):
            continue
        for axis in (0, 1):
            pictures = [p if axis == 0 else p.T for p in (shown, depth, g[scene.labels[k] - 1])]
            for line in range(parts.shape[axis]):
                for side, crossing in zip((-1, 1), crossings(scene, k, axis, line), strict=False):
                    x, y = (crossing, line + 0.5) if axis == 0 else (line + 0.5, crossing)
                    z = outline_depth(scene, k, x, y)
                    row = [picture[line] for picture in pictures]
                    slope = line_slope(row, scene.labels[k], side, crossing, z, over_farther, max_distance)
                    if slope:
                        forces.push_image(k, surface_point(scene, x, y, z), slope * np.eye(2)[axis])
    if depth_weight:
        push_depths(forces, shown, parts, g, depth_weight)
    return forces


def line_slope(row, label, side, crossing, edge_depth, over_farther, max_distance):
    """Choices 5 to 7 on one line of pixels: what they show, how deep it is, and g."""
    shown, depth, wanted = row
    positions = np.arange(len(shown)) + 0.5
    ahead = (positions - crossing) * side > 0
    outside, inside = np.flatnonzero(ahead)[::side], np.flatnonzero(~ahead)[::-side]
    if len(outside) and abs(positions[outside[0]] - crossing) <= 1 and shown[outside[0]] == label:
        return 0.0
    slope = 0.0
    for pixel in outside:
        distance = abs(positions[pixel] - crossing)
        if shown[pixel] == label or distance > max_distance:
            break
        if shown[pixel] == 0 or (over_farther and depth[pixel] > edge_depth):
            slope += side * wanted[pixel] / max(distance, 1.0)
    for pixel in inside:
        distance = abs(positions[pixel] - crossing)
        if shown[pixel] == 0 or distance > max_distance:
            break
        if shown[pixel] == label:
            slope += side * wanted[pixel] / max(distance, 1.0)  # dI = -1, and the way leads inward
    return slope


def push_depths(forces, shown, parts, g, depth_weight):
    """Choice 8."""
    scene = forces.scene
    depths = fronts(scene, *pixel_centres(parts.shape))
    for row, column in zip(*np.nonzero(parts), strict=True):
        x, y = column + 0.5, row + 0.5
        front = parts[row, column] - 1
        for label in set(scene.labels) - {shown[row, column]}:
            there = np.where(scene.labels == label, depths[:, row, column], np.inf)
            back = there.argmin()
            if label > len(g) or not np.isfinite(there[back]):
                continue
            between = max(there[back] - depths[front, row, column], MIN_DELTA_Z)
            amount = depth_weight * g[label - 1, row, column] * np.log(1 / between + 1)
            for k, sign in ((back, -1.0), (front, 1.0)):
                point = surface_point(scene, x, y, depths[k, row, column])
                forces.push(k, point, np.array([0, 0, sign * amount]))
