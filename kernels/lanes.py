"""Exchange of values between the 32 threads of a CUDA warp, all of which must take part, and reading of 32-bit sets.

A thread of the CPU device is alone.
"""

import warp as wp

LANES = wp.constant(32)


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


@wp.func
def lowest_bit(bits: wp.uint32):
    """Index of the lowest bit that is set."""
    return wp.bit_count((bits & (~bits + wp.uint32(1))) - wp.uint32(1))


@wp.func
def nth_bit(bits: wp.uint32, n: int):
    """Index of the bit before which n others are set."""
    index = int(0)
    left = n
    rest = bits
    for i in range(5):
        half = 16 >> i
        count = wp.bit_count(rest & ((wp.uint32(1) << wp.uint32(half)) - wp.uint32(1)))
        if left >= count:
            left -= count
            rest = rest >> wp.uint32(half)
            index += half
    return index
