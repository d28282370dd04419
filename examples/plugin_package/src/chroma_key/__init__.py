"""A chroma key: how much of a coloured screen still shines through at each pixel."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit import AlphaEstimator, Chord, ConfigError, LinearImage, NoiseModel, Observation

WEIGHTS = {
    "red": (1.0, -0.5, -0.5),
    "green": (-0.5, 1.0, -0.5),
    "blue": (-0.5, -0.5, 1.0),
}
"""Of R,G,B in the key; they add up to 0, so that no grey has any of it."""


@dataclass(frozen=True, kw_only=True)
class ChromaKey(AlphaEstimator):
    """A white, grey or black ball, however shaded, in front of a coloured screen.

    The key of a pixel is how much more of the screen's colour it has than of the two others. Greys
    have none of it: what is left of the screen's key in the shot tells how much of the screen is
    still seen, alpha = 1 - key(shot) / key(background), whatever the ball's light and pattern.
    """

    screen: str = "green"
    """Colour of the screen: red, green or blue."""
    least_key: float = 0.05
    """Key of the background, sensor white = 1, below which a pixel is no screen and not used."""

    def __post_init__(self) -> None:
        if self.screen not in WEIGHTS:
            raise ConfigError(f"screen is '{self.screen}'; it must be one of {', '.join(WEIGHTS)}")
        if not 0 < self.least_key < 1:
            raise ConfigError(f"least_key is {self.least_key}; a number between 0 and 1 is needed")

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Give the matte: alpha is the signal, the ground is 0.

        The variance of a quotient: that of the shot's key, and that of the background's as far as
        the screen is still seen. It is infinite where nothing is known.
        """
        seen, empty = self._key(image.rgb), self._key(background.rgb)
        is_screen = empty > self.least_key
        empty = torch.where(is_screen, empty, torch.ones_like(empty))
        share = seen / empty
        of_shot = self._key_variance(noise.variance(image.rgb))
        of_background = self._key_variance(noise.variance(background.rgb)) / background.frames
        variance = (of_shot + share**2 * of_background) / empty**2
        alpha = torch.where(is_screen, 1 - share, torch.zeros_like(share))
        return Observation(
            signal=alpha,
            ground=torch.zeros_like(alpha),
            variance=torch.where(is_screen, variance, torch.inf),
        )

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give 1: the ball alone hides the screen altogether."""
        return torch.ones_like(chord.offset)[..., None]

    def _key(self, rgb: Tensor) -> Tensor:
        """Weigh the channels [B, 3, H, W] into one [B, 1, H, W]."""
        return (rgb * self._weights(rgb)).sum(1, keepdim=True)

    def _key_variance(self, variance: Tensor) -> Tensor:
        return (variance * self._weights(variance) ** 2).sum(1, keepdim=True)

    def _weights(self, like: Tensor) -> Tensor:
        return like.new_tensor(WEIGHTS[self.screen])[:, None, None]
