"""Starts of a scene: cameras put together what the label network says of each sight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...body.lens import lens_camera
from ...body.parameters import BodyParameters
from ...body.rotations import nearest_rotation
from ...inputs.observation import REFERENCE_SIZE
from ...inputs.scene import Scene
from ...interop.checks import FLOATS, check_tensor
from ...models.clothes import CLOTHED
from ...models.model import DetailedModel
from ...models.pose import pose_from_ellipbody
from ...models.registration import shape_from_lengths
from ..mesh.gather import gather_aims, gather_turn_uncertainties
from ..mesh.landmark_costs import LandmarkAims
from ..mesh.observed_body import ObservedBody
from ..mesh.starts import Starts, WorldViews
from .clusters import of_one, of_several
from .homes import CameraPoses, find_homes
from .label_pictures import NO_LENS, cluster_pictures
from .plan import ScenePlan
from .smoothing import feet_rates, time_shares

_START_WIDTH = 2 / 3  # of the moves' Gaussian, by which starts are smoothed: no move brings back what that takes away
_UNSEEN_SPREAD = 1.0  # [rad], of turns where nobody sees a person


def gather_scene(plan: ScenePlan, looks: Sequence[ObservedBody]) -> Starts:
    """Starts of a scene's bodies, and what was observed of them.

    Args:
        plan: Of the scene.
        looks: Of ``look_at``.
    """
    scene, drawn, table = plan.scene, plan.energy.drawn, _Table.of(plan.scene, looks)
    cameras = CameraPoses.of(scene.views, looks[0].body.log_scale)
    homes = find_homes(scene, looks, cameras)
    known = _shapes(plan.model, homes.body, scene)
    shapes = known.values.repeat_interleave(scene.num_frames, 0)
    turned, moved = pose_from_ellipbody(plan.model, homes.body.posed(), shapes, trunk_along=True)
    to_world = homes.cameras.rotations.mT
    turned = turned[:, drawn.turning].clone()
    turned[:, 0] = to_world @ turned[:, 0]

    smooth = rates = None
    if scene.num_frames > 1 and plan.options.smoothing > 0:
        width, times = plan.options.smoothing, torch.from_numpy(scene.frame_times).to(turned.device)
        shares = time_shares(table.seen.view(-1, scene.num_frames), times, _START_WIDTH * width).to(turned)
        each = turned.unflatten(0, (scene.num_people, -1))
        turned = nearest_rotation(torch.einsum("pts,ps...->pt...", shares, each).flatten(0, 1))
        homes = homes.smoothed(shares)
        smooth = time_shares(table.seen.new_ones(1, scene.num_frames), times, width).to(turned)[0]
        if plan.options.sliding > 0 and (found := feet_rates(times, width)) is not None:
            rates = found.to(turned)

    turn_spreads = gather_turn_uncertainties(drawn, [look.uncertainty for look in looks], turned)[homes.looks]
    alone = together = None
    if drawn.mesh is not None:
        together = cluster_pictures(plan, of_several(plan.clusters), plan.options.together, looks)
        alone = cluster_pictures(plan, of_one(plan.clusters), plan.options.mesh.size, looks)
    return Starts(
        rotations=turned,
        translation=(to_world @ moved[..., None])[..., 0],
        shape=known.values,
        clothes=known.clothes,
        unknown=known.unknown,
        log_scale=homes.body.log_scale,
        shift=homes.body.shift,
        lens=homes.lenses,
        turn_variances=torch.where(table.seen[:, None], turn_spreads, _UNSEEN_SPREAD).square()[..., None],
        aims=_aims(plan, looks, table),
        views=_views(looks, table, cameras, homes.cameras),
        alone=alone,
        together=together,
        smooth=smooth,
        rates=rates,
    )


@dataclass(frozen=True)
class _Table:
    """Places of looks in tables of N bodies by V views.

    Attributes:
        rows: Body of each look, int64.
        columns: View of each look, int64.
        shape: N and V.
    """

    rows: torch.Tensor
    columns: torch.Tensor
    shape: tuple[int, int]

    @classmethod
    def of(cls, scene: Scene, looks: Sequence[ObservedBody]) -> _Table:
        """Find the places of a scene's looks."""
        device = looks[0].body.log_scale.device
        rows = [look.sight.person * scene.num_frames + look.sight.frame for look in looks]
        columns = [look.sight.view for look in looks]
        shape = scene.num_people * scene.num_frames, len(scene.views)
        return cls(torch.tensor(rows, device=device), torch.tensor(columns, device=device), shape)

    @property
    def seen(self) -> torch.Tensor:
        """True for bodies that a view sees, shape (N,)."""
        seen = torch.zeros(self.shape[0], dtype=torch.bool, device=self.rows.device)
        return seen.index_fill(0, self.rows, True)

    @property
    def shown(self) -> torch.Tensor:
        """True for views that see a body, shape (N, V)."""
        return self.full(torch.ones_like(self.rows, dtype=torch.bool)).view(self.shape)

    def full(self, values: torch.Tensor) -> torch.Tensor:
        """Values of looks as values of all bodies in all views, 0 where somebody is not seen, shape (N V, ...)."""
        full = values.new_full((*self.shape, *values.shape[1:]), 0)
        full[self.rows, self.columns] = values
        return full.flatten(0, 1)


def _aims(plan: ScenePlan, looks: Sequence[ObservedBody], table: _Table) -> LandmarkAims:
    """Aims of all bodies in all views; those who are not seen have no weight."""
    depths = BodyParameters.joined([look.body for look in looks]).posed().joints[..., 2]
    said = [look.uncertainty for look in looks]
    aims = gather_aims(plan.energy.drawn, [look.observation for look in looks], said, depths[:, 1:] - depths[:, :1])
    return LandmarkAims(
        landmark_indices=table.full(aims.landmark_indices),
        points=table.full(aims.points),
        weights=table.full(aims.weights),
        ends=aims.ends,
        depths=table.full(aims.depths),
        depth_weights=table.full(aims.depth_weights),
    )


def _views(looks: Sequence[ObservedBody], table: _Table, cameras: CameraPoses, homes: CameraPoses) -> WorldViews:
    lenses = table.full(torch.stack([look.observation.lens for look in looks if look.observation.lens is not None]))
    shown = table.shown
    crops = lens_camera(torch.where(shown.view(-1, 1), lenses, lenses.new_tensor(NO_LENS)), REFERENCE_SIZE)
    return WorldViews(
        rotations=cameras.rotations,
        translations=cameras.translations,
        home_rotations=homes.rotations,
        home_translations=homes.translations,
        focals=crops.focal,
        centres=crops.centre,
        observed=shown,
    )


@dataclass(frozen=True)
class _Shapes:
    """Shapes of P people.

    Attributes:
        values: Shape values, shape (P, S).
        clothes: Thicknesses of clothes [m], shape (P, 8).
        unknown: 1 for people whose shape and clothes are to be found, 0 for known ones, shape (P, 1).
    """

    values: torch.Tensor
    clothes: torch.Tensor
    unknown: torch.Tensor


def _shapes(model: DetailedModel, bodies: BodyParameters, scene: Scene) -> _Shapes:
    """Shapes of people: known ones, or those of the body in the first frame."""
    values = shape_from_lengths(model, bodies.select(slice(None, None, scene.num_frames)).posed())
    found = _Shapes(values, values.new_zeros(len(values), len(CLOTHED)), values.new_ones(len(values), 1))
    for person, known in scene.shapes.items():
        found.unknown[person] = 0
        for name, table, given in (("values", values, known.values), ("clothes", found.clothes, known.clothes)):
            check_tensor(f"shapes[{person}].{name}", given, table[person].shape, dtypes=FLOATS)
            table[person] = given.to(table)
    return found
