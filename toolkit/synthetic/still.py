"""A sharp picture of a ball at rest, with the true outline of its disc."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from toolkit.ball import Disc
from toolkit.synthetic.noise import add_noise
from toolkit.synthetic.paths import StraightPath, Vector
from toolkit.synthetic.render import SHARP, Scene, record, render_shot
from toolkit.synthetic.sharp import project_limb
from toolkit.types import LinearImage


@dataclass(frozen=True, kw_only=True)
class SharpPicture:
    """A picture of the ball at rest, and the truth about it."""

    image: LinearImage
    disc: Disc  # the true outline
    position: Vector  # of the ball's centre, m
    alpha: Tensor  # [H, W] share of the pixel that the ball covers; no lens blur
    clean_image: Tensor  # [3, H, W] before noise


def render_sharp(
    scene: Scene,
    *,
    seed: int = 0,
    position: Vector | None = None,
    supersampling: int = 5,
) -> SharpPicture:
    """Render the ball of a scene at rest, as it stands at mid-exposure.

    Same camera, light, background and exposure as `render_shot`, whose background picture belongs
    to this one too; the noise is its own.

    Args:
        scene: with the ball in motion.
        seed: of the noise.
        position: of the ball's centre, m; that at mid-exposure when None.
        supersampling: rays along one side of a pixel.

    Raises:
        ConfigError: when the ball is out of the picture, or touches the camera's plane.

    Example:
        >>> from toolkit.synthetic import benchmark_scene
        >>> sharp = render_sharp(benchmark_scene(width_px=30, length_widths=3))
        >>> round(2 * sharp.disc.semi_axes[0], 1)
        30.0
    """
    time = torch.tensor([scene.exposure / 2], dtype=torch.float64)
    x, y, z = scene.path.position(time)[0].tolist() if position is None else position
    # one instant is rendered, so that a spinning ball does not turn either
    resting = replace(scene, path=StraightPath(start=(x, y, z), start_velocity=(0.0, 0.0, 0.0)))
    shot = render_shot(resting, seed=seed, supersampling=supersampling)
    light = add_noise(shot.clean_image, scene.noise, seed, SHARP)
    return SharpPicture(
        image=record(light, scene.exposure),
        disc=true_disc(scene, (x, y, z)),
        position=(x, y, z),
        alpha=shot.alpha,
        clean_image=shot.clean_image,
    )


def true_disc(scene: Scene, position: Vector) -> Disc:
    """Give the ellipse that the ball's outline makes when its centre is at `position` m.

    Without distortion it is exact; a lens bends it into the nearest ellipse.
    """
    centre = torch.tensor([position], dtype=torch.float64)
    limb = project_limb(scene.camera, centre, scene.ball_radius)[0]
    return _ellipse_through(limb)


def _ellipse_through(points: Tensor) -> Disc:
    """Fit the conic a x^2 + b x y + c y^2 + d x + e y = 1 to points [N, 2] about their mean."""
    mean = points.mean(dim=0)
    scale = (points - mean).abs().max()
    x, y = ((points - mean) / scale).unbind(-1)
    terms = torch.stack([x * x, x * y, y * y, x, y], dim=-1)
    a, b, c, d, e = torch.linalg.lstsq(terms, torch.ones_like(x)[:, None]).solution[:, 0]
    shape = torch.stack([a, b / 2, b / 2, c]).reshape(2, 2)
    centre = -torch.linalg.solve(shape, torch.stack([d, e])) / 2
    curvature, axes = torch.linalg.eigh(shape)  # rising: the longer axis first
    semi_axes = scale * ((1 + centre @ shape @ centre) / curvature).sqrt()
    centre_x, centre_y = (mean + scale * centre).tolist()
    longer, shorter = semi_axes.tolist()
    return Disc(
        centre=(centre_x, centre_y),
        semi_axes=(longer, shorter),
        angle=math.atan2(float(axes[1, 0]), float(axes[0, 0])),
        std=0.0,
    )
