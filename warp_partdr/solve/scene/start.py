"""Starts of a scene's fit: the predictions of the label network, joined over all views."""

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
from .label_pictures import NO_LENS, cluster_pictures
from .plan import ScenePlan
from .smoothing import feet_rates, time_shares
from .start_bodies import CameraPoses, find_start_bodies

_START_WIDTH = 2 / 3  # of the width of motion; starts are smoothed less, because motion cannot bring back what is lost
_UNOBSERVED = 1.0  # [rad], standard deviation of rotations in frames without an observation


def gather_scene(plan: ScenePlan, observed_bodies: Sequence[ObservedBody]) -> Starts:
    """Collects the starts of a scene's bodies, and what was observed of them.

    Args:
        plan: Plan of the scene's fit.
        observed_bodies: Bodies that ``observe_scene`` returns.
    """
    scene = plan.scene
    drawn = plan.energy.drawn
    table = _Table.of(plan.scene, observed_bodies)
    cameras = CameraPoses.of(scene.views, observed_bodies[0].body.log_scale)
    start = find_start_bodies(scene, observed_bodies, cameras)
    known = _shapes(plan.model, start.body, scene)
    shapes = known.values.repeat_interleave(scene.num_frames, 0)
    rotations, translations = pose_from_ellipbody(plan.model, start.body.posed(), shapes, trunk_along=True)
    to_world = start.cameras.rotations.mT
    rotations = rotations[:, drawn.turning].clone()
    rotations[:, 0] = to_world @ rotations[:, 0]

    smooth = rates = None
    if scene.num_frames > 1 and plan.options.smoothing > 0:
        width = plan.options.smoothing
        times = torch.from_numpy(scene.frame_times).to(rotations.device)
        shares = time_shares(table.observed.view(-1, scene.num_frames), times, _START_WIDTH * width).to(rotations)
        each = rotations.unflatten(0, (scene.num_people, -1))
        rotations = nearest_rotation(torch.einsum("pts,ps...->pt...", shares, each).flatten(0, 1))
        start = start.smoothed(shares)
        smooth = time_shares(table.observed.new_ones(1, scene.num_frames), times, width).to(rotations)[0]
        if plan.options.sliding > 0 and (found := feet_rates(times, width)) is not None:
            rates = found.to(rotations)

    uncertainties = [observed.uncertainty for observed in observed_bodies]
    deviations = gather_turn_uncertainties(drawn, uncertainties, rotations)[start.references]
    alone = overlapping = None
    if drawn.mesh is not None:
        overlapping = cluster_pictures(plan, of_several(plan.clusters), plan.options.together, observed_bodies)
        alone = cluster_pictures(plan, of_one(plan.clusters), plan.options.mesh.size, observed_bodies)
    return Starts(
        rotations=rotations,
        translation=(to_world @ translations[..., None])[..., 0],
        shape=known.values,
        clothes=known.clothes,
        unknown=known.unknown,
        log_scale=start.body.log_scale,
        shift=start.body.shift,
        lens=start.lenses,
        turn_variances=torch.where(table.observed[:, None], deviations, _UNOBSERVED).square()[..., None],
        aims=_aims(plan, observed_bodies, table),
        views=_views(observed_bodies, table, cameras, start.cameras),
        alone=alone,
        overlapping=overlapping,
        smooth=smooth,
        rates=rates,
    )


@dataclass(frozen=True)
class _Table:
    """Table with N bodies as rows and V views as columns. Some of its cells have an observation.

    Attributes:
        rows: Index of the body of each observation, int64.
        columns: Index of the view of each observation, int64.
        shape: Numbers of bodies and views, N and V.
    """

    rows: torch.Tensor
    columns: torch.Tensor
    shape: tuple[int, int]

    @classmethod
    def of(cls, scene: Scene, observed_bodies: Sequence[ObservedBody]) -> _Table:
        """Finds the cells of a scene's observations."""
        device = observed_bodies[0].body.log_scale.device
        rows = [observed.person * scene.num_frames + observed.frame for observed in observed_bodies]
        columns = [observed.view for observed in observed_bodies]
        shape = scene.num_people * scene.num_frames, len(scene.views)
        return cls(torch.tensor(rows, device=device), torch.tensor(columns, device=device), shape)

    @property
    def observed(self) -> torch.Tensor:
        """True for bodies that have an observation in any view, shape (N,)."""
        observed = torch.zeros(self.shape[0], dtype=torch.bool, device=self.rows.device)
        return observed.index_fill(0, self.rows, True)

    @property
    def shown(self) -> torch.Tensor:
        """True for views that have an observation of a body, shape (N, V)."""
        return self.full(torch.ones_like(self.rows, dtype=torch.bool)).view(self.shape)

    def full(self, values: torch.Tensor) -> torch.Tensor:
        """Spreads values of observations over the table. Cells without an observation are 0, shape (N V, ...)."""
        full = values.new_full((*self.shape, *values.shape[1:]), 0)
        full[self.rows, self.columns] = values
        return full.flatten(0, 1)


def _aims(plan: ScenePlan, observed_bodies: Sequence[ObservedBody], table: _Table) -> LandmarkAims:
    """Aims of all bodies in all views. Bodies without an observation have no weight."""
    depths = BodyParameters.joined([observed.body for observed in observed_bodies]).posed().joints[..., 2]
    uncertainties = [observed.uncertainty for observed in observed_bodies]
    observations = [observed.observation for observed in observed_bodies]
    aims = gather_aims(plan.energy.drawn, observations, uncertainties, depths[:, 1:] - depths[:, :1])
    return LandmarkAims(
        landmark_indices=table.full(aims.landmark_indices),
        points=table.full(aims.points),
        weights=table.full(aims.weights),
        ends=aims.ends,
        depths=table.full(aims.depths),
        depth_weights=table.full(aims.depth_weights),
    )


def _views(
    observed_bodies: Sequence[ObservedBody], table: _Table, cameras: CameraPoses, crop_cameras: CameraPoses
) -> WorldViews:
    """Views of all bodies; cells without an observation have an arbitrary lens, and no weight."""
    known = [observed.observation.lens for observed in observed_bodies if observed.observation.lens is not None]
    lenses = table.full(torch.stack(known))
    shown = table.shown
    crops = lens_camera(torch.where(shown.view(-1, 1), lenses, lenses.new_tensor(NO_LENS)), REFERENCE_SIZE)
    return WorldViews(
        rotations=cameras.rotations,
        translations=cameras.translations,
        crop_rotations=crop_cameras.rotations,
        crop_translations=crop_cameras.translations,
        focals=crops.focal,
        centres=crops.centre,
        observed=shown,
    )


@dataclass(frozen=True)
class _Shapes:
    """Known and unknown shapes of P people.

    Attributes:
        values: Shape values, shape (P, S).
        clothes: Thicknesses of clothes [m], shape (P, 8).
        unknown: Factor 1 for people whose shape and clothes are to be found, 0 for known people, shape (P, 1).
    """

    values: torch.Tensor
    clothes: torch.Tensor
    unknown: torch.Tensor


def _shapes(model: DetailedModel, bodies: BodyParameters, scene: Scene) -> _Shapes:
    """Shapes of people: the known one, or the shape of the start in the first frame."""
    values = shape_from_lengths(model, bodies.select(slice(None, None, scene.num_frames)).posed())
    found = _Shapes(values, values.new_zeros(len(values), len(CLOTHED)), values.new_ones(len(values), 1))
    for person, known in scene.shapes.items():
        check_tensor(f"shapes[{person}].values", known.values, values[person].shape, dtypes=FLOATS)
        check_tensor(f"shapes[{person}].clothes", known.clothes, found.clothes[person].shape, dtypes=FLOATS)
        found.values[person] = known.values.to(values)
        found.clothes[person] = known.clothes.to(values)
        found.unknown[person] = 0
    return found
