"""How fast the mesh renderer is, stage by stage: captured graphs on random bodies, each with another as its target.

    python benchmarks/mesh_speed.py [--device cpu] [--size 256] [--bodies 1 8 128]

Times are medians of replays, warm; on CUDA the device's own events take them. Before that, what the launches leave in
buffers full of rubbish is held against ``label_loss``.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
import warp as wp

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.cameras import WeakPerspective
from warp_partdr.kernels import part_gradient, rasterize
from warp_partdr.mesh import ellipbody_mesh
from warp_partdr.render import label_loss, rasterize_parts

OPTIONS = {"near": -float("inf"), "perspective": False}


def standing_bodies(batch: int, size: int, off: float, subdivisions: int, device: str) -> torch.Tensor:
    """Projected vertices of bodies as high as three quarters of the picture, every joint ``off`` [rad] its place."""
    rng = np.random.default_rng(0)
    angles = rng.normal(0, 0.3, (batch, 20, 3)) + off * rng.normal(0, 1, (batch, 20, 3))
    body = EllipBody.mean(batch, device=device)
    parameters = body.torch()
    parameters["rotations"][:] = rotation_from_axis_angle(torch.from_numpy(angles)).to(parameters["rotations"])
    parameters["global_orient"][:] = torch.diag(torch.tensor([1.0, -1.0, -1.0])).to(parameters["global_orient"])
    points = body.pose(subdivisions=subdivisions).torch()["vertices"].flatten(1, 2)
    scale = torch.full((batch,), 0.45 * size, device=device)
    middle = torch.tensor([[size / 2 + 20 * off, size / 2]] * batch, device=device)
    return WeakPerspective(scale, middle).project(points).contiguous()


class Iteration:
    """One iteration's buffers, filled with rubbish, and its stages as launches."""

    def __init__(self, batch: int, size: int, subdivisions: int, device: str) -> None:
        self.mesh = mesh = ellipbody_mesh(subdivisions, device=device)
        self.bodies = standing_bodies(batch, size, 0.0, subdivisions, device)
        self.wanted = rasterize_parts(
            standing_bodies(batch, size, 0.2, subdivisions, device), mesh, (size, size)
        ).labels
        shape = (batch, size, size)
        self.vertices = wp.from_torch(self.bodies, dtype=wp.vec3)
        self.faces = wp.from_torch(mesh.faces, dtype=wp.vec3i)
        self.face_labels = wp.from_torch(mesh.face_labels)
        self.edges = wp.from_torch(mesh.edges)
        self.zbuffer = rasterize.ZBuffer.make(*shape, device)
        self.labels = wp.full(shape, 77, dtype=wp.uint8, device=device)
        self.depth = wp.full(shape, -9.0, dtype=wp.float32, device=device)
        self.face_index = wp.full(shape, -9, dtype=wp.int32, device=device)
        self.losses = wp.zeros(rasterize.pixel_lanes(shape, device == "cpu"), dtype=wp.float32, device=device)
        self.found = part_gradient.SilhouetteList.make(batch, self.edges.shape[0], device)
        self.grad = wp.full((*self.vertices.shape, 3), 9.0, dtype=wp.float32, device=device)
        self.gradient = part_gradient.LabelTarget()
        self.gradient.target = wp.from_torch(self.wanted)
        weights = torch.ones(256, device=device)
        weights[0] = weights[255] = 0.0
        self.gradient.label_weights = wp.from_torch(weights)
        self.gradient.scale = wp.ones(batch, dtype=wp.float32, device=device)
        extents = (batch, rasterize.NUM_EXTENTS, mesh.num_labels + 1)
        self.gradient.extents = wp.zeros(extents, dtype=wp.vec4i, device=device)

    def draw_labels(self) -> None:
        """The hard label image alone."""
        rasterize.launch_rasterize(
            self.vertices, self.faces, self.face_labels, **OPTIONS, zbuffer=self.zbuffer, labels=self.labels
        )

    def draw_all(self) -> None:
        """Labels, depth and face index, as ``rasterize_parts`` gives them."""
        self._draw(background=True)

    def draw(self) -> None:
        """What the gradient needs of them."""
        self._draw(background=False)

    def _draw(self, *, background: bool) -> None:
        rasterize.launch_rasterize(
            self.vertices,
            self.faces,
            self.face_labels,
            **OPTIONS,
            zbuffer=self.zbuffer,
            labels=self.labels,
            depth=self.depth,
            face_index=self.face_index,
            background=background,
        )

    def compare(self) -> None:
        """L_seg."""
        rasterize.launch_compare_labels(
            self.labels,
            self.gradient.target,
            self.gradient.label_weights,
            extents=self.gradient.extents,
            losses=self.losses,
        )

    def push_edges(self) -> None:
        """The x and y gradient."""
        self.grad.zero_()
        part_gradient.launch_push_edges(
            self.vertices,
            self.face_labels,
            self.edges,
            **OPTIONS,
            all_edges=False,
            over_farther=True,
            max_distance=float("inf"),
            labels=self.labels,
            face_index=self.face_index,
            depth=self.depth,
            gradient=self.gradient,
            found=self.found,
            grad_vertices=self.grad,
        )

    def push_depths(self) -> None:
        """The z gradient."""
        part_gradient.launch_push_depths(
            self.vertices,
            self.faces,
            self.face_labels,
            **OPTIONS,
            depth_weight=1.0,
            labels=self.labels,
            face_index=self.face_index,
            gradient=self.gradient,
            keys=self.zbuffer.keys,
            grad_vertices=self.grad,
        )

    def whole(self) -> None:
        """Render, L_seg and gradient."""
        self.draw()
        self.compare()
        self.push_edges()
        self.push_depths()

    def check(self) -> None:
        """Two runs agree with ``label_loss``.

        Raises:
            AssertionError: If they do not.
        """
        leaf = self.bodies.requires_grad_()
        loss, image = label_loss(leaf, self.mesh, self.wanted)
        (want,) = torch.autograd.grad(loss.sum(), leaf)
        for _ in range(2):
            self.whole()
            assert torch.equal(wp.to_torch(self.labels), image.labels)
            shown = image.labels > 0
            assert torch.equal(wp.to_torch(self.face_index)[shown], image.face_index[shown])
            torch.testing.assert_close(wp.to_torch(self.losses).sum((1, 2)), loss)
            torch.testing.assert_close(wp.to_torch(self.grad), want, rtol=1e-4, atol=1e-3)


def median_us(stage: Callable[[], None], device: str, *, replays: int = 30) -> float:
    """Median time of one captured stage [µs]."""
    stage()
    with wp.ScopedCapture(device=device) as capture:
        stage()
    times = []
    for _ in range(replays + 3):
        if device == "cpu":
            started = time.perf_counter()
            wp.capture_launch(capture.graph)
            times.append(1e6 * (time.perf_counter() - started))
        else:
            with wp.ScopedTimer("", print=False, synchronize=True):
                pass
            begin, end = wp.Event(device, enable_timing=True), wp.Event(device, enable_timing=True)
            wp.record_event(begin)
            wp.capture_launch(capture.graph)
            wp.record_event(end)
            times.append(1e3 * wp.get_event_elapsed_time(begin, end))
    return statistics.median(times[3:])


def main() -> None:
    """Check, measure, and print one table and the same as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--size", type=int, default=256, help="side of the picture [px]")
    parser.add_argument("--subdivisions", type=int, default=1, help="of EllipBody's parts, 0 to 3")
    parser.add_argument("--bodies", type=int, nargs="*", default=[1, 8, 128])
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    device = options.device
    figures: dict[str, float] = {}
    for batch in options.bodies:
        iteration = Iteration(batch, options.size, options.subdivisions, device)
        iteration.check()
        shown = float((wp.to_torch(iteration.labels) > 0).float().mean())
        wrong = float((wp.to_torch(iteration.labels) != iteration.wanted).float().mean())
        edges = int(iteration.found.counts.numpy()[:, 0].mean())
        print(f"B = {batch}: covers {shown:.1%}, wrong {wrong:.1%}, {edges} silhouette edges a body")
        for stage in (
            iteration.draw_labels,
            iteration.draw_all,
            iteration.draw,
            iteration.compare,
            iteration.push_edges,
            iteration.push_depths,
            iteration.whole,
        ):
            figures[f"B = {batch}: {stage.__name__} [us]"] = round(median_us(stage, device), 1)

    place = torch.cuda.get_device_name() if device != "cpu" else platform.processor() or platform.machine()
    about = {"device": place, "size": options.size, "warp": wp.config.version, "torch": torch.__version__}
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    for key, value in figures.items():
        print(f"{key:{max(map(len, figures))}}  {value}")
    print(json.dumps({**about, **figures}))


if __name__ == "__main__":
    main()
