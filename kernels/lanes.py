"""Exchange of values between the 32 threads of a CUDA warp, all of which must take part, and reading of 32-bit sets.

A thread of the CPU device is alone.
"""

from typing import Any

import warp as wp

LANES = wp.constant(32)
AT_ONCE = wp.constant(4)
SIXTEEN = 16  # values that ``sum_sixteen`` adds at once
Sixteen: Any = wp.types.vector(length=SIXTEEN, dtype=wp.float32)


def num_lanes(device: wp.Device) -> int:
    """Number of threads that exchange values: a warp on CUDA."""
    return 1 if device.is_cpu else int(LANES)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def wait_for_block():
    """Wait until all threads of the block are here, and what they wrote can be read."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
""")
def wait_for_lanes():
    """Wait until all threads of the warp are here, and what they wrote can be read by each other."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 4;
#else
    return 1;
#endif
""")
def at_once() -> int:  # type: ignore[empty-body]
    """Number of things, up to ``AT_ONCE``, that a thread reads before it uses the first: on CUDA, to wait once."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, yes);
#else
    return yes ? 1u : 0u;
#endif
""")
def ballot(yes: bool) -> wp.uint32:
    """A word with one bit for each thread, set where ``yes`` is true."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int distance = 16; distance > 0; distance /= 2)
        value += __shfl_xor_sync(0xffffffffu, value, distance);
#endif
    return value;
""")
def sum_lanes(value: float) -> float:  # type: ignore[empty-body]
    """Sum of all threads' values, added in a fixed order."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x & 31;
    for (int half = 8; half > 0; half /= 2)  // each thread keeps half of its values and sends the others
        for (int i = 0; i < half; ++i) {
            const bool upper = (lane & half) != 0;
            const float sent = upper ? values[i] : values[i + half];
            values[i] = (upper ? values[i + half] : values[i]) + __shfl_xor_sync(0xffffffffu, sent, half);
        }
    return values[0] + __shfl_xor_sync(0xffffffffu, values[0], 16);
#else
    return values[0];
#endif
""")
def sum_sixteen(values: Sixteen) -> float:  # type: ignore[empty-body]
    """Sum over all threads of value number ``lane % 16``, in a fixed order: 16 exchanges where one by one takes 80."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int distance = 1; distance < 32; distance *= 2) {
        const int before = __shfl_up_sync(0xffffffffu, value, distance);
        if ((threadIdx.x & 31) >= distance)
            value += before;
    }
#endif
    return value;
""")
def prefix_sum(value: int) -> int:  # type: ignore[empty-body]
    """Inclusive prefix sum over the threads."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, lane);
#else
    return value;
#endif
""")
def shuffle(value: wp.uint32, lane: int) -> wp.uint32:
    """Value of the thread ``lane``."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, lane);
#else
    return value;
#endif
""")
def shuffle_float(value: float, lane: int) -> float:  # type: ignore[empty-body]
    """Value of the thread ``lane``."""
    ...


@wp.func
def lowest_bit(bits: wp.uint32):
    """Index of the lowest bit that is set."""
    return wp.bit_count((bits & (~bits + wp.uint32(1))) - wp.uint32(1))


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 31 - __clz(bits);
#else
    return 31 - __builtin_clz(bits);
#endif
""")
def highest_bit(bits: wp.uint32) -> int:  # type: ignore[empty-body]
    """Index of the highest bit that is set, of those that are not all zero."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    int index = 0;
    for (int half = 16; half > 0; half /= 2) {
        const int count = __popc(bits & ((1u << half) - 1));
        if (n >= count) {
            n -= count;
            bits >>= half;
            index += half;
        }
    }
    return index;
#else
    for (; n > 0; --n)
        bits &= bits - 1;
    return __builtin_ctz(bits | 0x80000000u);
#endif
""")
def nth_bit(bits: wp.uint32, n: int) -> int:  # type: ignore[empty-body]
    """Index of the bit before which n others are set."""
    ...


@wp.func
def deal(bits: wp.uint32, found: int, owner: int, number: int, lanes: int):
    """Owner and index of bit ``number`` of all bits that the threads found; for each thread another number.

    ``found`` is the ``prefix_sum`` of the threads' counts, and ``owner`` what a thread calls its own bits.
    """
    finder = int(0)
    step = lanes // 2
    while step > 0:
        if int(shuffle(wp.uint32(found), finder + step - 1)) <= number:
            finder += step
        step = step // 2
    theirs = shuffle(bits, finder)
    before = int(shuffle(wp.uint32(found), finder)) - wp.bit_count(theirs)
    return wp.vec2i(int(shuffle(wp.uint32(owner), finder)), nth_bit(theirs, number - before))
