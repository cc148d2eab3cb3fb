"""Tensors over the memory of arrays."""

from __future__ import annotations

import gc
import warnings
import weakref

import numpy as np
import pytest
import torch
import warp as wp

from warp_partdr.interop.arrays import same_memory, tensor_over, warp_arrays


class Owner(np.ndarray):
    """An array that a weak reference can watch."""


def test_a_tensor_over_an_array_keeps_it_and_lets_it_go():
    array = Owner((40, 30, 3), dtype=np.uint8)
    array[:] = np.arange(3)
    array.flags.writeable = False
    watched = weakref.ref(array)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tensor = tensor_over(array)
    assert tensor.data_ptr() == array.ctypes.data
    del array
    gc.collect()
    assert watched() is not None
    assert torch.equal(tensor, torch.arange(3, dtype=torch.uint8).expand(40, 30, 3))
    del tensor
    gc.collect()
    assert watched() is None


def test_an_array_of_other_strides_is_copied():
    array = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)[:, ::-1]
    np.testing.assert_array_equal(tensor_over(array).numpy(), array)


def test_tensors_become_arrays_of_their_own_types():
    numbers, points = torch.arange(2.0), torch.arange(6.0).view(2, 3)
    scalars, vectors = warp_arrays([numbers, points], [None, wp.vec3])
    assert (scalars.dtype, vectors.dtype) == (wp.float32, wp.vec3)
    np.testing.assert_array_equal(vectors.numpy(), points)
    with pytest.raises(ValueError, match="zip"):
        warp_arrays([numbers, points], [None])


def test_tensors_over_one_memory_become_one_object():
    numbers = torch.arange(6, dtype=torch.int32)
    (first,) = same_memory([numbers.view(2, 3)])
    (again,) = same_memory([numbers.view(2, 3)])
    assert again is first
    (other,), (shape,), (part,) = same_memory([first.clone()]), same_memory([numbers]), same_memory([numbers[:3]])
    assert len({id(tensor) for tensor in (first, other, shape, part)}) == 4
    assert torch.equal(part, numbers[:3])
