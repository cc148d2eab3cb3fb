"""Times and bytes: medians by hand, kernels in their places, and the machine that they belong to."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from warp_partdr.lab.bench.launches import (
    Launched,
    _capture_pieces,
    _run_first,
    count_bytes,
    observe_launches,
    time_kernels,
)
from warp_partdr.lab.bench.machine import about, copy_bandwidth
from warp_partdr.lab.bench.timing import capture, repeat, time_calls, time_graph
from warp_partdr.lab.tables import format_time


@wp.kernel
def _double(values: wp.array[float]):
    i = wp.tid()
    values[i] = 2.0 * values[i]


@wp.kernel
def _add(values: wp.array[float], more: wp.array[float]):
    i = wp.tid()
    values[i] = values[i] + more[i]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that each look leaves as it is; what runs moves it on."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr("warp_partdr.lab.bench.timing.time", SimpleNamespace(perf_counter=lambda: clock.now))
    return clock


def test_timings_state_median_spread_and_fastest(clock: SimpleNamespace) -> None:
    durations = iter([99.0, 3.0, 1.0, 2.0, 5.0, 4.0, 7.0])  # the first does not count

    def call() -> None:
        clock.now += next(durations)

    timing = time_calls(call, "cpu", budget=15.0)
    assert timing.seconds == (3.0, 1.0, 2.0, 5.0, 4.0)  # until 15 s are over
    assert timing.median == 3.0
    assert timing.spread == 2.0  # from 2 to 4
    assert timing.fastest == 1.0


@pytest.mark.usefixtures("clock")
def test_repeats_are_bounded() -> None:
    assert len(repeat(lambda: [1.0], 0.0).seconds) == 3
    assert len(repeat(lambda: [1.0, 2.0], 1.0).seconds) == 200


def test_bytes_are_counted_once() -> None:
    a, b = (Launched(name, np.array(spans)) for name, spans in (("a", [[0, 10], [5, 20], [30, 40]]), ("b", [[2, 35]])))
    assert (a.bytes, b.bytes) == (30, 33)
    assert count_bytes([a, b]) == 40
    assert count_bytes([]) == Launched("c", np.zeros((0, 2), dtype=np.int64)).bytes == 0


def test_launches_and_their_arrays_are_seen(device: str) -> None:
    values, more = wp.zeros(100, dtype=float, device=device), wp.zeros(200, dtype=float, device=device)

    def run() -> None:
        wp.launch(_double, 100, [values], device=device)
        wp.launch(_add, dim=50, inputs=[values], outputs=[more[::2]], device=device)

    real = wp.launch
    seen = observe_launches(run)
    assert wp.launch is real
    assert [launched.name for launched in seen] == ["_double", "_add"]
    assert [launched.bytes for launched in seen] == [400, 400 + 796]  # a stride's last gap is not reached
    assert count_bytes(seen) == 400 + 796


@pytest.fixture
def counting(device: str) -> tuple[wp.array, Callable[[], None]]:
    """One number, and a run that makes it 3 by way of 1 and 2."""
    value, one = wp.zeros(1, dtype=float, device=device), wp.full(1, 1.0, dtype=float, device=device)

    def run() -> None:
        value.zero_()
        wp.launch(_add, 1, [value, one], device=device)
        wp.launch(_double, 1, [value], device=device)
        wp.launch(_add, 1, [value, one], device=device)

    return value, run


def test_each_kernel_is_timed(device: str, counting: tuple[wp.array, Callable[[], None]]) -> None:
    real = wp.launch
    timed = time_kernels(counting[1], device, 0.0)
    assert wp.launch is real
    assert [launched.name for launched, _ in timed] == ["_add", "_double", "_add"]
    assert all(len(timing.seconds) >= 3 for _, timing in timed)


def test_a_run_is_cut_into_beginnings_and_pieces(counting: tuple[wp.array, Callable[[], None]], device: str) -> None:
    """Beginnings start anew and end after the last kernel asked for; each piece does its part."""
    value, run = counting
    run()
    pieces = _capture_pieces(run, device)
    assert len(pieces) == 3
    for count, want in enumerate((1.0, 2.0, 3.0), start=1):
        value.fill_(9.0)
        _run_first(run, count)
        assert value.numpy()[0] == want
    value.fill_(9.0)
    for piece, want in zip(pieces, (1.0, 2.0, 3.0), strict=True):
        wp.capture_launch(piece)
        assert value.numpy()[0] == want


def test_a_graph_is_timed(device: str) -> None:
    values = wp.zeros(1, dtype=float, device=device)
    ones = wp.full(1, 1.0, dtype=float, device=device)
    graph = capture(lambda: wp.launch(_add, 1, [values, ones], device=device), device, times=4)
    before = values.numpy()[0]
    wp.capture_launch(graph)
    assert values.numpy()[0] == before + 4.0
    timing = time_graph(graph, device, 0.01)
    assert len(timing.seconds) >= 3
    assert min(timing.seconds) > 0


@pytest.mark.parametrize(
    ("seconds", "says"),
    [(0.0, "0 µs"), (-1e-9, "0 µs"), (1.234e-5, "12.3 µs"), (9.999e-4, "1e+03 µs"), (0.01, "10 ms"), (2.5, "2.5 s")],
)
def test_times_are_written_with_three_digits_and_a_unit(seconds: float, says: str) -> None:
    assert format_time(seconds) == says


def test_copies_have_a_bandwidth(device: str) -> None:
    assert 1e8 < copy_bandwidth(device, 0.0) < 1e14


def test_a_report_names_machine_and_versions(device: str) -> None:
    where = about(device)
    assert {"date", "machine", "warp-partdr", "warp", "torch", "python"} <= where.keys()
    assert ("gpu" in where) == (device != "cpu")
