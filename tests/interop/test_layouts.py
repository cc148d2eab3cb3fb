"""Views of numbers in one block of memory."""

import torch

from warp_partdr.interop.layouts import split_blocks


def test_blocks_of_a_part_of_memory_begin_where_the_part_begins():
    numbers = torch.arange(20.0)
    shapes = torch.Size((2, 3)), torch.Size((2,))
    for first in (0, 5):
        vectors, scalars = split_blocks(numbers[first : first + 8], shapes)
        assert torch.equal(vectors, numbers[first : first + 6].view(2, 3))
        assert torch.equal(scalars, numbers[first + 6 : first + 8])
