"""Paths a ball can take: where its centre is, and how fast it moves, at any time.

Camera frame (x right, y down, z forward), metre, second; t = 0 is the start of the exposure.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from toolkit.errors import ConfigError

Vector = tuple[float, float, float]


class BallPath(ABC):
    """The motion of a ball's centre. Subclass it as a frozen dataclass."""

    @abstractmethod
    def position(self, time: Tensor) -> Tensor:
        """Give the centre at each time [T] s, as [T, 3] m."""

    @abstractmethod
    def velocity(self, time: Tensor) -> Tensor:
        """Give the velocity at each time [T] s, as [T, 3] m/s."""


@dataclass(frozen=True, kw_only=True)
class StraightPath(BallPath):
    """Uniform motion along a straight line."""

    start: Vector
    start_velocity: Vector

    def position(self, time: Tensor) -> Tensor:
        """Give the centre, [T, 3] m."""
        return _vector(self.start) + time.double()[:, None] * _vector(self.start_velocity)

    def velocity(self, time: Tensor) -> Tensor:
        """Give the velocity, [T, 3] m/s."""
        return _vector(self.start_velocity).expand(len(time), 3)


@dataclass(frozen=True, kw_only=True)
class ParabolicPath(BallPath):
    """Free flight under a constant acceleration."""

    start: Vector
    start_velocity: Vector
    acceleration: Vector = (0.0, 9.81, 0.0)

    def position(self, time: Tensor) -> Tensor:
        """Give the centre, [T, 3] m."""
        t = time.double()[:, None]
        v, a = _vector(self.start_velocity), _vector(self.acceleration)
        return _vector(self.start) + v * t + a * (t * t / 2)

    def velocity(self, time: Tensor) -> Tensor:
        """Give the velocity, [T, 3] m/s."""
        t = time.double()[:, None]
        return _vector(self.start_velocity) + _vector(self.acceleration) * t


@dataclass(frozen=True, kw_only=True)
class BouncingPath(BallPath):
    """Free flight with one bounce off a level floor.

    The floor is a plane of constant y (which points down); the centre turns back at
    `contact_height`, one ball radius above it. The exposure is taken to be too short for a second
    bounce.
    """

    start: Vector
    start_velocity: Vector
    contact_height: float
    """The centre's y when the ball touches the floor, m; larger than the start's y."""
    acceleration: Vector = (0.0, 9.81, 0.0)
    restitution: float = 0.8
    """Speed along the floor's normal after the bounce, over that before."""
    tangential_loss: float = 0.0
    """Share of the speed along the floor that the bounce takes away."""

    def __post_init__(self) -> None:
        if not (0 <= self.restitution <= 1 and 0 <= self.tangential_loss <= 1):
            raise ConfigError(
                f"restitution {self.restitution} and tangential loss {self.tangential_loss}"
                " must lie in 0..1"
            )
        if self.start[1] >= self.contact_height:
            raise ConfigError(
                f"the ball starts at y {self.start[1]} m, on or below its contact height"
                f" {self.contact_height} m (y points down); start it above the floor"
            )

    @property
    def bounce_time(self) -> float:
        """The instant the ball touches the floor after t = 0, s; infinite when it never does."""
        drop = self.contact_height - self.start[1]
        v, a = self.start_velocity[1], self.acceleration[1]
        discriminant = v * v + 2 * a * drop
        if discriminant < 0:
            return math.inf
        # this form of the root stays exact as the acceleration goes to 0
        divisor = v + math.sqrt(discriminant)
        return 2 * drop / divisor if divisor > 0 else math.inf

    def position(self, time: Tensor) -> Tensor:
        """Give the centre, [T, 3] m."""
        before, after = self._flights()
        after_bounce = (time.double() > self.bounce_time)[:, None]
        return torch.where(
            after_bounce, after.position(time.double() - self._pivot), before.position(time)
        )

    def velocity(self, time: Tensor) -> Tensor:
        """Give the velocity, [T, 3] m/s; at the bounce itself that before it."""
        before, after = self._flights()
        after_bounce = (time.double() > self.bounce_time)[:, None]
        return torch.where(
            after_bounce, after.velocity(time.double() - self._pivot), before.velocity(time)
        )

    @property
    def _pivot(self) -> float:
        return self.bounce_time if math.isfinite(self.bounce_time) else 0.0

    def _flights(self) -> tuple[ParabolicPath, ParabolicPath]:
        """The free flights before the bounce, from t = 0, and after it, from the bounce."""
        before = ParabolicPath(
            start=self.start, start_velocity=self.start_velocity, acceleration=self.acceleration
        )
        pivot = torch.tensor([self._pivot], dtype=torch.float64)
        x, y, z = before.position(pivot)[0].tolist()
        vx, vy, vz = before.velocity(pivot)[0].tolist()
        kept = 1 - self.tangential_loss
        after = ParabolicPath(
            start=(x, y, z),
            start_velocity=(kept * vx, -self.restitution * vy, kept * vz),
            acceleration=self.acceleration,
        )
        return before, after


@dataclass(frozen=True, kw_only=True)
class CircularPath(BallPath):
    """A ball swung on a string: a circle at a constant rate."""

    centre: Vector
    arm: Vector
    """From the centre to the ball at t = 0, m."""
    axis: Vector
    """Axis of rotation, of any length; the motion is right-handed about it."""
    rate: float
    """rad/s."""

    def __post_init__(self) -> None:
        if math.hypot(*self.axis) == 0:
            raise ConfigError("the axis of a circular path has no length; give a direction")

    def position(self, time: Tensor) -> Tensor:
        """Give the centre of the ball, [T, 3] m."""
        return _vector(self.centre) + self._turned(_vector(self.arm), time)

    def velocity(self, time: Tensor) -> Tensor:
        """Give the velocity, [T, 3] m/s."""
        axis = torch.nn.functional.normalize(_vector(self.axis), dim=0)
        return self._turned(self.rate * torch.linalg.cross(axis, _vector(self.arm)), time)

    def _turned(self, vector: Tensor, time: Tensor) -> Tensor:
        return turned(vector, _vector(self.axis), self.rate * time.double())


def turned(vector: Tensor, axis: Tensor, angle: Tensor) -> Tensor:
    """Turn `vector` [3] right-handed about `axis` [3], of any length, by each angle [T] rad.

    Source: Rodrigues' formula.

    Returns:
        [T, 3].
    """
    k = torch.nn.functional.normalize(axis, dim=0)
    cosine, sine = angle.cos()[:, None], angle.sin()[:, None]
    result: Tensor = (
        vector * cosine
        + torch.linalg.cross(k, vector) * sine
        + k * torch.dot(k, vector) * (1 - cosine)
    )
    return result


def _vector(values: Vector) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)
