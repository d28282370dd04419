"""Paths of a ball as chains of arcs, each parabolic in time, and the numbers that shape them.

Time runs from -1/2 to 1/2 exposure; where rows are read out one after another, arcs go on beyond.
A path of gravity and drag, or any other law, fits in as a class that says which arcs its parameters
give (`SweepPath`).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Arcs:
    """P arcs C(t) = c0 + c1 t + c2 t^2 that follow one another."""

    coefficients: Tensor  # [P, 3, 3]: m, m per exposure, m per exposure^2
    joints: Tensor  # [P - 1] instants, exposures
    J: Tensor  # [P, 9, K] of the coefficients in the path's parameters

    def at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Give positions and velocities at times [T]: [T, 3] m and m per exposure."""
        place = torch.searchsorted(self.joints, time)
        c0, c1, c2 = self.coefficients[place].unbind(1)
        t = time[:, None]
        return c0 + t * (c1 + t * c2), c1 + 2 * t * c2

    def J_at(self, time: Tensor) -> tuple[Tensor, Tensor]:
        """Give the derivatives of both in the path's parameters [T, 3, K]."""
        place = torch.searchsorted(self.joints, time)
        J0, J1, J2 = self.J[place].reshape(len(time), 3, 3, -1).unbind(1)
        t = time[:, None, None]
        return J0 + t * (J1 + t * J2), J1 + 2 * t * J2

    def limits(self, start: Tensor, stop: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Cut every ray's exposure [N] at the joints: one part for each arc."""
        parts = []
        for index in range(len(self.coefficients)):
            low, high = start, stop
            if index > 0:
                low = low.clamp_min(float(self.joints[index - 1]))
            if index < len(self.joints):
                high = high.clamp_max(float(self.joints[index]))
            parts.append((low, torch.maximum(low, high)))
        return parts


class SweepPath(ABC):
    """A law of motion: it turns K parameters into arcs. Subclass it as a frozen dataclass."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of parameters, K."""

    @property
    def vectors(self) -> int:
        """Number of leading parameters that make up vectors in space, three each."""
        return self.size

    @abstractmethod
    def arcs(self, parameters: Tensor) -> Arcs:
        """Give the arcs of parameters [K]."""

    @abstractmethod
    def through(self, time: Tensor, points: Tensor) -> Tensor:
        """Give the parameters [K] of the path nearest to points [T, 3] at times [T]."""


@dataclass(frozen=True)
class SplinePath(SweepPath):
    """A uniform B-spline in time: of degree 1 with one piece the straight path, of 2 the parabola.

    Parameters are its control points, one after another.
    """

    degree: int = 1
    pieces: int = 1

    @property
    def size(self) -> int:
        """Three for each control point."""
        return 3 * (self.pieces + self.degree)

    def arcs(self, parameters: Tensor) -> Arcs:
        """Give the arcs: linear in the control points."""
        points = parameters.reshape(-1, 3)
        joints = torch.arange(1, self.pieces, dtype=torch.float64) / self.pieces - 0.5
        coefficients = torch.einsum("pkm,mx->pkx", self._weights, points)
        return Arcs(coefficients=coefficients, joints=joints, J=self._J)

    def through(self, time: Tensor, points: Tensor) -> Tensor:
        """Give the control points of the least-squares spline through points."""
        place = ((time + 0.5) * self.pieces).floor().long().clamp(0, self.pieces - 1)
        powers = torch.stack([time**k for k in range(3)], dim=-1)
        design = (powers[:, :, None] * self._weights[place]).sum(1)
        solution: Tensor = torch.linalg.lstsq(design, points).solution
        return solution.flatten()

    @cached_property
    def _weights(self) -> Tensor:
        """From control points to coefficients of the powers of time [P, 3, M]."""
        basis = {1: [[1.0, 0], [-1, 1]], 2: [[0.5, 0.5, 0], [-1, 1, 0], [0.5, -1, 0.5]]}
        local = torch.zeros(3, self.degree + 1, dtype=torch.float64)
        local[: self.degree + 1] = torch.tensor(basis[self.degree], dtype=torch.float64)
        weights = torch.zeros(self.pieces, 3, self.pieces + self.degree, dtype=torch.float64)
        for piece in range(self.pieces):
            # local time x = n t + d runs from 0 to 1 on the piece
            n, d = float(self.pieces), self.pieces / 2 - piece
            change = torch.tensor([[1, d, d * d], [0, n, 2 * n * d], [0, 0, n * n]]).double()
            weights[piece, :, piece : piece + self.degree + 1] = change @ local
        return weights

    @cached_property
    def _J(self) -> Tensor:
        eye = torch.eye(3, dtype=torch.float64)
        return torch.einsum("pkm,xy->pkxmy", self._weights, eye).reshape(self.pieces, 9, -1)


@dataclass(frozen=True)
class BouncePath(SweepPath):
    """Flights from bounce to bounce, all under the same acceleration, or none.

    Parameters: where the ball is at the start, at each bounce and at the end [bounces + 2, 3] m;
    the acceleration, half of it, m per exposure^2 [3], where there is one; the instants of the
    bounces.
    """

    instants: tuple[float, ...]
    """About when the bounces happen; the parameters tell exactly."""
    is_accelerated: bool = True

    @property
    def size(self) -> int:
        """Three for each end and bounce and the acceleration, one for each instant."""
        return self.vectors + len(self.instants)

    @property
    def vectors(self) -> int:
        """All but the instants."""
        return 3 * (len(self.instants) + 2) + 3 * self.is_accelerated

    def arcs(self, parameters: Tensor) -> Arcs:
        """Give the arcs; their derivatives in the instants follow the product rule."""
        vertices, bend, joints = self._split(parameters)
        bounds = torch.cat([joints.new_tensor([-0.5]), joints, joints.new_tensor([0.5])])
        count = len(bounds)
        coefficients, J = [], []
        for piece in range(count - 1):
            begin, end = bounds[piece], bounds[piece + 1]
            span = end - begin
            slope = (vertices[piece + 1] - vertices[piece]) / span
            c1 = slope - bend * (begin + end)
            c0 = vertices[piece] - begin * slope + bend * (begin * end)
            coefficients.append(torch.stack([c0, c1, bend]))
            part = torch.zeros(9, self.size, dtype=torch.float64)
            eye = torch.eye(3, dtype=torch.float64)
            first, last = slice(3 * piece, 3 * piece + 3), slice(3 * piece + 3, 3 * piece + 6)
            part[0:3, first], part[3:6, first] = eye * (end / span), -eye / span
            part[0:3, last], part[3:6, last] = -eye * (begin / span), eye / span
            if self.is_accelerated:
                at = slice(3 * count, 3 * count + 3)
                part[0:3, at], part[3:6, at], part[6:9, at] = (
                    eye * (begin * end),
                    -eye * (begin + end),
                    eye,
                )
            offset = self.size - len(self.instants) - 1  # of the instant that bounds[0] would have
            if piece > 0:
                part[0:3, offset + piece] = -slope - begin * slope / span + bend * end
                part[3:6, offset + piece] = slope / span - bend
            if piece < count - 2:
                part[0:3, offset + piece + 1] = begin * slope / span + bend * begin
                part[3:6, offset + piece + 1] = -slope / span - bend
            J.append(part)
        return Arcs(coefficients=torch.stack(coefficients), joints=joints, J=torch.stack(J))

    def through(self, time: Tensor, points: Tensor) -> Tensor:
        """Give the least-squares path through points, bounces at the instants stated."""
        joints = torch.tensor(self.instants, dtype=torch.float64)
        size = self.size - len(self.instants)
        zero = torch.cat([torch.zeros(size, dtype=torch.float64), joints])
        eye = torch.cat([torch.eye(size), torch.zeros(size, len(joints))], dim=1).double()
        columns = [self.arcs(zero + row).at(time)[0].flatten() for row in eye]
        solution: Tensor = torch.linalg.lstsq(
            torch.stack(columns, dim=-1), points.flatten()[:, None]
        ).solution
        return torch.cat([solution[:, 0], joints])

    def _split(self, parameters: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        bounces = len(self.instants)
        vertices = parameters[: 3 * (bounces + 2)].reshape(-1, 3)
        bend = parameters.new_zeros(3)
        if self.is_accelerated:
            bend = parameters[3 * (bounces + 2) : 3 * (bounces + 3)]
        return vertices, bend, parameters[self.size - bounces :]


STRAIGHT = SplinePath(1, 1)
PARABOLA = SplinePath(2, 1)
