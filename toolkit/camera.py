"""The camera: from points in space to pixels and back, lens distortion included.

Frames, pixels and the order of the distortion coefficients are those of OpenCV, so that numbers
move freely between the two: camera frame x right, y down, z forward; (0, 0) is the centre of the
top-left pixel; distortion is k1 k2 p1 p2 [k3 [k4 k5 k6]], of a fisheye k1 k2 k3 k4.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, TypeVar

import numpy as np
import torch
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from torch import Tensor

from toolkit import fisheye
from toolkit.errors import ConfigError

UNDISTORT_STEPS = 12
"""Newton steps at most; convergence is quadratic: 3 or 4 do but near the edge of a fold."""
UNDISTORTED = 1e-10
"""px that the last step may move any point; the next would move it by the square of that."""

Values = TypeVar("Values", Tensor, NDArray[np.float64])


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A pinhole with polynomial (4, 5) or rational (8 coefficients) distortion, or a fisheye.

    Source: the OpenCV camera models. A fisheye sees what lies less than 90 degrees off its axis.
    `covariance` is that of [fx fy cx cy, distortion...]: None when unknown, zero when the camera is
    known exactly.
    """

    MODELS: ClassVar[dict[str, tuple[int, ...]]] = {
        "pinhole": (0, 4, 5),
        "rational": (8,),
        "fisheye": (4,),
    }

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

    def J_parameters(self, points: Tensor) -> Tensor:
        """Give the derivative of `project` in `parameters` at each point [..., 3]: [..., 2, 4 + K].

        A pixel seen at rest has its ray turned by -J_unproject @ J_parameters instead.
        """
        x, y = (points[..., :2] / points[..., 2:]).unbind(-1)
        shown = self._shown(x, y)
        zero, one = torch.zeros_like(x), torch.ones_like(x)
        in_x, in_y = [shown[0], zero, one, zero], [zero, shown[1], zero, one]
        for change_x, change_y in self._J_coefficients(x, y):
            in_x.append(self.fx * change_x)
            in_y.append(self.fy * change_y)
        count = 4 + len(self.distortion)
        rows = [torch.stack(columns[:count], dim=-1) for columns in (in_x, in_y)]
        return torch.stack(rows, dim=-2)

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
        return self.unproject_and_J(pixels)[1]

    def unproject_and_J(self, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """Give `unproject` and its derivative, [..., 3] and [..., 3, 2]: most work is the same."""
        normalised = self.undistort(pixels)
        J_pixel = self._focal(pixels)[:, None] * self._J_distort(normalised)
        J_normalised = _inverse_2x2(J_pixel)
        ray = torch.cat([normalised, torch.ones_like(normalised[..., :1])], dim=-1)
        length = torch.linalg.vector_norm(ray, dim=-1, keepdim=True)
        unit = ray / length
        identity = torch.eye(3, dtype=ray.dtype, device=ray.device)
        along = unit[..., :, None] @ unit[..., None, :2]
        J_ray: Tensor = ((identity[:, :2] - along) / length[..., None]) @ J_normalised
        return unit, J_ray

    def undistort(self, pixels: Tensor) -> Tensor:
        """Give the normalised coordinates (x/z, y/z) seen at each pixel, [..., 2], or NaN."""
        distorted = (pixels - self._principal_point(pixels)) / self._focal(pixels)
        if not self.distortion:
            return distorted
        with np.errstate(all="ignore"):  # what cannot be inverted is told from the others below
            x, y = self._undistorted(*np.moveaxis(distorted.double().numpy(), -1, 0))
        return torch.from_numpy(np.stack([x, y], axis=-1)).to(pixels)

    def _undistorted(
        self, seen_x: NDArray[np.float64], seen_y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Invert the distortion by Newton steps; NaN where no lens shows a solution."""
        if self.model == "fisheye":
            return fisheye.undistorted(seen_x, seen_y, self.distortion)
        coefficients, focal = self._coefficients(), max(self.fx, self.fy)
        fold = _fold(coefficients)
        x, y = seen_x, seen_y
        for _ in range(UNDISTORT_STEPS):
            # kept before the fold, where Newton cannot leave for a solution that no lens shows
            shrink = np.minimum(0.999 * fold / np.maximum(np.hypot(x, y), 1e-300), 1)
            x, y = shrink * x, shrink * y
            a, b, d = _J_distorted(x, y, coefficients)
            now_x, now_y = _distorted(x, y, coefficients)
            missing_x, missing_y = seen_x - now_x, seen_y - now_y
            determinant = a * d - b * b
            step_x = (d * missing_x - b * missing_y) / determinant
            step_y = (a * missing_y - b * missing_x) / determinant
            x, y = x + step_x, y + step_y
            # False for NaN, which stays NaN
            if not (np.maximum(np.abs(step_x), np.abs(step_y)) * focal > UNDISTORTED).any():
                break
        now_x, now_y = _distorted(x, y, coefficients)
        error = np.maximum(np.abs(now_x - seen_x), np.abs(now_y - seen_y)) * focal
        is_seen = (error < 1e-6) & (np.hypot(x, y) < fold)
        return np.where(is_seen, x, np.nan), np.where(is_seen, y, np.nan)

    def _focal(self, like: Tensor) -> Tensor:
        return torch.tensor([self.fx, self.fy], dtype=like.dtype, device=like.device)

    def _principal_point(self, like: Tensor) -> Tensor:
        return torch.tensor([self.cx, self.cy], dtype=like.dtype, device=like.device)

    def _coefficients(self) -> tuple[float, ...]:
        """k1 k2 p1 p2 k3 k4 k5 k6, zero where the model has fewer."""
        return (*self.distortion, *(0.0,) * (8 - len(self.distortion)))

    def _distort(self, normalised: Tensor) -> Tensor:
        """Move ideal normalised points [..., 2] to where the lens shows them."""
        return torch.stack(self._shown(*normalised.unbind(-1)), dim=-1)

    def _J_distort(self, normalised: Tensor) -> Tensor:
        """Derivative of `_distort`, [..., 2, 2]."""
        x, y = normalised.unbind(-1)
        if self.model == "fisheye":
            a, b, d = fisheye.J_distorted(x, y, self.distortion)
        else:
            a, b, d = _J_distorted(x, y, self._coefficients())
        return torch.stack([a, b, b, d], dim=-1).reshape(*x.shape, 2, 2)

    def _shown(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Where the lens shows ideal normalised points."""
        if self.model == "fisheye":
            return fisheye.distorted(x, y, self.distortion)
        return _distorted(x, y, self._coefficients())

    def _J_coefficients(self, x: Tensor, y: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Derivative of `_shown` in each coefficient; of a pinhole in all eight."""
        if self.model == "fisheye":
            return fisheye.J_coefficients(x, y)
        return _J_coefficients(x, y, self._coefficients())


def _distorted(x: Values, y: Values, coefficients: tuple[float, ...]) -> tuple[Values, Values]:
    """Where the lens shows ideal normalised points."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if k4 or k5 or k6:
        radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = 2 * x * y
    tangential_x = p1 * xy + p2 * (r2 + 2 * x * x)
    tangential_y = p1 * (r2 + 2 * y * y) + p2 * xy
    return x * radial + tangential_x, y * radial + tangential_y


def _J_distorted(
    x: Values, y: Values, coefficients: tuple[float, ...]
) -> tuple[Values, Values, Values]:
    """Derivative of `_distorted`, the symmetric [[a, b], [b, d]]: a, b and d."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d x = 2 slope * x
    if k4 or k5 or k6:
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below
    mixed = 2 * (x * y * slope + p1 * x + p2 * y)
    return (
        radial + 2 * (x * x * slope + p1 * y + 3 * p2 * x),
        mixed,
        radial + 2 * (y * y * slope + 3 * p1 * y + p2 * x),
    )


def _J_coefficients(
    x: Tensor, y: Tensor, coefficients: tuple[float, ...]
) -> list[tuple[Tensor, Tensor]]:
    """Derivative of `_distorted` in each of k1 k2 p1 p2 k3 k4 k5 k6, (x, y)."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    below = 1 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * below
    rises = [r2 * below, r2**2 * below, r2**3 * below]
    rises += [-radial * rise for rise in rises]
    first, second, third, *rest = [(x * rise, y * rise) for rise in rises]
    tangential = [(2 * x * y, r2 + 2 * y * y), (r2 + 2 * x * x, 2 * x * y)]
    return [first, second, *tangential, third, *rest]


@lru_cache(maxsize=64)
def _fold(coefficients: tuple[float, ...]) -> float:
    """Normalised radius up to which radial distortion rises and has no pole, or infinity."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    above, below = Polynomial([1, k1, k2, k3]), Polynomial([1, k4, k5, k6])  # in r^2
    # numerator of the derivative of r * above / below
    slope = above * below + Polynomial([0, 2]) * (above.deriv() * below - above * below.deriv())
    roots = np.concatenate([slope.trim().roots(), below.trim().roots()])
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(squares.min()) ** 0.5 if squares.size else float("inf")


def _inverse_2x2(matrix: Tensor) -> Tensor:
    """Invert [..., 2, 2]; not finite where singular (torch.linalg.inv fails the whole batch)."""
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    adjugate = torch.stack([torch.stack([d, -b], dim=-1), torch.stack([-c, a], dim=-1)], dim=-2)
    return adjugate / (a * d - b * c)[..., None, None]
