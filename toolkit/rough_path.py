"""Paths simple enough to be fitted to a streak from nearly nowhere."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughPath:
    """Where the ball is at shares t = -0.5 to 0.5 of the exposure.

    Without a corner the coefficients multiply 1, t and perhaps t^2. With one at t = q they multiply
    1, t - q before it, t - q after it and perhaps (t - q)^2: one acceleration acts on both arms.
    """

    coefficients: Tensor  # [K, 3] m
    corner: float | None = None

    def basis(self, time: Tensor) -> Tensor:
        """Give the functions of time that the coefficients multiply, [T, K]."""
        passed = time - (self.corner or 0.0)
        slopes = [passed] if self.corner is None else [passed.clamp_max(0), passed.clamp_min(0)]
        functions = [torch.ones_like(time), *slopes, passed * passed]
        return torch.stack(functions[: len(self.coefficients)], dim=-1)

    def at(self, time: Tensor) -> Tensor:
        """Give the places at times [T], [T, 3] m."""
        return self.basis(time) @ self.coefficients

    def J_corner(self, time: Tensor) -> Tensor:
        """Give the derivative of `at` in the corner's time, [T, 3]."""
        passed = time - (self.corner or 0.0)
        steps = [torch.zeros_like(time), -(passed < 0).double(), -(passed >= 0).double()]
        return torch.stack([*steps, -2 * passed][: len(self.coefficients)], -1) @ self.coefficients

    @property
    def parameters(self) -> Tensor:
        """The coefficients, and the corner's time where there is one, [M]."""
        corner = self.coefficients.new_tensor([] if self.corner is None else [self.corner])
        return torch.cat([self.coefficients.flatten(), corner])

    def with_parameters(self, parameters: Tensor) -> "RoughPath":
        """Give a path of the same kind with other `parameters` [M]."""
        size = self.coefficients.numel()
        return RoughPath(
            coefficients=parameters[:size].reshape(-1, 3),
            corner=None if self.corner is None else float(parameters[size]),
        )

    def accelerated(self) -> "RoughPath":
        """Give the same path as one that may accelerate."""
        none = torch.zeros_like(self.coefficients[:1])
        return replace(self, coefficients=torch.cat([self.coefficients, none]))

    def travel(self) -> float:
        """Give about how far the ball goes, m."""
        points = self.at(torch.linspace(-0.5, 0.5, 17, dtype=torch.float64))
        return float(torch.linalg.vector_norm(points.diff(dim=0), dim=-1).sum())
