"""Rows of a table for the labels of pictures, word by word: libraries' own gather a few long rows well, not many short.

A label network's input is a row a pixel.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def copy_rows(
    labels: wp.array2d[wp.uint8],  # (B, pixels)
    tables: wp.array3d[wp.int64],  # (N, 256, words)
    which: wp.array[wp.int64],  # (B,), the table of each picture
    together: int,  # words of a pixel that a thread copies
    found: wp.array2d[wp.int64],  # (B, pixels words)  OUTPUT
):
    n, place = wp.tid()
    words = tables.shape[2]
    first = place * together
    pixel = first // words
    table, label = int(which[n]), int(labels[n, pixel])
    for word in range(first, first + together):
        found[n, word] = tables[table, label, word - pixel * words]


def launch_rows(labels: wp.array, tables: wp.array, which: wp.array, found: wp.array) -> None:
    """Launch ``copy_rows``."""
    # On a GPU neighbours write side by side; a CPU has more to do for a thread than for a word.
    together = tables.shape[2] if found.device.is_cpu else 1
    dim = found.shape[0], found.shape[1] // together
    wp.launch(copy_rows, dim=dim, inputs=[labels, tables, which, together], outputs=[found], device=found.device)
