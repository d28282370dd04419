from dataclasses import replace

import pytest
import torch

from plugins.two_colour import TwoColour
from plugins.uniform import Uniform
from toolkit import Camera, StreakError
from toolkit.box_filter import ring_mean
from toolkit.sweep.fit import outline
from toolkit.sweep.pixels import Beside, Frame
from toolkit.sweep.rays import RayGrid
from toolkit.synthetic import add_noise
from toolkit.synthetic.noise import NoiseLevel
from toolkit.types import LinearImage, NoiseModel
from toolkit.view import observe_streak

BARREL = (-0.3, 0.1, 1e-3, -8e-4, 0.0)
RATIONAL = (0.2, -0.1, 5e-4, 5e-4, 0.01, 0.45, -0.05, 0.02)


def find_rays(camera, place):
    return RayGrid.over(camera, place.amin(0), place.amax(0)).rays(place)


def lattice(width, height, step=1.0):
    y, x = torch.meshgrid(
        torch.arange(0, height, step).double(), torch.arange(0, width, step).double(), indexing="ij"
    )
    return torch.stack([x.flatten(), y.flatten()], dim=-1)


LENSES = {
    "plain": ((), 260.0, 1e-6),
    "barrel": (BARREL, 600.0, 1e-6),
    "wide barrel": (BARREL, 260.0, 1e-5),
    "very wide": (RATIONAL, 260.0, 3e-4),
}


@pytest.mark.parametrize("lens", LENSES)
def test_rays_are_those_of_the_camera(lens):
    distortion, focal, limit = LENSES[lens]
    camera = Camera.centred(320, 240, focal, distortion)
    place = lattice(320, 240, 3)
    rays = find_rays(camera, place)
    exact = camera.unproject(place)
    assert torch.linalg.vector_norm(rays.unit.mT - exact, dim=-1).max() * focal < limit
    assert (camera.project(rays.unit.mT) - place).abs().max() < limit


def test_their_changes_follow_the_distortion():
    camera = Camera.centred(320, 240, 260.0, BARREL)
    place = lattice(320, 240, 7)
    rays = find_rays(camera, place)
    for found, shift in ((rays.right, [0.5, 0.0]), (rays.down, [0.0, 0.5])):
        half = torch.tensor(shift, dtype=torch.float64)
        change = camera.unproject(place + half) - camera.unproject(place - half)
        assert (found.mT - change).norm(dim=-1).max() < 0.01 / camera.fx


def test_one_pixel_has_a_ray_too():
    camera = Camera.centred(320, 240, 260.0, BARREL)
    place = torch.tensor([[17.0, 230.0]], dtype=torch.float64)
    assert torch.allclose(find_rays(camera, place).unit.mT, camera.unproject(place), atol=1e-9)


@pytest.fixture(scope="module")
def short(streak):
    return streak(length_widths=1.0)


def test_all_the_ball_covers_is_taken_and_what_lies_beside_it_summed_up(short):
    pixels = short.pixels()
    covered = (short.shot.alpha > 0).nonzero().flip(-1)
    taken = {tuple(place) for place in pixels.place.long().tolist()}
    assert {tuple(place) for place in covered.tolist()} <= taken
    x, y = pixels.place.long().mT
    assert torch.equal(pixels.signal.float(), short.shot.image.rgb[0][:, y, x])
    assert torch.equal(pixels.ground.float(), short.shot.background.rgb[0][:, y, x])
    # gain and offset beside the streak are those of no change
    step = torch.linalg.solve(pixels.beside.information, -pixels.beside.gradient)
    std = torch.linalg.inv(pixels.beside.information).diagonal().sqrt()
    assert (step.abs() < 4 * std).all()


def test_a_window_in_the_picture_gives_the_same_pixels(short):
    frame = short.frame()
    left, top = 9, 14
    maps = {
        name: getattr(frame, name)[..., top:, left:]
        for name in ("signal", "ground", "shot_variance", "ground_variance", "usable")
    }
    window = replace(frame, corner=(left, top), **maps)
    middle = short.scene.camera.project(short.points())
    whole, cut = (one.about(middle, 16.0) for one in (frame, window))
    assert torch.equal(whole.place, cut.place)
    assert torch.equal(whole.signal, cut.signal)
    assert torch.allclose(whole.rays.unit, cut.rays.unit, atol=1e-9)


def test_where_nothing_was_measured_it_says_so(short):
    frame, model, truth = short.frame(), short.model(), short.truth()
    middle, half_width = outline(model, truth)
    with pytest.raises(StreakError, match=r"nothing was measured.*name a region"):
        frame.about(middle + 5000, half_width)
    blind = replace(frame, usable=torch.zeros_like(frame.usable))
    with pytest.raises(StreakError, match="nothing was measured"):
        blind.about(middle, half_width)


def test_unusable_pixels_are_left_out(short):
    frame = short.frame()
    usable = frame.usable.clone()
    x, y = short.scene.camera.project(short.points(3)[1]).long()
    usable[y, x] = False
    middle = short.scene.camera.project(short.points())
    fewer = replace(frame, usable=usable).about(middle, 16.0)
    assert len(fewer) == len(frame.about(middle, 16.0)) - 1
    assert [int(x), int(y)] not in fewer.place.long().tolist()


@pytest.mark.parametrize("side", [2, 3])
def test_squares_keep_light_and_precision(short, side):
    pixels = short.pixels(side)
    light = short.shot.image.rgb[0].double()
    height, width = (size // side * side for size in light.shape[1:])
    means = light[:, :height, :width].reshape(3, height // side, side, width // side, side)
    means = means.mean((2, 4))
    column, row = ((pixels.place + 0.5) / side - 0.5).round().long().mT
    assert torch.allclose(pixels.signal, means[:, row, column], atol=1e-6)
    assert torch.allclose(pixels.shot_variance, torch.tensor(short.noise**2 / side**2).double())
    assert torch.allclose(pixels.ground_variance, pixels.shot_variance)
    assert torch.allclose(pixels.rays.blur + 1 / 12, torch.tensor(side**2 / 12).double())
    # the middle of a square of pixels
    assert torch.equal(
        pixels.place[:, 0] % 1, torch.full((len(pixels),), (side - 1) / 2 % 1).double()
    )


def test_squares_leave_out_what_is_unusable(short):
    frame = short.frame()
    shot = frame.shot_variance.clone()
    shot[:, :, ::2] = torch.inf
    usable = frame.usable.clone()
    usable[::2] = False
    half = replace(frame, shot_variance=shot, usable=usable)
    middle = short.scene.camera.project(short.points())
    pixels = half.about(middle, 16.0, side=2)
    column, row = ((pixels.place + 0.5) / 2 - 0.5).round().long().mT
    # of four pixels one is left: odd row, odd column
    assert torch.allclose(pixels.signal, frame.signal[:, 2 * row + 1, 2 * column + 1].double())
    assert torch.allclose(pixels.shot_variance, torch.tensor(short.noise**2).double())


def test_beside_the_streak_gain_and_offset_come_back():
    generator = torch.Generator().manual_seed(2)
    ground = torch.rand(3, 4000, generator=generator, dtype=torch.float64)
    gain, offset = torch.tensor([[1.02], [0.99], [1.0]]), torch.tensor([[0.003], [0.0], [-0.004]])
    noise = 0.004
    signal = gain * ground + offset + noise * torch.randn(3, 4000, generator=generator).double()
    signal[:, :40] += 0.3  # something else moved there
    known = torch.full_like(ground, 1e-12)
    beside = Beside.of(signal, ground, torch.full_like(ground, noise**2), known)
    found = torch.linalg.solve(beside.information, -beside.gradient)
    std = torch.linalg.inv(beside.information).diagonal().sqrt()
    truth = torch.cat([gain[:, 0] - 1, offset[:, 0]])
    # outliers count linearly: they pull, but not far
    assert ((found - truth).abs() < 6 * std).all()
    assert (std < 1e-3).all()


def test_a_view_tells_whose_noise_is_whose(short):
    five = replace(short.shot.background, frames=5)
    view = observe_streak(short.shot.image, five, short.estimator)
    frame = Frame.of(view, short.estimator, short.scene.camera)
    share = frame.ground_variance / frame.shot_variance
    # a brighter shot has more noise
    assert float(share.median()) == pytest.approx(0.2, rel=0.05)
    assert torch.allclose(frame.noisier(3.0).shot_variance, 3 * frame.shot_variance)
    assert frame.noisier(3.0).noisier(2.0).excess == 6


def mosaic_of(light, noise, seed):
    """The picture behind a Bayer mosaic."""
    pattern = ((0, 1), (1, 2))
    height, width = light.shape[1:]
    channel = torch.tensor(pattern).repeat(height // 2 + 1, width // 2 + 1)[:height, :width]
    raw = add_noise(light.gather(0, channel[None]), noise, seed)[None]
    return LinearImage(clipped=raw >= 1, mosaic=raw, pattern=pattern)


def test_behind_a_mosaic_each_pixel_tells_of_one_colour(short):
    noise = NoiseLevel(read=0.01)
    shot = mosaic_of(short.shot.clean_image, noise, 1)
    ground = mosaic_of(short.shot.clean_background, noise, 2)
    model = NoiseModel(
        read_variance=torch.full((1, 3), 1e-4),
        gain=torch.zeros(1, 3),
        density=torch.tensor([0.25, 0.5, 0.25]),
    )
    seen = Uniform(colour=short.scene.appearance.colour).observe(shot, ground, model)
    measured = torch.isfinite(seen.variance[0])
    assert torch.equal(measured.sum(0), torch.ones_like(measured[0], dtype=torch.long))
    assert torch.equal((seen.signal[0] * measured).sum(0), shot.mosaic[0, 0])
    view = observe_streak(shot, ground, short.estimator)
    pixels = Frame.of(view, short.estimator, short.scene.camera).about(
        short.scene.camera.project(short.points()), 16.0
    )
    used = torch.isfinite(pixels.shot_variance)
    assert (used.sum(0) == 1).all()
    assert pixels.ground_variance[~used].eq(0).all()


def test_channels_that_mix_colours_come_once_a_cell_of_the_mosaic(short):
    noise = NoiseLevel(read=0.004)
    shot = mosaic_of(short.shot.clean_image, noise, 1)
    ground = mosaic_of(short.shot.clean_background, noise, 2)
    estimator = TwoColour(colours=(short.scene.appearance.colour, (0.02, 0.02, 0.9)))
    view = observe_streak(shot, ground, estimator)
    pixels = Frame.of(view, estimator, short.scene.camera).about(
        short.scene.camera.project(short.points()), 16.0
    )
    assert pixels.signal.shape[0] == 1
    # only sites of red are kept
    assert pixels.place.remainder(2).unique().numel() == 1


def test_the_ground_s_slope_is_that_of_its_texture(short):
    frame = short.frame()
    y, x = torch.meshgrid(*(torch.arange(n).float() for n in frame.usable.shape), indexing="ij")
    waves = torch.stack([0.3 + 0.01 * x, 0.5 - 0.02 * y, 0.2 + 0.004 * x * y / 30])
    pixels = replace(frame, ground=waves).about(short.scene.camera.project(short.points()), 16.0)
    x, y = pixels.place.mT
    right = torch.stack([torch.full_like(x, 0.01), 0 * x, 0.004 * y / 30])
    down = torch.stack([0 * x, torch.full_like(x, -0.02), 0.004 * x / 30])
    assert torch.allclose(pixels.ground_slope, torch.stack([right, down]), atol=1e-6)


def test_the_lens_mixes_rim_and_ground_by_their_joint_change(short):
    """The mean of a product over the spread, for an opacity and a ground that are both linear."""
    pixels = short.pixels()
    slope = torch.tensor([[0.1], [-0.05]]).double().expand(2, len(pixels))
    mixed = pixels.behind_lens(slope, 0.6).mixed
    spread = 0.6**0.5 * torch.randn(200_000, 2, generator=torch.Generator().manual_seed(0)).double()
    joint = ((spread @ slope[:, 0]) * (spread @ pixels.ground_slope[:, 1, 7])).mean()
    assert float(mixed[1, 7]) == pytest.approx(-float(joint), rel=0.05)
    assert (pixels.mixed == 0).all()
    coarse = short.pixels(3)
    slope = slope[:, : len(coarse)]
    share = coarse.behind_lens(slope, 0.6).mixed / -(slope[:, None] * coarse.ground_slope).sum(0)
    assert torch.allclose(share, torch.tensor(0.6 + 8 / 12).double())


@pytest.mark.parametrize("side", [1, 3])
def test_the_ring_about_a_square_leaves_out_its_own_light(short, side):
    ground = short.frame().ground
    squares = short.pixels(side).squares[0]
    at = len(squares) // 2
    ring = squares.ring(ground)[:, at]
    if side == 1:
        column, row = squares.corner[at].tolist()
        assert torch.allclose(ring, ring_mean(ground[None])[0, :, row, column], atol=1e-5)
    column, row = squares.corner[at].tolist()
    own = torch.zeros_like(ground)
    own[:, row - 1 : row + side + 1, column - 1 : column + side + 1] = 1
    assert torch.equal(squares.ring(ground + own)[:, at], ring)
    own[:, row + side + 1, column] = 1
    assert (squares.ring(ground + own)[:, at] > ring).all()
