"""Starts of a scene: cameras put together what the label network says of each sight."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE
from ...body.lens import lens_camera, seen_at, through_lens
from ...body.parameters import BodyParameters
from ...body.rotations import nearest_rotation, rotation_from_axis_angle, rotation_to_6d, rotation_to_axis_angle
from ...cameras import Crop
from ...inputs.observation import REFERENCE_SIZE, crop_lens, resize_nearest
from ...inputs.scene import Scene, View
from ...interop.checks import FLOATS, check_tensor
from ...models.clothes import CLOTHED
from ...models.model import DetailedModel
from ...models.pose import pose_from_ellipbody
from ...models.registration import shape_from_lengths
from ..mesh.gather import gather_aims, gather_turn_spreads
from ..mesh.landmark_costs import LandmarkAims
from ..mesh.looked import Looked
from ..mesh.starts import LabelPictures, Slots, Starts, Views
from .clusters import Clusters, of_one, of_several, slots_of
from .pictures import pelvises_in_world
from .plan import ScenePlan

_START_WIDTH = 2 / 3  # of the moves' Gaussian, by which starts are smoothed: no move brings back what that takes away
_SLOPES = 0.1  # of smooth moves: weight of their squares, in standard deviations of the Gaussian
_UNSEEN_SPREAD = 1.0  # [rad], of turns where nobody sees a person
_ROUNDED = 1e-6  # share of a step, by which times are rounded
_NEAREST = 0.1  # [m], of a pelvis before its camera
_NO_LENS = (1.0, 0.0, 0.0)  # of a picture that nobody is seen in
_MARGIN = 0.02  # of a picture's crop around several people


def gather_scene(plan: ScenePlan, looks: Sequence[Looked]) -> Starts:
    """Starts of a scene's bodies, and what was observed of them.

    Args:
        plan: Of the scene.
        looks: Of ``look_at``.
    """
    scene, drawn, options = plan.scene, plan.energy.drawn, plan.options
    num_frames, num_views = scene.num_frames, len(scene.views)
    count = scene.num_people * num_frames
    like = looks[0].body.log_scale
    rows = torch.tensor([look.sight.person * num_frames + look.sight.frame for look in looks], device=like.device)
    views = torch.tensor([look.sight.view for look in looks], device=like.device)
    rotations = torch.stack([view.rotation for view in scene.views]).to(like)
    translations = torch.stack([view.translation for view in scene.views]).to(like)

    homes = _homes(looks, rows.tolist(), scene)
    body = _joined(looks, homes, rotations, translations, scene)
    posed = body.posed()
    own = torch.arange(0, count, num_frames, device=like.device)
    shape, clothes, unknown = _shapes(plan.model, body.select(own), scene)
    turned, moved = pose_from_ellipbody(plan.model, posed, shape.repeat_interleave(num_frames, 0), trunk_along=True)
    first = torch.tensor([looks[home].sight.view for home in homes], device=like.device)
    to_world = rotations[first].mT
    turned = turned[:, drawn.turning].clone()
    turned[:, 0] = to_world @ turned[:, 0]

    seen = torch.zeros(count, dtype=torch.bool, device=like.device).index_fill(0, rows, True)
    log_scale, shift, smooth, rates = body.log_scale, body.shift, None, None
    lenses = torch.stack([look.seen.lens for look in looks if look.seen.lens is not None])
    at = torch.tensor(homes, device=like.device)
    if num_frames > 1 and options.smoothing > 0:
        width, times = options.smoothing, torch.from_numpy(scene.frame_times).to(like.device)
        shares = time_shares(seen.view(-1, num_frames), times, _START_WIDTH * width).to(like)
        each = turned.unflatten(0, (scene.num_people, -1))
        turned = nearest_rotation(torch.einsum("pts,ps...->pt...", shares, each).flatten(0, 1))
        there = rotations[first], translations[first], lenses[at]
        log_scale, shift = _smooth_places(shares, body, *there)
        smooth = time_shares(seen.new_ones(1, num_frames), times, width).to(like)[0]
        steps = times.diff()
        near = steps <= width * (1 + _ROUNDED)  # else a foot may have gone and stood again between two frames
        if options.sliding > 0 and near.any():
            rates = torch.where(near, 1 / steps, 0.0).to(like)

    said = [look.uncertainty for look in looks]
    depths = BodyParameters.joined([look.body for look in looks]).posed().joints[..., 2]
    aims = gather_aims(drawn, [look.seen for look in looks], said, depths[:, 1:] - depths[:, :1])
    turn_spreads = torch.where(seen[:, None], gather_turn_spreads(drawn, said, like)[at], _UNSEEN_SPREAD)

    def table(values: torch.Tensor) -> torch.Tensor:
        """Rows of sights by body and view, 0 where somebody is not seen, (N V, ...)."""
        full = values.new_full((count, num_views, *values.shape[1:]), 0)
        full[rows, views] = values
        return full.flatten(0, 1)

    alone = together = None
    if drawn.mesh is not None:
        together = _label_pictures(plan, of_several(plan.clusters), options.together, looks)
        alone = _label_pictures(plan, of_one(plan.clusters), options.mesh.size, looks)
    shown = table(torch.ones_like(views, dtype=torch.bool))
    crops = lens_camera(torch.where(shown[..., None], table(lenses), lenses.new_tensor(_NO_LENS)), REFERENCE_SIZE)
    return Starts(
        rotations=turned,
        translation=(to_world @ moved[..., None])[..., 0],
        shape=shape,
        clothes=clothes,
        unknown=unknown,
        log_scale=log_scale,
        shift=shift,
        lens=lenses[at],
        turn_variances=turn_spreads.square()[..., None],
        aims=LandmarkAims(
            places=table(aims.places),
            points=table(aims.points),
            votes=table(aims.votes),
            ends=aims.ends,
            depths=table(aims.depths),
            depth_weights=table(aims.depth_weights),
        ),
        views=Views(
            rotations=rotations,
            translations=translations,
            home_rotations=rotations[first],
            home_translations=translations[first],
            focals=crops.focal,
            centres=crops.centre,
            shown=shown.view(count, num_views),
        ),
        alone=alone,
        together=together,
        smooth=smooth,
        rates=rates,
    )


def _shapes(
    model: DetailedModel, bodies: BodyParameters, scene: Scene
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """``shape``, ``clothes`` and ``unknown`` of people: known, or of one of their bodies each."""
    shape = shape_from_lengths(model, bodies.posed())
    clothes, unknown = shape.new_zeros(len(shape), len(CLOTHED)), shape.new_ones(len(shape), 1)
    for person, known in scene.shapes.items():
        unknown[person] = 0
        for name, table, given in (("values", shape, known.values), ("clothes", clothes, known.clothes)):
            check_tensor(f"shapes[{person}].{name}", given, table[person].shape, dtypes=FLOATS)
            table[person] = given.to(table)
    return shape, clothes, unknown


def time_shares(seen: torch.Tensor, times: torch.Tensor, width: float) -> torch.Tensor:
    """Shares of frames in each frame's smooth value, by a Gaussian of this standard deviation, (P, T, T).

    Value and slope of each frame are fitted to its neighbours (local linear regression): at the ends of a film, where
    neighbours are on one side, their mean alone would hold moving people back. Slopes are held a little to 0.

    ``seen``, (P, T), says which frames are counted; where none is near, the nearest one is. ``times``, (T,), float64,
    are those of the frames, in the unit of the width.
    """
    apart = (times - times[:, None]) / width
    near = (-apart.square() / 2).masked_fill(~seen[:, None], -torch.inf).softmax(-1)
    first = (near * apart).sum(-1, keepdim=True)
    second = (near * apart.square()).sum(-1, keepdim=True) + _SLOPES
    return near * (second - first * apart) / (second - first.square())


def _smooth_places(
    shares: torch.Tensor,
    body: BodyParameters,
    rotations: torch.Tensor,
    translations: torch.Tensor,
    lenses: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """``log_scale`` and ``shift`` of bodies whose pelvises move smoothly in the world."""
    world = pelvises_in_world(body.log_scale, body.shift, lenses, rotations, translations)
    smooth = (shares @ world.unflatten(0, (len(shares), -1))).flatten(0, 1)
    there = (smooth[:, None] @ rotations.mT)[:, 0] + translations
    return seen_at(torch.cat([there[:, :2], there[:, 2:].clamp_min(_NEAREST)], dim=1), lenses)


def _homes(looks: Sequence[Looked], rows: Sequence[int], scene: Scene) -> list[int]:
    """Sight in whose crop each body is placed: of the view that sees the person surest in all frames, of those there.

    Smooth moves are smooth in one view alone. Where nobody sees a person, the sight is of the nearest frame.
    """
    sure: defaultdict[tuple[int, int], float] = defaultdict(float)
    for look in looks:
        sure[look.sight.person, look.sight.view] += float(look.evidence.keypoints.confidence.sum())
    best: dict[int, int] = {}
    for place, (look, row) in enumerate(zip(looks, rows, strict=True)):
        person = look.sight.person
        if row not in best or sure[person, look.sight.view] > sure[person, looks[best[row]].sight.view]:
            best[row] = place
    homes: list[int] = []
    for person in range(scene.num_people):
        first = person * scene.num_frames
        seen = np.array([row for row in best if first <= row < first + scene.num_frames])
        for row in range(first, first + scene.num_frames):
            homes.append(best[int(seen[np.abs(seen - row).argmin()])])
    return homes


def _joined(
    looks: Sequence[Looked],
    homes: Sequence[int],
    rotations: torch.Tensor,
    translations: torch.Tensor,
    scene: Scene,
) -> BodyParameters:
    """Bodies in their home crops: turns are means of what all views say, pelvises lie where the views' rays meet."""
    people: list[BodyParameters] = []
    of_row: dict[tuple[int, int], list[Looked]] = {}
    for look in looks:
        of_row.setdefault((look.sight.person, look.sight.frame), []).append(look)
    for person in range(scene.num_people):
        mine = [look for look in looks if look.sight.person == person]
        sizes = {
            name: torch.cat([getattr(look.body, name) for look in mine]).mean(0, keepdim=True)
            for name in ("lengths", "thicknesses")
        }
        for frame in range(scene.num_frames):
            home = looks[homes[person * scene.num_frames + frame]]
            body = replace(home.body, **sizes)
            group = of_row[home.sight.person, home.sight.frame]
            if len(group) > 1:
                body = _met(body, home, group, rotations, translations)
            people.append(body)
    return BodyParameters.joined(people)


def _met(
    body: BodyParameters, home: Looked, group: Sequence[Looked], rotations: torch.Tensor, translations: torch.Tensor
) -> BodyParameters:
    """A body that several views see, in its home crop."""
    here = home.sight.view
    world = [rotations[look.sight.view].mT @ look.body.global_orient() for look in group]
    orientation = rotations[here] @ _mean_rotation(torch.cat(world))
    local = torch.cat([rotation_from_axis_angle(look.body.rotations) for look in group])
    pelvis = rotations[here] @ _meeting_point(group, rotations, translations) + translations[here]
    lens = home.seen.lens
    assert lens is not None
    if pelvis[2] > _NEAREST:  # else rays do not meet before the camera
        log_scale, shift = seen_at(pelvis[None], lens[None])
        body = replace(body, log_scale=log_scale, shift=shift)
    return replace(
        body,
        orientation=rotation_to_6d(orientation)[None],
        rotations=rotation_to_axis_angle(_mean_rotation(local.transpose(0, 1)))[None],
    )


def _mean_rotation(rotations: torch.Tensor) -> torch.Tensor:
    """Chordal mean of rotations (..., N, 3, 3), shape (..., 3, 3)."""
    return nearest_rotation(rotations.mean(-3))


def _meeting_point(group: Sequence[Looked], rotations: torch.Tensor, translations: torch.Tensor) -> torch.Tensor:
    """The point that is nearest to the rays through the pelvises, shape (3,) [m]."""
    normal, right = rotations.new_zeros(3, 3), rotations.new_zeros(3)
    eye = torch.eye(3).to(normal)
    for look in group:
        _, pelvis = through_lens(look.body.camera(REFERENCE_SIZE), look.seen.lens, REFERENCE_SIZE)
        assert pelvis is not None
        turn, move = rotations[look.sight.view], translations[look.sight.view]
        ray = turn.mT @ torch.nn.functional.normalize(pelvis[0], dim=0)
        across = eye - ray[:, None] * ray
        # A little of the distance that the view alone gives, for rays may be parallel.
        along = 1e-3 * eye
        normal = normal + across + along
        right = right - across @ (turn.mT @ move) + along @ (turn.mT @ (pelvis[0] - move))
    return torch.linalg.solve(normal, right)


def _label_pictures(plan: ScenePlan, clusters: Clusters, size: int, looks: Sequence[Looked]) -> LabelPictures | None:
    """Pictures of these clusters in crops of a size, all ignored where nobody is seen; None if there is no cluster."""
    if not clusters:
        return None
    scene, like = plan.scene, looks[0].body.log_scale
    slots, rows = slots_of(clusters, scene.num_people, like.device)
    places: list[list[int]] = rows.tolist()
    shape = len(clusters) * scene.num_frames * len(scene.views), size, size
    target = torch.full(shape, IGNORE, dtype=torch.uint8, device=like.device)
    lenses = like.new_tensor(_NO_LENS).repeat(shape[0], 1)
    groups: dict[int, list[Looked]] = {}
    for look in looks:
        cluster = places[look.sight.person][0]
        if cluster >= 0 and look.seen.labels is not None:
            row = cluster * scene.num_frames + look.sight.frame
            groups.setdefault(row * len(scene.views) + look.sight.view, []).append(look)
    for picture, group in groups.items():
        if len(group) == 1:
            look = group[0]
            assert look.seen.labels is not None
            assert look.seen.lens is not None
            labels = _shifted(resize_nearest(look.seen.labels, size), look, places)
            target[picture], lenses[picture] = labels, look.seen.lens
        else:
            target[picture], lenses[picture] = _together(group, places, size, scene.views[group[0].sight.view], like)
    return LabelPictures.of(target, Slots(lenses, slots, rows))


def _shifted(labels: torch.Tensor, look: Looked, places: Sequence[Sequence[int]]) -> torch.Tensor:
    """Group ids of a person as the cluster's pictures have them."""
    moved = labels + places[look.sight.person][1] * look.evidence.labels.label_set.num_groups
    return torch.where((labels == BACKGROUND) | (labels == IGNORE), labels, moved.to(torch.uint8))


def _together(
    group: Sequence[Looked], places: Sequence[Sequence[int]], size: int, view: View, like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Labels of several people in one crop around them, and its lens."""
    sides = [look.crop.size[0] / look.crop.zoom for look in group]
    low = np.min([(look.crop.left, look.crop.top) for look in group], axis=0)
    high = np.max(
        [(look.crop.left + side, look.crop.top + side) for look, side in zip(group, sides, strict=True)], axis=0
    )
    side = float((high - low).max()) * (1 + _MARGIN)
    left, top = (low + high - side) / 2
    crop = Crop(float(left), float(top), REFERENCE_SIZE / side, (REFERENCE_SIZE, REFERENCE_SIZE))
    box = (crop.left, crop.top, crop.left + side, crop.top + side)
    each = [torch.from_numpy(look.evidence.target((size, size), box)).to(like.device) for look in group]
    stack = torch.stack(each)
    known = (stack != BACKGROUND) & (stack != IGNORE)
    shifted = torch.stack([_shifted(labels, look, places) for labels, look in zip(each, group, strict=True)])
    # A pixel is somebody's if just one says so, and background if all do.
    owned = torch.where(known, shifted, 0).sum(0).to(torch.uint8)
    rest = torch.where((stack == BACKGROUND).all(0), BACKGROUND, IGNORE).to(torch.uint8)
    return torch.where(known.sum(0) == 1, owned, rest), crop_lens(view.camera, crop).to(like)
