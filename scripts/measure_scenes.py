"""Measure and print a level of scenes of PartBench on some of its people.

    python scripts/measure_scenes.py pairs|groups|clip|views [FIRST LAST] [--mocap FOLDER] [--device cuda]
        [--method NAME]... [--jobs N]

People are 100 to 139 if nothing is said. Intervals are of 95 %, over scenes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console

from warp_partdr.lab.evaluation.evaluate import evaluate, one_thread, tables
from warp_partdr.lab.evaluation.partbench.report import compare_methods
from warp_partdr.lab.evaluation.partbench.samples import SCENES
from warp_partdr.lab.evaluation.partbench.scenes import SCENE_METHODS, partbench_scenes
from warp_partdr.lab.evaluation.scene_scoring import sliding_speed


def main() -> None:
    """Fit, and print tables and differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("level", choices=SCENES)
    parser.add_argument("people", type=int, nargs="*", default=[100, 139], help="first and last")
    parser.add_argument("--mocap", type=Path, help="motion capture, for the level clip")
    parser.add_argument("--method", action="append", choices=SCENE_METHODS, help="may be given again; default: all")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--jobs", type=int, default=1, help="fits at a time, in processes of their own")
    options = parser.parse_args()
    first, last = options.people
    one_thread()
    samples = partbench_scenes(range(first, last + 1), [options.level], options.mocap)
    methods = {name: SCENE_METHODS[name] for name in options.method or SCENE_METHODS}
    report = evaluate(samples, methods, device=options.device, jobs=options.jobs)
    for table in tables(report):
        Console(width=170).print(table)
    moving = [each for each in samples if each.scene.num_frames > 1]
    if moving:
        speeds = [sliding_speed(each.joints, each.joints, each.scene.frame_rate) for each in moving]
        print(f"Feet that stand slide by {1000 * np.nanmean(speeds):.0f} mm/s in the truth.")
    for finding in compare_methods(report):
        print(finding)
    for failure in report.failures:
        print(failure)


if __name__ == "__main__":
    main()
