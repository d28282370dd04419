"""The camera: from points in space to pixels and back, lens distortion included.

Frames, pixels and the order of the distortion coefficients are those of OpenCV, so that numbers
move freely between the two: camera frame x right, y down, z forward; (0, 0) is the centre of the
top-left pixel; distortion is k1 k2 p1 p2 [k3 [k4 k5 k6]].
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from numpy.polynomial import Polynomial
from torch import Tensor

from toolkit.errors import ConfigError

UNDISTORT_STEPS = 12
"""Newton steps; convergence is quadratic, and 3 or 4 are enough but near the edge of a fold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A pinhole camera with polynomial (4 or 5 coefficients) or rational (8) distortion.

    Source: the OpenCV camera model. `covariance` is that of [fx fy cx cy, distortion...]: None
    when unknown, zero when the camera is known exactly.
    """

    MODELS: ClassVar[dict[str, tuple[int, ...]]] = {"pinhole": (0, 4, 5), "rational": (8,)}

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    model: str = "pinhole"
    covariance: Tensor | None = None  # [4 + K, 4 + K]

    def __post_init__(self) -> None:
        allowed = self.MODELS.get(self.model)
        if allowed is None:
            raise ConfigError(
                f"camera model '{self.model}' is unknown; use one of {', '.join(self.MODELS)}"
            )
        if len(self.distortion) not in allowed:
            raise ConfigError(
                f"a {self.model} camera has {len(self.distortion)} distortion coefficients;"
                f" {allowed} are possible"
            )
        numbers = torch.tensor([self.fx, self.fy, self.cx, self.cy, *self.distortion])
        if not bool(torch.isfinite(numbers).all()):
            raise ConfigError(
                "the camera has a parameter that is not a finite number; calibrate again"
            )
        if min(self.fx, self.fy) <= 0 or min(self.width, self.height) <= 0:
            raise ConfigError("the camera needs positive fx, fy, width and height; calibrate again")

    @classmethod
    def centred(
        cls, width: int, height: int, focal: float, distortion: tuple[float, ...] = ()
    ) -> "Camera":
        """Give a camera of one focal length, px, that looks along the middle of its picture."""
        return cls(
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=(width - 1) / 2,
            cy=(height - 1) / 2,
            distortion=distortion,
            model="rational" if len(distortion) == 8 else "pinhole",
        )

    @property
    def parameters(self) -> Tensor:
        """[fx fy cx cy, distortion...] as float64 [4 + K]."""
        values = [self.fx, self.fy, self.cx, self.cy, *self.distortion]
        return torch.tensor(values, dtype=torch.float64)

    def with_parameters(self, parameters: Tensor) -> "Camera":
        """Give the same camera with other [fx fy cx cy, distortion...] [4 + K]."""
        fx, fy, cx, cy, *distortion = parameters.tolist()
        return replace(self, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(distortion))

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """Give the camera of the picture cut out at (left, top) px."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def resized(self, width: int, height: int) -> "Camera":
        """Give the camera of the picture resized to width x height; pixel areas are scaled."""
        sx, sy = width / self.width, height / self.height
        scale = torch.ones_like(self.parameters)
        scale[:4] = torch.tensor([sx, sy, sx, sy])
        covariance = self.covariance
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
            covariance=None if covariance is None else scale[:, None] * covariance * scale,
        )

    def project(self, points: Tensor) -> Tensor:
        """Give the pixel of each point.

        Args:
            points: camera frame, in front of the camera [..., 3]; any length unit.

        Returns:
            Pixels (x, y), [..., 2].
        """
        distorted = self._distort(points[..., :2] / points[..., 2:])
        return distorted * self._focal(points) + self._principal_point(points)

    def J_project(self, points: Tensor) -> Tensor:
        """Give the derivative of `project` in the point, [..., 2, 3]."""
        depth = points[..., 2]
        normalised = points[..., :2] / points[..., 2:]
        zero = torch.zeros_like(depth)
        J_normalised = torch.stack(
            [
                torch.stack([1 / depth, zero, -normalised[..., 0] / depth], dim=-1),
                torch.stack([zero, 1 / depth, -normalised[..., 1] / depth], dim=-1),
            ],
            dim=-2,
        )
        return self._focal(points)[:, None] * (self._J_distort(normalised) @ J_normalised)

    def unproject(self, pixels: Tensor) -> Tensor:
        """Give the unit viewing ray of each pixel.

        Args:
            pixels: (x, y), [..., 2].

        Returns:
            Unit rays, camera frame, [..., 3]; NaN where the distortion cannot be inverted.
        """
        normalised = self.undistort(pixels)
        rays = torch.cat([normalised, torch.ones_like(normalised[..., :1])], dim=-1)
        length: Tensor = torch.linalg.vector_norm(rays, dim=-1, keepdim=True)
        return rays / length

    def J_unproject(self, pixels: Tensor) -> Tensor:
        """Give the derivative of `unproject` in the pixel, [..., 3, 2]."""
        normalised = self.undistort(pixels)
        J_pixel = self._focal(pixels)[:, None] * self._J_distort(normalised)
        J_normalised = _inverse_2x2(J_pixel)
        ray = torch.cat([normalised, torch.ones_like(normalised[..., :1])], dim=-1)
        length = torch.linalg.vector_norm(ray, dim=-1)[..., None, None]
        unit = (ray / length[..., 0])[..., :, None]
        identity = torch.eye(3, dtype=ray.dtype, device=ray.device)
        J_ray: Tensor = ((identity - unit @ unit.mT) / length)[..., :, :2] @ J_normalised
        return J_ray

    def undistort(self, pixels: Tensor) -> Tensor:
        """Give the normalised coordinates (x/z, y/z) seen at each pixel, [..., 2], or NaN."""
        distorted = (pixels - self._principal_point(pixels)) / self._focal(pixels)
        if not self.distortion:
            return distorted
        fold = self._fold()
        normalised = distorted
        for _ in range(UNDISTORT_STEPS):
            # kept before the fold, where Newton cannot leave for a solution that no lens shows
            length = torch.linalg.vector_norm(normalised, dim=-1, keepdim=True)
            normalised = normalised * (0.999 * fold / length).clamp(max=1)
            missing = (distorted - self._distort(normalised))[..., None]
            step = (_inverse_2x2(self._J_distort(normalised)) @ missing)[..., 0]
            normalised = normalised + step
        error = (self._distort(normalised) - distorted).abs().amax(-1) * max(self.fx, self.fy)
        is_seen = (error < 1e-6) & (torch.linalg.vector_norm(normalised, dim=-1) < fold)
        return torch.where(is_seen[..., None], normalised, torch.nan)

    def _fold(self) -> float:
        """Normalised radius up to which radial distortion rises and has no pole, or infinity."""
        k1, k2, _, _, k3, k4, k5, k6 = self._coefficients()
        above, below = Polynomial([1, k1, k2, k3]), Polynomial([1, k4, k5, k6])  # in r^2
        # numerator of the derivative of r * above / below
        slope = above * below + Polynomial([0, 2]) * (above.deriv() * below - above * below.deriv())
        roots = np.concatenate([slope.trim().roots(), below.trim().roots()])
        squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
        return float(squares.min()) ** 0.5 if squares.size else float("inf")

    def _focal(self, like: Tensor) -> Tensor:
        return torch.tensor([self.fx, self.fy], dtype=like.dtype, device=like.device)

    def _principal_point(self, like: Tensor) -> Tensor:
        return torch.tensor([self.cx, self.cy], dtype=like.dtype, device=like.device)

    def _coefficients(self) -> tuple[float, ...]:
        """k1 k2 p1 p2 k3 k4 k5 k6, zero where the model has fewer."""
        return (*self.distortion, *(0.0,) * (8 - len(self.distortion)))

    def _distort(self, normalised: Tensor) -> Tensor:
        """Move ideal normalised points [..., 2] to where the lens shows them."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self._coefficients()
        x, y = normalised.unbind(-1)
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        tangential_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        tangential_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return torch.stack([x * radial + tangential_x, y * radial + tangential_y], dim=-1)

    def _J_distort(self, normalised: Tensor) -> Tensor:
        """Derivative of `_distort`, [..., 2, 2]."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self._coefficients()
        x, y = normalised.unbind(-1)
        r2 = x * x + y * y
        above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = above / below
        slope_above = k1 + r2 * (2 * k2 + 3 * r2 * k3)
        slope_below = k4 + r2 * (2 * k5 + 3 * r2 * k6)
        slope = 2 * (slope_above - radial * slope_below) / below  # d radial / d x = slope * x
        mixed = x * y * slope + 2 * p1 * x + 2 * p2 * y
        return torch.stack(
            [
                torch.stack([radial + x * x * slope + 2 * p1 * y + 6 * p2 * x, mixed], dim=-1),
                torch.stack([mixed, radial + y * y * slope + 6 * p1 * y + 2 * p2 * x], dim=-1),
            ],
            dim=-2,
        )


def _inverse_2x2(matrix: Tensor) -> Tensor:
    """Invert [..., 2, 2]; not finite where singular (torch.linalg.inv fails the whole batch)."""
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    adjugate = torch.stack([torch.stack([d, -b], dim=-1), torch.stack([-c, a], dim=-1)], dim=-2)
    return adjugate / (a * d - b * c)[..., None, None]
