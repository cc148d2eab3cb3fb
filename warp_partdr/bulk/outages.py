"""Errors that another run may not meet: of a disk, a memory or what is installed, not of what a file holds."""

from __future__ import annotations

import errno

import torch

from ..errors import InputError

# The system's errors about a path itself, which will be the same tomorrow. Pillow meets EINVAL in damaged pictures.
_LASTING = {errno.EINVAL, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP}
_PASSING = (MemoryError, torch.OutOfMemoryError, ImportError)


class PassingError(InputError):
    """An error that another run may not meet; it stays one on its way from another process."""


def is_passing(error: BaseException) -> bool:
    """True if another run may not meet an error.

    Errors of reading from a disk pass, too little memory, and a library that is not installed; also where another error
    was raised from such a one.
    """
    each: BaseException | None = error
    while each is not None:
        if isinstance(each, (PassingError, *_PASSING)):
            return True
        if isinstance(each, OSError) and each.errno in errno.errorcode.keys() - _LASTING:
            return True
        each = each.__cause__
    return False
