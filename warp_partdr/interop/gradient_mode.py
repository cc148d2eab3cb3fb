"""Torch's gradient mode within fits, which need gradients whatever the caller does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def with_gradients() -> Iterator[None]:
    """Let torch make gradients within, even if the caller is in ``torch.no_grad`` or ``torch.inference_mode``.

    Tensors that are made within are ordinary ones, and a later stage can use them. It can also be a decorator.
    """
    with torch.inference_mode(False), torch.enable_grad():
        yield
