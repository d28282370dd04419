"""The camera: from points in space to pixels and back, lens distortion included.

Frames, pixels and the order of the distortion coefficients are those of OpenCV, so that numbers
move freely between the two: camera frame x right, y down, z forward; (0, 0) is the centre of the
top-left pixel; distortion is k1 k2 p1 p2 [k3 [k4 k5 k6]], of a fisheye k1 k2 k3 k4.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toolkit import brown, fisheye
from toolkit.errors import ConfigError

UNDISTORT_STEPS = 12
"""Newton steps at most; convergence is quadratic: 3 or 4 do but near the edge of a fold."""
UNDISTORTED = 1e-10
"""px that the last step may move any point; the next would move it by the square of that."""


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
        fold = brown.fold(coefficients)
        x, y = seen_x, seen_y
        for _ in range(UNDISTORT_STEPS):
            # kept before the fold, where Newton cannot leave for a solution that no lens shows
            shrink = np.minimum(0.999 * fold / np.maximum(np.hypot(x, y), 1e-300), 1)
            x, y = shrink * x, shrink * y
            a, b, d = brown.J_distorted(x, y, coefficients)
            now_x, now_y = brown.distorted(x, y, coefficients)
            missing_x, missing_y = seen_x - now_x, seen_y - now_y
            determinant = a * d - b * b
            step_x = (d * missing_x - b * missing_y) / determinant
            step_y = (a * missing_y - b * missing_x) / determinant
            x, y = x + step_x, y + step_y
            # False for NaN, which stays NaN
            if not (np.maximum(np.abs(step_x), np.abs(step_y)) * focal > UNDISTORTED).any():
                break
        now_x, now_y = brown.distorted(x, y, coefficients)
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
            a, b, d = brown.J_distorted(x, y, self._coefficients())
        return torch.stack([a, b, b, d], dim=-1).reshape(*x.shape, 2, 2)

    def _shown(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Where the lens shows ideal normalised points."""
        if self.model == "fisheye":
            return fisheye.distorted(x, y, self.distortion)
        return brown.distorted(x, y, self._coefficients())

    def _J_coefficients(self, x: Tensor, y: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Derivative of `_shown` in each coefficient; of a pinhole in all eight."""
        if self.model == "fisheye":
            return fisheye.J_coefficients(x, y)
        return brown.J_coefficients(x, y, self._coefficients())


def _inverse_2x2(matrix: Tensor) -> Tensor:
    """Invert [..., 2, 2]; not finite where singular (torch.linalg.inv fails the whole batch)."""
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    adjugate = torch.stack([torch.stack([d, -b], dim=-1), torch.stack([-c, a], dim=-1)], dim=-2)
    return adjugate / (a * d - b * c)[..., None, None]
