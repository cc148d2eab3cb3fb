"""The way of both renderers: pictures with differentiable maps, L_seg, and their form under ``torch.compile``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeVar

import torch

from ..interop.arrays import contiguous
from ..interop.graph_cache import BYTES_PER_PIXEL, CapturedBodies, graphs
from ..interop.layouts import Shapes, Tensors, row_length, split_blocks
from ..interop.loss_graph import Recipe, find_label_loss
from ..interop.operation import Gradients, Operation
from ..interop.streams import launch_bodies_on
from .options import label_maps

Size = tuple[int, int]
Settings = tuple[list[int], str, list[float]]  # integers, name of the gradient, numbers


class Picture(NamedTuple):
    """Images of B bodies, shape (B, H, W).

    Attributes:
        labels: Label at each pixel, 0 = background, uint8.
        depth: Depth of the nearest surface [m], inf = background, float32.
        nearest: Index of the nearest face or ellipsoid, integers.
        faults: NaN for a body with numbers that can't be drawn (NaN, infinity, sizes of 0 or less), else 0, shape (B,).
        scratch: Scratch arrays of the launches that drew it, for the gradient. If it is None, they are made again.
    """

    labels: torch.Tensor
    depth: torch.Tensor
    nearest: torch.Tensor
    faults: torch.Tensor
    scratch: Any = None


class MapPasses(Recipe, Protocol):
    """Launches that draw, and those of the gradient."""

    drawing: str  # name of the public function that draws

    def draw(self, inputs: Tensors, size: Size) -> Picture:
        """Draw the picture."""

    def prepare_labels(self, inputs: Tensors, labels: torch.Tensor, faults: torch.Tensor) -> Callable[[], None]:
        """Allocate intermediate buffers; return a function that fills ``labels`` and ``faults`` by launches alone."""

    def gradients(self, inputs: Tensors, picture: Picture, grad_maps: torch.Tensor) -> Tensors:
        """Gradients with respect to the inputs, from that with respect to part maps (B, K, H, W)."""


class Passes(MapPasses, Protocol):
    """A renderer's launches, with its options."""

    kind: str  # of the custom operations: "mesh", "ellipsoid" or "body"

    @property
    def constants(self) -> Tensors:
        """Tensors that are drawn, too, but have no gradient."""

    def settings(self) -> Settings:
        """Options as custom operations take them."""


class DrawnLater:
    """Base of a dataclass of images, in the order of ``Picture``, that may be drawn when one is first read."""

    @classmethod
    def later(cls, draw: Callable[[], Iterable[torch.Tensor]], **drawn: torch.Tensor) -> Self:
        """Images that ``draw`` will give, but for those that are ``drawn``."""
        image = cls.__new__(cls)
        image.__dict__.update(drawn, _draw=draw)
        return image

    if not TYPE_CHECKING:  # or any name would be one of its attributes

        def __getattr__(self, name: str) -> Any:  # Python asks here for what it has not found
            if name not in self.__dataclass_fields__ or "_draw" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
            for field, image in zip(self.__dataclass_fields__, self._draw(), strict=False):
                self.__dict__.setdefault(field, image)
            return self.__dict__[name]


_Image = TypeVar("_Image", bound=DrawnLater)


def draw_picture(image: Callable[..., _Image], passes: Passes, inputs: Tensors, size: Size, num_maps: int) -> _Image:
    """Draw images, and maps of labels 1 to ``num_maps`` that carry gradients back to the inputs."""
    if torch.compiler.is_compiling():
        given = inputs if num_maps else tuple([tensor.detach() for tensor in inputs])
        maps, *images = _draw_compiled(passes, given, size, num_maps)  # removed where the picture is not used
        return image(*images, maps if num_maps else None)
    if num_maps == 0:
        found: _Image = _draw_labels(image, passes, inputs, size)
        return found
    return image(*_Maps(passes, size, num_maps)(*inputs))


def draw_maps(passes: Passes, inputs: Tensors, size: Size, num_maps: int) -> torch.Tensor:
    """Draw maps of labels 1 to ``num_maps``, shape (B, K, H, W), that carry gradients back to the inputs."""
    if torch.compiler.is_compiling():
        return _draw_compiled(passes, inputs, size, num_maps)[0]
    return _Maps(passes, size, num_maps)(*inputs)[-1]


def _draw_compiled(passes: Passes, inputs: Tensors, size: Size, num_maps: int) -> Tensors:
    """Draw maps, labels, depth and index of the nearest by a custom operation, which ``torch.compile`` takes whole."""
    operation = getattr(torch.ops.warp_partdr, f"{passes.kind}_maps")
    *pictures, _ = operation([*inputs, *passes.constants], [num_maps, *size], *passes.settings())
    return tuple(pictures)


@torch.no_grad()
def draw_labels(passes: MapPasses, inputs: Tensors, size: Size) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw labels alone, shape (B, H, W), uint8, and faults, by a captured graph where memory has room."""
    batch, device = inputs[0].shape[0], inputs[0].device
    if batch and (graph := _find_graph(passes, tuple([tensor.shape for tensor in inputs]), size, device)):
        copied = graph(inputs)
        return copied.labels, copied.faults
    labels, faults = torch.empty(batch, *size, dtype=torch.uint8, device=device), torch.empty(batch, device=device)
    given = tuple(map(contiguous, inputs))

    def launch(part: slice) -> None:
        passes.prepare_labels(tuple(tensor[part] for tensor in given), labels[part], faults[part])()

    launch_bodies_on(device, launch, batch, passes.modules)
    return labels, faults


def find_loss(
    image: type[_Image], passes: Passes, inputs: Tensors, target: torch.Tensor
) -> tuple[torch.Tensor, _Image]:
    """L_seg of each body against label images (N, H, W), and the picture, drawn when it is first looked at."""
    size = (target.shape[1], target.shape[2])
    loss, numbers = find_body_losses(passes, inputs, target)
    if torch.compiler.is_compiling():
        return loss, draw_picture(image, passes, inputs, size, 0)
    return loss, image.later(partial(_draw_copy, passes, numbers, [tensor.shape for tensor in inputs], size))


def find_body_losses(passes: Passes, inputs: Tensors, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """L_seg of each body, and ``Buffers.numbers``, as ``find_label_loss`` gives them, also under ``torch.compile``."""
    if not torch.compiler.is_compiling():
        return find_label_loss(passes, inputs, target)
    needs_grad = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs)
    operation = getattr(torch.ops.warp_partdr, f"{passes.kind}_label_loss")
    loss, numbers = operation([*inputs, *passes.constants], target, needs_grad, *passes.settings())
    return loss, numbers


@torch.no_grad()
def _draw_copy(passes: Passes, numbers: torch.Tensor, shapes: Sequence[torch.Size], size: Size) -> Tensors:
    """Draw the picture of a loss, from its copy of the inputs."""
    return passes.draw(split_blocks(numbers, tuple(shapes)), size)[:3]


@torch.no_grad()
def _draw_labels(image: Any, passes: Passes, inputs: Tensors, size: Size) -> Any:
    """Draw labels by a captured graph, and what else there is when it is first looked at; or all of it at once.

    All, where memory has no room, where copies of the inputs would take longer than labels, and where somebody has
    looked at more than labels before.
    """
    shapes = tuple([tensor.shape for tensor in inputs])
    num_bytes, pixels = 4 * sum([tensor.numel() for tensor in inputs]), shapes[0][0] * math.prod(size)
    key, graph = (passes, shapes, size), None
    if num_bytes <= max(pixels, _FEW_BYTES) and not (_looked_at and key in _looked_at):
        graph = _find_graph(*key, inputs[0].device)
    if graph is None:
        return image(*passes.draw(inputs, size)[:3])
    copied = graph(inputs)
    return image.later(partial(_draw_rest, key, copied), labels=copied.labels)


def _find_graph(passes: MapPasses, shapes: Shapes, size: Size, device: torch.device) -> _LabelsGraph | None:
    num_bytes = shapes[0][0] * math.prod(size) * BYTES_PER_PIXEL
    return graphs.find((passes, shapes, size), device, num_bytes, lambda: _LabelsGraph(passes, shapes, size, device))


_looked_at: set[tuple[Passes, Shapes, Size]] = set()  # pictures of which more than labels was wanted
_MOST_LOOKED_AT = 256
_FEW_BYTES = 2**22  # that are copied as fast as a copy begins


@torch.no_grad()
def _draw_rest(key: tuple[Passes, Shapes, Size], copied: _LabelsBlock) -> Tensors:
    """Draw what a labels' graph left out, and remember that it was wanted."""
    if len(_looked_at) >= _MOST_LOOKED_AT:
        _looked_at.clear()
    _looked_at.add(key)
    passes, shapes, size = key
    return passes.draw(split_blocks(copied.numbers, shapes), size)[:3]


class _LabelsBlock:
    """Labels, faults and inputs of B bodies in one block of memory, which is copied at once.

    Args:
        batch: Number of bodies B.
        size: Height and width of the pictures [px].
        length: Numbers of a body's inputs.
        memory: Block of bytes.
    """

    def __init__(self, batch: int, size: Size, length: int, memory: torch.Tensor) -> None:
        self._shape, self._length, self.memory = (batch, *size), length, memory
        height, width = size
        self.labels = memory.as_strided(self._shape, (height * width, width, 1))

    @classmethod
    def empty(cls, batch: int, size: Size, length: int, device: torch.device) -> _LabelsBlock:
        """Block that is to be filled."""
        num_bytes = _whole_words(batch * math.prod(size)) + 4 * batch * (1 + length)
        return cls(batch, size, length, torch.empty(num_bytes, dtype=torch.uint8, device=device))

    @property
    def faults(self) -> torch.Tensor:
        """Faults as in ``Picture``."""
        return self._floats[: self._shape[0]]

    @property
    def numbers(self) -> torch.Tensor:
        """Numbers of the inputs, for ``split_blocks``."""
        return self._floats[self._shape[0] :]

    @property
    def _floats(self) -> torch.Tensor:
        return self.memory[_whole_words(math.prod(self._shape)) :].view(torch.float32)

    def copy(self) -> _LabelsBlock:
        """Copy of the block."""
        batch, *size = self._shape
        return _LabelsBlock(batch, (size[0], size[1]), self._length, self.memory.clone())


def _whole_words(num_bytes: int) -> int:
    """The next multiple of 16 bytes, so that kernels can read what follows in the widest words."""
    return -num_bytes // 16 * -16


class _LabelsGraph:
    """Label images by a captured graph in fixed buffers; returns a copy of them."""

    def __init__(self, passes: MapPasses, shapes: Shapes, size: Size, device: torch.device) -> None:
        batch = shapes[0][0]
        self._block = block = _LabelsBlock.empty(batch, size, row_length(shapes), device)
        self._inputs = inputs = split_blocks(block.numbers, shapes)
        labels, faults = block.labels, block.faults

        def prepare(part: slice) -> Callable[[], None]:
            return passes.prepare_labels(tuple(tensor[part] for tensor in inputs), labels[part], faults[part])

        self._launches = CapturedBodies(prepare, batch, device)

    def __call__(self, inputs: Tensors) -> _LabelsBlock:
        torch._foreach_copy_(self._inputs, inputs)
        self._launches.replay()
        return self._block.copy()


@dataclass
class _Maps(Operation):
    """Three images, which have no gradient, and part maps."""

    passes: MapPasses
    size: Size
    num_maps: int
    scratch: Any = None  # of the launches that drew, for the gradient
    num_fixed = 3

    @property
    def name(self) -> str:
        return self.passes.drawing

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        *images, faults, self.scratch = self.passes.draw(inputs, self.size)
        return (*images, label_maps(images[0], self.num_maps, faults)), (*images, faults)

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        *inputs, labels, depth, nearest, faults = saved
        picture = Picture(labels, depth, nearest, faults, self.scratch)
        return self.passes.gradients(tuple(inputs), picture, adjoints[-1])
