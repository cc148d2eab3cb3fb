"""Pictures read, and their people cut out, in processes: in one, Python's lock lets a single core do that."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
import warp as wp
from torch.utils.data import DataLoader, Dataset

from ..errors import InputError, cause
from ..interop.devices import without_driver_warning
from ..kernels.launch import set_num_threads
from .cutting import Cut, Cutter, Held, read_picture
from .sources import PictureSource, SourcePicture

_SHARED = "/dev/shm"  # of Linux
_LARGEST_PIECE = 2**25 - 2**16  # [bytes], of which glibc takes notice
_GROUP = 32  # pictures that a process reads at a time

Group = Cut | list[Held]


class _Groups(Dataset[Group]):
    """Groups of pictures: people cut out of them, or pictures, if people have to be found in one of them."""

    def __init__(self, source: PictureSource, cutter: Cutter, groups: Sequence[Sequence[str]]) -> None:
        self.source, self.cutter, self.groups = source, cutter, groups

    def __len__(self) -> int:
        return len(self.groups)

    def __getitem__(self, index: int) -> Group:
        held = [(name, read_picture(self.source, name)) for name in self.groups[index]]
        if any(isinstance(seen, SourcePicture) and seen.people is None for _, seen in held):
            return held
        return self.cutter.cut(held, {})


def read_in_processes(
    source: PictureSource, cutter: Cutter, shards: Sequence[Sequence[str]], processes: int
) -> Iterator[Iterator[Held | Cut]]:
    """Read pictures in order, some groups ahead, by torch's ``DataLoader``.

    Args:
        source: Source of the pictures.
        cutter: Object that cuts people out of pictures.
        shards: Names of each shard's pictures.
        processes: Number of processes.

    Returns:
        Groups for ``group_rows``, one of each shard.

    Raises:
        InputError: If a process ends before its time.
    """
    groups = [names[first : first + _GROUP] for names in shards for first in range(0, len(names), _GROUP)]
    loader = DataLoader(
        _Groups(source, cutter, groups),
        batch_size=None,
        num_workers=processes,
        collate_fn=_as_it_is,
        worker_init_fn=_prepare,
        multiprocessing_context=_context(),
    )
    read = iter(loader)
    for names in shards:
        yield _each(islice(read, -(-len(names) // _GROUP)))


def _context() -> multiprocessing.context.BaseContext:
    """Processes that are forks of one that has read these modules and does nothing else.

    A fork of this one would inherit CUDA, Warp's and torch's threads half alive. Started each for itself, they would
    read the modules one after the other: each waits for the one before to take the pictures' names.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # on Windows
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


def _prepare(process: int) -> None:
    """Let a process take one core for Warp's kernels, as torch does, and keep its memory.

    The C library keeps what is freed, for what is taken anew from the system is cleared each time: glibc twice as much
    as the largest piece that was freed; others do as they do.
    """
    os.environ["CUDA_VISIBLE_DEVICES"] = ""  # else each would take some of the GPU's memory
    wp.config.log_level = wp.LOG_WARNING
    with without_driver_warning():
        wp.init()
    set_num_threads(1)
    np.empty(_LARGEST_PIECE, dtype=np.uint8)


def needed_memory(processes: int, batch: int, label_size: int) -> int:
    """Bytes of shared memory that hold people with labels: two groups of each process, and batches that wait."""
    return (2 * processes * _GROUP + 4 * batch) * label_size**2


def shared_memory() -> int:
    """Bytes of shared memory that are free; where nothing says so, enough."""
    try:
        return shutil.disk_usage(_SHARED).free
    except OSError:
        return sys.maxsize


def _each(groups: Iterator[Group]) -> Iterator[Held | Cut]:
    while True:
        try:
            group = next(groups, None)
        except RuntimeError as error:  # the loader's own, for what is at fault in a picture is a row
            fault = f"reading pictures: a process ended ({cause(error)})"
            raise InputError(f"{fault}; expected memory for all of them, in /dev/shm, too") from error
        if group is None:
            return
        if isinstance(group, Cut):
            yield group
        else:
            yield from group


def _as_it_is(group: Group) -> Group:
    return group
