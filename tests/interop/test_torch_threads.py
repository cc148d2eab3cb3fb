"""Torch's threads are one during fits, registrations and predictions, and afterwards what they were."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import torch

from warp_partdr.interop.torch_threads import all_torch_threads, one_torch_thread
from warp_partdr.models.registration import register
from warp_partdr.networks.regression.predict import predict_bodies
from warp_partdr.solve.ellipsoids.fitting import fit_body

COUNT = 3


@pytest.fixture(autouse=True)
def _three_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(COUNT)
    yield
    torch.set_num_threads(before)


def test_one_thread_ends_with_its_outermost_block_even_after_an_error() -> None:
    with one_torch_thread():
        with one_torch_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == COUNT
    with pytest.raises(KeyError), one_torch_thread():
        raise KeyError
    assert torch.get_num_threads() == COUNT


def test_all_threads_come_back_within_a_block_of_one() -> None:
    with one_torch_thread():
        with all_torch_threads():
            assert torch.get_num_threads() == COUNT
            with one_torch_thread():
                assert torch.get_num_threads() == 1
            assert torch.get_num_threads() == COUNT
        assert torch.get_num_threads() == 1
        with pytest.raises(KeyError), all_torch_threads():
            raise KeyError
        assert torch.get_num_threads() == 1
    with all_torch_threads():
        assert torch.get_num_threads() == COUNT
    assert torch.get_num_threads() == COUNT


def test_a_user_s_one_thread_stays_one() -> None:
    torch.set_num_threads(1)
    with one_torch_thread():
        pass
    assert torch.get_num_threads() == 1


@pytest.mark.parametrize("first_out", [0, 1])
def test_two_python_threads_at_once_restore_the_count(first_out: int) -> None:
    entered, leave = [threading.Event(), threading.Event()], [threading.Event(), threading.Event()]
    counts: dict[int, tuple[int, int]] = {}

    def work(number: int) -> None:
        with one_torch_thread():
            entered[number].set()
            leave[number].wait()
            within = torch.get_num_threads()
        counts[number] = within, torch.get_num_threads()

    # Threads that have not counted before take over the other's 1.
    threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for number in range(2):
        threads[number].start()
        entered[number].wait()
    for number in (first_out, 1 - first_out):
        leave[number].set()
        threads[number].join()
    assert counts == {0: (1, COUNT), 1: (1, COUNT)}
    assert torch.get_num_threads() == COUNT
    late: list[int] = []
    thread = threading.Thread(target=lambda: late.append(torch.get_num_threads()))
    thread.start()
    thread.join()
    assert late == [COUNT]


class _ProbeError(Exception):
    pass


@pytest.mark.parametrize(
    ("first", "call"),
    [
        ("warp_partdr.solve.ellipsoids.fitting.check_type", lambda: fit_body(None)),
        ("warp_partdr.networks.regression.predict.check_each", lambda: predict_bodies(None, None)),
        ("warp_partdr.models.registration.check_type", lambda: register(None, None)),
    ],
    ids=["fit_body", "predict_bodies", "register"],
)
def test_public_functions_take_one_and_give_back(first, call, monkeypatch) -> None:
    def probe(*_: object) -> None:
        raise _ProbeError(torch.get_num_threads())

    monkeypatch.setattr(first, probe)  # what they do first
    with pytest.raises(_ProbeError) as raised:
        call()
    assert raised.value.args == (1,)
    assert torch.get_num_threads() == COUNT
