"""Noise of a depth camera: Drake renders perfect depth, real cameras do not measure it."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.sensors import ImageDepth32F

from diagrams.collectable import PythonSystem
from diagrams.perception.noise_kernels import measure
from models.perception.camera import DepthImage

_STEP = 0.01  # m; depth jumps more than this at an edge


@dataclass
class DepthNoiseConfig:
    """Noise typical of an active stereo or structured-light camera; all zero is a perfect camera.

    The axial term grows with the square of depth, as disparity noise does: an error of 0.05 pixels at a focal
    length of 900 pixels and a baseline of 55 mm makes 1 mm at 1 m. The lateral term moves edges by a part of
    a pixel. Both are correlated between neighbours, since such cameras match windows, not single pixels. The
    defaults are a choice, not the measurement of a camera; docs/station.md says what larger ones do.

    Attributes:
        axial_floor: standard deviation of depth close to the camera, m.
        axial_growth: its growth with the square of depth, 1/m.
        lateral_jitter: standard deviation of the place in the scene that a pixel shows, pixels.
        correlation: standard deviation of the window over which both are correlated, pixels.
        missing_at_edges: share of the pixels beside a jump of depth that have no reading.
        missing_anywhere: share of all other pixels that have no reading.
        quantum: depth is a multiple of this, m; 0 for none.
        seed: of all random draws; the seed of a run is added to it.

    Raises:
        ValueError: a negative value, or a share above 1.
    """

    axial_floor: float = 0.4e-3
    axial_growth: float = 1.0e-3
    lateral_jitter: float = 0.4
    correlation: float = 1.0
    missing_at_edges: float = 0.3
    missing_anywhere: float = 0.003
    quantum: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        for field in fields(self):
            value = getattr(self, field.name)
            highest = 1.0 if field.name.startswith("missing") else np.inf
            if not 0 <= value <= highest:
                raise ValueError(f"depth_noise.{field.name} must lie between 0 and {highest}, got {value}")


def noisy_depth(depth: DepthImage, config: DepthNoiseConfig, generator: np.random.Generator) -> DepthImage:
    """A noise-free depth image (H, W), m, as the camera would have measured it.

    Pixels without a reading are 0; those beyond the camera's range stay infinite, as in Drake.
    """
    depth = np.ascontiguousarray(depth, dtype=np.float32)
    seed = generator.integers(0, 2**64, dtype=np.uint64)
    # A mean over a window of uniform numbers is close to normal; where the window is small, each is a sum.
    terms = 1 if config.correlation >= 1 else 12
    parameters = np.array(
        [
            config.lateral_jitter, config.axial_floor, config.axial_growth, config.quantum,
            config.missing_at_edges, config.missing_anywhere, _STEP,
        ],
        dtype=np.float32,
    )  # fmt: skip
    result = np.empty_like(depth)
    measure(depth, seed, _window(config.correlation), terms, parameters, result)
    return result


class DepthNoise(PythonSystem):
    """Puts a depth camera's noise on rendered pictures.

    .. pydrake_system::

        name: DepthNoise
        input_ports:
        - depth_image
        output_ports:
        - depth_image

    A frame's noise depends on the seed and the frame's number alone, which is the time in units of the
    camera's period; it does not matter who looks when, or how often.
    """

    def __init__(self, config: DepthNoiseConfig | None = None, rate: float = 15.0) -> None:
        """Noise for pictures taken `rate` times a second (Hz).

        Raises:
            ValueError: the rate is not positive.
        """
        super().__init__()
        if not rate > 0:
            raise ValueError(f"depth noise: the rate must be positive, got {rate} Hz")
        self._config = config or DepthNoiseConfig()
        self._rate = rate
        # What has to be compiled is so now, and no picture of a twin comes late.
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
    """(2 r + 1,) weights of a mean that keeps the variance."""
    size = 2 * int(np.ceil(3 * correlation)) + 1
    place = np.arange(size) - size // 2
    weights = np.exp(-0.5 * (place / correlation) ** 2) if correlation > 0 else np.ones(1)
    return (weights / np.linalg.norm(weights)).astype(np.float32)
