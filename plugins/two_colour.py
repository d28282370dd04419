"""A ball of two pigments, in whatever pattern, spin and shade."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from toolkit import (
    AlphaEstimator,
    Chord,
    ConfigError,
    LinearImage,
    NoiseModel,
    Observation,
    StreakError,
)

Vector = tuple[float, float, float]

MIN_ANGLE = math.radians(4)
"""Between the two pigments, below which they span no plane."""
MIN_CONTRAST = 2.0
"""Distance of the background from the plane, standard deviations of a pixel, at the median."""


@dataclass(frozen=True, kw_only=True)
class TwoColour(AlphaEstimator):
    """The ball's surface shows mixtures of two pigments, anywhere, in any light of one colour.

    All mixtures and all darker shades of them lie in one plane through black. What a pixel shows
    off that plane is background, so that its opacity follows without a word about pattern, spin or
    shading: alpha = 1 - (n.C) / (n.B), with n the plane's unit normal. Each pixel weighs by how far
    the background lies off the plane there.
    Source: Caglioti & Giusti 2007, section 3.2.3; MATHS, "Image formation".
    """

    colours: tuple[Vector, ...] = ()
    """The two pigments, linear R,G,B each, of any brightness."""
    plane_normal: Vector | None = None
    """Normal of the plane through black and both pigments, instead of these."""

    def __post_init__(self) -> None:
        if self.plane_normal is None and len(self.colours) != 2:
            raise ConfigError(
                f"two-colour needs the ball's two pigments, {len(self.colours)} given: "
                "--ball-colour R,G,B twice, or a ball.toml that holds their plane"
            )
        given = self.colours if self.plane_normal is None else (self.plane_normal,)
        for vector in given:
            length = math.hypot(*vector) if len(vector) == 3 else 0.0
            if not (math.isfinite(length) and length > 0):
                raise ConfigError(f"two-colour: {vector} is not three finite numbers, not all 0")
        if self.plane_normal is None:
            self._check_pigments()

    def _check_pigments(self) -> None:
        first, second = (np.array(colour) / math.hypot(*colour) for colour in self.colours)
        angle = math.atan2(float(np.linalg.norm(np.cross(first, second))), float(first @ second))
        if angle < MIN_ANGLE:
            raise ConfigError(
                f"the ball's two colours {self.colours[0]} and {self.colours[1]} have nearly the "
                f"same hue ({math.degrees(angle):.1f} degrees apart), so that they span no plane; "
                "use --estimator uniform or known-shading"
            )

    @property
    def normal(self) -> Vector:
        """Unit normal of the pigments' plane in R,G,B."""
        if self.plane_normal is not None:
            vector = np.array(self.plane_normal)
        else:
            vector = np.cross(np.array(self.colours[0]), np.array(self.colours[1]))
        x, y, z = (vector / np.linalg.norm(vector)).tolist()
        return (x, y, z)

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        """Give the distances of both pictures from the pigments' plane, one channel.

        A distance needs all three colours. Behind a mosaic it is taken where red was measured, once
        a cell of the mosaic, as one sample with the noise of all the cell holds.

        Raises:
            StreakError: when the background lies in that plane.
        """
        signal, ground = self._distance(image.rgb), self._distance(background.rgb)
        variance = noise.variance(image.rgb) + noise.variance(background.rgb) / background.frames
        variance = self._weights(variance, power=2)
        measured = image.measured()
        if measured is not None:
            sites = measured[:, :1]
            share = sites.to(variance.dtype).mean()
            variance = torch.where(sites, share * variance, torch.inf)
        self._check_background(ground, variance)
        return Observation(signal=signal, ground=ground, variance=variance)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        """Give 0: the ball never leaves its plane."""
        return torch.zeros_like(chord.offset)[..., None]

    def _distance(self, rgb: Tensor) -> Tensor:
        return self._weights(rgb, power=1)

    def _weights(self, values: Tensor, power: int) -> Tensor:
        weight = torch.tensor(self.normal, dtype=values.dtype, device=values.device) ** power
        return torch.einsum("c,bchw->bhw", weight, values)[:, None]

    def _check_background(self, ground: Tensor, variance: Tensor) -> None:
        used = torch.isfinite(variance)
        contrast = float((ground[used].abs() / variance[used].sqrt()).median())
        if not contrast >= MIN_CONTRAST:
            raise StreakError(
                "the background lies in the plane of the ball's two colours "
                f"({contrast:.1f} standard deviations off it, {MIN_CONTRAST:g} needed), so that "
                "nothing can be told from it; take a background of another hue"
            )
