"""The process of the command ``partdr``, also ``python -m warp_partdr``.

It is a file of its own that imports nothing at its top, so that Ctrl-C is quiet while the command itself is imported.
"""


def start() -> None:
    """Import the command and run it; Ctrl-C at any time ends the process with exit code 130, without a traceback."""
    try:
        from .cli.main import run

        run()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


if __name__ == "__main__":
    start()
