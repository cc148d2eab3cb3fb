"""Loader of the kernels that a fit needs. It runs before the fit, so that loading does not count as a stage's time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..solve.ellipsoids.options import FitOptions

NO_MODEL = "none"  # value of --model


def load_kernels(device: str, options: FitOptions, *, with_labels: bool) -> None:
    """Compile a fit's kernels, or load compiled ones; later, this would count as a stage's time."""
    import warp as wp

    from ..kernels import kinematics, own_pixels, own_targets
    from ..kernels.ellipsoids import picture, silhouette
    from ..kernels.mesh import label_borders, push_xy, push_z, rasterize, resolve
    from ..kernels.refine import state
    from ..render.ellipsoid_passes import estimator
    from ..render.renderers import RendererEllipsoids, RendererMesh

    modules: list[Any] = [kinematics, rasterize, resolve]
    if device == "cpu":  # on CUDA, launches compile these for their own block sizes
        modules.append(state.MODULE)
    if with_labels and isinstance(options.renderer, RendererMesh):
        modules += [label_borders] if options.renderer.gradient == "edges" else [push_xy, push_z]
    elif with_labels and device == "cpu":
        drawn = [stage.renderer for stage in options.stages if stage.size]
        gradients = sorted({each.gradient for each in drawn if isinstance(each, RendererEllipsoids)})
        modules += [silhouette, picture, *map(estimator, gradients)]
    for module in modules:
        wp.load_module(module, device=device)
    for module in (own_pixels, own_targets) if with_labels else ():  # a single person is cut out on the CPU
        wp.load_module(module, device="cpu")


def load_mesh_kernels(device: str) -> None:
    """Compile the mesh stage's kernels, or load compiled ones."""
    import warp as wp

    from ..kernels.mesh import label_borders, rasterize, resolve

    for module in (rasterize, resolve, label_borders):
        wp.load_module(module, device=device)
