"""Noise of a depth camera: Drake renders perfect depth, real cameras do not measure it."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.sensors import ImageDepth32F

from diagrams.collectable import PythonSystem
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
        seed: of all random draws.

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
    image: NDArray[np.floating] = depth
    if config.lateral_jitter > 0:
        jitter = np.float32(config.lateral_jitter)
        rows, columns = np.indices(depth.shape, dtype=np.float32)
        moved_columns = columns + jitter * _correlated(depth.shape, config.correlation, generator)
        moved_rows = rows + jitter * _correlated(depth.shape, config.correlation, generator)
        # The nearest pixel, not a mean: an edge moves, it does not smear.
        image = cv2.remap(
            depth, moved_columns, moved_rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
        )
    seen = np.isfinite(image) & (image > 0)
    deviation = config.axial_floor + config.axial_growth * np.where(seen, image, 0.0) ** 2
    image = image + deviation * _correlated(depth.shape, config.correlation, generator)
    if config.quantum > 0:
        image = np.round(image / config.quantum) * config.quantum
    chance = np.where(_beside_a_jump(depth), config.missing_at_edges, config.missing_anywhere)
    missing = generator.random(depth.shape, dtype=np.float32) < chance
    image[missing | (depth == 0)] = 0.0
    return image.astype(np.float32, copy=False)


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


def _correlated(
    shape: tuple[int, ...], correlation: float, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Normal field of mean 0 and standard deviation 1, smoothed over a window."""
    if correlation < 1:
        field = generator.standard_normal(shape, dtype=np.float32)
    else:  # a mean over a dozen uniform numbers is close to normal, and four times as fast
        field = np.sqrt(np.float32(12)) * (generator.random(shape, dtype=np.float32) - np.float32(0.5))
    if correlation == 0:
        return field
    size = 2 * int(np.ceil(3 * correlation)) + 1
    kernel = cv2.getGaussianKernel(size, correlation, cv2.CV_32F)
    kernel /= np.linalg.norm(kernel)  # keeps the variance
    return cv2.sepFilter2D(field, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT)


def _beside_a_jump(depth: DepthImage) -> NDArray[np.bool_]:
    square = np.ones((3, 3), np.uint8)
    near = np.where(np.isfinite(depth), depth, np.float32(1e3))
    return cv2.dilate(near, square) - cv2.erode(near, square) > _STEP
