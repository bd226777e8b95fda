"""Noise of a depth camera: Drake renders perfect depth, which real cameras do not measure.

Everything is in one file, so that numba recompiles it whenever any of it changes.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.perception.pinhole_camera import DepthImage
from slipmap.models.physics.compiled import LONE_FOLDER, compiled
from slipmap.models.settings import CheckedSettings, within

_STEP = 0.01  # m; larger jumps of depth count as an edge

_compiled = compiled(LONE_FOLDER)


@_compiled
def _random_bits(state):  # type: ignore[no-untyped-def]
    """64 pseudo-random bits of a state (SplitMix64)."""
    bits = state
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@_compiled
def _draw_row(state, terms, numbers, chances):  # type: ignore[no-untyped-def]
    """Draw a row, and return the state for the next.

    Args:
        state: uint64.
        terms: number of uniform numbers, 1 or a multiple of 4, summed for each of `numbers`.
        numbers: (3, w) result, with mean 0 and standard deviation 1.
        chances: (w,) result, from 0 up to 1.
    """
    scale = np.float32(np.sqrt(12.0 / terms) / 65536)
    middle, share = np.float32(32767.5), np.float32(1 / 65536)
    next_state, low = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFFFF)
    for column in range(numbers.shape[1]):
        state += next_state
        bits = _random_bits(state)
        # One draw gives four numbers of 16 bits.
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
    """Range of depth (H, W) among the neighbours of each pixel in a row, with `beyond` for infinity.

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
def _measure(depth, seed, window, terms, parameters, result):  # type: ignore[no-untyped-def]
    """Turn a noise-free picture into a camera's measurement.

    It works row by row, so that everything except the pictures stays in the processor's cache.

    Args:
        depth: (H, W) m.
        seed: uint64.
        window: (2 r + 1,) weights for smoothing the noise in either direction; their squares sum to 1.
        terms: uniform numbers summed in each noise value.
        parameters: (7,) lateral jitter (pixels), axial floor (m), axial growth (1/m), quantum (m), shares
            missing beside a jump and elsewhere, size of a jump (m).
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
            # The nearest pixel, not a mean: edges move, but do not blur.
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


@dataclass
class DepthNoiseConfig(CheckedSettings):
    """Noise typical of an active stereo or structured-light camera; all zero is a perfect camera.

    The axial term grows with the square of depth, like disparity noise: an error of 0.05 pixels at a focal
    length of 900 pixels and a baseline of 55 mm gives 1 mm at 1 m. The lateral term moves edges by a fraction
    of a pixel. Both are correlated between neighbours, because such cameras match windows, not single pixels.
    The defaults were chosen, not measured on a camera; docs/station.md describes the effect of larger ones.
    """

    _section = "depth_noise."

    axial_floor: float = within(0.4e-3, 0, np.inf)  # standard deviation of depth close to the camera, m
    axial_growth: float = within(1.0e-3, 0, np.inf)  # its growth with the square of depth, 1/m
    # standard deviation of the position in the scene that a pixel shows, pixels
    lateral_jitter: float = within(0.4, 0, np.inf)
    # standard deviation of the window over which both are correlated, pixels
    correlation: float = within(1.0, 0, np.inf)
    # share of the pixels beside a jump of depth that have no reading
    missing_at_edges: float = within(0.3, 0, 1.0)
    missing_anywhere: float = within(0.003, 0, 1.0)  # share of all other pixels that have no reading
    quantum: float = within(1e-3, 0, np.inf)  # depth is a multiple of this, m; 0 for none
    seed: int = within(0, 0, np.inf)  # of all random draws; the seed of a run is added to it


def noisy_depth(depth: DepthImage, config: DepthNoiseConfig, generator: np.random.Generator) -> DepthImage:
    """A noise-free depth image (H, W), m, as the camera would have measured it.

    Pixels without a reading are 0; those beyond the camera's range stay infinite, as in Drake.
    """
    depth = np.ascontiguousarray(depth, dtype=np.float32).view()
    depth.flags.writeable = False  # as pictures of Drake are: one type for the compiler
    seed = generator.integers(0, 2**64, dtype=np.uint64)
    # A mean over a window of uniform numbers is nearly normal; for a small window, each number is a sum.
    terms = 1 if config.correlation >= 1 else 12
    parameters = np.array(
        [
            config.lateral_jitter, config.axial_floor, config.axial_growth, config.quantum,
            config.missing_at_edges, config.missing_anywhere, _STEP,
        ],
        dtype=np.float32,
    )  # fmt: skip
    result = np.empty_like(depth)
    _measure(depth, seed, _window(config.correlation), terms, parameters, result)
    return result


class DepthNoise(PythonSystem):
    """Adds a depth camera's noise to rendered pictures; input and output are named `depth_image`.

    A frame's noise depends only on the seed and the frame's number, which is the time in units of the
    camera's period, not on when or how often the output is evaluated.
    """

    def __init__(self, config: DepthNoiseConfig | None = None, rate: float = 15.0) -> None:
        """Noise for pictures taken `rate` times per second (Hz).

        Raises:
            ValueError: the rate is not positive.
        """
        super().__init__()
        if not rate > 0:
            raise ValueError(f"depth noise: the rate must be positive, got {rate} Hz")
        self._config = config or DepthNoiseConfig()
        self._rate = rate
        # Compile now, so that no picture of a twin is late.
        noisy_depth(np.ones((32, 32), dtype=np.float32), self._config, np.random.default_rng(0))
        image = AbstractValue.Make(ImageDepth32F())
        self._input = self.DeclareAbstractInputPort("depth_image", image)
        self.DeclareAbstractOutputPort(
            "depth_image",
            lambda: AbstractValue.Make(ImageDepth32F()),
            self._calc,
            {self._input.ticket(), self.time_ticket()},
        )

    def _calc(self, context: Any, output: Any) -> None:
        picture: Any = self._input.Eval(context)
        frame = int(np.floor(context.get_time() * self._rate + 1e-6))
        generator = np.random.default_rng([self._config.seed, frame])
        noisy = noisy_depth(picture.data[:, :, 0], self._config, generator)
        result: Any = ImageDepth32F(picture.width(), picture.height())
        result.mutable_data[:, :, 0] = noisy
        output.set_value(result)


def _window(correlation: float) -> NDArray[np.float32]:
    """(2 r + 1,) weights of a sum that keeps the variance."""
    size = 2 * int(np.ceil(3 * correlation)) + 1
    place = np.arange(size) - size // 2
    weights = np.exp(-0.5 * (place / correlation) ** 2) if correlation > 0 else np.ones(1)
    return (weights / np.linalg.norm(weights)).astype(np.float32)
