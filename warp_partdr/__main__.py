"""``python -m warp_partdr``: the command ``partdr``, for launchers that take a module."""

from .cli.main import run

run()
