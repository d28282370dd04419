"""The bound of shots of a shaded ball whose light one noisy sharp picture told.

Two pictures tell of the motion here: the streak of path and light together, the sharp picture of
the light, and of the disc's place, size and blur in it. What the sharp picture tells is found by
rendering it once more for each change; what the streak tells by the exact stage's own derivatives,
at the true motion and in the true light, which `sweep_bound` checks against renderings. Of what is
common to both only the light is shared: neither disc nor blur is used for the streak.

`of_smooth_light` knows no lamp: a shade is as smooth as `toolkit.smooth_light` takes it to be, with
one lamp that ends somewhere. `of_known_family` knows that the ball is matt and of one colour before
one white lamp, and lacks six numbers: colour, share of the room, and direction of the lamp. It is
what a method made for such balls alone could reach, and here for comparison.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from plugins.known_shading import KnownShading
from plugins.loose_light import LooseLight
from toolkit import NoiseModel, SharpBall
from toolkit.motion import SPEED
from toolkit.shade_basis import (
    dense_basis,
    facing_places,
    lamp_light,
    shade_size,
    sparse_basis,
    turned,
)
from toolkit.smooth_pixels import SmoothPixels
from toolkit.smooth_shade import Guess, Joint, Shade
from toolkit.sweep.doubt import J_state
from toolkit.sweep.fit import SweepFit, fit_sweep
from toolkit.sweep.model import SweepModel
from toolkit.sweep.paths import STRAIGHT
from toolkit.sweep.pixels import Frame
from toolkit.sweep.relight import joint_light
from toolkit.synthetic import (
    Appearance,
    LitBall,
    PlainBall,
    RenderedShot,
    Scene,
    render_sharp,
    true_disc,
)
from toolkit.synthetic.lens import blur, mean_over_pixels
from toolkit.view import observe_streak

Array = NDArray[np.float64]

NODES, RIM = 129, 0.999
"""Of the light of a disc, and how near to the rim it is taken."""
MARGIN = 14
"""px about the disc that are looked at."""
RAYS = 3
"""Along a pixel's side."""
LEAST_COVERAGE = 0.02
"""Share of the ball from which a pixel is."""
STEP_PX, BLUR_STEP, STEP = 0.05, 0.05, 0.01
"""By which the disc is moved, the blur is widened, px, and all else is changed."""


class LightBound:
    """What a shot and a sharp picture of its ball could tell at best.

    Args:
        shot: of a `LitBall` of one pigment without a highlight, on a straight path.
        seed: of the sharp picture's noise.
    """

    def __init__(self, shot: RenderedShot, seed: int) -> None:
        self.shot = shot
        self.scene, self.background = _about_ball(shot)
        self.ball: LitBall = shot.scene.appearance
        self.centre = shot.position
        x, y, z = self.centre.tolist()
        self.disc = true_disc(self.scene, (x, y, z))
        away = torch.nn.functional.normalize(self.centre, dim=0)
        right = torch.eye(3, dtype=torch.float64)[0]
        right = torch.nn.functional.normalize(right - right @ away * away, dim=0)
        self.axes = torch.stack([right, torch.linalg.cross(away, right), away])
        middle = self.disc.to_unit(self.scene.camera.project(self.centre[None]))[0]
        sine = self.scene.ball_radius / float(self.centre.norm())
        self.near = torch.cat([torch.tensor([sine], dtype=torch.float64), middle])
        light = torch.tensor([self.ball.light], dtype=torch.float64)
        self.lamp = torch.nn.functional.normalize(light, dim=-1) @ self.axes.mT
        self.sharp = render_sharp(self.scene, seed=seed)
        self.fit = _true_fit(shot)

    def of_known_light(self) -> Array:
        """Give the least standard deviations of x, y, z and speed where the light is known."""
        return _std(self.fit, self.fit.path_covariance, self.scene.exposure)

    def of_smooth_light(self) -> Array:
        """Give those where the light is that of a smooth shade as the sharp picture tells it."""
        basis = rendered_basis(self)
        pixels = self._pixels()
        shade = Shade.with_design(basis, basis[:, 0], pixels)
        guess = Guess(disc=self.disc, spread=0.5, near=self.near, lamp=self.lamp)
        joint = Joint.with_slopes(shade, self._slopes(), self.near)
        coefficients, moved = joint.errors(guess)
        place = _grid()
        unit = self.unit(disc_normals(self.shot)).reshape(-1, 2)
        errors = dense_basis(unit) @ coefficients[:, :-1]
        errors += lamp_light(unit, self.lamp) * coefficients[:, -1:]
        for number, slope in enumerate(self._unseen_slopes(unit, place.reshape(-1, 2))):
            errors += moved[:, 6 + number, None, None] * slope
        return self._with_errors(errors)

    def of_known_family(self) -> Array:
        """Give those where all but six numbers of the light is known."""
        members = _family(self.ball)
        here = self.picture(self.ball)
        columns = [(self.picture(other) - here) / STEP for other in members]
        columns += self._slopes()[..., [0, 1, 2, 5]].unbind(-1)
        J = torch.stack(columns, dim=-1)
        weight = self._pixels().seen_by(self._coverage())[1]
        information = torch.einsum("pcm,pc,pcn->mn", J, weight, J)
        scale = information.diagonal().rsqrt()
        covariance = torch.linalg.inv(information * torch.outer(scale, scale))
        covariance = (covariance * torch.outer(scale, scale))[:6, :6]
        normals = disc_normals(self.shot).reshape(-1, 3)
        light = self.ball(normals, 0.0)
        changes = torch.stack([(other(normals, 0.0) - light) / STEP for other in members])
        root = torch.linalg.cholesky(covariance)
        return self._with_errors(torch.einsum("nm,npc->mpc", root, changes))

    def _with_errors(self, errors: Tensor) -> Array:
        """Give the bound where independent errors [E, NODES^2, 3] of the light are possible."""
        ball = exact_ball(self.shot)
        change = errors.mT.reshape(len(errors), 3, NODES, NODES) * math.sqrt(len(errors))
        ball = replace(ball, others=ball.rgb + change)
        camera = self.shot.scene.camera
        known = KnownShading(ball=ball).seen_through(camera)
        loose = LooseLight.of(known, ball, camera)
        light = joint_light(self.fit, loose, torch.zeros(len(errors), dtype=torch.float64))
        covariance = light.path_covariance(self.fit.model.path.size)
        return _std(self.fit, covariance, self.scene.exposure)

    def _coverage(self) -> Tensor:
        return _clean(self.scene, _white)[0].flatten()

    def picture(self, look: Appearance) -> Tensor:
        """What the ball alone shows in the sharp picture, [P, 3]."""
        return _clean(self.scene, look).flatten(1).mT

    def _pixels(self) -> SmoothPixels:
        """Those of the sharp picture, with the noise that they truly have."""
        level, share = self.scene.noise, self._coverage()
        light, behind = (x.flatten(1).mT for x in (self.sharp.clean_image, self.background))
        height, width = self.background.shape[1:]
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        ones = torch.ones(3, dtype=torch.float64)
        seen = self.sharp.image.rgb[0].flatten(1).mT.double()
        light = light.double()
        return SmoothPixels(
            place=torch.stack([x, y], dim=-1).double().reshape(-1, 2),
            index=torch.arange(height * width),
            shape=(height, width),
            light=seen,
            behind=behind,
            noise=level.read**2 + level.gain * light,
            behind_noise=level.read**2 + level.gain * behind,
            is_disturbed=torch.zeros(height * width, dtype=torch.bool),
            level=self.picture(self.ball).sum(0) / share.sum(),
            excess=ones,
            disc=self.disc,
            spread=0.5,
            model=NoiseModel(
                read_variance=ones[None] * level.read**2,
                gain=ones[None] * level.gain,
                density=ones,
            ),
            block=1,
            used=share > LEAST_COVERAGE,
        )

    def _slopes(self) -> Tensor:
        """What outline, blur, lamp and nearness change in the sharp picture, [P, 3, 11]."""
        here, pixel = self._shown(self.scene, self.centre), self.disc.semi_axes[1]
        px = float(self.centre.norm()) / self.scene.camera.fx
        moves = self.axes[:2] * (px * STEP_PX)
        right, down = (
            (self._shown(self.scene, self.centre + move) - here) / STEP_PX for move in moves
        )
        nearer = self.centre * (1 - STEP_PX / pixel)
        size = (self._shown(self.scene, nearer) - here) / STEP_PX
        wide = replace(self.scene, blur=math.sqrt(self.scene.blur**2 + BLUR_STEP))
        blur = (self._shown(wide, self.centre) - here) / BLUR_STEP
        x, y = self.disc.to_unit(self._pixels().place)[:, :, None].unbind(1)
        rest = [self.picture(self._function(number)) for number in range(5)]
        columns = [right, down, size, x * right - y * down, y * right + x * down, blur, *rest]
        return torch.stack(columns, dim=-1)

    def _shown(self, scene: Scene, centre: Tensor) -> Tensor:
        """Ball and noisy background in the sharp picture, the ball elsewhere, [P, 3]."""
        look, white = (_clean(scene, look, centre) for look in (self.ball, _white))
        return (look + (1 - white) * self.background).flatten(1).mT

    def _function(self, number: int) -> Appearance:
        """A look that is the change of light by the lamp's turns, or by nearness."""

        def look(normal: Tensor, _: float) -> Tensor:
            unit = self.unit(normal.double())
            point = self.centre + self.scene.ball_radius * normal.double()
            place = self.disc.to_unit(self.scene.camera.project(point))
            return self._unseen_slopes(unit, place)[number].to(normal)

        return look

    def _unseen_slopes(self, unit: Tensor, place: Tensor) -> list[Tensor]:
        """Change of the light at normals, seen at places, in turns of the lamp and nearness."""
        bright = torch.tensor(self.ball.pattern.colour) * (1 - self.ball.ambient)
        slopes = []
        here = lamp_light(unit, self.lamp)
        for turn in STEP * torch.eye(2, dtype=torch.float64):
            slopes.append((lamp_light(unit, turned(self.lamp, turn)) - here) / STEP * bright)
        light = self._light_at(facing_places(place, self.near))
        for step in STEP * torch.eye(3, dtype=torch.float64):
            moved = self._light_at(facing_places(place, self.near + step))
            slopes.append((moved - light) / STEP)
        return slopes

    def _light_at(self, unit: Tensor) -> Tensor:
        facing = (1 - (unit * unit).sum(-1, keepdim=True)).clamp_min(0).sqrt()
        return self.ball(torch.cat([unit, -facing], dim=-1) @ self.axes, 0.0)

    def unit(self, normal: Tensor) -> Tensor:
        """The normals' parts across the view, [..., 2]; those turned away at the rim."""
        unit = (normal @ self.axes.mT)[..., :2]
        length = torch.linalg.vector_norm(unit, dim=-1, keepdim=True)
        return unit / length.clamp_min(1)


def exact_ball(shot: RenderedShot) -> SharpBall:
    """Give the light of the disc at mid-exposure as it is."""
    x, y, z = shot.position.tolist()
    light = shot.scene.appearance(disc_normals(shot).reshape(-1, 3), shot.scene.exposure / 2)
    rgb = light.mT.reshape(3, NODES, NODES).float().contiguous()
    return SharpBall(disc=true_disc(shot.scene, (x, y, z)), rgb=rgb)


def disc_normals(shot: RenderedShot) -> Tensor:
    """Give the surface's normal at each node of the disc at mid-exposure [NODES, NODES, 3].

    Beyond the rim it stays as it is there.
    """
    scene, centre = shot.scene, shot.position
    x, y, z = centre.tolist()
    ray = scene.camera.unproject(true_disc(scene, (x, y, z)).from_unit(_grid()))
    near = ray @ centre
    depth = near - (near**2 - centre @ centre + scene.ball_radius**2).clamp_min(0).sqrt()
    return torch.nn.functional.normalize(depth[..., None] * ray - centre, dim=-1)


def _grid() -> Tensor:
    line = torch.linspace(-1, 1, NODES, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1)
    return place * (RIM / torch.linalg.vector_norm(place, dim=-1, keepdim=True)).clamp_max(1)


def _about_ball(shot: RenderedShot) -> tuple[Scene, Tensor]:
    """Give the scene cut out about the ball at mid-exposure, and its background's picture."""
    scene = shot.scene
    x, y, z = shot.position.tolist()
    disc = true_disc(scene, (x, y, z))
    reach = math.ceil(disc.semi_axes[0]) + MARGIN
    left, top = (max(0, round(c) - reach) for c in disc.centre)
    camera = scene.camera
    width, height = min(2 * reach, camera.width - left), min(2 * reach, camera.height - top)
    window = (..., slice(top, top + height), slice(left, left + width))
    part = replace(
        scene,
        camera=camera.cropped(left, top, width, height),
        background=scene.background[window].contiguous(),
    )
    return part, shot.clean_background[window].double()


def _white(normal: Tensor, _: float) -> Tensor:
    return torch.ones_like(normal)


def _clean(scene: Scene, look: Appearance, centre: Tensor | None = None) -> Tensor:
    """What a resting ball of some look adds to a black picture [3, H, W]."""
    night = replace(scene, background=0 * scene.background, appearance=look)
    if centre is None:
        return render_sharp(night, supersampling=RAYS).clean_image.double()
    x, y, z = centre.tolist()
    return render_sharp(night, position=(x, y, z), supersampling=RAYS).clean_image.double()


def rendered_basis(bound: LightBound) -> Tensor:
    """Render a ball in each number of a smooth shade [P, K]: all at once, since light adds up."""
    scene, centre, size = bound.scene, bound.centre, shade_size() + 1
    camera, radius = scene.camera, scene.ball_radius
    x, y = (
        (torch.arange(RAYS * count, dtype=torch.float64) + 0.5) / RAYS - 0.5
        for count in (camera.width, camera.height)
    )
    ray = camera.unproject(torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2))
    tangent = math.sqrt(float(centre @ centre) - radius**2)
    near = ray @ centre
    # as the renderer does: linear in the area near the rim
    px = float(centre.norm()) / camera.fx / RAYS * float(ray[:, 2].mean())
    cover = ((near - tangent) / (radius * px / float(centre.norm())) + 0.5).clamp(0, 1)
    depth = near - (near * near - tangent**2).clamp_min(0).sqrt()
    normal = torch.nn.functional.normalize(depth[:, None] * ray - centre, dim=-1)
    inside = cover.nonzero()[:, 0]
    unit = bound.unit(normal[inside])
    rows, numbers, values = sparse_basis(unit)
    order = numbers.argsort(stable=True)
    rows, values, numbers = rows[order], values[order], numbers[order]
    ends = torch.searchsorted(numbers, torch.arange(size)).tolist()
    columns = []
    for number in range(size):
        light = torch.zeros(len(ray), dtype=torch.float64)
        if number == size - 1:
            light[inside] = lamp_light(unit, bound.lamp)[:, 0]
        else:
            own = slice(ends[number], ends[number + 1])
            light[inside[rows[own]]] = values[own]
        fine = (light * cover).reshape(1, RAYS * camera.height, RAYS * camera.width).float()
        seen = mean_over_pixels(blur(fine.numpy(), scene.blur * RAYS), RAYS)
        columns.append(torch.from_numpy(seen).double().flatten())
    return torch.stack(columns, dim=1)


def _family(ball: LitBall) -> list[LitBall]:
    """Change each of the six numbers of a ball's light by a little."""
    r, g, b = ball.pattern.colour
    x, y, z = ball.light
    away = torch.nn.functional.normalize(torch.tensor([[x, y, z]], dtype=torch.float64), dim=-1)
    turns = [turned(away, turn)[0].tolist() for turn in STEP * torch.eye(2, dtype=torch.float64)]
    colours = [(r + STEP, g, b), (r, g + STEP, b), (r, g, b + STEP)]
    return [
        *(replace(ball, pattern=PlainBall(colour=colour)) for colour in colours),
        replace(ball, ambient=ball.ambient + STEP),
        *(replace(ball, light=(u, v, w)) for u, v, w in turns),
    ]


def _true_fit(shot: RenderedShot) -> SweepFit:
    """Compare the shot with the exact stage's model at the true motion, in the true light."""
    scene = shot.scene
    estimator = KnownShading(ball=exact_ball(shot)).seen_through(scene.camera)
    view = observe_streak(shot.image, shot.background, estimator)
    frame = Frame.of(view, estimator, scene.camera)
    time = torch.linspace(0, scene.exposure, 9, dtype=torch.float64)
    path = STRAIGHT.through(time / scene.exposure - 0.5, scene.path.position(time))
    model = SweepModel(
        path=STRAIGHT, estimator=estimator, camera=scene.camera, ball_radius=scene.ball_radius
    )
    rest = torch.tensor([scene.blur**2 + 1 / 12, 1, 1, 1, 0, 0, 0], dtype=torch.float64)
    return fit_sweep(model, torch.cat([path, rest]), frame, most_steps=0)


def _std(fit: SweepFit, covariance: Tensor, exposure: float) -> Array:
    """Give the standard deviations of x, y, z (m) and speed (m/s) for those of the path."""
    J = J_state(fit)
    state = (J @ covariance @ J.mT).diagonal().clamp_min(0).sqrt()
    return np.array([*state[:3].tolist(), float(state[SPEED]) / exposure])
