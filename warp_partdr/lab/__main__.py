"""The command ``python -m warp_partdr.lab``."""

from .harness import run_lab

if __name__ == "__main__":
    run_lab()
