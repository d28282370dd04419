"""Sensor noise: the shot noise of light and the read noise of the electronics."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from toolkit.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLevel:
    """Noise whose variance at a level C (sensor white = 1) is read^2 + gain * C."""

    read: float = 0.0
    """Standard deviation in the dark."""
    gain: float = 0.0
    """Light per photo-electron; the inverse of the full-well count."""

    def __post_init__(self) -> None:
        if not (0 <= self.read < 1 and 0 <= self.gain < 1):
            raise ConfigError(f"noise of read {self.read} and gain {self.gain} must lie in 0..1")


def add_noise(clean: Tensor, noise: NoiseLevel, seed: int, stream: int = 0) -> Tensor:
    """Give a noisy copy of a picture, cut at sensor white but not at zero, as on a real sensor.

    Args:
        clean: mean light, any shape, white = 1.
        noise: how much.
        seed: equal seeds give equal noise.
        stream: pictures of different streams have independent noise under the same seed.

    Returns:
        Same shape, float32.
    """
    generator = np.random.default_rng([seed, stream])
    light = clean.double().numpy()
    if noise.gain > 0:
        light = noise.gain * generator.poisson(np.maximum(light, 0) / noise.gain)
    if noise.read > 0:
        light = light + noise.read * generator.standard_normal(light.shape)
    return torch.from_numpy(np.minimum(light, 1.0).astype(np.float32))
