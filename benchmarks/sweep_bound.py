"""The Cramer-Rao bound of a rendered shot, from renderings alone: no model of a streak enters.

Unknown are position and velocity at mid-exposure, and beside them the lens's point spread, the
ball's colour, and a gain and an offset of the background in each channel, these held by the same
priors as in the fit. Each pixel is independent; its variance is that of the shot and, for the share
in which the background is seen through the ball, that of the background's picture.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sweep_scenes import fineness

from toolkit.synthetic import NoiseLevel, PlainBall, Scene, StraightPath, render_shot

Array = NDArray[np.float64]

STEP_PX = 0.003
"""By how much edges are moved, to either side, to take a derivative. Depth, colour and light nearly
make up for each other: 0.1 px would miss what is left by so much that the bound halves."""
BLUR_STEP = 0.1
"""px; only the direction of this derivative matters."""
WHITE = PlainBall(colour=(1.0, 1.0, 1.0))
KNOWN = 1e12
"""Prior information about what is given."""


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """Derivatives of a shot's light in all that is unknown, and what they make known."""

    shared: list[Array]  # [3, H, W] each: position and velocity at mid-exposure, point spread
    own: list[Array]  # likewise colour, gain, offset; each channel has its own
    weight: Array  # [3, H, W] inverse variance of a pixel
    covariance: Array  # [7 + 9, 7 + 9] least, of the shared and then the others by kind
    along: Array  # [3] unit velocity

    @property
    def std(self) -> Array:
        """Least standard deviations of x, y, z (m) and the speed (m/s)."""
        return np.asarray(np.sqrt(np.diag(self._of_four(self.covariance))))

    def shift(self, change: Array) -> Array:
        """By how much the likeliest x, y, z and speed move where the light [3, H, W] changes."""
        pull = np.zeros(len(self.covariance))
        for q, (J, at) in enumerate(_by_channel(self.shared, self.own)):
            pull[at] += J.T @ (self.weight[q] * change[q]).ravel()
        state = (self.covariance @ pull)[:6]
        return np.array([*state[:3], self.along @ state[3:]])

    def _of_four(self, covariance: Array) -> Array:
        take = np.zeros((4, len(covariance)))
        take[[0, 1, 2], [0, 1, 2]] = 1
        take[3, 3:6] = self.along
        return np.asarray(take @ covariance @ take.T)


def slopes_by_rendering(
    scene: Scene, *, is_colour_known: bool, gain_std: float, offset_std: float
) -> Slopes:
    """Render a plain ball on a straight path once more for each change of what is unknown.

    Args:
        scene: the shot.
        is_colour_known: whether the ball's colour is given.
        gain_std: prior of the background's gain.
        offset_std: prior of its offset.
    """
    night = replace(scene, background=0 * scene.background, appearance=WHITE)
    alpha = _pictures(night)[0]  # as the lens shows it
    image, background = _pictures(scene)
    weight = 1 / (
        _variance(scene.noise, image) + (1 - alpha) ** 2 * _variance(scene.noise, background)
    )
    shared = [*(_motion_slope(scene, parameter) for parameter in range(6)), _blur_slope(scene)]
    colour = np.array(scene.appearance.colour)[:, None, None]
    own = [alpha, image - alpha * colour, 1 - alpha]
    information = np.diag(
        [0.0] * len(shared)
        + [KNOWN if is_colour_known else 0.0] * 3
        + [gain_std**-2] * 3
        + [offset_std**-2] * 3
    )
    for q, (J, at) in enumerate(_by_channel(shared, own)):
        information[np.ix_(at, at)] += J.T @ (weight[q].ravel()[:, None] * J)
    velocity = np.array(scene.path.start_velocity)
    return Slopes(
        shared=shared,
        own=own,
        weight=weight,
        covariance=np.linalg.inv(information),
        along=velocity / np.linalg.norm(velocity),
    )


def _by_channel(shared: list[Array], own: list[Array]) -> Iterator[tuple[Array, list[int]]]:
    """The derivatives of each channel's pixels [N, 7 + 3], and which unknowns they are in."""
    first, channels = len(shared), len(shared[0])
    for q in range(channels):
        J = np.stack([column[q].ravel() for column in (*shared, *own)], axis=-1)
        yield J, [*range(first), *(first + kind * channels + q for kind in range(len(own)))]


def _motion_slope(scene: Scene, parameter: int) -> Array:
    """Derivative of the light in one of x y z vx vy vz at mid-exposure [3, H, W]."""
    h = _motion_step(scene, parameter)
    after, before = (_pictures(_moved(scene, parameter, way * h))[0] for way in (1, -1))
    return (after - before) / (2 * h)


def _motion_step(scene: Scene, parameter: int) -> float:
    """What moves an edge by `STEP_PX`."""
    middle = np.array(scene.path.start) + np.array(scene.path.start_velocity) * scene.exposure / 2
    pixel = np.linalg.norm(middle) / scene.camera.fx  # m
    # the depth moves edges by as much less as the ball is smaller than its distance
    slowness = float(np.linalg.norm(middle)) / scene.ball_radius if parameter % 3 == 2 else 1.0
    step = STEP_PX * float(pixel) * slowness
    return step if parameter < 3 else step * 2 / scene.exposure


def _moved(scene: Scene, parameter: int, change: float) -> Scene:
    start, velocity = np.array(scene.path.start), np.array(scene.path.start_velocity)
    if parameter < 3:
        start[parameter] += change
    else:  # the place at mid-exposure stays
        velocity[parameter - 3] += change
        start[parameter - 3] -= change * scene.exposure / 2
    x, y, z = start.tolist()
    vx, vy, vz = velocity.tolist()
    return replace(scene, path=StraightPath(start=(x, y, z), start_velocity=(vx, vy, vz)))


def _blur_slope(scene: Scene) -> Array:
    """Derivative of the light in the point spread, but for the background's own picture."""
    low, high = max(0.0, scene.blur - BLUR_STEP), scene.blur + BLUR_STEP
    less, more = (np.subtract(*_pictures(replace(scene, blur=sigma))) for sigma in (low, high))
    return np.asarray((more - less) / (high - low))


def _pictures(scene: Scene) -> tuple[Array, Array]:
    """The light of shot and background [3, H, W]."""
    step, rays = fineness(scene)
    shot = render_shot(scene, step=step / 2, supersampling=rays)
    return shot.clean_image.double().numpy(), shot.clean_background.double().numpy()


def _variance(noise: NoiseLevel, light: Array) -> Array:
    return noise.read**2 + noise.gain * light
