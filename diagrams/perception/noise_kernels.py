"""The noise of a depth picture, in machine code.

All of it stands in one file, so that numba compiles it anew whenever something in it changes.
"""

import numpy as np

from models.physics.compiled import LONE_FOLDER, compiled

_compiled = compiled(LONE_FOLDER)


@_compiled
def _random_bits(state):  # type: ignore[no-untyped-def]
    """64 bits that seem to have nothing to do with those of another state (SplitMix64)."""
    bits = state
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@_compiled
def _draw_row(state, terms, numbers, chances):  # type: ignore[no-untyped-def]
    """Draw a row, and return the state for the next.

    Args:
        state: uint64.
        terms: how many uniform numbers, 1 or a multiple of 4, are added to one of `numbers`.
        numbers: (3, w) result, of mean 0 and standard deviation 1.
        chances: (w,) result, from 0 up to 1.
    """
    scale = np.float32(np.sqrt(12.0 / terms) / 65536)
    middle, share = np.float32(32767.5), np.float32(1 / 65536)
    next_state, low = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFFFF)
    for column in range(numbers.shape[1]):
        state += next_state
        bits = _random_bits(state)
        # One draw serves for four numbers of 16 bits.
        chances[column] = share * np.float32(np.int32(bits & low))
        if terms == 1:
            numbers[0, column] = scale * (np.float32(np.int32((bits >> np.uint64(16)) & low)) - middle)
            numbers[1, column] = scale * (np.float32(np.int32((bits >> np.uint64(32)) & low)) - middle)
            numbers[2, column] = scale * (np.float32(np.int32(bits >> np.uint64(48))) - middle)
            continue
        for k in range(3):
            total = np.float32(0)
            for _ in range(terms // 4):
                state += next_state
                bits = _random_bits(state)
                for _ in range(4):
                    total += np.float32(np.int32(bits & low)) - middle
                    bits >>= np.uint64(16)
            numbers[k, column] = scale * total
    return state


@_compiled
def _jumps(depth, row, beyond, high, low, jump):  # type: ignore[no-untyped-def]
    """By how much depth (H, W) differs among the neighbours of a row's pixels, with `beyond` for infinity.

    `high` and `low` (W,) are scratch, `jump` (W,) is the result, m.
    """
    height, width = depth.shape
    for column in range(width):
        high[column], low[column] = np.float32(0), beyond
    for other in range(max(row - 1, 0), min(row + 2, height)):
        for column in range(width):
            value = min(depth[other, column], beyond)
            high[column], low[column] = max(high[column], value), min(low[column], value)
    for column in range(1, width - 1):
        jump[column] = max(high[column - 1], high[column], high[column + 1]) - min(
            low[column - 1], low[column], low[column + 1]
        )
    for column, other in ((0, min(1, width - 1)), (width - 1, max(width - 2, 0))):
        jump[column] = max(high[column], high[other]) - min(low[column], low[other])


@_compiled
def measure(depth, seed, window, terms, parameters, result):  # type: ignore[no-untyped-def]
    """What a camera measures of a noise-free picture.

    Works row by row, so that all but the pictures stays in the processor's cache.

    Args:
        depth: (H, W) m.
        seed: uint64.
        window: (2 r + 1,) over which noise is smoothed in either direction; its squares add up to 1.
        terms: uniform numbers in one of the noise.
        parameters: (7,) lateral jitter (pixels), axial floor (m), axial growth (1/m), quantum (m), shares
            missing beside a jump and elsewhere, what counts as a jump (m).
        result: (H, W) m.
    """
    height, width = depth.shape
    number = len(window)
    margin = number // 2
    jitter, floor, growth, quantum, at_edges, anywhere, step = parameters
    rounding = np.float32(1) / quantum if quantum > 0 else np.float32(0)
    half, beyond = np.float32(0.5), np.float32(1e3)
    plain = np.empty((3, width + 2 * margin), np.float32)
    drawn = np.empty((number, width + 2 * margin), np.float32)  # chances, of the rows in the window
    smooth = np.empty((number, 3, width), np.float32)  # along the row
    noise = np.empty((3, width), np.float32)
    high, low, jump = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    state = seed
    for newest in range(height + 2 * margin):
        slot = newest % number
        state = _draw_row(state, terms, plain, drawn[slot])
        for k in range(3):
            for column in range(width):
                smooth[slot, k, column] = window[0] * plain[k, column]
            for i in range(1, number):
                for column in range(width):
                    smooth[slot, k, column] += window[i] * plain[k, column + i]
        row = newest - 2 * margin
        if row < 0:
            continue
        for k in range(3):
            for column in range(width):
                noise[k, column] = window[0] * smooth[row % number, k, column]
            for i in range(1, number):
                for column in range(width):
                    noise[k, column] += window[i] * smooth[(row + i) % number, k, column]
        _jumps(depth, row, beyond, high, low, jump)
        for column in range(width):
            # The nearest pixel, not a mean: an edge moves, it does not smear.
            there = column + np.int32(np.floor(jitter * noise[0, column] + half))
            where = row + np.int32(np.floor(jitter * noise[1, column] + half))
            result[row, column] = depth[min(max(where, 0), height - 1), min(max(there, 0), width - 1)]
        chances = drawn[(row + margin) % number]
        for column in range(width):
            value = result[row, column]
            if value > 0 and value < np.inf:
                value += (floor + growth * value * value) * noise[2, column]
                if quantum > 0:
                    value = np.rint(value * rounding) * quantum
            chance = at_edges if jump[column] > step else anywhere
            missing = chances[margin + column] < chance or depth[row, column] == 0
            result[row, column] = np.float32(0) if missing else value
