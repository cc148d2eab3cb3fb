"""The commands ``partdr bench ...``: figures on the screen and on disk, with the machine that they belong to."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from ..errors import InputError
from ..interop.devices import choose_device
from .options import DeviceOption, OutOption

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

bench = typer.Typer(help="How fast this machine is, and what speed costs.", no_args_is_help=True)

_OUT = Path("out")

_KERNELS_HELP = """Time every kernel and the whole iteration: renderers, batches and picture sizes.

Example: `partdr bench kernels --device cpu --quick`

A table on the screen; the same figures as bench-kernels-DEVICE.json and .png in FOLDER, with machine and versions.
DRTK, nvdiffrast, PyTorch3D, Mitsuba and Embree (embreex) draw the same mesh where they are installed; pip brings the
last two: `.[peers]`.
"""

_SAVINGS_HELP = """Time what it saves to model only what a scene requires, one row a saving.

Example: `partdr bench savings --device cpu`

A table on the screen; the same figures as bench-savings-DEVICE.json in FOLDER, with machine and versions. On the CPU,
on one core. Takes about 40 s; what is left out when, docs/savings.md says.
"""

_TRADEOFF_HELP = """Measure what accuracy costs: mesh E0 to E3 and exact ellipsoids, gradients, picture sizes.

Example: `partdr bench tradeoff --device cpu --quick`

People of known truth, EllipBodies and Annys, are refined from starts a stated way off: time an iteration against part
F1, joint error and error of the gradient; then iterations, float64, and whole fits at each quality. Tables on the
screen; the same figures as bench-tradeoff-DEVICE.json, and a chart, .png, in FOLDER, with machine and versions. Ten
minutes on two cores that do nothing else; --quick one. docs/accuracy.md says what was found.
"""


@bench.command("kernels", help=_KERNELS_HELP)
def bench_kernels(
    device: DeviceOption = "auto",
    quick: Annotated[bool, Option(help="The main rows alone, fewer repeats, no starts: under 20 s.")] = False,
    out: OutOption = _OUT,
) -> None:
    """Time kernels; see ``_KERNELS_HELP``."""
    where = _begin(device, out)
    from ..lab.bench.kernels.chart import draw_kernel_chart
    from ..lab.bench.kernels.measure import run_kernels
    from ..lab.bench.kernels.plan import plan_kernels
    from ..lab.bench.kernels.report import print_kernels
    from .progress import FitProgress

    with FitProgress() as progress:
        figures = run_kernels(plan_kernels(where, quick=quick), progress)
    _save(out, f"kernels-{where}", figures, partial(print_kernels, figures), draw_kernel_chart(figures))


@bench.command("savings", help=_SAVINGS_HELP)
def bench_savings(device: DeviceOption = "auto", out: OutOption = _OUT) -> None:
    """Time savings; see ``_SAVINGS_HELP``."""
    where = _begin(device, out)
    from ..kernels.launch import set_num_threads
    from ..lab.bench.machine import about
    from ..lab.bench.savings import print_savings, run_savings
    from .progress import FitProgress

    set_num_threads(1)  # shares of time are of one core's
    with FitProgress() as progress:
        rows = run_savings(where, progress=progress)
    machine = about(where)
    _save(out, f"savings-{where}", {"machine": machine, "rows": rows}, partial(print_savings, rows, machine))


@bench.command("tradeoff", help=_TRADEOFF_HELP)
def bench_tradeoff(
    device: DeviceOption = "auto",
    quick: Annotated[bool, Option(help="Few people and settings: under a minute, and no conclusions.")] = False,
    out: OutOption = _OUT,
) -> None:
    """Measure the tradeoff; see ``_TRADEOFF_HELP``."""
    where = _begin(device, out)
    from ..lab.bench.tradeoff.chart import draw_tradeoff_chart
    from ..lab.bench.tradeoff.measure import run_tradeoff
    from ..lab.bench.tradeoff.plan import plan_tradeoff
    from ..lab.bench.tradeoff.tables import print_tradeoff
    from .progress import FitProgress

    with FitProgress() as progress:
        report = run_tradeoff(plan_tradeoff(where, quick=quick), progress)
    _save(out, f"tradeoff-{where}", report.as_dict(), partial(print_tradeoff, report), draw_tradeoff_chart(report))


def _begin(device: str, out: Path) -> str:
    """Make the folder, and choose the device; torch and Warp are loaded from here on, so that --help is quick."""
    import torch

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: {out}: {error.strerror}; expected a folder") from error
    where = choose_device(device)
    if where == "cpu":
        torch.set_num_threads(1)  # as ``fit`` does
    return where


def _save(
    out: Path, name: str, figures: dict[str, Any], show: Callable[[Console], None], chart: Figure | None = None
) -> None:
    """Write bench-NAME.json, and bench-NAME.png where there is a chart, and show the figures."""
    from ..lab.tables import save_figures, wide_console

    path = out / f"bench-{name.replace(':', '')}"
    files = [path.with_suffix(".json")]
    save_figures(figures, files[0])
    if chart is not None:
        files.append(path.with_suffix(".png"))
        chart.savefig(files[1])
    show(wide_console())
    typer.echo(f"{' and '.join(map(str, files))} {'holds' if len(files) == 1 else 'hold'} the same figures")
