"""Tables on a device that a cache frees stay in memory while a captured graph reads them."""

from __future__ import annotations

from weakref import ref

import torch

from warp_partdr.interop.captured_call import call_as_graph
from warp_partdr.interop.device_cache import device_cache, keeping_tables

made: list[str] = []


@device_cache(1)
def order_of(name: str, device: torch.device) -> torch.Tensor:
    made.append(name)
    return torch.tensor({"forwards": [0, 1, 2], "backwards": [2, 1, 0]}[name], device=device)


def reordered(values: torch.Tensor, name: str) -> tuple[torch.Tensor]:
    return (values[:, order_of(name, values.device)],)


def test_values_are_made_once_until_others_take_their_place() -> None:
    cpu = torch.device("cpu")
    first = order_of("forwards", cpu)
    made.clear()
    assert order_of("forwards", cpu) is first
    assert made == []
    order_of("backwards", cpu)
    order_of("forwards", cpu)
    assert made == ["backwards", "forwards"]


def test_what_is_asked_for_during_a_capture_is_kept_with_it() -> None:
    cpu = torch.device("cpu")
    order_of("forwards", cpu)
    with keeping_tables() as tables:
        table = ref(order_of("forwards", cpu))
    order_of("backwards", cpu)
    order_of("forwards", cpu)
    assert table() is tables[0]
    assert len(tables) == 1  # what is asked for afterwards is not
    tables.clear()
    assert table() is None


def test_a_graph_reads_its_table_after_the_cache_freed_it(device: str) -> None:
    """An order of the network's landmarks was freed so; the graph then read whatever the memory was used for."""
    values = torch.rand(4, 3, device=device)
    for _ in range(3):
        call_as_graph(reordered, (values,), "backwards")
    order_of("forwards", values.device)
    others = [torch.zeros(3, dtype=torch.int64, device=device) for _ in range(64)]  # in the memory that was freed
    (found,) = call_as_graph(reordered, (values,), "backwards")
    assert torch.equal(found, values.flip(1))
    assert len(others) == 64
