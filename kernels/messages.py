"""Messages while kernels are loaded: Warp's own, and the one that tells why a first run takes longer."""

from __future__ import annotations

import os
import sys
from pathlib import Path

COMPILING = "compiling kernels, once for this machine"


def quieten() -> None:
    """Let Warp tell warnings and errors alone; if no kernel is compiled yet, say so in one line.

    ``wp.config.log_level = wp.LOG_INFO`` brings Warp's messages back.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    say_if_compiling("warp_partdr")


def say_if_compiling(name: str) -> None:
    """Say in a line on stderr that kernels will be compiled, if none is; ``name`` says who compiles them."""
    if not kernels_are_compiled():
        print(f"{name}: {COMPILING}: the first run takes up to a minute longer", file=sys.stderr, flush=True)


def kernels_are_compiled() -> bool:
    """True if Warp's cache holds kernels of this package, or if it is not known where the cache is."""
    import warp as wp  # here, for a command without kernels starts without it

    folder = wp.config.kernel_cache_dir or os.environ.get("WARP_CACHE_PATH")
    if not folder:
        if sys.platform != "linux":
            return True
        folder = str(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warp")
    # The folder holds one a version of Warp, or is that already once Warp has begun.
    return any(next(Path(folder).glob(f"{below}wp_{__package__}.*"), None) for below in ("", f"{wp.config.version}/"))
