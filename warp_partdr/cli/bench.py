"""Commands ``partdr bench ...``: figures on the screen and on disk, with the machine that they were measured on."""

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

bench = typer.Typer(help="Measure how fast this machine is, and what accuracy costs.", no_args_is_help=True)

_OUT = Path("out")

_KERNELS_HELP = """Time every kernel and the whole iteration, for several renderers, batches and picture sizes.

Example: `partdr bench kernels --device cpu --quick`

A table appears on the screen. FOLDER gets the same figures as bench-kernels-DEVICE.json and .png, with machine and
versions. DRTK, nvdiffrast, PyTorch3D, Mitsuba and Embree (embreex) draw the same mesh if they are installed; pip can
install the last two: `.[peers]`.
"""

_SAVINGS_HELP = """Time what is saved if only the parts of the model are computed that a scene requires.

Example: `partdr bench savings --device cpu`

A table appears on the screen, one row for each saving. FOLDER gets the same figures as bench-savings-DEVICE.json, with
machine and versions. On the CPU, one core is used. It takes about 40 s. docs/measured/savings.md explains what is left
out.
"""

_TRADEOFF_HELP = """Measure what accuracy costs: meshes E0 to E3 and exact ellipsoids, gradients, picture sizes.

Example: `partdr bench tradeoff --device cpu --quick`

People whose true bodies are known, EllipBodies and Anny bodies, are refined from starts with known errors. Tables on
the screen compare the time of an iteration with part F1, joint error and error of the gradient; then iterations,
float64, and whole fits at each quality. FOLDER gets the same figures as bench-tradeoff-DEVICE.json, and a chart as
.png, with machine and versions. It takes ten minutes on two idle cores, one minute with --quick.
docs/measured/speed_and_accuracy.md has the results.
"""


@bench.command("kernels", help=_KERNELS_HELP)
def bench_kernels(
    device: DeviceOption = "auto",
    quick: Annotated[
        bool, Option(help="Only the main rows, with fewer repeats and no cold starts: under 20 s.")
    ] = False,
    out: OutOption = _OUT,
) -> None:
    """Time kernels; see ``_KERNELS_HELP``."""
    used_device = _begin(device, out)
    from ..lab.bench.kernels.chart import draw_kernel_chart
    from ..lab.bench.kernels.measure import run_kernels
    from ..lab.bench.kernels.plan import plan_kernels
    from ..lab.bench.kernels.report import print_kernels
    from .progress import FitProgress

    with FitProgress() as progress:
        figures = run_kernels(plan_kernels(used_device, quick=quick), progress)
    _save(out, f"kernels-{used_device}", figures, partial(print_kernels, figures), draw_kernel_chart(figures))


@bench.command("savings", help=_SAVINGS_HELP)
def bench_savings(device: DeviceOption = "auto", out: OutOption = _OUT) -> None:
    """Time savings; see ``_SAVINGS_HELP``."""
    used_device = _begin(device, out)
    from ..kernels.launch import set_num_threads
    from ..lab.bench.machine import about
    from ..lab.bench.savings import print_savings, run_savings
    from .progress import FitProgress

    set_num_threads(1)  # shares of time are measured on one core
    with FitProgress() as progress:
        rows = run_savings(used_device, progress=progress)
    machine = about(used_device)
    _save(out, f"savings-{used_device}", {"machine": machine, "rows": rows}, partial(print_savings, rows, machine))


@bench.command("tradeoff", help=_TRADEOFF_HELP)
def bench_tradeoff(
    device: DeviceOption = "auto",
    quick: Annotated[bool, Option(help="Few people and options: under a minute, too few for conclusions.")] = False,
    out: OutOption = _OUT,
) -> None:
    """Measure the tradeoff; see ``_TRADEOFF_HELP``."""
    used_device = _begin(device, out)
    from ..lab.bench.tradeoff.chart import draw_tradeoff_chart
    from ..lab.bench.tradeoff.measure import run_tradeoff
    from ..lab.bench.tradeoff.plan import plan_tradeoff
    from ..lab.bench.tradeoff.tables import print_tradeoff
    from .progress import FitProgress

    with FitProgress() as progress:
        report = run_tradeoff(plan_tradeoff(used_device, quick=quick), progress)
    _save(
        out, f"tradeoff-{used_device}", report.as_dict(), partial(print_tradeoff, report), draw_tradeoff_chart(report)
    )


def _begin(device: str, out: Path) -> str:
    """Make the folder, and choose the device. Torch and Warp are loaded only now, so that --help is fast."""
    import torch

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: {out}: {error.strerror}; expected a folder") from error
    used_device = choose_device(device)
    if used_device == "cpu":
        torch.set_num_threads(1)  # as ``fit`` does
    return used_device


def _save(
    out: Path, name: str, figures: dict[str, Any], show: Callable[[Console], None], chart: Figure | None = None
) -> None:
    """Write bench-NAME.json, and bench-NAME.png if there is a chart, and show the figures."""
    from ..lab.tables import save_figures, wide_console

    path = out / f"bench-{name.replace(':', '')}"
    files = [path.with_suffix(".json")]
    save_figures(figures, files[0])
    if chart is not None:
        files.append(path.with_suffix(".png"))
        chart.savefig(files[1])
    show(wide_console())
    typer.echo(f"{' and '.join(map(str, files))} {'holds' if len(files) == 1 else 'hold'} the same figures")
